"""Generate the documentation that comes from the code and from `docs/results`."""
