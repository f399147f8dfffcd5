"""Postures in which a limp person lies: set, settled under gravity, found at rest.

A posture is only where a person is laid down. Limp limbs fall, roll and slide from there until they
rest, which :class:`LyingWorld` finds out. Angles are anatomical ones in degrees, see
:mod:`saver_envs.people.limp_joints`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.bed import Bed, add_bed
from saver_envs.people.limp_frames import shoulder_centre, shoulder_rotation
from saver_envs.people.limp_joints import PASSIVE_JOINTS, joint_names
from saver_envs.people.limp_person import ROOT_JOINT, LimpPerson, add_limp_person
from saver_envs.people.manikin import SIDES
from saver_envs.people.rotations import about, matrix_of, quaternion_of
from saver_envs.validation import require
from saver_envs.world import TIMESTEP, set_physics

#: Joints of a person in the order of a pose.
_NAMES: Final = tuple(name for joint in PASSIVE_JOINTS for name in joint_names(joint))
#: Numbers of a pose: the pelvis' place and quaternion, four a shoulder and one any other joint.
POSE_SIZE: Final = 7 + sum(4 if name.endswith("shoulder") else 1 for name in _NAMES)
#: Gap under a person who is laid down (m).
_AIR: Final = 0.001
#: Duration of the damped fall (s), after which velocities are kept; longest of the whole wait.
_FALL, _LONGEST_WAIT = 2.0, 12.0
#: Velocities are multiplied by this, and how often (s), while limbs fall.
_SLOWED, _EVERY = 0.9, 0.01
#: A person is at rest who moves less than this (m) in so much time (s).
REST_MOTION, REST_TIME = 0.0005, 0.5


@dataclass(frozen=True)
class ArmPosture:
    """Angles of an arm, degrees.

    :param abduction: of the upper arm from the side, in the plane of the back.
    :param flexion: of the upper arm out of that plane, to the front.
    :param rotation: of the upper arm about its long axis, outwards.
    :param elbow: bend.
    """

    abduction: float = 12.0
    flexion: float = 0.0
    rotation: float = -20.0
    elbow: float = 15.0


@dataclass(frozen=True)
class LegPosture:
    """Angles of a leg, degrees.

    :param flexion: of the hip.
    :param abduction: of the hip, outwards.
    :param rotation: of the hip, outwards.
    :param knee: bend.
    """

    flexion: float = 0.0
    abduction: float = 4.0
    rotation: float = 20.0
    knee: float = 2.0


@dataclass(frozen=True)
class LyingPosture:
    """How a person lies before gravity acts.

    :param roll: turn about the long axis, degrees: 0 on the back, 90 on the left side.
    :param arms: of the left and the right arm.
    :param legs: of the left and the right leg.
    :param hinges: degrees of further joints by name, such as ``neck_rotation``.
    """

    roll: float = 0.0
    arms: tuple[ArmPosture, ArmPosture] = (ArmPosture(), ArmPosture())
    legs: tuple[LegPosture, LegPosture] = (LegPosture(), LegPosture())
    hinges: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require("roll", self.roll, -180 <= self.roll <= 180, "-180 to 180 degrees")

    def mirrored(self) -> LyingPosture:
        """Return the posture of the mirror image."""
        flipped = ("spine_twist", "spine_bend", "neck_rotation", "neck_bend")
        hinges = {
            _other_side(name): -angle if name in flipped else angle
            for name, angle in self.hinges.items()
        }
        return LyingPosture(-self.roll, self.arms[::-1], self.legs[::-1], hinges)


def _other_side(name: str) -> str:
    for side, other in (SIDES, SIDES[::-1]):
        if name.startswith(side):
            return name.replace(side, other)
    return name


class PersonLayout:
    """Where a person's numbers are in a model.

    :param model: with a person.
    :param prefix: of the person's names.
    """

    def __init__(self, model: mujoco.MjModel, prefix: str = "") -> None:
        self._model, self._prefix = model, prefix
        root = model.joint(prefix + ROOT_JOINT)
        #: (7,) addresses of the pelvis' place and quaternion in ``qpos``.
        self.root_qpos = int(root.qposadr[0]) + np.arange(7)
        joints = [
            model.joint(prefix + name) for joint in PASSIVE_JOINTS for name in joint_names(joint)
        ]
        #: Ids of the joints, in the order of the table, left before right.
        self.joints = np.array([joint.id for joint in joints], dtype=np.intp)
        sizes = [4 if name.endswith("shoulder") else 1 for name in _NAMES]
        spans = [
            int(joint.qposadr[0]) + np.arange(size)
            for joint, size in zip(joints, sizes, strict=True)
        ]
        #: Joint -> its addresses in ``qpos``, (1,) or (4,).
        self.joint_qpos = dict(zip(_NAMES, spans, strict=True))
        #: (35,) addresses of all of the person's numbers in ``qpos``: the same order in any model.
        self.qpos = np.concatenate([self.root_qpos, *spans])
        pelvis = model.body(prefix + "pelvis").id
        #: Ids of the bodies.
        self.bodies = np.flatnonzero(model.body_rootid == pelvis)
        #: Ids of the capsules.
        self.geoms = np.flatnonzero(
            np.isin(model.geom_bodyid, self.bodies) & (model.geom_contype > 0)
        )

    def pose(
        self, posture: LyingPosture, place: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the person's numbers (35,) in a posture; the height is that of the compiled model.

        :param posture: the angles.
        :param place: x and y of the pelvis, metres.
        :param yaw: turn about the vertical, radians; at 0 the feet point along +x.
        :raises ValueError: for an angle beyond its joint's range, or an unknown hinge.
        """
        values = {name: np.zeros(len(span)) for name, span in self.joint_qpos.items()}
        for side, arm, leg in zip(SIDES, posture.arms, posture.legs, strict=True):
            values[f"{side}_shoulder"] = self._shoulder(side, arm)
            for name, angle in (
                ("elbow", arm.elbow),
                ("hip_flexion", leg.flexion),
                ("hip_abduction", leg.abduction),
                ("hip_rotation", leg.rotation),
                ("knee", leg.knee),
            ):
                values[f"{side}_{name}"][:] = math.radians(angle)
        for name, angle in posture.hinges.items():
            known = name in values and len(values[name]) == 1
            require("hinges", name, known, "hinges of limp_joints.PASSIVE_JOINTS")
            values[name][:] = math.radians(angle)
        _require_within_ranges(values)
        turn = about((0, 0, 1), yaw) @ about((-1, 0, 0), math.radians(posture.roll))
        height = float(self._model.qpos0[self.root_qpos[2]])
        root = np.array([*place, height, *quaternion_of(turn)])
        return np.concatenate([root, *(values[name] for name in _NAMES)])

    def _shoulder(self, side: str, arm: ArmPosture) -> NDArray[np.float64]:
        """Return the quaternion (4,) of a shoulder, whose zero is the middle of its range."""
        angles = (math.radians(angle) for angle in (arm.abduction, arm.flexion, arm.rotation))
        middle = matrix_of(self._model.body(f"{self._prefix}{side}_upper_arm").quat)
        turn = shoulder_rotation(side, *angles) @ shoulder_centre(side).T
        return quaternion_of(middle.T @ turn @ middle)


