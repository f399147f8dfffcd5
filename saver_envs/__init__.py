"""SAVER environments: goal-conditioned one- and two-arm manipulation on MuJoCo."""

from saver_envs.registration import register_all, register_robot, register_task
from saver_envs.tasks.contract import Start, Task, TaskPage
from saver_envs.tasks.layout import Part

__all__ = ["Part", "Start", "Task", "TaskPage", "register_robot", "register_task"]

register_all()
