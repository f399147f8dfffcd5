"""The world around the arms: options of the simulation, light, floor, table and cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import COLLISION_GROUP, DRAWN_ONLY

TIMESTEP = 0.002  # s, the dissertation's (chapter 5)
TABLE_BIT = 1
"""Collision bit of the table alone."""

#: Table around a base, in its frame: from behind it to before it, and to either side (m).
TABLE_DEPTH, TABLE_SIDE = (-0.16, 0.80), 0.60
TABLE_COLOUR, TABLE_GRID = (0.80, 0.74, 0.65), 0.10  # red, green, blue; width of a square (m)
#: Cameras: vertical field of view (degrees), and what they frame: arms up to this height (m), and
#: the table without this rim along x and y (m).
FIELD_OF_VIEW, FRAMED_HEIGHT, UNFRAMED_RIM = 45.0, 0.62, (0.12, 0.22)


@dataclass(frozen=True)
class TableArea:
    """The rectangle of table that all arms work over, world frame, metres."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @property
    def centre(self) -> NDArray[np.float64]:
        return (self.lower + self.upper) / 2

    @property
    def half(self) -> NDArray[np.float64]:
        return (self.upper - self.lower) / 2

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points (..., 2) are over the table, (...)."""
        within = (points >= self.lower) & (points <= self.upper)
        return np.logical_and.reduce(within, axis=-1)


def table_around(
    positions: NDArray[np.float64],
    yaws: NDArray[np.float64],
    depth: tuple[float, float] = TABLE_DEPTH,
) -> TableArea:
    """Return the smallest table with room for the surroundings of every base.

    :param positions: (arms, 3) of the bases, metres.
    :param yaws: (arms,) radians.
    :param depth: from behind a base to before it, metres.
    """
    corners = np.array([(x, y) for x in depth for y in (-TABLE_SIDE, TABLE_SIDE)])
    cosine, sine = np.cos(yaws), np.sin(yaws)
    rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    points = (positions[:, None, :2] + np.einsum("aij,kj->aki", rotation, corners)).reshape(-1, 2)
    return TableArea(points.min(axis=0), points.max(axis=0))


def new_world(table: TableArea, height: float = 0.0) -> mujoco.MjSpec:
    """Return a specification with options, lights, floor and table, without arms.

    :param table: where the table is.
    :param height: of its surface above the arms' bases, metres.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "saver"
    set_physics(spec)
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = 1920, 1080
    visual.quality.offsamples = 4
    visual.quality.shadowsize = 4096
    # Ambient, headlight and lamp together leave the table just short of white in the overhead view.
    visual.headlight.ambient = (0.44, 0.44, 0.45)
    visual.headlight.diffuse = (0.22, 0.22, 0.22)
    visual.headlight.specular = (0.05, 0.05, 0.05)
    visual.map.haze = 0.15
    visual.map.shadowclip = 6  # else the floor is speckled where the map of shadows ends
    visual.rgba.haze = (0.80, 0.83, 0.86, 1)
    _add_materials(spec)
    _add_light(spec, table)
    _add_table(spec, table)
    for geom in spec.worldbody.geoms:
        geom.pos[2] += height
    _add_floor(spec)
    return spec


def set_physics(spec: mujoco.MjSpec) -> None:
    """Set the units and the options of the simulation in which everything is simulated."""
    spec.compiler.degree = False
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # Pyramidal cones let a lifted cube slip out of the hand within 4 s; elliptic ones hold it,
    # and need fewer constraint rows.
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10


