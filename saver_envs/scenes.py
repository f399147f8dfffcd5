"""Composes the world, arms and a task's bodies into one compiled model with named addresses."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import COLLISION_GROUP, Fingers, Robot
from saver_envs.validation import require
from saver_envs.world import TABLE_BIT, TABLE_DEPTH, add_cameras, new_world, table_around

Bases = Literal["row", "ring", "bedside"]
Array = NDArray[np.float64]

#: Distance between neighbouring bases in a row (m), Table 8.1.
BASE_SPACING = 0.72
#: Distance of the bases on either side of a bed (m), ours: arms reach from there across the
#: person's middle, and as far as elbows of arms that are spread.
BEDSIDE_SPACING = 1.0
#: Radius of the circle of bases around the table (m), ours: the distance of a base in a row from
#: the middle of its workspace.
RING_RADIUS = 0.60
MAX_ARMS = 4
#: First part of the names of sensors that count contacts for ``cost_collision``.
COLLISION = "collision_"
#: First part of the names of the sensors of their forces.
FORCE_OF = "contact_force_"
_FOUND, _FORCE = mujoco.mjtConDataField.mjCONDATA_FOUND, mujoco.mjtConDataField.mjCONDATA_FORCE
#: Reading of a contact sensor that finds out whether there is a contact.
CONTACT_COUNT = (1 << int(_FOUND), 0, 1)
#: Reading of the net force of all contacts, N. A sensor that reads both misses contacts that have
#: no force yet.
NET_FORCE = (1 << int(_FORCE), 3, 1)
#: First part of the names of the sites that show targets.
TARGET = "target"
#: Memory for the contacts of a simulation and their constraints (bytes), ten times the need.
MEMORY = 4 * 2**20

OBJECT_BIT = 2
"""Collision bit of the task's objects."""
#: Arm i adds the bit ``FIRST_ARM_BIT << i``; an arm never meets itself.
FIRST_ARM_BIT = 4

#: Colours of objects and targets, one per arm (red, green, blue).
ARM_COLOURS = ((0.85, 0.33, 0.20), (0.20, 0.47, 0.75), (0.93, 0.69, 0.20), (0.45, 0.62, 0.35))


@dataclass(frozen=True)
class Arms:
    """The arms of a scene.

    :param robot: every arm's description.
    :param n: how many, 1 to 4.
    :param fingers: actuated or locked.
    :param bases: layout of the bases, see :func:`base_poses`.
    :raises ValueError: for another number of arms or another way to stand.
    """

    robot: Robot
    n: int = 1
    fingers: Fingers = Fingers.ACTUATED
    bases: Bases = "row"

    def __post_init__(self) -> None:
        base_poses(self.n, self.bases)

    @property
    def position(self) -> Array:
        """Positions of the bases (arms, 3), world frame, metres."""
        return base_poses(self.n, self.bases)[0]

    @property
    def yaw(self) -> Array:
        """Turns of the bases about the vertical (arms,), radians."""
        return base_poses(self.n, self.bases)[1]

    def body(self, index: int) -> str:
        """Return the name of the base body of arm ``index``, below which all of the arm is."""
        return f"arm{index}_{self.robot.base_body}"


