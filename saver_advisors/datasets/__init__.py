"""Data sets of episodes, for learning offline: Minari's format and LeRobot's."""
