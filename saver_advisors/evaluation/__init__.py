"""Evaluation: episodes with fixed seeds, metrics of learning curves, and statistics over seeds."""
