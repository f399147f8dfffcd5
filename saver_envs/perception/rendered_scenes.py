"""Render labelled pictures of random scenes: people on stretchers, robot arms, clutter, lights."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, Camera, CameraPose, RgbdCamera
from saver_envs.people.manikin import add_manikin, joint_centres
from saver_envs.people.postures import random_appearance, random_posture
from saver_envs.people.stretcher import add_stretcher
from saver_envs.perception.lifting import pixel_windows
from saver_envs.perception.skeleton import N_JOINTS, Visibility
from saver_envs.robots import ROBOTS
from saver_envs.robots.description import COLLISION_GROUP, Fingers, Robot
from saver_envs.scenes import BASE_SPACING
from saver_envs.world import add_picture, give_texture

CAMERA: Final = "kinect"
#: Largest depth of a joint below the visible surface (m): the hip's flesh and some clothes. A joint
#: further behind the surface is occluded.
_DEEPEST_JOINT: Final = 0.17
_TEXTURE_SIZE: Final = 128
#: Bases of the arms on the bench (Table 8.1), (m).
_BASES: Final = ((0.0, -BASE_SPACING / 2), (0.0, BASE_SPACING / 2))
#: Number of steps, and seconds per step, in which the limbs settle.
_SETTLE_STEPS, _SETTLE_TIMESTEP = 120, 0.004
#: Largest overlap of an arm with a person (m).
_DEEPEST_TOUCH: Final = 0.02
#: The pose of the bench's camera with the head of the person at the top of the picture.
_HEAD_UP_BENCH: Final = BENCH_POSE.rotation @ np.diag([-1, -1, 1])


@dataclass(frozen=True)
class RenderedSceneOptions:
    """Contents of a rendered scene.

    :param split: whose people and patterns are drawn: ``train``, ``validation`` or ``test``.
    :param people: 1 or 2; ``None`` draws 2 with probability 1/4.
    :param arms: probability of robot arms.
    :param occluding: turn the arms between the camera and the person.
    :param low_light: make the scene dark.
    :param bench_share: probability of a view close to the bench's camera; other views are elevated.
    :param shadow_share: probability of shadows.
    """

    split: str = "train"
    people: int | None = None
    arms: float = 0.6
    occluding: bool = False
    low_light: bool = False
    bench_share: float = 0.35
    shadow_share: float = 0.15


@dataclass(frozen=True)
class LabelledPicture:
    """A picture with the joints of the people in it.

    :param rgb: (height, width, 3) uint8.
    :param depth: (height, width) float32, metres; 0 where there is no measurement.
    :param pixels: (people, 14, 2) true joints, also outside the picture; NaN behind the camera.
    :param visibility: (people, 14) of :class:`~.skeleton.Visibility`; 0 outside the picture.
    :param positions: (people, 14, 3) true joints, bench frame, metres.
    :param pose: pose of the camera.
    :param boxes: (people, 4) left, top, right, bottom of each person's visible part, pixels.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    pixels: NDArray[np.float64]
    visibility: NDArray[np.uint8]
    positions: NDArray[np.float64]
    pose: CameraPose
    boxes: NDArray[np.float64]