def _add_materials(spec: mujoco.MjSpec) -> None:
    """Add the sky and the table's grid."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.90, 0.93, 0.96),
        rgb2=(0.62, 0.68, 0.74),
        width=256,
        height=256,
    )
    spec.add_texture(
        name="table",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=TABLE_COLOUR,
        markrgb=tuple(0.80 * part for part in TABLE_COLOUR),
        width=256,
        height=256,
    )
    material = spec.add_material(
        name="table",
        texuniform=True,
        texrepeat=(2 / TABLE_GRID, 2 / TABLE_GRID),
        specular=0.1,
        shininess=0.1,
    )
    give_texture(material, "table")


def give_texture(material: mujoco.MjsMaterial, name: str) -> None:
    """Draw a material with the texture of a name."""
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
    material.textures = textures


def add_picture(spec: mujoco.MjSpec, name: str, pixels: NDArray[np.float64]) -> None:
    """Add a texture of colours (size, size, 3) in [0, 1]."""
    size = len(pixels)
    kind = mujoco.mjtTexture.mjTEXTURE_2D
    texture = spec.add_texture(name=name, type=kind, width=size, height=size, nchannel=3)
    texture.data = np.rint(255 * pixels).astype(np.uint8).tobytes()


def draw_box(
    body: mujoco.MjsBody,
    centre: tuple[float, ...],
    half: tuple[float, ...],
    colour: tuple[float, ...],
    name: str = "",
) -> None:
    """Add a box that is only drawn.

    :param body: that it belongs to.
    :param centre: metres.
    :param half: half of its sides, metres.
    :param colour: red, green, blue.
    :param name: of the geom.
    """
    shape = mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(name=name, type=shape, pos=centre, size=half, rgba=(*colour, 1), **DRAWN_ONLY)


def _add_light(spec: mujoco.MjSpec, table: TableArea) -> None:
    spec.worldbody.add_light(
        pos=(table.centre[0] - 0.3, table.centre[1] - 0.9, 2.4),
        dir=(0.12, 0.35, -1),
        diffuse=(0.48, 0.48, 0.46),
        specular=(0.15, 0.15, 0.15),
        castshadow=True,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    )


def _add_table(spec: mujoco.MjSpec, table: TableArea) -> None:
    world = spec.worldbody
    # A plane is the cheapest shape to rest on; the slab under it is the table that is seen.
    world.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(2, 2, 0.1),
        contype=TABLE_BIT,
        conaffinity=0,
        condim=3,
        # A contact has the larger friction of its two geoms: with next to none of its own, the
        # table leaves it to the objects.
        friction=(0.01, 0.001, 0.0001),
        group=COLLISION_GROUP,
    )
    (x, y), (half_x, half_y) = table.centre, table.half
    draw_box(world, (x, y, -0.0215), (half_x, half_y, 0.02), TABLE_COLOUR, "table_slab")
    for side_x in (-1, 1):
        for side_y in (-1, 1):
            leg = (x + side_x * (half_x - 0.06), y + side_y * (half_y - 0.06), -0.396)
            name = f"table_leg_{side_x}_{side_y}"
            draw_box(world, leg, (0.03, 0.03, 0.355), (0.35, 0.36, 0.38), name)
    world.add_geom(
        name="table_grid",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(x, y, -0.001),
        size=(half_x, half_y, 0.1),
        material="table",
        **DRAWN_ONLY,
    )


def move_table(model: mujoco.MjModel, height: float) -> None:
    """Move the table of a drawing model, so that its surface is this high (m)."""
    shift = height - model.geom("table").pos[2]
    for index in range(model.ngeom):
        if model.geom(index).name.startswith("table"):
            model.geom_pos[index, 2] += shift


def _add_floor(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(0, 0, -0.75),
        size=(0, 0, 1),
        rgba=(0.72, 0.75, 0.78, 1),
        **DRAWN_ONLY,
    )


def add_cameras(spec: mujoco.MjSpec, table: TableArea) -> None:
    """Add cameras that frame the table and all arms in 4:3 pictures."""
    centre = np.array([*table.centre, FRAMED_HEIGHT / 2])
    corners = np.array(
        [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64
    ) * [*(table.half - UNFRAMED_RIM), FRAMED_HEIGHT / 2]
    directions = {
        "front": (1.0, 0.0, 0.62),
        "three_quarter": (0.85, 0.75, 0.62),
        "side": (0.05, 1.0, 0.30),
        "overhead": (0.02, 0.0, 1.0),
    }
    tangent = np.array([4 / 3, 1.0]) * math.tan(math.radians(FIELD_OF_VIEW) / 2)
    for name, direction in directions.items():
        backward = np.asarray(direction) / np.linalg.norm(direction)
        right = np.cross((0.0, 0.0, 1.0), backward)
        right /= np.linalg.norm(right)
        up = np.cross(backward, right)
        rotation = np.stack([right, up, backward], axis=1)
        seen = corners @ rotation
        # The nearest distance from which every corner lies within the picture.
        distance = float((seen[:, 2:] + np.abs(seen[:, :2]) / tangent).max())
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.reshape(9))
        spec.worldbody.add_camera(
            name=name, pos=centre + distance * backward, quat=quaternion, fovy=FIELD_OF_VIEW
        )