def _require_within_ranges(values: Mapping[str, NDArray[np.float64]]) -> None:
    """Check the numbers of all joints.

    :raises ValueError: for one beyond its range; the message names the joint and its range.
    """
    for joint in PASSIVE_JOINTS:
        low, high = joint.range
        for name in joint_names(joint):
            value = values[name]
            turn = 2 * math.acos(min(abs(value[0]), 1.0)) if len(value) == 4 else value[0]
            angle = round(math.degrees(turn), 3)
            kind = "turn from the middle of its range" if len(value) == 4 else "angle"
            valid = f"{low:g} to {high:g} degrees ({kind})"
            require(name, angle, low <= angle <= high, valid)


class LyingWorld:
    """A person alone on a bed, to find out how the person comes to rest.

    :param person: who.
    :param bed: on what.
    """

    def __init__(self, person: LimpPerson, bed: Bed) -> None:
        spec = mujoco.MjSpec()
        set_physics(spec)
        add_limp_person(spec, person, bed.centre, skins=False)
        add_bed(spec, bed)
        #: Compiled.
        self.model = spec.compile()
        #: Where the person's numbers are.
        self.layout = PersonLayout(self.model)
        self._bed = bed
        #: After :meth:`laid`: the state in which the person rests.
        self.data = mujoco.MjData(self.model)

    def laid(
        self, posture: LyingPosture, place: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0
    ) -> NDArray[np.float64] | None:
        """Return how a person comes to rest who is laid down in a posture.

        :param posture: before gravity acts.
        :param place: x and y of the pelvis, metres.
        :param yaw: turn about the vertical, radians; at 0 the feet point along +x.
        :return: the person's numbers (35,), see :class:`PersonLayout`; ``None`` without rest.
        :raises ValueError: for a place beside the bed, or an angle beyond its joint's range.
        """
        require("place", place, self._bed.under(*place), "over the bed")
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[self.layout.qpos] = self.layout.pose(posture, place, yaw)
        data.qpos[self.layout.root_qpos[2]] += self._bed.centre[2] + _AIR - self._lowest()
        while data.time < _FALL:
            mujoco.mj_step(model, data, round(_EVERY / TIMESTEP))
            data.qvel *= _SLOWED
        while data.time < _LONGEST_WAIT:
            before = self.points()
            mujoco.mj_step(model, data, round(REST_TIME / TIMESTEP))
            if np.linalg.norm(self.points() - before, axis=-1).max() < REST_MOTION:
                mujoco.mj_forward(model, data)
                return data.qpos[self.layout.qpos].copy()
        return None

    def points(self) -> NDArray[np.float64]:
        """Return the ends of all capsules, (ends, 3), metres."""
        model, data, geoms = self.model, self.data, self.layout.geoms
        along = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2] * model.geom_size[geoms, 1:2]
        centre = data.geom_xpos[geoms]
        return np.concatenate([centre - along, centre + along])

    def _lowest(self) -> float:
        """Return the height of the lowest point of what lies over the bed, metres."""
        mujoco.mj_kinematics(self.model, self.data)
        points = self.points()
        radius = np.tile(self.model.geom_size[self.layout.geoms, 0], 2)
        over = [self._bed.under(x, y) for x, y in points[:, :2]]
        return float((points[:, 2] - radius)[over].min())
