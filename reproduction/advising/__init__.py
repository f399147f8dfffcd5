"""Chapter 5: every strategy of advising, beside Table 5.2."""
