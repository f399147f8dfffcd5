"""Profile a training run and compare its speed with stock SB3."""
