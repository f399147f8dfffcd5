"""Policies of the Jaco, unchanged, on other arms, beside Table 5.4."""
