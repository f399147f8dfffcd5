"""Composes the world, arms and objects into one compiled model with named addresses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import COLLISION_GROUP, Fingers, Robot
from saver_envs.world import TABLE_BIT, add_cameras, bench_round, new_world

if TYPE_CHECKING:
    from saver_envs.people.bench import PersonAddresses

Layout = Literal["row", "ring"]

#: Distance between neighbouring bases in a row (m), Table 8.1.
BASE_SPACING = 0.72
#: Radius of the circle on which bases stand around the table (m), ours: as far from the centre
#: as a base of a row is from the middle of its workspace.
RING_RADIUS = 0.60
MAX_ARMS = 4
#: First part of the names of sensors that count contacts for ``cost_collision``.
COLLISION = "collision_"
#: Memory for the contacts of a simulation and their constraints (bytes), ten times what they need.
MEMORY = 4 * 2**20

#: Further collision bits. Arm i adds the bit ``FIRST_ARM_BIT << i``; an arm never meets itself.
OBJECT_BIT, FIRST_ARM_BIT = 2, 4

OBJECT_COLOURS = ((0.85, 0.33, 0.20), (0.20, 0.47, 0.75), (0.93, 0.69, 0.20), (0.45, 0.62, 0.35))


@dataclass(frozen=True)
class ObjectProperties:
    """Cubes that the arms move, all alike.

    :param size: edge length, metres.
    :param mass: kilograms.
    :param friction: sliding friction with the table and the hands, dimensionless.
    :param damping: viscous drag on the cube's motion, N s/m; 0 for free sliding. Its turning is
        dragged, in N m s/rad, as if that came from one face: by the mean of the squared distances
        of the face's points from its middle, a sixth of the squared edge, times as much.
    """

    size: float = 0.056
    mass: float = 0.2
    friction: float = 0.5
    damping: float = 0.0


@dataclass(frozen=True)
class Scene:
    """A compiled model and where to find things in it; arrays have one row per arm.

    :param model: the compiled MuJoCo model, of what moves and collides alone; see
        :meth:`drawing_model`.
    :param robot: the arms' description.
    :param fingers: whether the finger joints exist.
    :param objects: size, mass and friction of the cubes.
    :param layout: how the bases stand.
    :param base_position: (arms, 3), metres, world frame.
    :param base_rotation: (arms, 3, 3), columns are the base's axes in the world frame.
    :param joint_qpos: (arms, dof) addresses of the arm joints in ``qpos``.
    :param joint_dof: (arms, dof) addresses in ``qvel``.
    :param joint_id: (arms, dof) joint ids.
    :param finger_qpos: (arms, fingers) addresses in ``qpos``; empty when locked.
    :param finger_dof: (arms, fingers) addresses in ``qvel``.
    :param arm_ctrl: (arms, dof) actuator ids.
    :param finger_ctrl: (arms, fingers) actuator ids.
    :param tool_site: (arms,) site ids.
    :param object_qpos: (arms, 7) addresses of position and quaternion.
    :param object_dof: (arms, 6) addresses of linear and angular velocity.
    :param target_site: (arms,) sites that show the targets.
    :param collision_sensor: addresses in ``sensordata`` of contacts that ``cost_collision`` counts.
    :param person: where the person is in the scene of :mod:`saver_envs.people.bench`, whose wrists
        are the objects.
    """

    model: mujoco.MjModel
    robot: Robot
    fingers: Fingers
    objects: ObjectProperties
    layout: Layout
    base_position: NDArray[np.float64]
    base_rotation: NDArray[np.float64]
    joint_qpos: NDArray[np.intp]
    joint_dof: NDArray[np.intp]
    joint_id: NDArray[np.intp]
    finger_qpos: NDArray[np.intp]
    finger_dof: NDArray[np.intp]
    arm_ctrl: NDArray[np.intp]
    finger_ctrl: NDArray[np.intp]
    tool_site: NDArray[np.intp]
    object_qpos: NDArray[np.intp]
    object_dof: NDArray[np.intp]
    target_site: NDArray[np.intp]
    collision_sensor: NDArray[np.intp]
    person: PersonAddresses | None = None

    @property
    def n_arms(self) -> int:
        """Number of arms, and of objects."""
        return len(self.base_position)

    @property
    def object_rest_height(self) -> float:
        """Height of a resting cube's centre above the table, metres."""
        return self.objects.size / 2

    def drawing_model(self, body: int = 0) -> mujoco.MjModel:
        """Return the same bench with meshes and decorations.

        Its state, actuators, sites and cameras are those of :attr:`model`; its bodies and geoms
        are more. Callers share it and must not change it.

        :param body: which of the bodies the person has, in scenes with one.
        """
        if self.person is not None:
            return self.person.drawing_model(body, self.robot)
        return _drawing_model(self.robot, self.n_arms, self.fingers, self.objects, self.layout)


