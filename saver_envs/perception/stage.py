"""Rendered scenes: people on stretchers, robot arms, clutter, lamps, grounds of any pattern."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, Camera, CameraPose, RgbdCamera
from saver_envs.people.manikin import add_manikin, joint_centres
from saver_envs.people.postures import random_appearance, random_posture
from saver_envs.people.stretcher import Stretcher, add_stretcher
from saver_envs.perception.skeleton import N_JOINTS, Visibility
from saver_envs.robots import JACO, MICO
from saver_envs.robots.description import COLLISION_GROUP, Fingers, Robot
from saver_envs.scenes import BASE_SPACING

CAMERA: Final = "kinect"
#: A joint is hidden where the surface in front of it is nearer to the camera by more than this (m):
#: the thickest flesh over a joint, the hip's, and some clothes.
_DEEPEST_JOINT: Final = 0.17
_TEXTURE_SIZE: Final = 128
#: Bases of the arms on the bench (Table 8.1), (m).
_BASES: Final = ((0.0, -BASE_SPACING / 2), (0.0, BASE_SPACING / 2))
#: Limbs settle for so many steps of so many seconds.
_SETTLE_STEPS, _SETTLE_TIMESTEP = 120, 0.004
#: An arm may overlap with a person by this much (m).
_DEEPEST_TOUCH: Final = 0.02


@dataclass(frozen=True)
class StageOptions:
    """What a scene holds.

    :param split: whose people and patterns it has: ``train``, ``validation`` or ``test``.
    :param people: 1 or 2; ``None`` draws, one in four times 2.
    :param arms: probability of robot arms.
    :param occluding: whether arms are put between the camera and the person.
    :param low_light: whether it is dark.
    :param bench_share: share of frames from the bench's camera pose, the rest is elevated.
    :param shadow_share: share of frames with shadows.
    """

    split: str = "train"
    people: int | None = None
    arms: float = 0.6
    occluding: bool = False
    low_light: bool = False
    bench_share: float = 0.35
    shadow_share: float = 0.15


@dataclass(frozen=True)
class Labelled:
    """A picture and where people's joints are in it.

    :param rgb: (height, width, 3) uint8.
    :param depth: (height, width) float32 metres, 0 where there is none; with the sensor's noise.
    :param pixels: (people, 14, 2) true joints, also outside the picture; NaN behind the camera.
    :param visibility: (people, 14) of :class:`~.skeleton.Visibility`; 0 outside the picture.
    :param positions: (people, 14, 3) true joints, bench frame, metres.
    :param pose: of the camera.
    :param boxes: (people, 4) left, top, right, bottom of what is seen of a person, pixels.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    pixels: NDArray[np.float64]
    visibility: NDArray[np.uint8]
    positions: NDArray[np.float64]
    pose: CameraPose
    boxes: NDArray[np.float64]


