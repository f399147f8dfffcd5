"""Ids are rows: id -> task, robot, arms. Adapters build their episodes from a row and options.

The rows of this package are registered like your own: see :func:`register_task` and
:func:`register_robot`.
"""

from __future__ import annotations

import difflib
import inspect
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from typing import Any

import gymnasium
import numpy as np
import pettingzoo

from saver_envs.control import InverseKinematics
from saver_envs.episodes import DEFAULT_SPEED, RATED_SPEED, Control, Episodes, Settings
from saver_envs.randomization.parameters import COMMON, Parameter
from saver_envs.randomization.presets import parse_randomization
from saver_envs.robots import ROBOTS
from saver_envs.robots.description import Robot
from saver_envs.tasks.arm_straighten import ArmStraighten
from saver_envs.tasks.carry import Carry
from saver_envs.tasks.contract import RewardType, Start, Task
from saver_envs.tasks.distance import Distance
from saver_envs.tasks.intake import Intake
from saver_envs.tasks.leg_straighten import LegStraighten
from saver_envs.tasks.log_roll import LogRoll
from saver_envs.tasks.pick_and_place import PickAndPlace
from saver_envs.tasks.push import Push
from saver_envs.tasks.wrist_push import WristPush
from saver_envs.validation import import_named, require_kind

#: Module whose ids need no prefix.
PACKAGE = "saver_envs"
#: Suffix of the name of an id with a dense reward.
DENSE = "Dense"

#: Default ids of commands: with one arm, and with two.
ONE_ARM_ID, TWO_ARM_ID = "JacoPush-v0", "DualJacoPush-v0"
#: Ids that are timed by default, and ids that the demo shows.
TIMED_IDS = (ONE_ARM_ID, "JacoPickAndPlace-v0", TWO_ARM_ID, "DualJacoPickAndPlace-v0")
SHOWN_IDS = (
    *(ONE_ARM_ID, "JacoPickAndPlace-v0", "MicoPush-v0"),
    *(TWO_ARM_ID, "DualJacoDistance-v0", "DualMicoPush-v0"),
)
#: The id of the closed loop of camera, policy and servos.
CASUALTY_ID = "WristPush-v0"
#: The ids by which a person is extracted, one after the other.
EXTRACTION_IDS = ("ArmStraighten-v0", "LegStraighten-v0", "Intake-v0")


@dataclass(frozen=True)
class EnvironmentRow:
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
class ControlOptions:
    """Keyword arguments of every id; its task adds more.

    :param n_arms: 1 to 4 arms; the id's number by default.
    :param max_episode_steps: actions in an episode; the task's horizon by default.
    :param max_speed: top speed of the set-points, m/s; 0.5, or 0.2 when rated.
    :param rated: the makers' setting (Table 5.3): 0.2 m/s, joint speed limits, the task's rated
        horizon. ``gymnasium.make`` and ``make_vec`` keep the horizon that is registered: pass
        ``max_episode_steps`` as well.
    :param control: ``cartesian`` displacements of the tool, or ``joints`` of the joint angles.
    :param bounded_observations: finite bounds of observations and goals, for libraries that need
        them; values beyond, which a regular episode does not have, are clipped.
    :param randomization: what differs between episodes: ``none``, ``mild``, ``wide``,
        ``held-out:NAME``, ``held-out:all``, or a mapping of parameters to distributions or numbers.
    :param report_parameters: put what was drawn into ``info["parameters"]``.
    :param collision_force: report ``collision_force`` (N) in ``info``: the highest of four samples
        a step of the net force between two things whose contact ``cost_collision`` counts. It costs
        3% of the step rate, and no episode differs.
    """

    n_arms: int | None = None
    max_episode_steps: int | None = None
    max_speed: float | None = None
    rated: bool = False
    control: Control = "cartesian"
    bounded_observations: bool = False
    randomization: Any = "none"
    report_parameters: bool = False
    collision_force: bool = False


#: Every id with its row, the dense twins behind the sparse ones.
ENVIRONMENTS: dict[str, EnvironmentRow] = {}
#: Id with camera pictures as observations -> the id whose episodes they show.
PIXELS: dict[str, str] = {}


