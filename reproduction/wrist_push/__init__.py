"""Evaluate the whole robot over many trials and compare it with chapter 8."""
