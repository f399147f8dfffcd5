"""Wrappers round environments: sensors with errors, and readings of another robot's hand."""