def register_task(
    task: type[Task],
    name: str,
    robot: str,
    n_arms: int,
    *,
    version: int = 0,
    dense: bool = True,
    pixels: bool = False,
    check: bool = True,
) -> tuple[str, ...]:
    """Register a task with a robot under an id, for Gymnasium and for PettingZoo.

    Call it where your module is imported: ``gymnasium.make("your_module:YourTask-v0")`` and
    ``saver train --env your_module:YourTask-v0`` then find the id. The task's horizon is registered
    as ``max_episode_steps``. Ids of several arms are in PettingZoo's registry as well, behind
    ``saver_envs/``.

    :param task: the task's class.
    :param name: first part of the id, such as ``DualJacoPush``.
    :param robot: name of a registered robot.
    :param n_arms: number of arms.
    :param version: last part of the id.
    :param dense: register a twin with a dense reward, ``<name>Dense-v<version>``.
    :param pixels: register a twin whose observation is the RGB-D camera's picture,
        ``<name>Pixels-v<version>``.
    :param check: build episodes, reset them and step them once, to find out what the task lacks.
    :return: the ids.
    :raises ValueError: for a taken id, an unknown robot, or a task that lacks a part; the message
        names it.
    """
    if robot not in ROBOTS:
        raise ValueError(
            f"robot={robot!r} is not registered{_hint(robot, ROBOTS)}; register_robot adds one"
        )
    rows = {f"{name}-v{version}": EnvironmentRow(task, robot, n_arms, "sparse")}
    if dense:
        rows[f"{name}{DENSE}-v{version}"] = EnvironmentRow(task, robot, n_arms, "dense")
    pixel_id = f"{name}Pixels-v{version}"
    taken = [one for one in (*rows, pixel_id) if one in ENVIRONMENTS or one in PIXELS]
    if taken:
        raise ValueError(f"id {taken[0]!r} is taken: choose another name or version")
    if check:
        for row in rows.values():
            _check(row)
    ENVIRONMENTS.update(rows)
    for env_id in rows:
        gymnasium.register(
            id=env_id,
            entry_point="saver_envs.envs.goal_env:SaverGoalEnv",
            vector_entry_point="saver_envs.envs.vector_env:SaverVectorEnv",
            max_episode_steps=task.horizon,
            kwargs={"env_id": env_id},
        )
        if n_arms > 1:
            pettingzoo.register(
                "parallel",
                f"{PACKAGE}/{env_id}",
                entry_point="saver_envs.envs.parallel_env:parallel_env",
                kwargs={"env_id": env_id},
            )
    if pixels:
        PIXELS[pixel_id] = f"{name}-v{version}"
        gymnasium.register(
            id=pixel_id,
            entry_point="saver_envs.envs.pixel_env:SaverPixelEnv",
            max_episode_steps=task.horizon,
            kwargs={"env_id": PIXELS[pixel_id]},
        )
    return tuple(rows)


def register_robot(robot: Robot) -> Robot:
    """Register a robot under its name.

    :param robot: from a MuJoCo model, see :func:`saver_envs.robots.from_model.robot_from_model`.
    :return: the robot.
    :raises ValueError: for a taken name.
    """
    if robot.name in ROBOTS:
        raise ValueError(f"robot {robot.name!r} is registered already: choose another name")
    ROBOTS[robot.name] = robot
    return robot


def _check(row: EnvironmentRow) -> None:
    """Build an episode of a row and compare it with what the task declares.

    :raises ValueError: naming what is missing or of another size.
    """
    kind = row.task
    if not (inspect.isclass(kind) and issubclass(kind, Task) and is_dataclass(kind)):
        raise ValueError(f"task={kind!r}: must be a dataclass derived from saver_envs.Task")
    if not isinstance(getattr(kind, "name", None), str):
        raise ValueError(f"{kind.__name__}.name: must be the task's name in lower case")
    for group in ("summed", "hard"):
        if surplus := set(getattr(kind, group)) - set(kind.costs):
            raise ValueError(
                f"{kind.__name__}.{group} names {sorted(surplus)}: must be among its costs "
                f"{kind.costs}"
            )
    try:
        _check_episodes(kind.__name__, Episodes(*_described(row, ControlOptions(), {}), n=2))
    except NotImplementedError as error:
        method = traceback.extract_tb(error.__traceback__)[-1].name
        raise ValueError(f"{kind.__name__} lacks the method {method}()") from error
    except LookupError as error:
        raise ValueError(f"{kind.__name__}: {error}") from error


