"""RL Zoo with our algorithms, environments and advice."""

from saver_advisors.zoo.algorithms import ALGORITHMS, register_algorithms

__all__ = ["ALGORITHMS", "register_algorithms"]
