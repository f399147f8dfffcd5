"""Wrappers that join perception and modelling to environments."""
