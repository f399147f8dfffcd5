"""The skeleton of chapter 4: 14 joints, 13 limbs, a tree rooted at the neck; COCO's key points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray


class Visibility(IntEnum):
    """Visibility of an annotated joint, with COCO's numbers."""

    MISSING = 0
    OCCLUDED = 1
    VISIBLE = 2


@dataclass(frozen=True)
class Limb:
    """A line from a proximal joint, nearer to the neck, to a distal joint.

    :param name: the limb's name in configurations, weight files and ``limbs=[...]``.
    :param proximal: index into :data:`JOINTS`.
    :param distal: index into :data:`JOINTS`.
    """

    name: str
    proximal: int
    distal: int

    @property
    def ends(self) -> tuple[int, int]:
        """Proximal and distal joint."""
        return self.proximal, self.distal


JOINTS: Final = (
    *("neck", "head"),
    *("right_shoulder", "right_elbow", "right_wrist"),
    *("left_shoulder", "left_elbow", "left_wrist"),
    *("right_hip", "right_knee", "right_ankle"),
    *("left_hip", "left_knee", "left_ankle"),
)
NECK: Final = JOINTS.index("neck")
N_JOINTS: Final = len(JOINTS)


def _limb(name: str, proximal: str, distal: str) -> Limb:
    return Limb(name, JOINTS.index(proximal), JOINTS.index(distal))


#: From the neck outwards: a limb comes after the limb whose distal joint is its proximal joint.
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


def _mirrored(names: Sequence[str]) -> NDArray[np.intp]:
    swap = {"left": "right", "right": "left"}
    sides = [name.partition("_") for name in names]
    return np.array([names.index(swap.get(side, side) + mid + rest) for side, mid, rest in sides])


#: Index of each joint's, and of each limb's, mirror image.
MIRRORED_JOINTS: Final = _mirrored(JOINTS)
MIRRORED_LIMBS: Final = _mirrored(LIMB_NAMES)

COCO_JOINTS: Final = (
    "nose",
    *(
        f"{side}_{part}"
        for part in ("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle")
        for side in ("left", "right")
    ),
)
#: COCO's key point for each of our joints; -1 for the neck, which COCO does not have.
_FROM_COCO: Final = np.array(
    [-1, COCO_JOINTS.index("nose"), *(COCO_JOINTS.index(name) for name in JOINTS[2:])]
)
_COCO_SHOULDERS: Final = [COCO_JOINTS.index(f"{side}_shoulder") for side in ("left", "right")]


def limb_indices(limbs: Sequence[str] | None) -> tuple[int, ...]:
    """Return the indices of limbs in :data:`LIMBS`, ascending and without repetition.

    :param limbs: names, or ``None`` for all 13.
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
    """Return the end joints of limbs (indices into :data:`LIMBS`), ascending."""
    return tuple(sorted({joint for limb in limbs for joint in LIMBS[limb].ends}))


def from_coco(keypoints: NDArray[Any]) -> NDArray[np.float64]:
    """Convert COCO's key points into our joints: neck between the shoulders, head at the nose.

    :param keypoints: (..., 17, 3): x, y (pixels) and visibility 0, 1 or 2.
    :return: (..., 14, 3), the same. The neck has the visibility of the less visible shoulder, and
        is missing if a shoulder is; missing joints are at (0, 0).
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
    """Convert our joints into COCO's key points, without eyes and ears.

    :param joints: (..., 14, 2) pixels; positions of joints that were not found are ignored.
    :param scores: (..., 14) confidence or visibility; 0 where a joint is missing.
    :return: (..., 17, 3): x, y and the score; all 0 for a missing key point.
    """
    given = np.concatenate([np.asarray(joints), np.asarray(scores)[..., None]], axis=-1)
    given = np.where(given[..., 2:] > 0, given, 0.0)
    keypoints = np.zeros((*given.shape[:-2], len(COCO_JOINTS), 3))
    ours = np.flatnonzero(_FROM_COCO >= 0)
    keypoints[..., _FROM_COCO[ours], :] = given[..., ours, :]
    return keypoints
