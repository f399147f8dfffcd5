"""What reproduces the dissertation: `python -m reproduction NAME`, from a clone."""
