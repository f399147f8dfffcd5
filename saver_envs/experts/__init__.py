"""Scripted experts that solve the tasks from the observation alone."""

from saver_envs.experts.expert import Expert, make_expert

__all__ = ["Expert", "make_expert"]