def _check_episodes(name: str, episodes: Episodes) -> None:
    """Start episodes and step them once, and compare the results with the task's declarations."""
    task, n = episodes.task, episodes.n
    generators = [np.random.default_rng(index) for index in range(n)]
    _check_start(name, episodes, [task.sample(one, episodes.scene) for one in generators])
    for index, generator in enumerate(generators):
        episodes.set_generator(index, generator)
    if episodes.reset().lost.any():
        raise ValueError(
            f"{name}.place: a body with a free joint starts beyond the table's edge: set "
            f"{name}.table_depth, or {name}.keeps_to_table = False"
        )
    outcome = episodes.step(np.zeros((n, episodes.action_size)))
    missing = [cost for cost in task.costs if f"cost_{cost}" not in outcome.measured]
    if missing:
        raise ValueError(f"{name}.measure: returns no cost_{missing[0]}, which costs names")
    measured: dict[str, Any] = {"reward": outcome.reward, **outcome.measured}
    for key, values in measured.items():
        if np.shape(values) != (n,):
            raise ValueError(f"{name}: {key} has shape {np.shape(values)}, must be {(n,)}")


def _check_start(name: str, episodes: Episodes, starts: list[Start]) -> None:
    """Place starts, and compare observation and goals with what the task declares."""
    task, simulation, memory = episodes.task, episodes.simulation, episodes.memory
    n, size = episodes.n, task.goal_layout.size
    task.place(simulation, memory, np.arange(n), starts)
    seen = task.observe(simulation, memory, simulation.arm_state())
    found = {
        (f"observe: part {part.name!r}", "observation"): (
            seen[part.name],
            (n, part.size) if part.shared else (n, task.n_arms, part.size),
        )
        for part in task.observation
    }
    found["achieved: the goal", "goal"] = task.achieved(simulation, memory, seen), (n, size)
    found["desired: the goal", "goal"] = task.desired(starts), (n, size)
    for (what, declared), (values, wanted) in found.items():
        if np.shape(values) != wanted:
            raise ValueError(
                f"{name}.{what} has shape {np.shape(values)}, but {name}.{declared} declares "
                f"{wanted}"
            )


def row_of(env_id: str) -> EnvironmentRow:
    """Return the row of an id; ``module:Id`` imports the module first, which registers it.

    :raises ValueError: for an unknown id; the message lists the valid ones.
    """
    module, _, name = env_id.rpartition(":")
    if name not in ENVIRONMENTS and module not in ("", PACKAGE):
        import_named(f"env_id={env_id!r}: {module!r}", module)
    if name in ENVIRONMENTS:
        return ENVIRONMENTS[name]
    raise ValueError(
        f"env_id={env_id!r} is not a registered environment{_hint(name, ENVIRONMENTS)}; valid ids "
        f"are {', '.join(ENVIRONMENTS)}"
    )


