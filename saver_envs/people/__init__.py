"""People: their bodies, how they lie, and what they feel."""
