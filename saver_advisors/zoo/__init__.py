"""RL Zoo with our algorithms, environments and advice."""
