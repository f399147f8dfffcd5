"""Robot arms, one file each, and the table of their names."""

from saver_envs.robots.description import Robot
from saver_envs.robots.jaco import JACO
from saver_envs.robots.mico import MICO
from saver_envs.robots.ur10e import UR10E

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (JACO, MICO, UR10E)}
"""Every robot by its name; `register_robot` adds to it."""

__all__ = ["JACO", "MICO", "ROBOTS", "UR10E", "Robot"]