def base_poses(n_arms: int, layout: Layout) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the bases stand and which way they face.

    :param n_arms: 1 to 4.
    :param layout: ``row``: side by side along y, 0.72 m apart, all facing +x; ``ring``: on a
        circle round the point (0.6, 0, 0), facing it.
    :return: positions (arms, 3) in metres and yaw angles (arms,) in radians, world frame.
    :raises ValueError: for another number of arms or another layout.
    """
    if not 1 <= n_arms <= MAX_ARMS:
        raise ValueError(f"n_arms={n_arms!r}: a scene holds 1 to {MAX_ARMS} arms")
    index = np.arange(n_arms)
    positions = np.zeros((n_arms, 3))
    if layout == "row":
        positions[:, 1] = (index - (n_arms - 1) / 2) * BASE_SPACING
        return positions, np.zeros(n_arms)
    if layout == "ring":
        yaw = 2 * math.pi * index / n_arms
        positions[:, 0] = RING_RADIUS * (1 - np.cos(yaw))
        positions[:, 1] = -RING_RADIUS * np.sin(yaw)
        return positions, yaw
    raise ValueError(f"layout={layout!r}: valid layouts are 'row' and 'ring'")


def add_arm(
    spec: mujoco.MjSpec,
    robot: Robot,
    fingers: Fingers,
    index: int,
    position: NDArray[np.float64],
    yaw: float,
    n_arms: int,
) -> None:
    """Add arm ``index`` of ``n_arms``, with the collision bits of its number.

    :param spec: gets the arm, its names behind ``arm<index>_``.
    :param robot: the arm.
    :param fingers: actuated or locked fingers.
    :param index: which of the scene's arms it is.
    :param position: (3,) of its base, metres.
    :param yaw: of its base, radians.
    :param n_arms: how many arms the scene has.
    """
    arm = robot.build(fingers)
    spec.assets = {**spec.assets, **arm.assets}  # attaching a body leaves the mesh files behind
    arm_bits = sum(FIRST_ARM_BIT << other for other in range(n_arms) if other != index)
    for geom in arm.geoms:
        if int(geom.group) != COLLISION_GROUP:
            continue
        geom.contype = FIRST_ARM_BIT << index
        geom.conaffinity = arm_bits | OBJECT_BIT
        if geom.name not in robot.off_table_geoms:
            geom.conaffinity |= TABLE_BIT
    quaternion = (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2))
    frame = spec.worldbody.add_frame(pos=position, quat=quaternion)
    frame.attach_body(arm.body(robot.base_body), f"arm{index}_", "")


def _add_object(spec: mujoco.MjSpec, index: int, objects: ObjectProperties, x: float) -> None:
    body = spec.worldbody.add_body(name=f"object{index}", pos=(x, 0.1 * index, objects.size / 2))
    body.add_freejoint(name=f"object{index}_joint")
    if objects.damping:
        body.joints[0].damping = (objects.damping, 0, 0)
    body.add_geom(
        name=f"object{index}",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(objects.size / 2,) * 3,
        mass=objects.mass,
        friction=(objects.friction, 0.02, 0.001),
        condim=3,
        contype=OBJECT_BIT,
        conaffinity=TABLE_BIT | OBJECT_BIT,
        rgba=(*OBJECT_COLOURS[index], 1),
    )
    add_target(spec, index, objects.size / 2, (x, 0.1 * index, objects.size / 2))


def add_target(
    spec: mujoco.MjSpec, index: int, radius: float, position: tuple[float, float, float]
) -> None:
    """Add the site that shows the target of arm ``index``; renderers move it."""
    spec.worldbody.add_site(
        name=f"target{index}",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(radius, 0, 0),
        pos=position,
        rgba=(*OBJECT_COLOURS[index], 0.45),
    )


def _add_collision_sensors(spec: mujoco.MjSpec, robot: Robot, n_arms: int) -> None:
    """Count contacts between arms, of arms with the table, and with other arms' objects."""
    pairs: list[tuple[str, int, str, int, str]] = []
    body, geom = int(mujoco.mjtObj.mjOBJ_XBODY), int(mujoco.mjtObj.mjOBJ_GEOM)
    for index in range(n_arms):
        arm = f"arm{index}_{robot.base_body}"
        pairs.append((f"{COLLISION}arm{index}_table", body, arm, geom, "table"))
        for other in range(n_arms):
            if other > index:
                other_arm = f"arm{other}_{robot.base_body}"
                pairs.append((f"{COLLISION}arm{index}_arm{other}", body, arm, body, other_arm))
            if other != index:
                name = f"{COLLISION}arm{index}_object{other}"
                pairs.append((name, body, arm, geom, f"object{other}"))
    add_contact_counters(spec, pairs)


