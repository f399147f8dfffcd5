"""The skeleton of chapter 4: 14 joints, 13 limbs, a tree rooted at the neck; COCO's key points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray


class Visibility(IntEnum):
    """How a joint is annotated, with COCO's numbers."""

    MISSING = 0
    OCCLUDED = 1
    VISIBLE = 2


@dataclass(frozen=True)
class Limb:
    """A line from the joint nearer to the neck to the one farther from it.

    :param name: what configurations, weight files and ``limbs=[...]`` call it.
    :param proximal: index into :data:`JOINTS`.
    :param distal: index into :data:`JOINTS`.
    """

    name: str
    proximal: int
    distal: int


JOINTS: Final = (
    "neck",
    "head",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "right_hip",
    "right_knee",
    "right_ankle",
    "left_hip",
    "left_knee",
    "left_ankle",
)
NECK: Final = JOINTS.index("neck")
N_JOINTS: Final = len(JOINTS)


def _limb(name: str, proximal: str, distal: str) -> Limb:
    return Limb(name, JOINTS.index(proximal), JOINTS.index(distal))


#: From the neck outwards: a limb comes after the one whose distal joint is its proximal one.
LIMBS: Final = (
    _limb("head", "neck", "head"),
    _limb("right_collar", "neck", "right_shoulder"),
    _limb("right_upper_arm", "right_shoulder", "right_elbow"),
    _limb("right_forearm", "right_elbow", "right_wrist"),
    _limb("left_collar", "neck", "left_shoulder"),
    _limb("left_upper_arm", "left_shoulder", "left_elbow"),
    _limb("left_forearm", "left_elbow", "left_wrist"),
    _limb("right_trunk", "neck", "right_hip"),
    _limb("right_thigh", "right_hip", "right_knee"),
    _limb("right_shank", "right_knee", "right_ankle"),
    _limb("left_trunk", "neck", "left_hip"),
    _limb("left_thigh", "left_hip", "left_knee"),
    _limb("left_shank", "left_knee", "left_ankle"),
)
LIMB_NAMES: Final = tuple(limb.name for limb in LIMBS)
N_LIMBS: Final = len(LIMBS)


def _mirrored(name: str) -> str:
    if name.startswith("left_"):
        return "right_" + name.removeprefix("left_")
    return "left_" + name.removeprefix("right_") if name.startswith("right_") else name


#: Where a joint, or a limb, is found in a picture that is mirrored left to right.
MIRRORED_JOINTS: Final = np.array([JOINTS.index(_mirrored(name)) for name in JOINTS])
MIRRORED_LIMBS: Final = np.array([LIMB_NAMES.index(_mirrored(name)) for name in LIMB_NAMES])

COCO_JOINTS: Final = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
#: COCO's key point for each of our joints; the neck, which has none, reads -1.
_FROM_COCO: Final = np.array(
    [
        -1 if name == "neck" else COCO_JOINTS.index("nose" if name == "head" else name)
        for name in JOINTS
    ]
)
_COCO_SHOULDERS: Final = [
    COCO_JOINTS.index("left_shoulder"),
    COCO_JOINTS.index("right_shoulder"),
]


def limb_indices(limbs: Sequence[str] | None) -> tuple[int, ...]:
    """Return the places of limbs in :data:`LIMBS`, in the order of the skeleton.

    :param limbs: names, or ``None`` for all 13.
    :return: indices, without repetition.
    :raises ValueError: for an empty list or an unknown name; the message lists the valid names.
    """
    if limbs is None:
        return tuple(range(N_LIMBS))
    if isinstance(limbs, str) or not limbs:
        raise ValueError(f"limbs={limbs!r}: give a list of names out of {', '.join(LIMB_NAMES)}")
    unknown = [name for name in limbs if name not in LIMB_NAMES]
    if unknown:
        raise ValueError(
            f"limbs={list(limbs)!r}: {unknown[0]!r} is none of {', '.join(LIMB_NAMES)}"
        )
    return tuple(sorted({LIMB_NAMES.index(name) for name in limbs}))


def joints_of(limbs: Iterable[int]) -> tuple[int, ...]:
    """Return the joints that limbs (indices into :data:`LIMBS`) begin and end at, in order."""
    return tuple(
        sorted({joint for limb in limbs for joint in (LIMBS[limb].proximal, LIMBS[limb].distal)})
    )


def from_coco(keypoints: NDArray[Any]) -> NDArray[np.float64]:
    """Turn COCO's key points into our joints: neck between the shoulders, head at the nose.

    :param keypoints: (..., 17, 3): x, y (pixels) and visibility 0, 1 or 2.
    :return: (..., 14, 3), the same. The neck is as visible as the less visible shoulder, and
        missing where one of them is; missing joints are at (0, 0).
    :raises ValueError: for another shape.
    """
    given = np.asarray(keypoints, dtype=np.float64)
    if given.shape[-2:] != (len(COCO_JOINTS), 3):
        raise ValueError(f"keypoints of shape {given.shape}: must end in {(len(COCO_JOINTS), 3)}")
    joints = given[..., _FROM_COCO, :]
    shoulders = given[..., _COCO_SHOULDERS, :]
    joints[..., NECK, :2] = shoulders[..., :2].mean(axis=-2)
    joints[..., NECK, 2] = shoulders[..., 2].min(axis=-1)
    joints[joints[..., 2] == Visibility.MISSING] = 0.0
    return joints


def to_coco(joints: NDArray[Any], scores: NDArray[Any]) -> NDArray[np.float64]:
    """Turn our joints into COCO's key points; eyes and ears, which we lack, are missing.

    :param joints: (..., 14, 2) pixels; rows of joints that were not found are not looked at.
    :param scores: (..., 14) a confidence or a visibility; 0 where a joint is missing.
    :return: (..., 17, 3): x, y and the score.
    """
    given = np.concatenate([np.asarray(joints), np.asarray(scores)[..., None]], axis=-1)
    given = np.where(given[..., 2:] > 0, given, 0.0)
    keypoints = np.zeros((*given.shape[:-2], len(COCO_JOINTS), 3))
    ours = np.flatnonzero(_FROM_COCO >= 0)
    keypoints[..., _FROM_COCO[ours], :] = given[..., ours, :]
    return keypoints
