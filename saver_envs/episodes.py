"""Task + simulation + control = n episodes in step; the only place with an episode clock."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import DampedLeastSquares, InverseKinematics, bounded
from saver_envs.grasping import Grasp, settled_grasp
from saver_envs.people.bench import compose_with_person
from saver_envs.people.patient import Patient, People, joined
from saver_envs.reachability import reachability_map
from saver_envs.robots.description import Fingers, Robot
from saver_envs.scenes import Layout, ObjectProperties, Scene, compose
from saver_envs.simulation import SUBSTEPS, ArmState, ObjectState, Simulation, SimulationState
from saver_envs.tasks.base import Readings, Task
from saver_envs.tasks.observation import SIZE_PER_ARM, observe
from saver_envs.tasks.regions import OVERLAP, regions
from saver_envs.tasks.sampling import Start, StartSampler
from saver_envs.tasks.wrist_starts import WristStart, WristStartSampler

Control = Literal["cartesian", "joints"]

#: Duration of an action (s): 25 Hz.
ACTION_DURATION = SUBSTEPS * 0.002
#: Top speeds of the set-point (m/s): ours by default, the makers' (Table 5.3) when rated.
DEFAULT_SPEED, RATED_SPEED = 0.5, 0.2
DEFAULT_HORIZON, RATED_HORIZON = 50, 125
#: A set-point runs at most this many actions' way at top speed ahead of the tool, 0.05 m at
#: 0.5 m/s, so that a blocked arm presses with bounded force, turns round at once, and does not
#: race to catch up when it comes free.
LEASH = 2.5
#: So far may joint targets run ahead of the joints where they are the action (rad): more than they
#: lag at full speed, 0.11.
JOINT_LEASH = 0.15
#: Edges of cubes (m) that can be pushed by these hands and lie on the table within their reach.
OBJECT_SIZE = (0.04, 0.12)
_MOST_REDRAWS = 50


@dataclass(frozen=True)
class Settings:
    """Everything that makes a scene and its episodes, apart from the task.

    :param robot: the arm.
    :param horizon: actions in an episode.
    :param max_speed: top speed of the set-points, m/s.
    :param limit_joint_speed: keep the joints' targets within the makers' joint speed limits.
    :param control: ``cartesian`` (displacements of the tool) or ``joints`` (of the joint angles).
    :param objects: size, mass and friction of the cubes.
    :param layout: ``row`` or ``ring``.
    :param overlap: how far an arm's box reaches beyond the middle line to a neighbour, metres.
    :param in_hand_share: share of the arms that start an episode with their cube in hand, for
        training; 0 in evaluation.
    """

    robot: Robot
    horizon: int = DEFAULT_HORIZON
    max_speed: float = DEFAULT_SPEED
    limit_joint_speed: bool = False
    control: Control = "cartesian"
    objects: ObjectProperties = field(default_factory=ObjectProperties)
    layout: Layout = "row"
    overlap: float = OVERLAP
    in_hand_share: float = 0.0

    def __post_init__(self) -> None:
        checks = {
            "horizon": (self.horizon >= 1, "at least 1 action"),
            "max_speed": (0 < self.max_speed <= 2, "above 0 and at most 2 m/s"),
            "control": (self.control in ("cartesian", "joints"), "'cartesian' or 'joints'"),
            "overlap": (0 <= self.overlap <= 0.2, "0 to 0.2 m"),
            "in_hand_share": (0 <= self.in_hand_share <= 1, "0 to 1"),
        }
        for name, (holds, valid) in checks.items():
            if not holds:
                raise ValueError(f"{name}={getattr(self, name)!r}: must be {valid}")
        least, greatest = OBJECT_SIZE
        properties = {
            "size": (least <= self.objects.size <= greatest, f"{least} to {greatest} m"),
            "mass": (0 < self.objects.mass < np.inf, "above 0 kg"),
            "friction": (0 <= self.objects.friction < np.inf, "at least 0"),
            "damping": (0 <= self.objects.damping < np.inf, "at least 0 N s/m"),
        }
        for name, (holds, valid) in properties.items():
            if not holds:
                value = getattr(self.objects, name)
                raise ValueError(f"object_{name}={value!r}: must be {valid}")


@dataclass(frozen=True)
class Observation:
    """What an agent sees; fresh float32 arrays with one row per episode.

    :param observation: (n, 28 * arms).
    :param achieved_goal: (n, goal_size).
    :param desired_goal: (n, goal_size).
    """

    observation: NDArray[np.float32]
    achieved_goal: NDArray[np.float32]
    desired_goal: NDArray[np.float32]

    def as_dict(self) -> dict[str, NDArray[np.float32]]:
        """Return the three arrays under the names of the goal API."""
        return {
            "observation": self.observation,
            "achieved_goal": self.achieved_goal,
            "desired_goal": self.desired_goal,
        }


@dataclass(frozen=True)
class Outcome:
    """What a step or a reset led to; every array has one entry per episode.

    :param reward: (n,) float32.
    :param truncated: (n,) the episode is over: its horizon is reached, or it diverged.
    :param success: (n,) ``is_success``.
    :param reached: (n,) every object is at its target now.
    :param diverged: (n,) the simulation broke down in this step.
    :param costs: name -> (n,) of every cost.
    :param cost: (n,) sum of the costs that the task names.
    :param readings: name -> (n,) of what was measured besides, with a person on the bench:
        ``torso_force`` (N) and ``torso_displacement`` (m).
    """

    reward: NDArray[np.float32]
    truncated: NDArray[np.bool_]
    success: NDArray[np.bool_]
    reached: NDArray[np.bool_]
    diverged: NDArray[np.bool_]
    costs: dict[str, NDArray[np.float64]]
    cost: NDArray[np.float64]
    readings: Readings = field(default_factory=dict)

    def info(self) -> dict[str, NDArray[np.generic]]:
        """Return the entries of ``info``, an array of n each."""
        return {
            "is_success": self.success,
            "goal_reached": self.reached,
            "diverged": self.diverged,
            "cost": self.cost,
            **{f"cost_{name}": cost for name, cost in self.costs.items()},
            **self.readings,
        }

    def info_of(self, index: int) -> dict[str, bool | float]:
        """Return the ``info`` of one episode, of plain Python values."""
        return {name: values[index].item() for name, values in self.info().items()}


@dataclass(frozen=True)
class EpisodesState:
    """Everything that n episodes' future depends on; arrays with one row per episode.

    :param simulation: the simulations' state.
    :param set_point: (n, arms, 3) tool set-points in base frames, metres.
    :param target: (n, arms, 3) target points in base frames, metres.
    :param goal: (n, goal_size) desired goals.
    :param elapsed: (n,) actions since the reset.
    :param constraint_broken: (n,) whether what the task must never do was done.
    :param observation: (n, 28 * arms) as last read.
    :param achieved: (n, goal_size) as last read.
    :param generators: the episodes' sources of randomness.
    :param people: who lies on the bench, where somebody does.
    """

    simulation: SimulationState
    set_point: NDArray[np.float64]
    target: NDArray[np.float64]
    goal: NDArray[np.float64]
    elapsed: NDArray[np.int64]
    constraint_broken: NDArray[np.bool_]
    observation: NDArray[np.float64]
    achieved: NDArray[np.float64]
    generators: tuple[np.random.Generator, ...]
    people: People | None = None


class Episodes:
    """n episodes of one task, stepped together.

    They can be pickled and deep-copied in the midst of an episode: the copy is built anew from
    the constructor's arguments, takes over the state and goes on identically.

    :param task: what is to be done.
    :param settings: robot, limits, objects and control.
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
        self.scene: Scene = _scene(task, settings)
        self.simulation = Simulation(self.scene, n, threads)
        self.patient = Patient(self.simulation) if task.moves_person else None
        self.regions = regions(robot, task.n_arms, settings.layout, settings.overlap)
        self._threads = threads
        self.inverse_kinematics: InverseKinematics = inverse_kinematics or DampedLeastSquares(robot)
        self._reachability = reachability_map(robot)
        self._sampler = self._start_sampler()
        self._grasp: Grasp | None = None
        if settings.in_hand_share > 0 and task.fingers is Fingers.ACTUATED:
            self._grasp = settled_grasp(robot, settings.objects)
        self._joint_lower = np.asarray(robot.joint_lower)
        self._joint_upper = np.asarray(robot.joint_upper)
        self._joint_speed = np.asarray(robot.joint_speed_limits)
        self._has_gripper = task.fingers is Fingers.ACTUATED
        degrees_of_freedom = len(robot.arm_joints)
        self._motion_size = 3 if settings.control == "cartesian" else degrees_of_freedom
        self._generators = [np.random.default_rng() for _ in range(n)]
        arms = task.n_arms
        self.set_point = np.zeros((n, arms, 3))
        self.target = np.zeros((n, arms, 3))
        self.elapsed = np.zeros(n, dtype=np.int64)
        self._goal = np.zeros((n, task.goal_size))
        self._constraint_broken = np.zeros(n, dtype=bool)
        self._arms: ArmState = self.simulation.arm_state()
        self._observation = np.zeros((n, self.observation_size))
        self._achieved = np.zeros((n, task.goal_size))

    def _start_sampler(self) -> StartSampler | WristStartSampler:
        if self.patient is not None:
            return WristStartSampler(self.scene, self.regions, self._reachability)
        rules = self.task.start_rules(self.scene.object_rest_height)
        return StartSampler(self.scene, self.regions, self._reachability, rules)

    @property
    def action_size_per_arm(self) -> int:
        """Numbers of an arm's action: motion, and the gripper command where the fingers move."""
        return self._motion_size + self._has_gripper

    @property
    def action_size(self) -> int:
        """Numbers of an action, arm after arm."""
        return self.action_size_per_arm * self.task.n_arms

    @property
    def observation_size(self) -> int:
        """Numbers of an observation, 28 an arm."""
        return SIZE_PER_ARM * self.task.n_arms

    @property
    def goal_size(self) -> int:
        """Numbers of a goal."""
        return self.task.goal_size

    def set_generator(self, index: int, generator: np.random.Generator) -> None:
        """Give episode ``index`` its source of randomness for the resets to come."""
        self._generators[index] = generator

    def get_state(self) -> EpisodesState:
        """Return a copy of everything that the episodes' future depends on."""
        return EpisodesState(
            simulation=self.simulation.get_state(),
            set_point=self.set_point.copy(),
            target=self.target.copy(),
            goal=self._goal.copy(),
            elapsed=self.elapsed.copy(),
            constraint_broken=self._constraint_broken.copy(),
            observation=self._observation.copy(),
            achieved=self._achieved.copy(),
            generators=tuple(copy.deepcopy(self._generators)),
            people=None if self.patient is None else self.patient.get_people(),
        )

    def set_state(self, state: EpisodesState) -> None:
        """Go back to a state that :meth:`get_state` returned; what follows is then the same.

        :param state: of these episodes, or of others built from the same arguments.
        :raises ValueError: for a state of another scene or another number of episodes.
        """
        if self.patient is not None and state.people is not None:
            self.patient.set_people(state.people)
        self.simulation.set_state(state.simulation)
        self.set_point = state.set_point.copy()
        self.target = state.target.copy()
        self._goal = state.goal.copy()
        self.elapsed = state.elapsed.copy()
        self._constraint_broken = state.constraint_broken.copy()
        self._observation = state.observation.copy()
        self._achieved = state.achieved.copy()
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
        rows = np.arange(self.n) if ids is None else np.asarray(ids, dtype=np.intp)
        starts = self._begin(rows)
        self.set_point[rows] = np.stack([start.hand for start in starts])
        self.target[rows] = np.stack([start.target for start in starts])
        self._goal[rows] = np.stack([self.task.desired_goal(start.target) for start in starts])
        self.elapsed[rows] = 0
        self._constraint_broken[rows] = False
        self._read(rows)
        return self._outcome(np.zeros(self.n, dtype=bool), np.zeros(self.n, dtype=bool))

    def _begin(self, rows: NDArray[np.intp]) -> list[Start]:
        """Draw starts of episodes ``rows`` and put everything there.

        The sampler knows hands as points. Whether one touches its cube, with fingers open and
        the cube larger than usual, shows in the simulation: such a start is drawn again.
        """
        starts: dict[int, Start] = {}
        left = rows
        for _ in range(_MOST_REDRAWS):
            drawn = [self._sampler.sample(self._generators[row]) for row in left]
            starts.update(zip(left.tolist(), drawn, strict=True))
            held = self._place(left, drawn)
            left = left[self.simulation.touching(left) & ~held]
            if not left.size:
                return [starts[row] for row in rows.tolist()]
        raise RuntimeError(
            f"{_MOST_REDRAWS} starts in a row had contact: objects of "
            f"{self.settings.objects.size} m leave no room for the hand"
        )

    def _place(self, rows: NDArray[np.intp], starts: list[Start]) -> NDArray[np.bool_]:
        """Put arms, fingers and cubes of episodes ``rows`` (k,) where their starts say.

        :return: (k,) episodes that start with a cube in hand.
        """
        robot, arms = self.settings.robot, self.task.n_arms
        hand = np.stack([start.hand for start in starts])
        joints = self._reachability.postures_at(hand.reshape(-1, 3))
        fingers = np.full((len(rows), *self.scene.finger_qpos.shape), robot.finger_open)
        position = np.stack([start.object for start in starts])
        quaternion = np.zeros((len(rows), arms, 4))
        quaternion[..., 0] = 1
        held = np.zeros((len(rows), arms), dtype=bool)
        if self._grasp is not None:
            share = self.settings.in_hand_share
            held = np.stack([self._generators[row].random(arms) < share for row in rows])
            position[held] = hand[held] + self._grasp.object_offset
            quaternion[held] = self._grasp.object_quaternion
            fingers[held] = self._grasp.finger_position
        joints = joints.reshape(len(rows), arms, -1)
        if self.patient is not None:
            people = [start.people for start in starts if isinstance(start, WristStart)]
            self.patient.place(rows, joined(people), joints)
            return np.zeros(len(rows), dtype=bool)
        objects = np.concatenate([self.simulation.to_world(position), quaternion], axis=-1)
        self.simulation.reset(rows, joints, fingers, objects)
        if held.any():
            episode, arm = np.nonzero(held)
            controls = self.scene.finger_ctrl[arm]
            self.simulation.ctrl[rows[episode][:, None], controls] = robot.finger_closed
        in_hand: NDArray[np.bool_] = np.logical_or.reduce(held, axis=-1)
        return in_hand

    def step(self, actions: NDArray[np.floating], ids: NDArray[np.intp] | None = None) -> Outcome:
        """Apply one action to every episode, or to some.

        :param actions: (n, action_size); clipped to [-1, 1]. A Cartesian motion of 1 moves the
            set-point by ``max_speed`` times 0.04 s along its axis; the whole displacement is no
            longer than that. A gripper command of 1 opens the hand, -1 closes it.
        :param ids: (k,) which of the n to step; all by default. The others stay where they are
            and must be reset before they are stepped again: their set-points have moved on.
        :return: the outcome of all n, of which that of ``ids`` is new.
        :raises ValueError: for a wrong shape or a value that is not finite; nothing has changed.
        """
        blocks = self.checked(actions).reshape(self.n, self.task.n_arms, -1)
        targets = self.simulation.ctrl.copy()
        arm_targets = self._arm_targets(blocks[..., : self._motion_size], targets)
        targets[:, self.scene.arm_ctrl] = arm_targets
        if self._has_gripper:
            robot = self.settings.robot
            closing = (1 - blocks[..., -1:]) / 2
            finger = robot.finger_open + closing * (robot.finger_closed - robot.finger_open)
            targets[:, self.scene.finger_ctrl] = finger
        collided, diverged = self.simulation.step(targets, self.settings.limit_joint_speed, ids)
        self.elapsed[slice(None) if ids is None else ids] += 1
        rows = ids
        if diverged.any():
            broken = np.flatnonzero(diverged)
            self._begin(broken)  # a sound state, in which they can be stepped until reset
            rows = np.setdiff1d(np.arange(self.n) if ids is None else ids, broken)
        self._read(rows)
        return self._outcome(collided, diverged)

    def checked(self, actions: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return actions (n, action_size) within [-1, 1].

        :raises ValueError: for a wrong shape or a value that is not finite.
        """
        values = np.asarray(actions, dtype=np.float64)
        if values.shape != (self.n, self.action_size):
            raise ValueError(
                f"actions of shape {values.shape}: must have shape {(self.n, self.action_size)}"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"actions={values!r}: every value must be finite")
        return bounded(values, -1.0, 1.0)

    def _arm_targets(
        self, motion: NDArray[np.float64], controls: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof), radians, for motions in [-1, 1]."""
        commanded = controls.take(self.scene.arm_ctrl, 1)
        if self.settings.control == "joints":
            # Joints may go as much faster than their makers rate them as the tool may.
            scale = self.settings.max_speed / RATED_SPEED * ACTION_DURATION
            wanted = commanded + motion * self._joint_speed * scale
        else:
            wanted = self.inverse_kinematics(self._arms, self.moved_set_point(motion))
        if self.settings.limit_joint_speed:
            # One factor for all joints of an arm: clipped one by one they would bend the tool's way
            # and press the hand on the table.
            change = wanted - commanded
            excess = np.abs(change) / (self._joint_speed * ACTION_DURATION)
            wanted = commanded + change / np.maximum(excess.max(axis=-1, keepdims=True), 1.0)
        if self.settings.control == "joints":
            # Last, since the joints of a blocked arm may be pushed away faster than they may move.
            present = self._arms.joint_position
            wanted = present + bounded(wanted - present, -JOINT_LEASH, JOINT_LEASH)
        return bounded(wanted, self._joint_lower, self._joint_upper)

    def moved_set_point(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Move the set-points as a Cartesian action does, and return them.

        :param motion: (n, arms, 3), in [-1, 1].
        :return: (n, arms, 3) within workspace, top speed and leash, metres.
        """
        longest = self.settings.max_speed * ACTION_DURATION
        moved = self.set_point + shortened(motion * longest, longest)
        tool = self._arms.tool_position
        moved = tool + shortened(moved - tool, LEASH * longest)
        if self.task.held_height is not None:
            moved[..., 2] = self.task.held_height
        self.set_point = self.regions.workspace.clip(moved)
        return self.set_point

    def _read(self, rows: NDArray[np.intp] | None = None) -> None:
        """Read observations and achieved goals of ``rows``, or of all.

        The others keep what was read before: a diverged episode its last good observation.
        """
        simulation = self.simulation
        self._arms = simulation.arm_state()
        objects = self.object_state()
        fingers, finger_velocities = simulation.finger_state()
        locked = self.settings.robot.finger_closed
        observation = observe(self._arms, objects, fingers, finger_velocities, locked)
        achieved = self.task.achieved_goal(objects)
        if rows is None:
            self._observation, self._achieved = observation, achieved
        else:
            self._observation[rows] = observation[rows]
            self._achieved[rows] = achieved[rows]

    @property
    def people(self) -> People | None:
        """Who lies on the bench, where somebody does; not a copy."""
        return None if self.patient is None else self.patient.people

    def object_state(self) -> ObjectState:
        """Return the state of the cubes, or of the wrists, copied."""
        if self.patient is not None:
            return self.patient.wrists()
        return self.simulation.object_state()

    def _outcome(self, collided: NDArray[np.bool_], diverged: NDArray[np.bool_]) -> Outcome:
        # From the numbers that agents see, so that relabelling them finds the very same rewards.
        achieved, desired = self._achieved.astype(np.float32), self._goal.astype(np.float32)
        readings = {} if self.patient is None else self.patient.readings()
        costs = self.task.costs(achieved, desired, collided, readings)
        reward, reached = self.task.judge(achieved, desired)
        for name in self.task.never:
            self._constraint_broken |= costs[name] > 0
        success = reached & ~self._constraint_broken
        return Outcome(
            reward=reward,
            truncated=(self.elapsed >= self.settings.horizon) | diverged,
            success=success,
            reached=reached,
            diverged=diverged,
            costs=costs,
            cost=sum((costs[name] for name in self.task.cost_names), np.zeros(self.n)),
            readings=readings,
        )

    def observation(self) -> Observation:
        """Return what the agents see now, in arrays of their own."""
        return Observation(
            self._observation.astype(np.float32),
            self._achieved.astype(np.float32),
            self._goal.astype(np.float32),
        )


def _scene(task: Task, settings: Settings) -> Scene:
    if task.moves_person:
        return compose_with_person(settings.robot)
    return compose(settings.robot, task.n_arms, task.fingers, settings.objects, settings.layout)


def shortened(vectors: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """Return vectors (..., 3), those longer than ``longest`` scaled down to it."""
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return vectors * np.minimum(1.0, longest / np.maximum(length, 1e-12))
