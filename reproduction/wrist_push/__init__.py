"""The whole robot over many trials, beside chapter 8."""
