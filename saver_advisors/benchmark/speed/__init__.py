"""How fast the environments are, beside the bare simulator and beside other suites."""
