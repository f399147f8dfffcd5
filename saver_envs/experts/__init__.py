"""Scripted experts: they solve the tasks from the observation alone, and prove that they can be."""

from saver_envs.experts.evaluation import ExpertRow, evaluate_expert, expert_table
from saver_envs.experts.expert import Expert, make_expert

__all__ = ["Expert", "ExpertRow", "evaluate_expert", "expert_table", "make_expert"]
