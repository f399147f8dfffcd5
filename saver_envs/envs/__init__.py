"""Thin adapters over the core: Gymnasium, its vector API, PettingZoo and Stable-Baselines3."""
