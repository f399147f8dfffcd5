"""Where a training run spends its time, beside stock SB3."""
