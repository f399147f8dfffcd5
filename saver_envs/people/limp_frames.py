"""Frames of a limp person's bodies: how they lie at zero posture against the mesh.

A body's frame is parallel to the mesh's frame where the mesh is as exported, arms and legs spread
and elbows bent. At zero posture (see :mod:`saver_envs.people.limp_joints`) limbs are turned.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from saver_envs.people.limp_joints import SHOULDER_CENTRE
from saver_envs.people.manikin import hinge, limb_capsule
from saver_envs.people.rotations import Rotation, about, frame_of, shortest_turn
from saver_envs.people.surface import BodyShape

_FEETWARDS: Final = np.array([1.0, 0.0, 0.0])
_LEFT: Final = np.array([0.0, 1.0, 0.0])
_FRONT: Final = np.array([0.0, 0.0, 1.0])


def zero_rotations(shape: BodyShape) -> dict[str, Rotation]:
    """Return by how much every body is turned at zero posture, from where it is in the mesh.

    :param shape: of the person.
    """
    turned = {body: np.eye(3) for body in ("pelvis", "torso", "head")}
    for limb, far, ending, lift, axis in (
        ("upper_arm", "forearm", "hand", 1.0, -_LEFT),
        ("thigh", "shank", "foot", -1.0, _LEFT),
    ):
        crease, bent = hinge(f"left_{far}", shape, lift)
        along = shape.head(f"left_{far}") - shape.head(f"left_{limb}")
        near = frame_of(_FEETWARDS, axis) @ frame_of(along, crease).T
        straight = near @ about(crease, -bent)
        turned |= {f"left_{limb}": near, f"left_{far}": straight}
        turned[f"left_{ending}"] = straight
    begin, tip, _ = limb_capsule("left_hand", shape)
    onward = begin - shape.head("left_forearm")
    turned["left_hand"] = turned["left_forearm"] @ shortest_turn(tip - begin, onward)
    for body in [name for name in turned if name.startswith("left_")]:
        turned[body.replace("left_", "right_")] = mirrored_rotation(turned[body])
    return turned


def shoulder_rotation(side: str, abduction: float, flexion: float, rotation: float) -> Rotation:
    """Return the turn (3, 3) of an upper arm from zero posture, in the frame of the torso.

    :param side: ``left`` or ``right``.
    :param abduction: turn of the arm away from the trunk in the plane of the back, radians.
    :param flexion: turn out of that plane to the front, radians.
    :param rotation: turn of the arm about its long axis, outwards, radians.
    """
    turned = about(_FRONT, abduction) @ about(-_LEFT, flexion) @ about(-_FEETWARDS, rotation)
    return turned if side == "left" else mirrored_rotation(turned)


def shoulder_centre(side: str) -> Rotation:
    """Return the turn of an upper arm from zero posture to the centre of the shoulder's cone."""
    abduction, flexion, rotation = (math.radians(angle) for angle in SHOULDER_CENTRE)
    return shoulder_rotation(side, abduction, flexion, rotation)


def mirrored_rotation(rotation: Rotation) -> Rotation:
    """Return the rotation of the other side."""
    across = np.diag([1.0, -1.0, 1.0])
    return across @ rotation @ across