class Content:
    """What a scene holds besides arms: nothing by default; a task is one."""

    #: Number of models that differ in these bodies; an episode has one of them.
    variants: ClassVar[int] = 1
    #: Table under the arms, from behind a base to before it (m).
    table_depth: ClassVar[tuple[float, float]] = TABLE_DEPTH
    #: Height of the table above the arms' bases (m).
    table_height: float = 0.0

    def scene_key(self) -> Hashable:
        """Return what identifies the scene: contents with equal keys build the same bodies."""
        return self

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add bodies, sensors and sites to a scene that has its arms already.

        :param spec: of the scene; the arms' names begin with ``arm0_``, ``arm1_``, ...
        :param arms: which arms there are and where they stand.
        :param variant: which of :attr:`variants` models.
        :param decorated: whether the model is drawn; otherwise visual geoms may be left out.
        """

    def compiled(self, model: mujoco.MjModel) -> None:
        """Adjust the compiled model, for what a specification cannot express."""


#: Arms over a bare table.
BARE_TABLE = Content()


@dataclass(frozen=True)
class _Recipe:
    """What a scene is compiled from; recipes with equal arms and keys are equal."""

    arms: Arms
    key: Hashable
    content: Content = field(compare=False)
    forces: bool = False


class Scene:
    """Compiled models and where to find things in them; arrays have one row per arm.

    :param recipe: what it is compiled from.
    """

    def __init__(self, recipe: _Recipe) -> None:
        arms, robot = recipe.arms, recipe.arms.robot
        self._recipe = recipe
        variants = range(recipe.content.variants)
        #: The models of what moves and collides, one per variant; see :meth:`drawing_model`.
        self.models = tuple(_physics_model(recipe, variant) for variant in variants)
        #: The model of the first variant.
        self.model = self.models[0]
        #: Which arms, and how they stand.
        self.arms = arms
        #: Every arm's description.
        self.robot = robot
        #: Number of arms.
        self.n_arms = arms.n
        #: (arms, 3), metres, world frame.
        self.base_position = arms.position
        cosine, sine = np.cos(arms.yaw), np.sin(arms.yaw)
        zero, one = np.zeros(arms.n), np.ones(arms.n)
        rotation = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], axis=-1)
        #: (arms, 3, 3), columns are the base's axes in the world frame.
        self.base_rotation = rotation.reshape(-1, 3, 3)
        #: Rotations (arms, 3, 3) from the world's frame to the bases'.
        self.world_to_base = np.swapaxes(self.base_rotation, -1, -2)
        #: Whether any base's frame is turned against the world's.
        self.bases_turned = bool(arms.yaw.any())
        model = self.model
        # Locked fingers have neither joints nor actuators.
        moving = arms.fingers is Fingers.ACTUATED
        #: (arms, dof) joint ids.
        self.joint_id = self._ids(model.joint, robot.arm_joints)
        #: (arms, dof) addresses of the arm joints in ``qpos``.
        self.joint_qpos = model.jnt_qposadr[self.joint_id].astype(np.intp)
        #: (arms, dof) addresses in ``qvel``.
        self.joint_dof = model.jnt_dofadr[self.joint_id].astype(np.intp)
        finger_id = self._ids(model.joint, robot.finger_joints if moving else ())
        #: (arms, fingers) addresses in ``qpos``; empty when locked.
        self.finger_qpos = model.jnt_qposadr[finger_id].astype(np.intp)
        #: (arms, fingers) addresses in ``qvel``.
        self.finger_dof = model.jnt_dofadr[finger_id].astype(np.intp)
        #: (arms, dof) actuator ids.
        self.arm_ctrl = self._ids(model.actuator, robot.arm_actuators)
        #: (arms, fingers) actuator ids.
        self.finger_ctrl = self._ids(model.actuator, robot.finger_actuators if moving else ())
        #: (arms,) site ids.
        self.tool_site = self._ids(model.site, (robot.tool_site,))[:, 0]
        sites = [model.site(index).name for index in range(model.nsite)]
        targets = range(sum(name.startswith(TARGET) for name in sites))
        #: Ids of the sites that show targets.
        self.target_site = np.array([model.site(f"{TARGET}{k}").id for k in targets], np.intp)
        pads = finger_geoms(robot, arms.fingers)
        #: (arms, pads) ids of the geoms that touch what the hands hold.
        self.finger_geom = self._ids(model.geom, pads)
        sensors = [model.sensor(index).name for index in range(model.nsensor)]
        counting = [index for index, name in enumerate(sensors) if name.startswith(COLLISION)]
        #: The table that is drawn.
        self.table = table_around(arms.position, arms.yaw, recipe.content.table_depth)
        loose = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        #: (k, 2) addresses in ``qpos`` of x and y of every body with a free joint.
        self.loose_qpos = model.jnt_qposadr[loose].astype(np.intp)[:, None] + np.arange(2)
        #: Addresses in ``sensordata`` of contacts that ``cost_collision`` counts.
        self.collision_sensor = model.sensor_adr[counting].astype(np.intp)
        forces = [index for index, name in enumerate(sensors) if name.startswith(FORCE_OF)]
        #: (k, 3) addresses of their forces.
        self.collision_force_sensor = model.sensor_adr[forces].astype(np.intp)[:, None] + [0, 1, 2]

    def _ids(self, kind: Callable[[str], Any], names: tuple[str, ...]) -> NDArray[np.intp]:
        """Look up names of every arm (arms, names)."""
        rows = [[kind(f"arm{arm}_{name}").id for name in names] for arm in range(self.n_arms)]
        return np.array(rows, dtype=np.intp)

    def to_world(self, points: Array) -> Array:
        """Turn base-frame points (..., arms, 3) into world-frame ones, metres."""
        if self.bases_turned:
            points = rotate(self.base_rotation, points)
        return points + self.base_position

    def to_bases(self, points: Array) -> Array:
        """Turn world-frame points (..., arms, 3) into ones in each arm's base frame, metres."""
        points = points - self.base_position
        return rotate(self.world_to_base, points) if self.bases_turned else points

    def drawing_model(self, variant: int = 0) -> mujoco.MjModel:
        """Return the same scene with meshes and decorations.

        Its state, actuators, sites and cameras are those of :attr:`models`; its bodies and geoms
        are more. Callers share it and must not change it.
        """
        return _drawing_model(self._recipe, variant)


