"""Frozen policies: their networks, cards and files, and the teachers that act with them."""
