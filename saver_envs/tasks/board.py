"""The board that two hands carry by its grips, and the block that lies on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.randomization import LogUniform, Parameter, Uniform
from saver_envs.scenes import (
    ARM_COLOURS,
    OBJECT_BIT,
    Arms,
    add_collision_counters,
    add_target,
    finger_geoms,
    free_bodies,
)
from saver_envs.simulation import Simulation, cross, rotate_by_quaternion
from saver_envs.tasks.contract import Rows
from saver_envs.world import TABLE_BIT

FloatArray = NDArray[np.float64]

#: Names of the bodies, and of the geoms that rest on the table and on the board.
BOARD, LOAD = "board", "load"
#: Half of the sides of the board, which lies along y, and of the block on it (m).
BOARD_HALF, LOAD_HALF = (0.08, 0.30, 0.01), (0.03, 0.03, 0.02)
#: Half of the sides of its grips (m): blocks on its ends, 40 mm thick between the fingers. Their
#: flat faces keep the board from rolling in the hands.
GRIP_HALF = (0.03, 0.02, 0.0375)
#: The ends of the board, which have targets: where its grips are held, that high above it (m).
HELD_HEIGHT: Final = 0.045
#: From the middle of the board, in its frame; those of arm 0, to the right, and of arm 1.
ENDS: Final = np.array([[0.0, side * (BOARD_HALF[1] - GRIP_HALF[1]), 0.0] for side in (-1, 1)])
ENDS[:, 2] = BOARD_HALF[2] + HELD_HEIGHT
#: Share of the board's mass that is a grip's.
_GRIP_SHARE = 0.1
_COMPILED_X, _COLOUR, _LOAD_COLOUR = 0.42, (0.62, 0.52, 0.38, 1.0), (0.45, 0.62, 0.35, 1.0)

#: What may differ between episodes; nominal values are those of the task's options.
BOARD_PARAMETERS = (
    Parameter(
        *("board_mass", "kg", "mass of the board", 0.6, (0.05, 2.0)),
        wide=Uniform(0.4, 0.8),
        held_out=Uniform(0.8, 1.0),
    ),
    Parameter(
        *("load_mass", "kg", "mass of the block on the board", 0.2, (0.001, 2.0)),
        wide=LogUniform(0.05, 0.4),
        held_out=Uniform(0.4, 0.6),
    ),
    Parameter(
        *("load_friction", "", "sliding friction of block and board", 0.5, (0.0, 10.0)),
        wide=Uniform(0.3, 0.8),
        held_out=Uniform(0.22, 0.3),
    ),
    Parameter(
        *("finger_friction", "", "sliding friction of grips and fingers", 1.5, (0.0, 10.0)),
        wide=Uniform(0.8, 1.5),
        held_out=Uniform(0.6, 0.8),
    ),
    Parameter(
        # Arms reach 2 cm below their usual table.
        *("table_height", "m", "height of the table above the arms' bases", 0.0, (-0.02, 0.05)),
        wide=Uniform(-0.01, 0.01),
    ),
)


@dataclass(frozen=True)
class BoardState:
    """Where board and block are, leading dimension n; world frame unless told otherwise.

    :param position: (n, 3) middle of the board, metres.
    :param quaternion: (n, 4) of the board, w first, w >= 0.
    :param linear_velocity: (n, 3) of its middle, metres per second.
    :param angular_velocity: (n, 3), radians per second.
    :param ends: (n, 2, 3), metres.
    :param load: (n, 3) middle of the block in the board's frame, metres.
    :param load_velocity: (n, 3) of the block against the board, in the board's frame, m/s.
    """

    position: FloatArray
    quaternion: FloatArray
    linear_velocity: FloatArray
    angular_velocity: FloatArray
    ends: FloatArray
    load: FloatArray
    load_velocity: FloatArray


def add_board(spec: mujoco.MjSpec, arms: Arms, values: Mapping[str, float]) -> None:
    """Add board, block, targets, and sensors that count collisions.

    :param spec: of a scene with two arms.
    :param arms: the arms.
    :param values: of :data:`BOARD_PARAMETERS`, by name.
    """
    height = values["table_height"] + BOARD_HALF[2]
    board = spec.worldbody.add_body(name=BOARD, pos=(_COMPILED_X, 0, height))
    board.add_freejoint(name=f"{BOARD}_joint")
    bits = {"contype": OBJECT_BIT, "conaffinity": TABLE_BIT | OBJECT_BIT, "condim": 3}
    friction = (values["load_friction"], 0.02, 0.001)
    box, mass = mujoco.mjtGeom.mjGEOM_BOX, values["board_mass"]
    own = {"mass": (1 - 2 * _GRIP_SHARE) * mass, "friction": friction, "rgba": _COLOUR}
    board.add_geom(name=BOARD, type=box, size=BOARD_HALF, **own, **bits)
    for index, (_, y, _) in enumerate(ENDS):
        board.add_geom(
            name=f"grip{index}",
            type=box,
            pos=(0, y, BOARD_HALF[2] + GRIP_HALF[2]),
            size=GRIP_HALF,
            mass=_GRIP_SHARE * mass,
            rgba=(*ARM_COLOURS[index], 1),
            **bits,
        )
        add_target(spec, index, GRIP_HALF[1], (_COMPILED_X, y, height + HELD_HEIGHT))
    place = (_COMPILED_X, 0, height + BOARD_HALF[2] + LOAD_HALF[2])
    load = spec.worldbody.add_body(name=LOAD, pos=place)
    load.add_freejoint(name=f"{LOAD}_joint")
    own = {"mass": values["load_mass"], "friction": friction, "rgba": _LOAD_COLOUR}
    load.add_geom(name=LOAD, type=box, size=LOAD_HALF, **own, **bits)
    add_collision_counters(spec, arms, [[LOAD]] * arms.n)
    for index in range(arms.n):
        for pad in finger_geoms(arms.robot, arms.fingers):
            geom = spec.geom(f"arm{index}_{pad}")
            # Of two geoms, that with the higher priority decides about their friction.
            geom.priority, geom.friction[0] = 1, values["finger_friction"]


def vary_board(
    simulation: Simulation, rows: Rows, values: Mapping[str, FloatArray], nominal: float
) -> None:
    """Give some simulations a board, a block, pads and a table of their own.

    :param simulation: of a scene with a board.
    :param rows: (k,) which simulations.
    :param values: parameter -> (k, 1).
    :param nominal: mass of the board in the scene's model, kg.
    """
    scene, field, every = simulation.scene, simulation.per_simulation, rows[:, None]
    base, names = scene.model, (BOARD, LOAD)
    bodies = {name: base.body(name).id for name in names}
    factors = {}
    if "board_mass" in values:
        factors[bodies[BOARD]] = values["board_mass"][:, 0] / nominal
    if "load_mass" in values:
        factors[bodies[LOAD]] = values["load_mass"][:, 0] / base.body_mass[bodies[LOAD]]
    for body, factor in factors.items():
        field("body_mass")[rows, body] = base.body_mass[body] * factor
        field("body_inertia")[rows, body] = base.body_inertia[body] * factor[:, None]
    if "load_friction" in values:
        geoms = [base.geom(name).id for name in names]
        field("geom_friction")[every, geoms, 0] = values["load_friction"]
    if "finger_friction" in values:
        field("geom_friction")[every, scene.finger_geom.ravel(), 0] = values["finger_friction"]
    if "table_height" in values:
        table = values["table_height"]
        field("geom_pos")[every, base.geom("table").id, 2] = table
        raised = table - base.geom("table").pos[2]
        own, ids = free_bodies(scene, names), list(bodies.values())
        field("body_pos")[every, ids, 2] = base.body_pos[ids, 2] + raised
        for name in ("qpos0", "qpos_spring"):
            field(name)[every, own.qpos[:, 2]] = base.qpos0[own.qpos[:, 2]] + raised
        field("site_pos")[every, scene.target_site, 2] = (
            base.site_pos[scene.target_site, 2] + raised
        )


def place_board(simulation: Simulation, rows: Rows, board: FloatArray, load: FloatArray) -> None:
    """Put boards and blocks of simulations ``rows`` (k,) somewhere, at rest.

    :param simulation: of a scene with a board.
    :param rows: (k,).
    :param board: (k, 7) position and quaternion, world frame, metres.
    :param load: (k, 2) middle of the block on the board, in its frame, metres.
    """
    own = free_bodies(simulation.scene, (BOARD, LOAD))
    lever = np.column_stack([load, np.full(len(rows), BOARD_HALF[2] + LOAD_HALF[2])])
    on_board = board.copy()
    on_board[:, :3] += rotate_by_quaternion(board[:, 3:], lever)
    simulation.qpos[rows[:, None], own.qpos[0]] = board
    simulation.qpos[rows[:, None], own.qpos[1]] = on_board


def board_state(simulation: Simulation) -> BoardState:
    """Return where boards and blocks are, copied."""
    own = free_bodies(simulation.scene, (BOARD, LOAD))
    poses, velocities = simulation.qpos.take(own.qpos, 1), simulation.qvel.take(own.dof, 1)
    position, quaternion = poses[:, 0, :3], poses[:, 0, 3:]
    linear = velocities[:, 0, :3]
    # A free joint's angular velocity is given in the body's own frame.
    angular = rotate_by_quaternion(quaternion, velocities[:, 0, 3:])
    back = quaternion * np.array([1.0, -1.0, -1.0, -1.0])
    lever = poses[:, 1, :3] - position
    slip = velocities[:, 1, :3] - linear - cross(angular, lever)
    return BoardState(
        position=position,
        quaternion=np.where(quaternion[:, :1] < 0, -quaternion, quaternion),
        linear_velocity=linear,
        angular_velocity=angular,
        ends=position[:, None] + rotate_by_quaternion(quaternion[:, None], ENDS),
        load=rotate_by_quaternion(back, lever),
        load_velocity=rotate_by_quaternion(back, slip),
    )


def tilt(quaternion: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the angles (...) between boards of these quaternions (..., 4) and the level, rad."""
    x, y = quaternion[..., 1], quaternion[..., 2]
    return 2 * np.arcsin(np.minimum(np.sqrt(x * x + y * y), 1.0))


def lies_on_board(load: FloatArray) -> NDArray[np.bool_]:
    """Return whether blocks with their middles there (..., 3), in the board's frame, lie on it."""
    level = np.abs(load[..., :2]) <= np.array(BOARD_HALF[:2])
    return np.logical_and.reduce(level, axis=-1) & (load[..., 2] > BOARD_HALF[2])
