"""Evaluation: episodes with fixed seeds, and what is counted in them."""