def add_contact_counters(
    spec: mujoco.MjSpec, pairs: Sequence[tuple[str, int, str, int, str]]
) -> None:
    """Add sensors that count contacts.

    :param spec: gets the sensors.
    :param pairs: name of the sensor, type and name of what touches, type and name of what is
        touched; a body stands for its whole subtree.
    """
    for name, first_type, first, second_type, second in pairs:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=first_type,
            objname=first,
            reftype=second_type,
            refname=second,
            intprm=(int(1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)), 0, 1),
        )


@lru_cache(maxsize=32)
def compose(
    robot: Robot,
    n_arms: int = 1,
    fingers: Fingers = Fingers.ACTUATED,
    objects: ObjectProperties = ObjectProperties(),
    layout: Layout = "row",
) -> Scene:
    """Compile a bench with arms, one cube and one target each, and cameras.

    The result is cached: callers share it and must not change its model.

    :param robot: the arm, used ``n_arms`` times.
    :param n_arms: 1 to 4.
    :param fingers: actuated or locked fingers.
    :param objects: size, mass and friction of the cubes.
    :param layout: how the bases stand, see :func:`base_poses`.
    :return: the scene.
    :raises ValueError: for a number of arms or a layout that cannot be.
    """
    model = _physics_model(robot, n_arms, fingers, objects, layout)
    return address(model, robot, fingers, objects, layout, *base_poses(n_arms, layout))


@lru_cache(maxsize=32)
def _drawing_model(
    robot: Robot, n_arms: int, fingers: Fingers, objects: ObjectProperties, layout: Layout
) -> mujoco.MjModel:
    """Compile a bench with all that there is to see."""
    return _specification(robot, n_arms, fingers, objects, layout).compile()


def _physics_model(
    robot: Robot, n_arms: int, fingers: Fingers, objects: ObjectProperties, layout: Layout
) -> mujoco.MjModel:
    """Compile a bench of what moves and collides alone; see :func:`compile_physics`."""
    model = compile_physics(
        _specification(robot, n_arms, fingers, objects, layout),
        _drawing_model(robot, n_arms, fingers, objects, layout),
    )
    for index in range(n_arms):
        # A free joint has one damping for all its motions: as N m s/rad it would hold a cube fast.
        turning = model.joint(f"object{index}_joint").dofadr[0] + np.arange(3, 6)
        model.dof_damping[turning] = objects.damping * objects.size**2 / 6
    return model


