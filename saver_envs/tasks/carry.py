"""Carry: two hands lift a board by its grips and bring it to its target, level, a block on it."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace
from saver_envs.randomization import Parameter
from saver_envs.randomization.parameters import require_allowed
from saver_envs.reachability import reachability_map
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, Scene
from saver_envs.simulation import ArmState, Resting, Simulation
from saver_envs.tasks.arm_and_object import HAND_PARTS, OBJECT_PARTS, hand_parts
from saver_envs.tasks.board import (
    BOARD,
    BOARD_HALF,
    BOARD_PARAMETERS,
    GRIP_HALF,
    LOAD,
    LOAD_HALF,
    add_board,
    board_state,
    lies_on_board,
    place_board,
    tilt,
    vary_board,
)
from saver_envs.tasks.carry_starts import CarryStart, CarryStartSampler, start_text
from saver_envs.tasks.contract import FloatArray, Memory, Rows, Seen, Task, TaskPage
from saver_envs.tasks.layout import Part
from saver_envs.tasks.regions import regions
from saver_envs.validation import require
from saver_envs.world import move_table

#: Greatest angle between the board and the level (rad).
GREATEST_TILT = math.radians(10.0)
_POSITION, _RELATIVE, *_OF_BOARD = OBJECT_PARTS


@dataclass(frozen=True)
class Carry(Task):
    """A board for both hands: each end to its target, level all the way, its load still on it.

    The board lies on the table; no arm can lift it alone without tilting it.

    :param board_mass: mass of the board, kg.
    :param load_mass: mass of the block on the board, kg.
    :param load_friction: sliding friction of block and board, and of board and table.
    :param finger_friction: sliding friction of the grips and the fingers.
    :param table_height: height of the table above the arms' bases, m.
    """

    board_mass: float = 0.6
    load_mass: float = 0.2
    load_friction: float = 0.5
    finger_friction: float = 1.5
    table_height: float = 0.0

    name: ClassVar[str] = "carry"
    fingers: ClassVar[Fingers] = Fingers.ACTUATED
    horizon: ClassVar[int] = 125
    rated_horizon: ClassVar[int] = 250
    costs: ClassVar[tuple[str, ...]] = ("collision", "tilt", "dropped")
    summed: ClassVar[tuple[str, ...]] = ("tilt", "dropped")
    hard: ClassVar[tuple[str, ...]] = ("tilt", "dropped")
    expert: ClassVar[str | None] = "saver_envs.experts.carry:expert"
    parameters: ClassVar[tuple[Parameter, ...]] = BOARD_PARAMETERS

    def __post_init__(self) -> None:
        super().__post_init__()
        require("n_arms", self.n_arms, self.n_arms == 2, "exactly 2, one for each end")
        require_allowed(self, self.parameters)

    @property
    def observation(self) -> tuple[Part, ...]:
        """Each arm's hand and its end of the board; what the board and its load do, for both."""
        shared = (replace(part, shared=True) for part in _OF_BOARD)
        load = (
            Part("load position on the object", 3, "m", shared=True),
            replace(_OF_BOARD[1], name="load velocity on the object", shared=True),
        )
        return (*HAND_PARTS, _POSITION, _RELATIVE, *shared, *load)

    @property
    def resting(self) -> tuple[Resting, ...]:
        """The board, which lies on the table, and the block, which lies on the board."""
        return BOARD, (LOAD, BOARD)

    # ---------------------------------------------------------------- the scene

    def scene_key(self) -> Hashable:
        """Tasks with the same board share a scene."""
        return BOARD, self.n_arms, *self._values().values()

    def _values(self) -> dict[str, float]:
        return {one.name: getattr(self, one.name) for one in self.parameters}

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add board, block, targets, and sensors that count collisions."""
        add_board(spec, arms, self._values())

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        return regions(arms).workspace.raised(self.table_height)

    def vary(
        self, simulation: Simulation, rows: Rows, values: Mapping[str, NDArray[np.float64]]
    ) -> None:
        """Give some simulations a board, a block, pads and a table of their own."""
        vary_board(simulation, rows, values, self.board_mass)

    # ---------------------------------------------------------------- episodes

    def sample(self, generator: np.random.Generator, scene: Scene) -> CarryStart:
        """Draw board, block, target and hands."""
        return _sampler(scene, self.table_height).sample(generator)

    def place(
        self, simulation: Simulation, memory: Memory, rows: Rows, starts: Sequence[CarryStart]
    ) -> None:
        """Put arms, board and block where the starts say."""
        scene, robot = simulation.scene, simulation.scene.robot
        hand = np.stack([start.hand for start in starts])
        joints = reachability_map(robot).postures_at(hand.reshape(-1, 3))
        fingers = np.full((len(rows), *scene.finger_qpos.shape), robot.finger_open)
        simulation.reset(rows, joints.reshape(len(rows), self.n_arms, -1), fingers)
        board, load = (np.stack([getattr(one, name) for one in starts]) for name in (BOARD, LOAD))
        place_board(simulation, rows, board, load)
        simulation.refresh(rows)

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands, ends, board and block."""
        board = board_state(simulation)
        ends = simulation.scene.to_bases(board.ends)
        names = [part.name for part in (_POSITION, _RELATIVE, *_OF_BOARD)]
        moving = board.quaternion, board.linear_velocity, board.angular_velocity
        seen = dict(zip(names, (ends, ends - arms.tool_position, *moving), strict=True))
        on_it = {
            "load position on the object": board.load,
            "load velocity on the object": board.load_velocity,
        }
        return hand_parts(simulation, arms) | seen | on_it

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return where both ends are, each in its arm's base frame, metres."""
        return seen[_POSITION.name].reshape(simulation.n, -1)

    def desired(self, starts: Sequence[CarryStart]) -> NDArray[np.float64]:
        """Return where both ends are to be, each in its arm's base frame, metres."""
        return np.stack([start.target.reshape(-1) for start in starts])

    def measure(
        self, simulation: Simulation, memory: Memory, achieved: FloatArray, desired: FloatArray
    ) -> dict[str, NDArray[np.float64]]:
        """Return the costs, and the tilt (rad)."""
        board = board_state(simulation)
        tilted, dropped = tilt(board.quaternion), ~lies_on_board(board.load)
        costs = {
            "cost_tilt": (tilted > GREATEST_TILT).astype(np.float64),
            "cost_dropped": dropped.astype(np.float64),
        }
        measured = super().measure(simulation, memory, achieved, desired)
        return measured | costs | {"tilt": tilted}

    # ---------------------------------------------------------------- pictures and the page

    def decorate(self, model: mujoco.MjModel, memory: Memory, row: int) -> None:
        """Show the table as it is in the episode."""
        move_table(model, self.table_height)

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        degrees = f"{math.degrees(GREATEST_TILT):.0f} degrees"
        x, y, z = (f"{200 * half:g}" for half in LOAD_HALF)
        board = f"{2 * BOARD_HALF[1]:g} m, {self.board_mass:g} kg"
        return TaskPage(
            succeeds=(
                f"each end of the board is within {100 * self.success_threshold:g} cm of its "
                f"target in the air; and the board was never tilted by more than {degrees}, and "
                "the block on it did not fall"
            ),
            start=start_text(),
            reward="0 where both ends are within the threshold of their targets, else -1.",
            dense="minus the sum of the ends' distances to their targets, in metres.",
            goal={"object position": "end of the board, the middle of its grip, and its target"},
            costs={
                "collision": (
                    "1 on a step with contact between arms, or of an arm with the table or with "
                    "the block"
                ),
                "tilt": f"1 on a step on which the board is tilted by more than {degrees}",
                "dropped": "1 on a step on which the middle of the block is not above the board",
            },
            facts=(
                ("object", "the board; its position is that of the arm's end"),
                ("board", f"{board}, grips of {2000 * GRIP_HALF[1]:g} mm at its ends"),
                ("load", f"a block of {x} x {y} x {z} cm, {self.load_mass:g} kg, on the board"),
            ),
            readings="`info` also has `tilt` (rad), the angle between the board and the level.",
        )


@lru_cache(maxsize=64)
def _sampler(scene: Scene, table_height: float) -> CarryStartSampler:
    return CarryStartSampler(
        scene, regions(scene.arms), reachability_map(scene.robot), table_height
    )
