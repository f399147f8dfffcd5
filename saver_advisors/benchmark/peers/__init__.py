"""Other suites, each in its own virtual environment and process."""
