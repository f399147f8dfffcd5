"""One table: id -> task, robot, arms. Adapters build their episodes from a row and options."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, fields
from typing import Any

import gymnasium
import pettingzoo

from saver_envs.control import InverseKinematics
from saver_envs.episodes import (
    DEFAULT_HORIZON,
    DEFAULT_SPEED,
    RATED_HORIZON,
    RATED_SPEED,
    Control,
    Episodes,
    Settings,
)
from saver_envs.robots import ROBOTS
from saver_envs.scenes import Layout, ObjectProperties
from saver_envs.tasks.base import SUCCESS_THRESHOLD, RewardType, Task
from saver_envs.tasks.distance import Distance, RewardCombination, RewardStage
from saver_envs.tasks.pick_and_place import PickAndPlace
from saver_envs.tasks.push import Push
from saver_envs.tasks.regions import OVERLAP
from saver_envs.tasks.wrist_push import HORIZON as WRIST_PUSH_HORIZON
from saver_envs.tasks.wrist_push import WristPush

VERSION = 0
#: Share of contested starts, set so that two arms which ignore one another fail often enough (see
#: docs/decisions.md).
CONTESTED_SHARE = 0.4


@dataclass(frozen=True)
class Row:
    """What an id stands for.

    :param task: the task's class.
    :param robot: name of the robot.
    :param n_arms: number of arms.
    :param reward_type: ``sparse`` or ``dense``.
    """

    task: type[Task]
    robot: str
    n_arms: int
    reward_type: RewardType


@dataclass(frozen=True)
class Options:
    """Keyword arguments of every id.

    :param n_arms: 1 to 4 arms; the id's number by default. The distance task needs 2.
    :param horizon: actions in an episode; 50, or 125 when rated; 250 in wrist push.
    :param max_speed: top speed of the set-points, m/s; 0.5, or 0.2 when rated.
    :param rated: the makers' setting (Table 5.3): 0.2 m/s, joint speed limits, 125 actions.
    :param success_threshold: distance of an object from its target that counts as reached, m.
    :param control: ``cartesian`` displacements of the tool, or ``joints`` of the joint angles.
    :param object_size: edge of the cubes, m.
    :param object_mass: mass of a cube, kg.
    :param object_friction: sliding friction of the cubes.
    :param object_damping: linear damping of the cubes' motion, N s/m.
    :param layout: bases in a ``row`` or a ``ring`` round the table.
    :param overlap: how far an arm's box reaches beyond the middle line to its neighbour, m.
    :param contested_share: share of the episodes of several arms in which the ways of two hands
        meet (push and pick and place).
    :param in_hand_share: share of the arms that start with their cube in hand (tasks whose fingers
        move; for training).
    :param reward_stage: ``goal`` or ``constrained`` (distance task alone).
    :param reward_combination: ``min``, ``linear`` or ``shaped``, how the constrained stage puts
        goal and constraint together (distance task alone).
    :param constraint_weight: of the constraint where they are summed (distance task alone).
    """

    n_arms: int | None = None
    horizon: int | None = None
    max_speed: float | None = None
    rated: bool = False
    success_threshold: float = SUCCESS_THRESHOLD
    control: Control = "cartesian"
    object_size: float = ObjectProperties.size
    object_mass: float = ObjectProperties.mass
    object_friction: float = ObjectProperties.friction
    object_damping: float = ObjectProperties.damping
    layout: Layout = "row"
    overlap: float = OVERLAP
    contested_share: float = CONTESTED_SHARE
    in_hand_share: float = 0.0
    reward_stage: RewardStage | None = None
    reward_combination: RewardCombination | None = None
    constraint_weight: float | None = None


def _rows() -> dict[str, Row]:
    """Return every id with its row, the Dense twins behind the sparse ones."""
    plain = {
        "JacoPush": (Push, "jaco", 1),
        "JacoPickAndPlace": (PickAndPlace, "jaco", 1),
        "DualJacoPush": (Push, "jaco", 2),
        "DualJacoPickAndPlace": (PickAndPlace, "jaco", 2),
        "DualJacoDistance": (Distance, "jaco", 2),
        "MicoPush": (Push, "mico", 1),
        "MicoPickAndPlace": (PickAndPlace, "mico", 1),
        "DualMicoPush": (Push, "mico", 2),
        "DualMicoPickAndPlace": (PickAndPlace, "mico", 2),
        "WristPush": (WristPush, "mico", 2),
    }
    rewards: tuple[tuple[str, RewardType], ...] = (("", "sparse"), ("Dense", "dense"))
    return {
        f"{name}{suffix}-v{VERSION}": Row(task, robot, n_arms, reward)
        for suffix, reward in rewards
        for name, (task, robot, n_arms) in plain.items()
        if robot in ROBOTS
    }


ENVIRONMENTS: dict[str, Row] = _rows()
#: Ids whose observation is the camera's picture alone, and the ids behind them.
PIXELS: dict[str, str] = {f"WristPushPixels-v{VERSION}": f"WristPush-v{VERSION}"}


def row_of(env_id: str) -> Row:
    """Return the row of an id, with or without the ``saver_envs:`` prefix.

    :raises ValueError: for an unknown id; the message lists the valid ones.
    """
    name = env_id.removeprefix("saver_envs:")
    if name in ENVIRONMENTS:
        return ENVIRONMENTS[name]
    raise ValueError(
        f"env_id={env_id!r} is not an environment of this package{_hint(name, ENVIRONMENTS)}; "
        f"valid ids are {', '.join(ENVIRONMENTS)}"
    )


def _hint(name: str, valid: Any) -> str:
    close = difflib.get_close_matches(name, list(valid), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def parse_options(options: dict[str, Any]) -> Options:
    """Turn keyword arguments into options.

    :raises TypeError: for an unknown keyword; the message lists the valid ones.
    """
    valid = [field.name for field in fields(Options)]
    for name in options:
        if name not in valid:
            raise TypeError(
                f"unknown keyword {name!r}{_hint(name, valid)}; valid keywords are "
                f"{', '.join(valid)}"
            )
    return Options(**options)


def make_episodes(
    env_id: str,
    n: int = 1,
    threads: int = 1,
    inverse_kinematics: InverseKinematics | None = None,
    **options: Any,
) -> Episodes:
    """Build n episodes of an id, as every adapter does.

    :param env_id: a registered id.
    :param n: number of episodes stepped together.
    :param threads: native threads of the simulation.
    :param inverse_kinematics: replaces damped least squares.
    :param options: see :class:`Options`.
    :return: the episodes, not yet reset.
    :raises ValueError: for an unknown id or an option out of range.
    :raises TypeError: for an unknown option.
    """
    row, chosen = row_of(env_id), parse_options(options)
    return Episodes(_task(row, chosen), _settings(row, chosen), n, threads, inverse_kinematics)


def _task(row: Row, options: Options) -> Task:
    _refuse_idle(row.task, options)
    n_arms = row.n_arms if options.n_arms is None else options.n_arms
    if row.task is Distance:
        constraint: dict[str, Any] = {name: getattr(options, name) for name in _OF_CONSTRAINT}
        return Distance(
            n_arms,
            row.reward_type,
            options.success_threshold,
            **{name: value for name, value in constraint.items() if value is not None},
        )
    if row.task is WristPush:
        return WristPush(n_arms, row.reward_type, options.success_threshold)
    return row.task(n_arms, row.reward_type, options.success_threshold, options.contested_share)


_OF_CONSTRAINT = ("reward_stage", "reward_combination", "constraint_weight")
#: Options that say how cubes are or how they start, and where other arms would stand.
_OF_CUBES = (
    "object_size",
    "object_mass",
    "object_friction",
    "object_damping",
    "layout",
    "contested_share",
    "in_hand_share",
)
_NO_CONSTRAINT = "only the distance task has a constraint in its reward"
#: Options that would change nothing in a task, by the reason. A task that is not named has no
#: constraint.
_IDLE: dict[type[Task], dict[str, tuple[str, ...]]] = {
    Push: {_NO_CONSTRAINT: _OF_CONSTRAINT, "the fingers of push are locked": ("in_hand_share",)},
    Distance: {"the cubes of the distance task go side by side": ("contested_share",)},
    WristPush: {
        _NO_CONSTRAINT: _OF_CONSTRAINT,
        "not an option of wrist push, whose two arms stand in a row and whose objects are a "
        "person's wrists": _OF_CUBES,
    },
}


def _refuse_idle(task: type[Task], options: Options) -> None:
    """Refuse what would change nothing, rather than let somebody believe that it does."""
    usual = Options()
    for reason, names in _IDLE.get(task, {_NO_CONSTRAINT: _OF_CONSTRAINT}).items():
        for name in names:
            value = getattr(options, name)
            if value != getattr(usual, name):
                raise ValueError(f"{name}={value!r}: {reason}")


def _settings(row: Row, options: Options) -> Settings:
    speed = RATED_SPEED if options.rated else DEFAULT_SPEED
    horizon = RATED_HORIZON if options.rated else DEFAULT_HORIZON
    if row.task is WristPush:  # long enough for either speed
        horizon = WRIST_PUSH_HORIZON
    return Settings(
        robot=ROBOTS[row.robot],
        horizon=horizon if options.horizon is None else options.horizon,
        max_speed=speed if options.max_speed is None else options.max_speed,
        limit_joint_speed=options.rated,
        control=options.control,
        objects=ObjectProperties(
            options.object_size,
            options.object_mass,
            options.object_friction,
            options.object_damping,
        ),
        layout=options.layout,
        overlap=options.overlap,
        in_hand_share=options.in_hand_share,
    )


def register_all() -> None:
    """Register every id with Gymnasium, and those of several arms with PettingZoo as well.

    Episodes end by their own clock, so no time limit is given. PettingZoo's ids have this package
    as their namespace: ``pettingzoo.make("parallel", "saver_envs/DualJacoPush-v0")``.
    """
    for env_id, row in ENVIRONMENTS.items():
        gymnasium.register(
            id=env_id,
            entry_point="saver_envs.envs.goal_env:SaverGoalEnv",
            vector_entry_point="saver_envs.envs.vector_env:SaverVectorEnv",
            kwargs={"env_id": env_id},
        )
        if row.n_arms > 1:
            pettingzoo.register(
                "parallel",
                f"saver_envs/{env_id}",
                entry_point="saver_envs.envs.parallel_env:parallel_env",
                kwargs={"env_id": env_id},
            )
    for env_id, behind in PIXELS.items():
        gymnasium.register(
            id=env_id,
            entry_point="saver_envs.envs.pixel_env:SaverPixelEnv",
            kwargs={"env_id": behind},
        )
