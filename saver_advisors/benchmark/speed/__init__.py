"""The speed of the environments, compared with the bare simulator and with other suites."""
