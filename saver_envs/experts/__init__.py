"""Scripted experts: they solve the tasks from the observation alone, and prove that they can be."""

from saver_envs.experts.expert import Expert, make_expert

__all__ = ["Expert", "make_expert"]
