"""Scripted experts that solve the tasks from the observation alone."""

from saver_envs.experts.expert import Expert, expert_of, make_expert

__all__ = ["Expert", "expert_of", "make_expert"]