def compile_physics(spec: mujoco.MjSpec, whole: mujoco.MjModel) -> mujoco.MjModel:
    """Compile a scene without what is only seen, and with jointless bodies fused to their parents.

    It moves as the whole does, for a quarter fewer instructions: the compiler keeps the inertia of
    what it drops or fuses. What it would change is how soft contacts are, which follows from the
    inverse weight of the bodies that touch: a fused one keeps that of its lightest part, the
    fingertips.

    :param spec: of the scene.
    :param whole: the scene, compiled with all that there is.
    :return: the model.
    """
    spec.compiler.discardvisual = spec.compiler.fusestatic = True
    model = spec.compile()
    parts = [whole.geom(model.geom(index).name).bodyid[0] for index in range(model.ngeom)]
    np.maximum.at(model.body_invweight0, model.geom_bodyid, whole.body_invweight0[parts])
    return model


def _specification(
    robot: Robot, n_arms: int, fingers: Fingers, objects: ObjectProperties, layout: Layout
) -> mujoco.MjSpec:
    positions, yaws = base_poses(n_arms, layout)
    bench = bench_round(positions, yaws)
    spec = new_world(bench)
    spec.memory = MEMORY
    add_cameras(spec, bench)
    for index in range(n_arms):
        add_arm(spec, robot, fingers, index, positions[index], float(yaws[index]), n_arms)
    for index in range(n_arms):
        _add_object(spec, index, objects, x=0.4)
    _add_collision_sensors(spec, robot, n_arms)
    return spec


def address(
    model: mujoco.MjModel,
    robot: Robot,
    fingers: Fingers,
    objects: ObjectProperties,
    layout: Layout,
    positions: NDArray[np.float64],
    yaws: NDArray[np.float64],
) -> Scene:
    """Look every name up once, after compilation."""
    arms = range(len(positions))
    finger_joints = robot.finger_joints if fingers is Fingers.ACTUATED else ()
    finger_actuators = robot.finger_actuators if fingers is Fingers.ACTUATED else ()

    def table(rows: list[list[int]]) -> NDArray[np.intp]:
        return np.array(rows, dtype=np.intp).reshape(len(positions), -1)

    def joint_ids(arm: int, names: tuple[str, ...]) -> list[int]:
        return [model.joint(f"arm{arm}_{name}").id for name in names]

    def actuator_ids(arm: int, names: tuple[str, ...]) -> list[int]:
        return [model.actuator(f"arm{arm}_{name}").id for name in names]

    joint_id = table([joint_ids(arm, robot.arm_joints) for arm in arms])
    finger_id = table([joint_ids(arm, finger_joints) for arm in arms])
    joints = {model.joint(index).name for index in range(model.njnt)}

    def cubes(addresses: NDArray[np.int32], size: int) -> NDArray[np.intp]:
        names = [f"object{arm}_joint" for arm in arms]
        if names[0] not in joints:
            return table([[] for _ in arms])
        ids = np.array([model.joint(name).id for name in names])
        return addresses[ids][:, None].astype(np.intp) + np.arange(size)

    names = [model.sensor(index).name for index in range(model.nsensor)]
    sensors = [index for index, name in enumerate(names) if name.startswith(COLLISION)]

    cosine, sine = np.cos(yaws), np.sin(yaws)
    zero, one = np.zeros_like(yaws), np.ones_like(yaws)
    rotation = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], axis=-1)
    return Scene(
        model=model,
        robot=robot,
        fingers=fingers,
        objects=objects,
        layout=layout,
        base_position=positions,
        base_rotation=rotation.reshape(-1, 3, 3),
        joint_id=joint_id,
        joint_qpos=model.jnt_qposadr[joint_id].astype(np.intp),
        joint_dof=model.jnt_dofadr[joint_id].astype(np.intp),
        finger_qpos=model.jnt_qposadr[finger_id].astype(np.intp),
        finger_dof=model.jnt_dofadr[finger_id].astype(np.intp),
        arm_ctrl=table([actuator_ids(arm, robot.arm_actuators) for arm in arms]),
        finger_ctrl=table([actuator_ids(arm, finger_actuators) for arm in arms]),
        tool_site=np.array([model.site(f"arm{arm}_{robot.tool_site}").id for arm in arms]),
        object_qpos=cubes(model.jnt_qposadr, 7),
        object_dof=cubes(model.jnt_dofadr, 6),
        target_site=np.array([model.site(f"target{a}").id for a in arms]),
        collision_sensor=model.sensor_adr[sensors].astype(np.intp),
    )