def _hint(name: str, valid: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(valid), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def default_options(env_id: str) -> dict[str, Any]:
    """Return every keyword argument of an id with its default."""
    return {name: field.default for name, field in _option_fields(env_id).items()}


def _option_fields(env_id: str) -> dict[str, Field[Any]]:
    task = [
        field
        for field in fields(row_of(env_id).task)
        if field.name not in ("n_arms", "reward_type") and field.default is not MISSING
    ]
    return {field.name: field for field in (*fields(ControlOptions), *task)}


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
    :param options: of :class:`ControlOptions`, and the fields of the task's class.
    :return: the episodes, not yet reset.
    :raises ValueError: for an unknown id or an option out of range.
    :raises TypeError: for an unknown option.
    """
    return Episodes(*task_and_settings(env_id, options), n, threads, inverse_kinematics)


def task_and_settings(env_id: str, options: Mapping[str, Any]) -> tuple[Task, Settings]:
    """Return task and settings of an id with these options, without building a simulation.

    :raises ValueError: for an unknown id or an option out of range.
    :raises TypeError: for an unknown option.
    """
    valid = _option_fields(env_id)
    for name, value in options.items():
        if name not in valid:
            # Python's wording, which TorchRL and Gymnasium look for.
            hint = " (it is 'max_episode_steps')" if name == "horizon" else _hint(name, valid)
            raise TypeError(
                f"{env_id} got an unexpected keyword argument {name!r}{hint}; valid keywords are "
                f"{', '.join(valid)}"
            )
        require_kind(name, value, valid[name].type)
    names = {one.name for one in fields(ControlOptions)}
    control = {name: value for name, value in options.items() if name in names}
    of_task = {name: value for name, value in options.items() if name not in names}
    return _described(row_of(env_id), ControlOptions(**control), of_task)


def varied_in(env_id: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the distributions of what varies in an environment, as JSON; none if nothing does.

    :raises ValueError: for an unknown id or an option out of range.
    :raises TypeError: for an unknown option.
    """
    return task_and_settings(env_id, options)[1].randomization.as_json()


def _described(
    row: EnvironmentRow, control: ControlOptions, of_task: Mapping[str, Any]
) -> tuple[Task, Settings]:
    n_arms = row.n_arms if control.n_arms is None else control.n_arms
    task = row.task(n_arms=n_arms, reward_type=row.reward_type, **of_task)
    if task.observe_pending_motion and control.control != "cartesian":
        raise ValueError(
            "observe_pending_motion=True: needs control='cartesian', which displaces set-points, "
            f"not {control.control!r}"
        )
    known = parameters_of(task)
    randomization = parse_randomization(control.randomization, known)
    speeds = randomization.distribution_of("max_speed")
    slow = control.rated or (speeds is not None and speeds.ends[0] < DEFAULT_SPEED)
    horizon = task.rated_horizon if slow else task.horizon
    speed = RATED_SPEED if control.rated else DEFAULT_SPEED
    return task, Settings(
        robot=ROBOTS[row.robot],
        horizon=horizon if control.max_episode_steps is None else control.max_episode_steps,
        max_speed=speed if control.max_speed is None else control.max_speed,
        limit_joint_speed=control.rated,
        control=control.control,
        bounded_observations=control.bounded_observations,
        randomization=randomization,
        report_parameters=control.report_parameters,
        collision_force=control.collision_force,
    )


def parameters_of(task: Task) -> tuple[Parameter, ...]:
    """Return what may differ between the episodes of a task: its own parameters, then others."""
    return (*task.parameters, *COMMON)


def register_all() -> None:
    """Register our own ids."""
    rows: tuple[tuple[type[Task], str, str, int], ...] = (
        (Push, "JacoPush", "jaco", 1),
        (PickAndPlace, "JacoPickAndPlace", "jaco", 1),
        (Push, "DualJacoPush", "jaco", 2),
        (PickAndPlace, "DualJacoPickAndPlace", "jaco", 2),
        (Distance, "DualJacoDistance", "jaco", 2),
        (Carry, "DualJacoCarry", "jaco", 2),
        (Push, "MicoPush", "mico", 1),
        (PickAndPlace, "MicoPickAndPlace", "mico", 1),
        (Push, "DualMicoPush", "mico", 2),
        (PickAndPlace, "DualMicoPickAndPlace", "mico", 2),
    )
    for task, name, robot, n_arms in rows:
        register_task(task, name, robot, n_arms, check=False)
    register_task(ArmStraighten, "ArmStraighten", "jaco", 2, check=False)
    register_task(LegStraighten, "LegStraighten", "jaco", 2, check=False)
    register_task(LogRoll, "LogRoll", "ur10e", 2, check=False)
    register_task(Intake, "Intake", "mico", 2, check=False)
    register_task(WristPush, "WristPush", "mico", 2, pixels=True, check=False)