class Stage:
    """One compiled scene: people, clothes and patterns stay; poses, view and light change.

    :param random: source of everything.
    :param options: what it holds.
    :param camera: intrinsics; pictures are of its size.
    """

    def __init__(
        self, random: np.random.Generator, options: StageOptions, camera: Camera = KINECT_V2
    ) -> None:
        self._random = random
        self._options = options
        spec = _world(random)
        count = options.people or (2 if random.random() < 0.25 else 1)
        self._prefixes = [f"person{index}_" for index in range(count)]
        for index, prefix in enumerate(self._prefixes):
            _add_person(spec, random, options.split, prefix, index)
        self._arms = _add_arms(spec, random) if random.random() < options.arms else []
        _add_clutter(spec, random)
        camera.add_to(spec, CAMERA, BENCH_POSE)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._camera = RgbdCamera(self._model, CAMERA, camera)
        self._lights = self._model.light_diffuse.copy()
        self._owners = self._skin_owners()

    def frame(self, depth_noise: bool = True) -> Labelled:
        """Return a labelled picture of people in new postures, from a new view, in a new light."""
        self._pose_people()
        self._pose_arms()
        pose = self._view()
        self._light()
        data, model = self._data, self._model
        model.cam_pos[0], model.cam_quat[0] = pose.position, pose.quaternion()
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        shadows = bool(self._random.random() < self._options.shadow_share)
        frame = self._camera.capture(data, self._random if depth_noise else None, shadows)
        return self._label(frame.rgb, frame.depth, pose)

    def close(self) -> None:
        """Free the graphics context."""
        self._camera.close()

    def _skin_owners(self) -> NDArray[np.intp]:
        """Return which person (skins,) a skin belongs to."""
        model = self._model
        starts = [model.name_skinadr[skin] for skin in range(model.nskin)]
        names = [model.names[start : model.names.index(b"\0", start)].decode() for start in starts]
        return np.array(
            [next(k for k, p in enumerate(self._prefixes) if name.startswith(p)) for name in names]
        )

    def _pose_people(self) -> None:
        random, model, data = self._random, self._model, self._data
        mujoco.mj_resetData(model, data)
        for prefix in self._prefixes:
            random_posture(random, model, data.qpos, prefix)
            address = int(model.joint(f"{prefix}slide_x").qposadr[0])
            data.qpos[address : address + 2] += random.uniform(-0.05, 0.05, 2)
            data.qpos[address + 2] = random.normal(0, 0.06)
        for arm in self._arms:
            arm.park(data)
        if random.random() < 0.85:  # else limbs float, as if somebody held them
            mujoco.mj_step(model, data, _SETTLE_STEPS)
        data.qvel[:] = 0.0

    def _pose_arms(self) -> None:
        random, data = self._random, self._data
        for arm in self._arms:
            for _ in range(6):
                arm.reach(data, random, over=self._options.occluding)
                mujoco.mj_kinematics(self._model, data)
                mujoco.mj_collision(self._model, data)
                if not arm.presses(self._model, data):
                    break
            else:
                arm.park(data)

    def _view(self) -> CameraPose:
        random = self._random
        mujoco.mj_kinematics(self._model, self._data)
        joints = joint_centres(self._model, self._data, self._prefixes[0])
        if random.random() < self._options.bench_share:
            turned = CameraPose(BENCH_POSE.position, BENCH_POSE.rotation @ np.diag([-1, -1, 1]))
            tilt = np.empty(9)
            quaternion = np.empty(4)
            mujoco.mju_axisAngle2Quat(quaternion, _unit(random), math.radians(random.uniform(0, 5)))
            mujoco.mju_quat2Mat(tilt, quaternion)
            position = turned.position + random.uniform(-0.06, 0.06, 3)
            return CameraPose(position, tilt.reshape(3, 3) @ turned.rotation)
        target = joints[:, :].mean(axis=0) + random.uniform(-0.2, 0.2, 3)
        azimuth, elevation = random.uniform(0, 2 * math.pi), math.radians(random.uniform(40, 90))
        distance = random.uniform(1.35, 2.3)
        away = np.array(
            [
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            ]
        )
        spine = joints[0] - (joints[8] + joints[11]) / 2
        return _upright(target + distance * away, target, spine, random)

    def _light(self) -> None:
        random, model = self._random, self._model
        strength = (
            random.uniform(0.08, 0.25) if self._options.low_light else random.uniform(0.6, 1.8)
        )
        tint = 1 + random.uniform(-0.12, 0.12, 3)
        model.light_diffuse[:] = self._lights * strength * tint
        for light in range(model.nlight):
            model.light_pos[light, :2] = random.uniform(-1.5, 1.5, 2)
        ambient = random.uniform(0.2, 0.6) * strength
        model.vis.headlight.ambient[:] = ambient
        model.vis.headlight.diffuse[:] = random.uniform(0.0, 0.4) * strength

    def _label(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], pose: CameraPose
    ) -> Labelled:
        drawn = self._camera.segmentation(self._data)
        is_skin = drawn[..., 1] == int(mujoco.mjtObj.mjOBJ_SKIN)
        person = np.where(is_skin, self._owners[np.where(is_skin, drawn[..., 0], 0)], -1)
        positions = np.stack([joint_centres(self._model, self._data, p) for p in self._prefixes])
        pixels, distance = self._camera.camera.project(positions, pose)
        visibility = np.stack(
            [
                _visibility(pixels[k], distance[k], person == k, depth)
                for k in range(len(self._prefixes))
            ]
        )
        boxes = np.stack([_box(person == k) for k in range(len(self._prefixes))])
        return Labelled(rgb, depth, pixels, visibility, positions, pose, boxes)


