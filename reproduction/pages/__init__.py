"""The documentation that comes from the code and from `docs/results`: its text and its pictures."""
