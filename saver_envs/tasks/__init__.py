"""Tasks: their bodies, starts, observations, goals, rewards and costs."""
