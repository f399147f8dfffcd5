"""Tasks: what is to be done, how starts are drawn, what is rewarded and what costs."""