@lru_cache(maxsize=32)
def finger_geoms(robot: Robot, fingers: Fingers) -> tuple[str, ...]:
    """Return the names of the collision geoms below a robot's hand, or of those of the hand.

    The hand is the body of the tool's site; a gripper without fingers is one body.
    """
    hand = robot.build(fingers).site(robot.tool_site).parent
    below = [geom for body in hand.find_all("body") for geom in body.geoms]
    for geoms in (below, hand.geoms):
        names = tuple(geom.name for geom in geoms if int(geom.group) == COLLISION_GROUP)
        if names:
            return names
    return ()


@dataclass(frozen=True)
class FreeBodies:
    """Addresses of bodies with free joints.

    :param qpos: (k, 7) addresses of position and quaternion in ``qpos``.
    :param dof: (k, 6) addresses of linear and angular velocity in ``qvel``.
    """

    qpos: NDArray[np.intp]
    dof: NDArray[np.intp]


@lru_cache(maxsize=64)
def free_bodies(scene: Scene, names: tuple[str, ...]) -> FreeBodies:
    """Look up bodies that have a free joint each.

    :raises KeyError: for a name that is not in the scene.
    :raises ValueError: for a body without such a joint.
    """
    model = scene.model
    joints = [int(model.body(name).jntadr[0]) for name in names]
    for name, joint in zip(names, joints, strict=True):
        if joint < 0 or int(model.jnt_type[joint]) != int(mujoco.mjtJoint.mjJNT_FREE):
            raise ValueError(f"body {name!r} has no free joint")
    qpos = model.jnt_qposadr[joints].astype(np.intp)[:, None] + np.arange(7)
    return FreeBodies(qpos, model.jnt_dofadr[joints].astype(np.intp)[:, None] + np.arange(6))


def rotate(rotation: Array, vector: Array) -> Array:
    """Apply (..., 3, 3) rotations to (..., 3) vectors, with a fixed order of summation."""
    return np.sum(rotation * vector[..., None, :], axis=-1)


def base_poses(n_arms: int, bases: Bases) -> tuple[Array, Array]:
    """Return where the bases stand and which way they face.

    :param n_arms: 1 to 4.
    :param bases: ``row``: side by side along y, 0.72 m apart, all facing +x; ``ring``: on a circle
        around the point (0.6, 0, 0), facing it; ``bedside``: as in a row, 1 m apart.
    :return: positions (arms, 3) in metres and yaw angles (arms,) in radians, world frame.
    :raises ValueError: for another number of arms or another way to stand.
    """
    require("n_arms", n_arms, 1 <= n_arms <= MAX_ARMS, f"1 to {MAX_ARMS}")
    require("layout", bases, bases in get_args(Bases), "'row' or 'ring' or 'bedside'")
    index = np.arange(n_arms)
    positions = np.zeros((n_arms, 3))
    if bases != "ring":
        spacing = BASE_SPACING if bases == "row" else BEDSIDE_SPACING
        positions[:, 1] = (index - (n_arms - 1) / 2) * spacing
        return positions, np.zeros(n_arms)
    yaw = 2 * math.pi * index / n_arms
    positions[:, 0] = RING_RADIUS * (1 - np.cos(yaw))
    positions[:, 1] = -RING_RADIUS * np.sin(yaw)
    return positions, yaw


def compose(arms: Arms, content: Content = BARE_TABLE, forces: bool = False) -> Scene:
    """Compile a table with arms, cameras and a content.

    Scenes are cached: callers share them and must not change their models.

    :param arms: which arms, and how they stand.
    :param content: other bodies; none by default.
    :param forces: measure the forces of the contacts that ``cost_collision`` counts.
    :return: the scene.
    """
    key = content.scene_key(), content.table_depth
    return _compose(_Recipe(arms, key, content, forces))


_compose = lru_cache(maxsize=32)(Scene)


@lru_cache(maxsize=32)
def _drawing_model(recipe: _Recipe, variant: int) -> mujoco.MjModel:
    return _specification(recipe, variant, decorated=True).compile()


