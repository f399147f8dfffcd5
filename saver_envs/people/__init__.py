"""People: bodies, postures, and the loads on them."""
