"""Worlds that vary: what differs between episodes, and by which distributions."""

from saver_envs.randomization.distributions import Choice, LogUniform, Uniform
from saver_envs.randomization.parameters import Parameter

__all__ = ["Choice", "LogUniform", "Parameter", "Uniform"]
