"""Adapters of episodes: Gymnasium, its vector API, PettingZoo and Stable-Baselines3."""
