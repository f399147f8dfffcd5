"""Grids of training runs: read from a file, run on this machine or on a cluster, and resumed."""