def _physics_model(recipe: _Recipe, variant: int) -> mujoco.MjModel:
    """Compile a scene without visual geoms, and with static bodies fused to their parents.

    It moves like the complete scene with a quarter fewer instructions: the compiler keeps the
    inertia of what it drops or fuses. Only the softness of contacts would change, which depends on
    the inverse weight of the bodies: a fused body keeps that of its lightest part, the fingertips.
    """
    whole = _specification(recipe, variant, decorated=False).compile()
    spec = _specification(recipe, variant, decorated=False)
    spec.compiler.discardvisual = spec.compiler.fusestatic = True
    model = spec.compile()
    parts = [whole.geom(model.geom(index).name).bodyid[0] for index in range(model.ngeom)]
    np.maximum.at(model.body_invweight0, model.geom_bodyid, whole.body_invweight0[parts])
    recipe.content.compiled(model)
    return model


def _specification(recipe: _Recipe, variant: int, decorated: bool) -> mujoco.MjSpec:
    arms, content = recipe.arms, recipe.content
    table = table_around(arms.position, arms.yaw, content.table_depth)
    spec = new_world(table, content.table_height)
    spec.memory = MEMORY
    add_cameras(spec, table)
    for index in range(arms.n):
        _add_arm(spec, arms, index)
    content.build(spec, arms, variant, decorated)
    if recipe.forces:
        for one in [one for one in spec.sensors if one.name.startswith(COLLISION)]:
            name = f"{FORCE_OF}{one.name}"
            add_contact_sensor(spec, name, one.objname, one.reftype, one.refname, NET_FORCE)
    return spec


def _add_arm(spec: mujoco.MjSpec, arms: Arms, index: int) -> None:
    """Add arm ``index`` with the prefix ``arm<index>_`` and its collision bits."""
    robot = arms.robot
    arm = robot.build(arms.fingers)
    spec.assets = {**spec.assets, **arm.assets}  # attaching a body leaves the mesh files behind
    arm_bits = sum(FIRST_ARM_BIT << other for other in range(arms.n) if other != index)
    for geom in arm.geoms:
        if int(geom.group) != COLLISION_GROUP:
            continue
        geom.contype = FIRST_ARM_BIT << index
        geom.conaffinity = arm_bits | OBJECT_BIT
        if geom.name not in robot.off_table_geoms:
            geom.conaffinity |= TABLE_BIT
    yaw = float(arms.yaw[index])
    quaternion = (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2))
    frame = spec.worldbody.add_frame(pos=arms.position[index], quat=quaternion)
    frame.attach_body(arm.body(robot.base_body), f"arm{index}_", "")


def add_target(
    spec: mujoco.MjSpec, index: int, radius: float, position: tuple[float, float, float]
) -> None:
    """Add a site that shows a target; renderers move it.

    :param spec: gets the site ``target<index>``.
    :param index: of the target, and of its colour.
    :param radius: metres.
    :param position: before it is moved, metres.
    """
    spec.worldbody.add_site(
        name=f"{TARGET}{index}",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(radius, 0, 0),
        pos=position,
        rgba=(*ARM_COLOURS[index], 0.45),
    )


def add_collision_counters(
    spec: mujoco.MjSpec, arms: Arms, strange: Sequence[Sequence[str]]
) -> None:
    """Count contacts between arms, and of arms with the table and with what they may not touch.

    :param spec: gets the sensors.
    :param arms: the arms.
    :param strange: names of the geoms that an arm may not touch, arm by arm.
    """
    body, geom = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_GEOM
    for index, names in enumerate(strange):
        arm, name = arms.body(index), f"{COLLISION}arm{index}"
        add_contact_sensor(spec, f"{name}_table", arm, geom, "table")
        for other in range(index + 1, arms.n):
            add_contact_sensor(spec, f"{name}_arm{other}", arm, body, arms.body(other))
        for one in names:
            add_contact_sensor(spec, f"{name}_{one}", arm, geom, one)


def add_contact_sensor(
    spec: mujoco.MjSpec,
    name: str,
    body: str,
    kind: mujoco.mjtObj,
    other: str,
    reading: tuple[int, int, int] = CONTACT_COUNT,
) -> None:
    """Add a sensor of the contacts between a body with its subtree and something else.

    :param spec: gets the sensor.
    :param name: of the sensor.
    :param body: name of the body.
    :param kind: what ``other`` names: a geom, or a body with its subtree.
    :param other: what the body touches.
    :param reading: MuJoCo's parameters of a contact sensor: bits of the data, way of reduction
        and number of contacts; by default whether there is a contact.
    """
    spec.add_sensor(
        name=name,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=body,
        reftype=kind,
        refname=other,
        intprm=reading,
    )
