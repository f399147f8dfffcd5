"""What a task is: everything that `episodes.py` asks of one, with defaults for moving objects.

A task is an immutable description; its fields are its options. It owns the bodies that it adds to
the scene, the starts, what is observed, the goal, the reward, the costs, and the text of its page.
Arrays lead with n, the number of episodes; a single environment is n = 1 of the same code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace, length
from saver_envs.randomization import Parameter
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, Bases, Content, Scene
from saver_envs.simulation import ArmState, Resting, Simulation
from saver_envs.tasks.layout import Layout, Part
from saver_envs.validation import require

if TYPE_CHECKING:
    import mujoco

RewardType = Literal["sparse", "dense"]
FloatArray = NDArray[np.floating]
Bools = NDArray[np.bool_]
Rows = NDArray[np.intp]
#: Arrays (n, ...) that a task keeps, by name; copied and pickled with the episodes.
Memory = dict[str, NDArray[Any]]
#: Parts of an observation by name.
Seen = dict[str, NDArray[np.float64]]

#: Distance within which an object counts as at its target (m).
SUCCESS_THRESHOLD = 0.05
#: Part of the observation with the option ``observe_pending_motion``.
PENDING = Part("displacement of pending actions", 3, "m")
#: Least distance of an object's start from its target (m).
LEAST_WAY = 0.10


@dataclass(frozen=True)
class Start:
    """Where an episode starts; a task's own class adds what it places.

    :param hand: (arms, 3) tool positions in the base frames, metres.
    """

    hand: NDArray[np.float64]


class NoStart(RuntimeError):
    """No start keeps the rules: options or parameters leave no room."""


@dataclass(frozen=True)
class TaskPage:
    """What a task's page says, in Markdown; in the places of the page template.

    :param succeeds: when an episode succeeds, a clause.
    :param start: what the sampler guarantees, one sentence each.
    :param reward: of the sparse id.
    :param dense: of the dense id, a clause.
    :param costs: cost -> when it is 1.
    :param goal: part of the goal -> what it means.
    :param facts: rows of the table of facts, name and value.
    :param readings: further entries of ``info``, a sentence.
    """

    succeeds: str = "every object is at its target"
    start: Sequence[str] = ()
    reward: str = "0 where the goal is reached, else -1."
    dense: str = "minus the sum of the objects' distances to their targets, in metres."
    costs: Mapping[str, str] = field(default_factory=dict)
    goal: Mapping[str, str] = field(default_factory=dict)
    facts: Sequence[tuple[str, str]] = ()
    readings: str = ""


@dataclass(frozen=True)
class Task(Content):
    """Base of all tasks; a subclass overrides what differs.

    :param n_arms: number of arms.
    :param reward_type: ``sparse`` (eq. 6.4: 0 where the goal is reached, else -1) or ``dense``
        (the negative sum of the objects' distances to their targets, metres).
    :param success_threshold: distance of an object from its target that counts as reached, metres.
    :param observe_pending_motion: add to each arm's observation how far pending actions will move
        its set-point: those whose effect cannot be seen yet, since actions or observations are
        delayed. A driver that acknowledges commands lets its users know that.
    """

    n_arms: int
    reward_type: RewardType = "sparse"
    success_threshold: float = SUCCESS_THRESHOLD
    observe_pending_motion: bool = False

    #: Lower-case name of the task.
    name: ClassVar[str]
    #: Whether the fingers move.
    fingers: ClassVar[Fingers] = Fingers.ACTUATED
    #: Height at which the tool is held (m), or ``None`` where the action sets it.
    held_height: ClassVar[float | None] = None
    #: Least distance of a start from its goal, in the goal's unit; the threshold is below it.
    least_way: ClassVar[float] = LEAST_WAY
    #: Actions for which the goal has to be reached without a break before an episode succeeds.
    hold: ClassVar[int] = 0
    #: Actions in an episode, at the default speed and at the rated one.
    horizon: ClassVar[int] = 50
    rated_horizon: ClassVar[int] = 125
    #: Costs that ``info`` reports as ``cost_<name>``.
    costs: ClassVar[tuple[str, ...]] = ("collision",)
    #: Those that ``info["cost"]`` adds up.
    summed: ClassVar[tuple[str, ...]] = ("collision",)
    #: Those that must stay 0 throughout an episode for it to succeed.
    hard: ClassVar[tuple[str, ...]] = ()
    #: Whether a body with a free joint is lost once its centre has been beyond the table's edge;
    #: the episode cannot succeed any more.
    keeps_to_table: ClassVar[bool] = True
    #: Part of the goal, of size 1, that must stay at its desired value, and its tolerance; or
    #: ``None``.
    constraint: ClassVar[tuple[str, float] | None] = None
    #: Scripted policy that solves it, as ``module:function``.
    expert: ClassVar[str | None] = None
    #: Whether the simulation keeps the highest sample of each sensor in an action.
    keeps_peaks: ClassVar[bool] = False
    #: What may differ between episodes, besides what may in every task.
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __post_init__(self) -> None:
        known = self.reward_type in ("sparse", "dense")
        require("reward_type", self.reward_type, known, "'sparse' or 'dense'")
        least, threshold = self.least_way, self.success_threshold
        way = f"{least:.2f} {self.goal[0].unit}, the least distance of a start from its target"
        within = 0 < threshold < least
        require("success_threshold", threshold, within, f"between 0 and {way}")

    # ---------------------------------------------------------------- what agents see

    @property
    def observation(self) -> tuple[Part, ...]:
        """The parts of the observation."""
        raise NotImplementedError

    @property
    def goal(self) -> tuple[Part, ...]:
        """The parts of a goal; by default the position of each arm's object."""
        return (Part("object position", 3, "m"),)

    @cached_property
    def observation_layout(self) -> Layout:
        """Where the parts of the observation lie."""
        parts = self.observation
        return Layout((*parts, PENDING) if self.observe_pending_motion else parts, self.n_arms)

    @cached_property
    def goal_layout(self) -> Layout:
        """Where the parts of a goal lie."""
        return Layout(self.goal, self.n_arms)

    # ---------------------------------------------------------------- the scene

    @property
    def bases(self) -> Bases:
        """How the arms' bases stand."""
        return "row"

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add the task's bodies, sensors and sites; see :meth:`saver_envs.scenes.Content.build`.

        Sensors whose names begin with ``collision_`` count what ``cost_collision`` counts. Sites
        called ``target0``, ``target1``, ... show the points of :meth:`targets`.
        """
        raise NotImplementedError

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        raise NotImplementedError

    # ---------------------------------------------------------------- worlds that vary

    @cached_property
    def _own_parameters(self) -> dict[str, Parameter]:
        """Those of :attr:`parameters` that are fields, by name."""
        names = {one.name for one in fields(self)}
        return {one.name: one for one in self.parameters if one.name in names}

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Return the task of an episode whose parameters have these values.

        It draws the episode's start. By default the fields of these names are replaced.

        :param values: parameter -> (size,).
        """
        own: dict[str, Any] = {}
        for name, parameter in self._own_parameters.items():
            if name in values:
                value = values[name][0].item()
                if parameter.whole:
                    value = parameter.names[int(value)] if parameter.names else int(value)
                own[name] = value
        if not own:
            return self
        # The values are valid, and checks would take a tenth of a reset. What is cached, such as
        # layouts of what agents see, is that of all episodes.
        task = object.__new__(type(self))
        task.__dict__.update(vars(self) | own)
        return task

    def vary(
        self, simulation: Simulation, rows: Rows, values: Mapping[str, NDArray[np.float64]]
    ) -> None:
        """Write the values of :attr:`parameters` into the models of some simulations.

        See :meth:`saver_envs.simulation.Simulation.per_simulation`. What MuJoCo derives from the
        fields is updated afterwards.

        :param rows: (k,) simulations.
        :param values: parameter -> (k, size); those that vary, also others than the task's.
        """

    # ---------------------------------------------------------------- episodes

    def memory(self, n: int) -> Memory:
        """Return arrays (n, ...) that the task needs besides the simulation's state."""
        return {}

    def sample(self, generator: np.random.Generator, scene: Scene) -> Start:
        """Draw a start; :meth:`valid` checks contacts.

        :param generator: the episode's source of randomness.
        :param scene: of these arms and this task.
        :raises NoStart: where there is none; in worlds that vary, another world is drawn.
        """
        raise NotImplementedError

    def place(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[Any]
    ) -> None:
        """Place everything as the starts of episodes ``rows`` say, and refresh the simulation."""
        raise NotImplementedError

    @property
    def resting(self) -> tuple[Resting, ...]:
        """Names of the geoms that lie on the table at the start, or on others."""
        return ()

    def valid(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[Any]
    ) -> Bools:
        """Return which of the episodes just placed may begin; the others are drawn again.

        By default nothing may have contact except what :attr:`resting` names.
        """
        return ~simulation.touching(rows, self.resting)

    def restore(self, simulation: Simulation, memory: Memory) -> None:
        """Restore model fields from the memory, before a state is set."""

    def drive(self, simulation: Simulation, memory: Memory, rows: Rows | slice) -> None:
        """Move what moves on its own, such as a bed; called before each action."""

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return every part of the observation, unscaled; further entries are ignored.

        :param arms: the arms' state.
        :return: part -> (n, arms, size), or (n, size) for a shared one.
        """
        raise NotImplementedError

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return achieved goals (n, goal size).

        :param seen: what :meth:`observe` has just returned.
        """
        raise NotImplementedError

    def desired(self, starts: Sequence[Any]) -> NDArray[np.float64]:
        """Return the goals (k, goal size) of starts."""
        raise NotImplementedError

    # ---------------------------------------------------------------- reward, costs, success

    def reward_and_reached(
        self, achieved: FloatArray, desired: FloatArray
    ) -> tuple[NDArray[np.float32], Bools]:
        """Return rewards and where the goal is reached, shape of the leading dimensions.

        Relabelling calls it with other goals, so it depends on its arguments alone.

        :param achieved: (..., goal size).
        :param desired: (..., goal size).
        """
        distances = self.distances(achieved, desired)
        reached: Bools = np.logical_and.reduce(distances <= self.success_threshold, axis=-1)
        if self.reward_type == "sparse":
            return reached.astype(np.float32) - np.float32(1), reached
        return -distances.sum(axis=-1).astype(np.float32), reached

    def distances(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Return each object's distance to its target (..., arms), metres."""
        return length(self.goal_layout.blocks(achieved - desired))

    def reward(self, achieved: FloatArray, desired: FloatArray) -> NDArray[np.float32]:
        """Return the reward of goals (..., goal size), shape (...); pure."""
        return self.reward_and_reached(achieved, desired)[0]

    def deviation(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Return how far the constraint's value is from the desired one, shape (...).

        :raises ValueError: for a task without a constraint.
        """
        if self.constraint is None:
            raise ValueError(f"the task {self.name!r} has no constraint")
        layout, (name, _) = self.goal_layout, self.constraint
        return np.abs(layout.get(achieved, name) - layout.get(desired, name))[..., 0]

    @property
    def least_reward(self) -> float:
        """The smallest reward of a step where rewards are sparse."""
        return -1.0

    def measure(
        self,
        simulation: Simulation,
        memory: Memory,
        achieved: FloatArray,
        desired: FloatArray,
    ) -> dict[str, NDArray[np.float64]]:
        """Return the entries of ``info``, (n,) each: ``cost_<name>`` of every cost, and readings.

        :param achieved: (n, goal size), as agents see them.
        :param desired: (n, goal size), as agents see them.
        """
        measured = {"cost_collision": simulation.collided.astype(np.float64)}
        if len(simulation.scene.collision_force_sensor):
            measured["collision_force"] = simulation.collision_force.copy()
        return measured

    # ---------------------------------------------------------------- pictures and pages

    def targets(self, scene: Scene, goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points (n, k, 3) that the sites ``target0`` to ``target<k-1>`` show, world."""
        return scene.to_world(self.goal_layout.blocks(goal))

    def variant_of(self, memory: Memory, row: int) -> int:
        """Return which of :attr:`variants` models episode ``row`` has."""
        return 0

    def decorate(self, model: mujoco.MjModel, memory: Memory, row: int) -> None:
        """Adapt a drawing model to episode ``row``."""

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the task's page."""
        return TaskPage()