class _Arm:
    """A robot arm on the stage: joints that are set, not simulated."""

    def __init__(self, robot: Robot, prefix: str) -> None:
        self._robot = robot
        self._prefix = prefix

    def _put(self, data: mujoco.MjData, angles: NDArray[np.float64]) -> None:
        for joint, servo, angle in zip(
            self._robot.arm_joints, self._robot.arm_actuators, angles, strict=True
        ):
            data.joint(self._prefix + joint).qpos = angle
            data.actuator(self._prefix + servo).ctrl = angle

    def park(self, data: mujoco.MjData) -> None:
        """Fold the arm above its base."""
        self._put(data, np.array(self._robot.home))

    def reach(self, data: mujoco.MjData, random: np.random.Generator, over: bool) -> None:
        """Take any posture round the home posture; ``over``: turned towards the person."""
        home = np.array(self._robot.home)
        lower = np.array(self._robot.joint_lower)
        upper = np.array(self._robot.joint_upper)
        spread = np.full(len(home), 0.6)
        spread[0] = 0.35 if over else 1.0
        self._put(data, np.clip(home + random.normal(0, 1, len(home)) * spread, lower, upper))

    def presses(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Say whether the arm and a person are in one another."""
        for contact in data.contact:
            names = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
            arm = [name.startswith(self._prefix) for name in names]
            someone = [name.startswith("person") for name in names]
            if any(arm) and any(someone) and contact.dist < -_DEEPEST_TOUCH:
                return True
        return False


def _world(random: np.random.Generator) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = _SETTLE_TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    visual = spec.visual
    visual.quality.offsamples = 0
    visual.quality.shadowsize = 1024
    visual.map.znear, visual.map.zfar = 0.02, 20.0
    visual.headlight.specular = (0.05, 0.05, 0.05)
    _add_texture(spec, "floor", random)
    _add_texture(spec, "bench", random)
    world = spec.worldbody
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(0, 0, -random.uniform(0.02, 0.75)),
        size=(6, 6, 0.1),
        material="floor",
        contype=0,
        conaffinity=0,
    )
    # What the limbs lie on is level with the stretcher whether a table is seen there or not.
    world.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(3, 3, 0.1),
        contype=1,
        conaffinity=0,
        group=COLLISION_GROUP,
    )
    if random.random() < 0.7:
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(random.uniform(0.1, 0.4), 0, -0.0145),
            size=(random.uniform(0.6, 1.4), random.uniform(0.5, 1.1), 0.01),
            material="bench",
            contype=0,
            conaffinity=0,
        )
    for _ in range(random.integers(1, 4)):
        world.add_light(
            pos=(0, 0, random.uniform(2.0, 3.5)),
            dir=(0, 0, -1),
            type=mujoco.mjtLightType.mjLIGHT_POINT,
            diffuse=np.full(3, random.uniform(0.25, 0.6)),
            specular=np.full(3, random.uniform(0, 0.2)),
            castshadow=True,
        )
    return spec


def _add_texture(spec: mujoco.MjSpec, name: str, random: np.random.Generator) -> None:
    """Add a material with a random pattern: smooth spots, planks, tiles or plain."""
    size = _TEXTURE_SIZE
    first, second = random.uniform(0.05, 0.95, (2, 3))
    if random.random() < 0.5:  # greyish, as most floors are
        first, second = (0.8 * colour.mean() + 0.2 * colour for colour in (first, second))
    cells = int(random.choice([4, 8, 16, 32]))
    rows, columns = np.indices((size, size)) // (size // cells)
    kind = random.integers(4)
    if kind == 0:
        share = np.kron(random.random((cells, cells)), np.ones((size // cells, size // cells)))
    elif kind == 1:
        share = random.random(cells)[rows]
    elif kind == 2:
        share = ((rows + columns) % 2).astype(np.float64)
    else:
        share = np.zeros((size, size))
    share = np.clip(share + random.normal(0, random.uniform(0, 0.15), (size, size)), 0, 1)
    pixels = first + share[..., None] * (second - first)
    texture = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=size, height=size, nchannel=3
    )
    texture.data = np.rint(255 * np.clip(pixels, 0, 1)).astype(np.uint8).tobytes()
    repeat = random.uniform(0.5, 3.0)
    material = spec.add_material(
        name=name, texuniform=True, texrepeat=(repeat, repeat), specular=0.1, shininess=0.1
    )
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
    material.textures = textures


def _add_person(
    spec: mujoco.MjSpec, random: np.random.Generator, split: str, prefix: str, index: int
) -> None:
    """Add a person, head towards -x; a second one lies beside the first."""
    appearance = random_appearance(random, split)
    position = (random.uniform(0.25, 0.45), random.uniform(-0.03, 0.03), 0.0)
    yaw = random.normal(0, 0.05)
    if index:
        side = random.choice([-1.0, 1.0])
        position = (random.uniform(0.0, 0.6), side * random.uniform(0.62, 0.95), 0.0)
        yaw = random.normal(0, 0.3)
    add_manikin(spec, appearance, position, yaw, prefix)
    if random.random() < 0.85:
        canvas, support = random.uniform(0.1, 0.95, (2, 3))
        stretcher = Stretcher(
            width=random.uniform(0.48, 0.6), colour=tuple(canvas), support=tuple(support)
        )
        add_stretcher(spec, stretcher, appearance, position, yaw, prefix)


def _add_arms(spec: mujoco.MjSpec, random: np.random.Generator) -> list[_Arm]:
    """Add one or two arms where the bench has them."""
    arms = []
    bases = [base for base in _BASES if random.random() < 0.8]
    robot = JACO if random.random() < 0.75 else MICO
    for index, (x, y) in enumerate(bases):
        arm = robot.build(Fingers.LOCKED)
        spec.assets = {**spec.assets, **arm.assets}
        for geom in arm.geoms:
            if int(geom.group) == COLLISION_GROUP:
                geom.contype, geom.conaffinity = 4, 2
        frame = spec.worldbody.add_frame(pos=(x, y, 0))
        frame.attach_body(arm.body(robot.base_body), f"arm{index}_", "")
        arms.append(_Arm(robot, f"arm{index}_"))
    return arms


def _add_clutter(spec: mujoco.MjSpec, random: np.random.Generator) -> None:
    """Add boxes and cylinders of any colour beside the stretcher."""
    for _ in range(random.integers(0, 7)):
        round_one = random.random() < 0.4
        size = random.uniform(0.02, 0.16, 3)
        angle = random.uniform(0, math.pi)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER if round_one else mujoco.mjtGeom.mjGEOM_BOX,
            pos=(
                random.uniform(-1.0, 1.6),
                random.choice([-1, 1]) * random.uniform(0.5, 1.3),
                size[2],
            ),
            size=(size[0], size[2], 0) if round_one else size,
            quat=(math.cos(angle / 2), 0, 0, math.sin(angle / 2)),
            rgba=(*random.uniform(0, 1, 3), 1),
            contype=0,
            conaffinity=0,
        )


def _unit(random: np.random.Generator) -> NDArray[np.float64]:
    axis = random.standard_normal(3)
    unit: NDArray[np.float64] = axis / np.linalg.norm(axis)
    return unit


def _upright(
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    spine: NDArray[np.float64],
    random: np.random.Generator,
) -> CameraPose:
    """Return a view in which the spine points upwards, or up to 50 degrees to either side."""
    pose = CameraPose.looking_at(position, target, spine)
    roll = math.radians(random.uniform(-50, 50))
    cosine, sine = math.cos(roll), math.sin(roll)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return CameraPose(pose.position, pose.rotation @ turn)


def _visibility(
    pixels: NDArray[np.float64],
    distance: NDArray[np.float64],
    mine: NDArray[np.bool_],
    depth: NDArray[np.float32],
) -> NDArray[np.uint8]:
    """Return how each joint (14,) of a person is annotated.

    :param pixels: (14, 2).
    :param distance: (14,) of the joints along the view, metres.
    :param mine: (height, width) where the person is seen.
    :param depth: (height, width) metres.
    """
    height, width = mine.shape
    inside = np.isfinite(pixels).all(axis=1) & (pixels >= 0).all(axis=1)
    inside &= (np.nan_to_num(pixels) < (width, height)).all(axis=1)
    column = np.where(inside, np.nan_to_num(pixels[:, 0]), 0).astype(np.intp)
    row = np.where(inside, np.nan_to_num(pixels[:, 1]), 0).astype(np.intp)
    near = np.array([(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    rows = np.clip(row[:, None] + near[:, 0], 0, height - 1)
    columns = np.clip(column[:, None] + near[:, 1], 0, width - 1)
    surface = np.where(mine[rows, columns], depth[rows, columns], -np.inf).max(axis=1)
    seen = inside & (surface > distance - _DEEPEST_JOINT)
    visibility = np.full(N_JOINTS, Visibility.MISSING, dtype=np.uint8)
    visibility[inside] = Visibility.OCCLUDED
    visibility[seen] = Visibility.VISIBLE
    return visibility


def _box(mine: NDArray[np.bool_]) -> NDArray[np.float64]:
    rows, columns = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
    if len(rows) == 0:
        return np.zeros(4)
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