class RenderedScene:
    """One compiled scene: people, clothes and patterns stay; poses, view and light change.

    :param random: source of all random numbers.
    :param options: contents of the scene.
    :param camera: intrinsics and size of the pictures.
    """

    def __init__(
        self,
        random: np.random.Generator,
        options: RenderedSceneOptions,
        camera: Camera = KINECT_V2,
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
        names = [self._model.skin(skin).name for skin in range(self._model.nskin)]
        #: Index (skins,) of the person that each skin belongs to.
        self._owners = np.array([self._prefixes.index(name.split("_")[0] + "_") for name in names])

    def frame(self, depth_noise: bool = True) -> LabelledPicture:
        """Render people in new postures, from a new view, in a new light.

        :param depth_noise: add the noise of the sensor to the depth.
        :return: the picture and its labels.
        """
        from PIL import Image

        data, model, random = self._data, self._model, self._random
        self._pose_people()
        self._pose_arms()
        mujoco.mj_kinematics(model, data)
        if random.random() < self._options.bench_share:
            pose = _bench_view(random)
        else:
            pose = _elevated_view(random, joint_centres(model, data, self._prefixes[0]))
        self._light()
        model.cam_pos[0], model.cam_quat[0] = pose.position, pose.quaternion()
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        shadows = bool(random.random() < self._options.shadow_share)
        rgb, depth = self._camera.capture(data, random if depth_noise else None, shadows)
        positions = np.stack([joint_centres(model, data, prefix) for prefix in self._prefixes])
        pixels, distance = self._camera.camera.project(positions, pose)
        masks = self._masks()
        people = zip(pixels, distance, masks, strict=True)
        visibility = np.stack([_visibility(*person, depth) for person in people])
        edges = [Image.fromarray(mask).getbbox() or (0, 0, 0, 0) for mask in masks]
        boxes = np.array(edges, dtype=np.float64)
        return LabelledPicture(rgb, depth, pixels, visibility, positions, pose, boxes)

    def close(self) -> None:
        """Free the graphics context."""
        self._camera.close()

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
        if random.random() < 0.85:  # otherwise limbs float, as if somebody held them
            mujoco.mj_step(model, data, _SETTLE_STEPS)
        data.qvel[:] = 0.0

    def _pose_arms(self) -> None:
        for arm in self._arms:
            for _ in range(6):
                arm.reach(self._data, self._random, over=self._options.occluding)
                mujoco.mj_kinematics(self._model, self._data)
                mujoco.mj_collision(self._model, self._data)
                if not arm.presses(self._model, self._data):
                    break
            else:
                arm.park(self._data)

    def _light(self) -> None:
        random, model = self._random, self._model
        strength = random.uniform(*((0.08, 0.25) if self._options.low_light else (0.6, 1.8)))
        tint = 1 + random.uniform(-0.12, 0.12, 3)
        model.light_diffuse[:] = self._lights * strength * tint
        for light in range(model.nlight):
            model.light_pos[light, :2] = random.uniform(-1.5, 1.5, 2)
        model.vis.headlight.ambient[:] = random.uniform(0.2, 0.6) * strength
        model.vis.headlight.diffuse[:] = random.uniform(0.0, 0.4) * strength

    def _masks(self) -> list[NDArray[np.bool_]]:
        """Return where each person is visible, (height, width) each."""
        drawn = self._camera.draw(self._data, "segmentation", shadows=False)
        is_skin = drawn[..., 1] == int(mujoco.mjtObj.mjOBJ_SKIN)
        person = np.where(is_skin, self._owners[np.where(is_skin, drawn[..., 0], 0)], -1)
        return [person == index for index in range(len(self._prefixes))]


class _SceneArm:
    """A robot arm of a scene, whose joints are set and not simulated."""

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
        """Take a random posture around the home posture; ``over``: turned towards the person."""
        spread = np.full(len(self._robot.home), 0.6)
        spread[0] = 0.35 if over else 1.0
        angles = self._robot.home + random.normal(0, 1, len(spread)) * spread
        self._put(data, np.clip(angles, self._robot.joint_lower, self._robot.joint_upper))

    def presses(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Return whether the arm and a person overlap."""
        for contact in data.contact:
            names = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
            arm = any(name.startswith(self._prefix) for name in names)
            person = any(name.startswith("person") for name in names)
            if arm and person and contact.dist < -_DEEPEST_TOUCH:
                return True
        return False


def _bench_view(random: np.random.Generator) -> CameraPose:
    """Return a view close to the bench's camera, tilted by up to 5 degrees."""
    tilt, quaternion = np.empty(9), np.empty(4)
    axis = random.standard_normal(3)
    angle = math.radians(random.uniform(0, 5))
    mujoco.mju_axisAngle2Quat(quaternion, axis / np.linalg.norm(axis), angle)
    mujoco.mju_quat2Mat(tilt, quaternion)
    position = BENCH_POSE.position + random.uniform(-0.06, 0.06, 3)
    return CameraPose(position, tilt.reshape(3, 3) @ _HEAD_UP_BENCH)


def _elevated_view(random: np.random.Generator, joints: NDArray[np.float64]) -> CameraPose:
    """Return a view from above in which the spine points up, to within 50 degrees.

    :param random: source.
    :param joints: (14, 3) of the person in view, metres.
    """
    target = joints.mean(axis=0) + random.uniform(-0.2, 0.2, 3)
    azimuth, elevation = random.uniform(0, 2 * math.pi), math.radians(random.uniform(40, 90))
    aside = math.cos(elevation)
    away = np.array([aside * math.cos(azimuth), aside * math.sin(azimuth), math.sin(elevation)])
    spine = joints[0] - (joints[8] + joints[11]) / 2
    position = target + random.uniform(1.35, 2.3) * away
    pose = CameraPose.looking_at(position, target, spine)
    roll = math.radians(random.uniform(-50, 50))
    cosine, sine = math.cos(roll), math.sin(roll)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return CameraPose(position, pose.rotation @ turn)


def _add_decoration(spec: mujoco.MjSpec, **settings: Any) -> None:
    """Add a geom that touches nothing."""
    spec.worldbody.add_geom(contype=0, conaffinity=0, **settings)


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
    plane, box = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX
    height = -random.uniform(0.02, 0.75)
    _add_decoration(spec, type=plane, pos=(0, 0, height), size=(6, 6, 0.1), material="floor")
    # Limbs lie level with the stretcher, with or without a visible table.
    spec.worldbody.add_geom(
        name="table", type=plane, size=(3, 3, 0.1), contype=1, conaffinity=0, group=COLLISION_GROUP
    )
    if random.random() < 0.7:
        position = (random.uniform(0.1, 0.4), 0, -0.0145)
        size = (random.uniform(0.6, 1.4), random.uniform(0.5, 1.1), 0.01)
        _add_decoration(spec, type=box, pos=position, size=size, material="bench")
    for _ in range(random.integers(1, 4)):
        spec.worldbody.add_light(
            pos=(0, 0, random.uniform(2.0, 3.5)),
            dir=(0, 0, -1),
            type=mujoco.mjtLightType.mjLIGHT_POINT,
            diffuse=np.full(3, random.uniform(0.25, 0.6)),
            specular=np.full(3, random.uniform(0, 0.2)),
            castshadow=True,
        )
    return spec


def _add_texture(spec: mujoco.MjSpec, name: str, random: np.random.Generator) -> None:
    """Add a material with a random pattern: patches, planks, tiles or plain."""
    size = _TEXTURE_SIZE
    first, second = random.uniform(0.05, 0.95, (2, 3))
    if random.random() < 0.5:  # greyish, as most floors are
        first, second = (0.8 * colour.mean() + 0.2 * colour for colour in (first, second))
    cells = int(random.choice([4, 8, 16, 32]))
    rows, columns = np.indices((size, size)) // (size // cells)
    kind = random.integers(4)
    mix = np.zeros((size, size))
    if kind == 0:
        mix = random.random((cells, cells))[rows, columns]
    elif kind == 1:
        mix = random.random(cells)[rows]
    elif kind == 2:
        mix = ((rows + columns) % 2).astype(np.float64)
    mix = np.clip(mix + random.normal(0, random.uniform(0, 0.15), (size, size)), 0, 1)
    pixels = first + mix[..., None] * (second - first)
    add_picture(spec, name, np.clip(pixels, 0, 1))
    repeat = random.uniform(0.5, 3.0)
    material = spec.add_material(
        name=name, texuniform=True, texrepeat=(repeat, repeat), specular=0.1, shininess=0.1
    )
    give_texture(material, name)


def _add_person(
    spec: mujoco.MjSpec, random: np.random.Generator, split: str, prefix: str, index: int
) -> None:
    """Add a person, head towards -x; a second person lies beside the first."""
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
        width = random.uniform(0.48, 0.6)
        colours = tuple(canvas), tuple(support)
        add_stretcher(spec, appearance, position, yaw, prefix, width, *colours)


def _add_arms(spec: mujoco.MjSpec, random: np.random.Generator) -> list[_SceneArm]:
    """Add up to two arms at the bases of the bench."""
    arms = []
    bases = [base for base in _BASES if random.random() < 0.8]
    # Only the first two robots, so that a new robot does not change the pictures of a seed.
    usual, other = islice(ROBOTS.values(), 2)
    robot = usual if random.random() < 0.75 else other
    for index, (x, y) in enumerate(bases):
        arm = robot.build(Fingers.LOCKED)
        spec.assets = {**spec.assets, **arm.assets}
        for geom in arm.geoms:
            if int(geom.group) == COLLISION_GROUP:
                geom.contype, geom.conaffinity = 4, 2
        frame = spec.worldbody.add_frame(pos=(x, y, 0))
        frame.attach_body(arm.body(robot.base_body), f"arm{index}_", "")
        arms.append(_SceneArm(robot, f"arm{index}_"))
    return arms


def _add_clutter(spec: mujoco.MjSpec, random: np.random.Generator) -> None:
    """Add boxes and cylinders of any colour beside the stretcher."""
    for _ in range(random.integers(0, 7)):
        is_round = random.random() < 0.4
        size = random.uniform(0.02, 0.16, 3)
        angle = random.uniform(0, math.pi)
        x = random.uniform(-1.0, 1.6)
        y = random.choice([-1, 1]) * random.uniform(0.5, 1.3)
        _add_decoration(
            spec,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER if is_round else mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, size[2]),
            size=(size[0], size[2], 0) if is_round else size,
            quat=(math.cos(angle / 2), 0, 0, math.sin(angle / 2)),
            rgba=(*random.uniform(0, 1, 3), 1),
        )


def _visibility(
    pixels: NDArray[np.float64],
    distance: NDArray[np.float64],
    mask: NDArray[np.bool_],
    depth: NDArray[np.float32],
) -> NDArray[np.uint8]:
    """Return how each joint (14,) of a person is annotated.

    :param pixels: (14, 2).
    :param distance: (14,) of the joints along the view, metres.
    :param mask: (height, width) where the person is visible.
    :param depth: (height, width) metres.
    """
    inside, rows, columns = pixel_windows(pixels, depth.shape, 1)
    surface = np.where(mask[rows, columns], depth[rows, columns], -np.inf).max(axis=(1, 2))
    visibility = np.full(N_JOINTS, Visibility.MISSING, dtype=np.uint8)
    visibility[inside] = Visibility.OCCLUDED
    visibility[inside & (surface > distance - _DEEPEST_JOINT)] = Visibility.VISIBLE
    return visibility
