"""The arms that can be modelled: one row each, with all that generators and models need."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.dh import (
    MICO_TABLE,
    MICO_TABLE_LIMITS,
    MICO_TOOL,
    fetch_chain,
    mico_chain,
    table_limits,
)
from saver_envs.modelling.inertia import Links, fetch_appendix_links, mico_appendix_links
from saver_envs.modelling.mujoco_chain import chain_of_model
from saver_envs.robots.description import Fingers, Robot
from saver_envs.robots.fetch import FETCH
from saver_envs.robots.jaco import JACO
from saver_envs.robots.mico import MICO

Pose = Literal["position", "pose"]
#: Inverse kinematics or inverse dynamics.
Task = Literal["ik", "id"]
TASK_NAMES: Final[Mapping[Task, str]] = {"ik": "inverse kinematics", "id": "inverse dynamics"}


@dataclass(frozen=True)
class Arm:
    """An arm as the models see it.

    :param name: lower-case name.
    :param robot: its description.
    :param chain: its kinematics, of the tool that the data and the paper speak of.
    :param tool_chain: its kinematics, of the tool that the environments' set-points refer to.
    :param lower: (dof,) where joints are sampled from; continuous joints have a turn, radians.
    :param upper: (dof,).
    :param target: whether targets are positions (3 numbers) or poses (position, then the rotation
        vector from the tool-down orientation: 6 numbers).
    :param appendix_links: the paper's inertia, where it has one.
    :param idle_joints: joints that do not move the tool's position.
    """

    name: str
    robot: Robot
    chain: Chain
    tool_chain: Chain
    lower: FloatArray
    upper: FloatArray
    target: Pose
    appendix_links: Callable[[], Links] | None = None
    idle_joints: tuple[int, ...] = ()

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.chain.dof

    @property
    def target_size(self) -> int:
        """Numbers of a target."""
        return 3 if self.target == "position" else 6

    @property
    def joint_lower(self) -> FloatArray:
        """Limits (dof,) that a command may never leave; minus infinity where there are none."""
        return np.asarray(self.robot.joint_lower)

    @property
    def joint_upper(self) -> FloatArray:
        """Limits (dof,) that a command may never leave; infinity where there are none."""
        return np.asarray(self.robot.joint_upper)


def _mico() -> Arm:
    lower, upper = table_limits(MICO_TABLE, MICO_TABLE_LIMITS)
    return Arm(
        "mico",
        MICO,
        mico_chain(),
        mico_chain(MICO_TOOL),
        lower,
        upper,
        "position",
        mico_appendix_links,
        idle_joints=(3,),
    )


def _fetch() -> Arm:
    lower, upper = _one_turn(FETCH)
    chain = fetch_chain()
    return Arm("fetch", FETCH, chain, chain, lower, upper, "position", fetch_appendix_links)


def _jaco() -> Arm:
    model = JACO.build(Fingers.LOCKED).compile()
    chain = chain_of_model(model, JACO.base_body, JACO.arm_joints, JACO.tool_site)
    lower, upper = _one_turn(JACO)
    return Arm("jaco", JACO, chain, chain, lower, upper, "pose")


def _one_turn(robot: Robot) -> tuple[FloatArray, FloatArray]:
    lower = np.maximum(np.asarray(robot.joint_lower), -math.pi)
    return lower, np.minimum(np.asarray(robot.joint_upper), math.pi)


_BUILDERS = {"mico": _mico, "fetch": _fetch, "jaco": _jaco}
ARMS = tuple(_BUILDERS)


@cache
def arm_named(name: str) -> Arm:
    """Return an arm.

    :raises ValueError: for a name that is not in ``ARMS``.
    """
    if name not in _BUILDERS:
        raise ValueError(f"robot={name!r}: must be one of {', '.join(ARMS)}")
    return _BUILDERS[name]()
