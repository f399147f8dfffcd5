"""Chapter 6: learning under a constraint, and the safe algorithms where the optimum is known."""
