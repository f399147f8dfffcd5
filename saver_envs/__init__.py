"""SAVER environments: goal-conditioned one- and two-arm manipulation on MuJoCo."""

from saver_envs.registration import register_all

register_all()
