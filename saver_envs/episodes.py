"""Task + simulation + control = n episodes in step; the only place with an episode clock."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from saver_envs.control import (
    DampedLeastSquares,
    InverseKinematics,
    bounded,
    checked_action,
)
from saver_envs.randomization.presets import NO_RANDOMIZATION, Randomization, Values
from saver_envs.robots.description import Fingers, Robot
from saver_envs.scenes import Arms, Scene, compose
from saver_envs.simulation import ACTION_DURATION, ArmState, Simulation
from saver_envs.tasks.contract import PENDING, Memory, NoStart, Start, Task
from saver_envs.tasks.layout import Layout
from saver_envs.validation import require
from saver_envs.worlds import Worlds

Control = Literal["cartesian", "joints"]

#: Top speeds of the set-point (m/s): ours by default, the makers' (Table 5.3) when rated.
DEFAULT_SPEED, RATED_SPEED = 0.5, 0.2
#: Largest lead of the targets over the joints in joint control (rad); at full speed it is 0.11.
JOINT_LEAD = 0.15
#: Most actions in an episode.
LONGEST_EPISODE = 1_000_000
_MOST_REDRAWS = 50


@dataclass(frozen=True)
class Settings:
    """How the arms of an episode are driven, whatever the task.

    :param robot: the arm.
    :param horizon: actions in an episode.
    :param max_speed: top speed of the set-points, m/s.
    :param limit_joint_speed: keep the joints' targets within the makers' joint speed limits.
    :param control: ``cartesian`` (displacements of the tool) or ``joints`` (of the joint angles).
    :param bounded_observations: clip observations and goals to the limits of their parts.
    :param randomization: what differs between episodes.
    :param report_parameters: whether ``info`` has the values that were drawn.
    :param collision_force: measure the force of the contacts that ``cost_collision`` counts.
    :raises ValueError: for a value out of range.
    """

    robot: Robot
    horizon: int = Task.horizon
    max_speed: float = DEFAULT_SPEED
    limit_joint_speed: bool = False
    control: Control = "cartesian"
    bounded_observations: bool = False
    randomization: Randomization = NO_RANDOMIZATION
    report_parameters: bool = False
    collision_force: bool = False

    def __post_init__(self) -> None:
        speed, known = self.max_speed, self.control in get_args(Control)
        steps, most = self.horizon, LONGEST_EPISODE
        require("max_episode_steps", steps, 1 <= steps <= most, f"1 to {most} actions")
        require("max_speed", speed, 0 < speed <= 2, "above 0 and at most 2 m/s")
        require("control", self.control, known, "'cartesian' or 'joints'")


@dataclass(frozen=True)
class Observation:
    """What an agent sees; fresh float32 arrays with one row per episode.

    :param observation: (n, observation size).
    :param achieved_goal: (n, goal size).
    :param desired_goal: (n, goal size).
    """

    observation: NDArray[np.float32]
    achieved_goal: NDArray[np.float32]
    desired_goal: NDArray[np.float32]

    def as_dict(self) -> dict[str, NDArray[np.float32]]:
        """Return the three arrays under the names of the goal API."""
        return dict(vars(self))


@dataclass(frozen=True)
class Outcome:
    """What a step or a reset led to; every array has one entry per episode.

    :param reward: (n,) float32.
    :param truncated: (n,) the episode is over: its horizon is reached, or it diverged.
    :param success: (n,) ``is_success``.
    :param safe_success: (n,) success in an episode without a step of ``cost_collision``, or of
        ``cost`` for a task without that cost.
    :param reached: (n,) the goal is reached now.
    :param lost: (n,) an object has been beyond the table's edge in the episode.
    :param diverged: (n,) the simulation broke down in this step.
    :param cost: (n,) sum of the costs that the task names.
    :param measured: name -> (n,) of every cost, ``cost_<name>``, and of the task's readings.
    :param parameters: name -> (n, size) of what was drawn for the episode, where ``info`` has it.
    """

    reward: NDArray[np.float32]
    truncated: NDArray[np.bool_]
    success: NDArray[np.bool_]
    safe_success: NDArray[np.bool_]
    reached: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    diverged: NDArray[np.bool_]
    cost: NDArray[np.float64]
    measured: dict[str, NDArray[np.float64]]
    parameters: Values | None = None

    def info(self) -> dict[str, NDArray[np.generic]]:
        """Return the entries of ``info``, an array of n each."""
        return {
            "is_success": self.success,
            "safe_success": self.safe_success,
            "goal_reached": self.reached,
            "object_lost": self.lost,
            "diverged": self.diverged,
            "cost": self.cost,
            **self.measured,
        }

    def info_of(self, index: int) -> dict[str, Any]:
        """Return the ``info`` of one episode, of plain Python values."""
        info: dict[str, Any] = {name: values[index].item() for name, values in self.info().items()}
        return info | self.parameters_of(index)

    def parameters_of(self, index: int) -> dict[str, Any]:
        """Return the entry ``parameters`` of the ``info`` of one episode, if it has one."""
        if self.parameters is None:
            return {}
        return {
            "parameters": {
                name: values[index].item() if values.shape[1] == 1 else values[index].copy()
                for name, values in self.parameters.items()
            }
        }


#: Attributes of :class:`Episodes` that change from step to step.
_CHANGING = (
    *("set_point", "goal", "elapsed", "_failed", "_collided", "_lost", "_observation", "_achieved"),
    *("_missed", "memory"),
)


@dataclass(frozen=True)
class EpisodesState:
    """Everything that n episodes' future depends on.

    :param simulation: (n, state size) the simulations' state.
    :param changing: arrays with one row per episode, and the task's memory, by attribute.
    :param generators: the episodes' sources of randomness.
    :param worlds: what differs between the episodes.
    """

    simulation: NDArray[np.float64]
    changing: dict[str, Any]
    generators: tuple[np.random.Generator, ...]
    worlds: dict[str, Any]


class Episodes:
    """n episodes of one task, stepped together.

    They can be pickled and deep-copied within an episode: the copy is rebuilt from the
    constructor's arguments, takes over the state and continues identically.

    :param task: what is to be done.
    :param settings: robot, limits and control.
    :param n: number of episodes.
    :param threads: native threads of the simulation.
    :param inverse_kinematics: set-points to joint targets; damped least squares by default.
    """

    def __init__(
        self,
        task: Task,
        settings: Settings,
        n: int = 1,
        threads: int = 1,
        inverse_kinematics: InverseKinematics | None = None,
    ) -> None:
        self.task = task
        self.settings = settings
        self.n = n
        robot = settings.robot
        arms = Arms(robot, task.n_arms, task.fingers, task.bases)
        self.scene: Scene = compose(arms, task, settings.collision_force)
        self.simulation = Simulation(self.scene, n, threads, task.keeps_peaks)
        self._threads = threads
        self.inverse_kinematics: InverseKinematics = inverse_kinematics or DampedLeastSquares(robot)
        self._joint_lower = np.asarray(robot.joint_lower)
        self._joint_upper = np.asarray(robot.joint_upper)
        self._joint_speed = np.asarray(robot.joint_speed_limits)
        self._has_gripper = task.fingers is Fingers.ACTUATED
        degrees_of_freedom = len(robot.arm_joints)
        #: Size of the motion in an arm's action, which comes first.
        self.motion_size = 3 if settings.control == "cartesian" else degrees_of_freedom
        #: Size of an arm's action: motion, and the gripper command if the fingers move.
        self.action_size_per_arm = self.motion_size + self._has_gripper
        #: Size of an action, arm after arm.
        self.action_size = self.action_size_per_arm * task.n_arms
        self.worlds = Worlds(
            task, self.simulation, settings.randomization, settings.max_speed, self.action_size
        )
        #: Size of an observation.
        self.observation_size = task.observation_layout.size
        #: Size of a goal.
        self.goal_size = task.goal_layout.size
        self._generators = [np.random.default_rng() for _ in range(n)]
        self.memory: Memory = task.memory(n)
        self.set_point = np.zeros((n, task.n_arms, 3))
        #: (n,) actions since the reset; -1 before the first one.
        self.elapsed = np.full(n, -1, dtype=np.int64)
        #: (n, goal size) desired goals.
        self.goal = np.zeros((n, self.goal_size))
        self._failed = np.zeros(n, dtype=bool)
        self._collided = np.zeros(n, dtype=bool)
        self._lost = np.zeros(n, dtype=bool)
        # (n,) the last action after which the goal was not reached; 0 at the reset.
        self._missed = np.zeros(n, dtype=np.int64)
        self._arms: ArmState = self.simulation.arm_state()
        self._observation = np.zeros((n, self.observation_size))
        self._achieved = np.zeros((n, self.goal_size))

    def limits_of(self, layout: Layout) -> NDArray[np.float64]:
        """Return the greatest absolute values (size,); infinite unless observations are bounded.

        :param layout: the task's layout of observations, or of goals.
        """
        limited = self.settings.bounded_observations
        return layout.limits if limited else np.full(layout.size, np.inf)

    def set_generator(self, index: int, generator: np.random.Generator) -> None:
        """Give episode ``index`` its source of randomness for the resets to come."""
        self._generators[index] = generator

    def get_state(self) -> EpisodesState:
        """Return a copy of everything that the episodes' future depends on."""
        changing = {name: getattr(self, name) for name in _CHANGING}
        generators = tuple(copy.deepcopy(self._generators))
        return EpisodesState(
            self.simulation.get_state(),
            copy.deepcopy(changing),
            generators,
            self.worlds.get_state(),
        )

    def set_state(self, state: EpisodesState) -> None:
        """Go back to a state that :meth:`get_state` returned; what follows is then the same.

        :param state: of these episodes, or of others built from the same arguments.
        :raises ValueError: for a state of another scene or another number of episodes.
        """
        changing = copy.deepcopy(state.changing)
        self.memory = changing["memory"]
        self.worlds.set_state(state.worlds)
        self.task.restore(self.simulation, self.memory)
        self.simulation.set_state(state.simulation)
        for name, values in changing.items():
            setattr(self, name, values)
        self._arms = self.simulation.arm_state()
        self._generators = list(copy.deepcopy(state.generators))

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = (self.task, self.settings, self.n, self._threads, self.inverse_kinematics)
        # Generators as they are, since an environment may share its own with its episode.
        state = replace(self.get_state(), generators=tuple(self._generators))
        return type(self), arguments, state

    def __setstate__(self, state: EpisodesState) -> None:
        self.set_state(state)
        self._generators = list(state.generators)

    def reset(self, ids: Sequence[int] | NDArray[np.intp] | None = None) -> Outcome:
        """Start new episodes.

        :param ids: which of the n; all by default.
        :return: the outcome of all n, of which that of ``ids`` is new: cost 0, not truncated.
        """
        rows = self._rows(ids)
        self.worlds.draw(rows, self._generators)
        starts = self._begin(rows)
        self.worlds.begin_errors(rows, self._generators)
        self.set_point[rows] = np.stack([start.hand for start in starts])
        self.goal[rows] = self._clipped(self.task.desired(starts), self.task.goal_layout)
        self.elapsed[rows] = self._missed[rows] = 0
        self._failed[rows] = self._collided[rows] = self._lost[rows] = False
        self._read(rows, begins=True)
        self.simulation.collided[:] = False
        self.simulation.collision_force[:] = 0.0
        return self._outcome(np.zeros(self.n, dtype=bool))

    def _rows(self, ids: Sequence[int] | NDArray[np.intp] | None) -> NDArray[np.intp]:
        """Return the indices (k,) of some episodes, or of all."""
        return np.arange(self.n) if ids is None else np.asarray(ids, dtype=np.intp)

    def _begin(self, rows: NDArray[np.intp]) -> list[Start]:
        """Draw starts of episodes ``rows`` and place everything.

        The sampler treats hands as points. Only the simulation shows whether one touches its
        object, such as open fingers a large cube; such a start is drawn again.
        """
        task, simulation = self.task, self.simulation
        starts: dict[int, Start] = {}
        left = rows
        for _ in range(_MOST_REDRAWS):
            drawn = [self._sample(row) for row in left.tolist()]
            starts.update(zip(left.tolist(), drawn, strict=True))
            task.place(simulation, self.memory, left, drawn)
            left = left[~task.valid(simulation, self.memory, left, drawn)]
            if not left.size:
                return [starts[row] for row in rows.tolist()]
        touching = simulation.contacts_of(int(left[0]), task.resting)
        raise RuntimeError(
            f"{_MOST_REDRAWS} starts of the task {task.name!r} in a row were not valid; in the "
            f"last one {touching or 'nothing'} touched ({task})"
        )

    def _sample(self, row: int) -> Start:
        """Draw the start of an episode, in another world where its own has none."""
        for _ in range(_MOST_REDRAWS):
            try:
                return self.worlds.tasks[row].sample(self._generators[row], self.scene)
            except NoStart:
                if not self.settings.randomization:
                    raise
                self.worlds.draw(np.array([row]), self._generators)
        raise NoStart(
            f"{_MOST_REDRAWS} worlds of randomization={self.settings.randomization.as_json()} in a "
            f"row have no start of the task {self.task.name!r}"
        )

    def step(self, actions: NDArray[np.floating], ids: NDArray[np.intp] | None = None) -> Outcome:
        """Apply one action to every episode, or to some.

        :param actions: (n, action_size); clipped to [-1, 1]. A Cartesian motion of 1 moves the
            set-point by ``max_speed`` times 0.04 s along its axis; the whole displacement is no
            longer than that. A gripper command of 1 opens the hand, -1 closes it.
        :param ids: (k,) which of the n to step; all by default. The others stay where they are
            and must be reset before they are stepped again: their set-points have moved on.
        :return: the outcome of all n, of which that of ``ids`` is new.
        :raises ValueError: for a wrong shape or a value that is not finite; nothing has changed.
        :raises gymnasium.error.ResetNeeded: before the first reset of an episode.
        """
        checked = self.checked(actions)
        everything = slice(None) if ids is None else ids
        self.require_begun(everything)
        if self.task.observe_pending_motion:
            sent = checked.reshape(self.n, self.task.n_arms, -1)
            self.worlds.send(sent[..., : self.motion_size], self._rows(ids))
        arriving = self.worlds.delayed("action_delay", checked, self._rows(ids))
        blocks = arriving.reshape(self.n, self.task.n_arms, -1)
        self.task.drive(self.simulation, self.memory, everything)
        targets = self.simulation.ctrl.copy()
        arm_targets = self._arm_targets(blocks[..., : self.motion_size], targets)
        targets[:, self.scene.arm_ctrl] = arm_targets
        if self._has_gripper:
            robot = self.settings.robot
            closing = (1 - blocks[..., -1:]) / 2
            finger = robot.finger_open + closing * (robot.finger_closed - robot.finger_open)
            targets[:, self.scene.finger_ctrl] = finger
        diverged = self.simulation.step(targets, self.settings.limit_joint_speed, ids)
        self.elapsed[everything] += 1
        rows = ids
        if diverged.any():
            broken = np.flatnonzero(diverged)
            self._begin(broken)  # a sound state, in which they can be stepped until reset
            rows = np.setdiff1d(np.arange(self.n) if ids is None else ids, broken)
        self._read(rows)
        return self._outcome(diverged)

    def require_begun(self, rows: NDArray[np.intp] | slice = slice(None)) -> None:
        """Check that episodes have begun.

        :raises gymnasium.error.ResetNeeded: for those that have never been reset.
        """
        if (self.elapsed[rows] < 0).any():
            raise ResetNeeded(
                "Cannot call env.step() before calling env.reset(): episodes "
                f"{np.flatnonzero(self.elapsed < 0).tolist()} have not begun"
            )

    def checked(self, actions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return actions (n, action_size) within [-1, 1].

        :raises ValueError: for a wrong shape or a value that is not finite.
        """
        return checked_action(actions, (self.n, self.action_size), "actions")

    def _arm_targets(
        self, motion: NDArray[np.float64], controls: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof), radians, for motions in [-1, 1]."""
        commanded = controls.take(self.scene.arm_ctrl, 1)
        if self.settings.control == "joints":
            # Joints may exceed their rated speed by the same factor as the tool.
            scale = self.worlds.speed / RATED_SPEED * ACTION_DURATION
            wanted = commanded + motion * self._joint_speed * scale
        else:
            wanted = self.inverse_kinematics(self._arms, self.moved_set_point(motion))
        if self.settings.limit_joint_speed:
            # One factor for all joints of an arm: clipping each by itself would bend the tool's
            # path and press the hand on the table.
            change = wanted - commanded
            excess = np.abs(change) / (self._joint_speed * ACTION_DURATION)
            wanted = commanded + change / np.maximum(excess.max(axis=-1, keepdims=True), 1.0)
        if self.settings.control == "joints":
            # Last, because contacts may push the joints of a blocked arm faster than they may move.
            present = self._arms.joint_position
            wanted = present + bounded(wanted - present, -JOINT_LEAD, JOINT_LEAD)
        return bounded(wanted, self._joint_lower, self._joint_upper)

    def moved_set_point(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Move the set-points as a Cartesian action does, and return them.

        :param motion: (n, arms, 3), in [-1, 1].
        :return: (n, arms, 3) in the base frames, metres.
        """
        rule = self.worlds.set_points
        self.set_point = rule.moved(self.set_point, motion, self._arms.tool_position)
        return self.set_point

    def _read(self, rows: NDArray[np.intp] | None = None, begins: bool = False) -> None:
        """Read observations and achieved goals of ``rows``, or of all.

        The others keep what was read before: a diverged episode its last good observation.

        :param begins: whether these episodes begin now.
        """
        task, simulation = self.task, self.simulation
        self._arms = simulation.arm_state()
        seen = task.observe(simulation, self.memory, self._arms)
        if task.observe_pending_motion:  # its values follow, since they are known without delay
            seen[PENDING.name] = np.zeros_like(self.set_point)
        every, layout = self._rows(rows), task.observation_layout
        observation = self.worlds.measured(layout.join(seen), every)
        observation = self._clipped(observation, layout)
        if begins:
            self.worlds.begin_delays(every, self._resting_actions()[every], observation[every])
        else:
            observation = self.worlds.delayed("observation_delay", observation, every)
        if task.observe_pending_motion:
            layout.get(observation, PENDING.name)[...] = self.worlds.pending_motion()
        achieved = task.achieved(simulation, self.memory, seen)
        achieved = self._clipped(achieved, task.goal_layout)
        if rows is None:
            self._observation, self._achieved = observation, achieved
        else:
            self._observation[rows] = observation[rows]
            self._achieved[rows] = achieved[rows]

    def _resting_actions(self) -> NDArray[np.float64]:
        """Return actions (n, action size) that leave the arms where they are."""
        blocks = np.zeros((self.n, self.task.n_arms, self.action_size_per_arm))
        if self._has_gripper:
            robot = self.settings.robot
            finger = self.simulation.ctrl.take(self.scene.finger_ctrl, 1).mean(axis=-1)
            closing = (finger - robot.finger_open) / (robot.finger_closed - robot.finger_open)
            blocks[..., -1] = 1 - 2 * closing
        return blocks.reshape(self.n, -1)

    def _clipped(self, values: NDArray[np.float64], layout: Layout) -> NDArray[np.float64]:
        """Return values (k, size) within the layout's limits, if observations are bounded."""
        if not self.settings.bounded_observations:
            return values
        return bounded(values, -layout.limits, layout.limits)

    def _outcome(self, diverged: NDArray[np.bool_]) -> Outcome:
        # From the float32 values that agents see, so that relabelling gives exactly the same
        # rewards.
        task = self.task
        achieved, desired = self._achieved.astype(np.float32), self.goal.astype(np.float32)
        measured = task.measure(self.simulation, self.memory, achieved, desired)
        reward, reached = task.reward_and_reached(achieved, desired)
        for name in task.hard:
            self._failed |= measured[f"cost_{name}"] > 0
        cost = sum((measured[f"cost_{name}"] for name in task.summed), np.zeros(self.n))
        self._collided |= measured.get("cost_collision", cost) > 0
        if task.keeps_to_table:
            self._lost |= self.simulation.off_table()
        self._missed = np.where(reached, self._missed, self.elapsed)
        held = self.elapsed - self._missed >= task.hold
        success = reached & held & ~self._failed & ~self._lost
        return Outcome(
            reward=reward,
            truncated=(self.elapsed >= self.settings.horizon) | diverged,
            success=success,
            safe_success=success & ~self._collided,
            reached=reached,
            lost=self._lost.copy(),
            diverged=diverged,
            cost=cost,
            measured=measured,
            parameters=self.worlds.values if self.settings.report_parameters else None,
        )

    def observation(self) -> Observation:
        """Return what the agents see now, in new arrays."""
        return Observation(
            self._observation.astype(np.float32),
            self._achieved.astype(np.float32),
            self.goal.astype(np.float32),
        )

    def targets(self) -> NDArray[np.float64]:
        """Return the points (n, k, 3) that the scene's target sites show, world frame, metres."""
        return self.task.targets(self.scene, self.goal)

    def variant_of(self, index: int) -> int:
        """Return which of the scene's models episode ``index`` has."""
        return self.task.variant_of(self.memory, index)

    def decorate(self, model: mujoco.MjModel, index: int) -> None:
        """Adapt a drawing model to episode ``index``: decorations and targets."""
        self.worlds.tasks[index].decorate(model, self.memory, index)
        self.worlds.decorate(model, index)
        model.site_pos[self.scene.target_site] = self.targets()[index]
