"""Robot arms, one file each, and the table that names them."""

from saver_envs.robots.description import Robot
from saver_envs.robots.jaco import JACO

ROBOTS: dict[str, Robot] = {robot.name: robot for robot in (JACO,)}

__all__ = ["JACO", "ROBOTS", "Robot"]
