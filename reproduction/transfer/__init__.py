"""Run Jaco policies unchanged on other arms and compare them with Table 5.4."""
