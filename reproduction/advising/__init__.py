"""Chapter 5: all advising strategies, compared with Table 5.2."""
