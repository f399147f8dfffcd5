"""Evaluation: episodes with fixed seeds, what is counted in them, and what curves of them say."""
