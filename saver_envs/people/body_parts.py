"""Collision capsules of a limp person, each of which belongs to one part of the body.

The parts are those for which ISO/TS 15066 has limits of force. Chest and back are different
capsules of the same body, and so are skull, face and neck.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.manikin import limb_capsule
from saver_envs.people.surface import BodyShape

#: Parts of the trunk and the head.
CENTRAL_PARTS: Final = ("skull", "face", "neck", "back", "chest", "abdomen", "pelvis")
#: Parts that there are on either side, each a body of its own.
LIMB_PARTS: Final = ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
#: Where the chest ends and the abdomen begins, from waist (0) to neck (1); ours.
_RIBS: Final = 0.36
#: Thickness of the capsules of back and chest, shares of half of the trunk's depth; ours.
_BACK, _CHEST = 0.66, 0.60
#: The same of the pelvis.
_PELVIS: Final = 0.88


@dataclass(frozen=True)
class PartCapsule:
    """A capsule in the frame of the mesh (see :mod:`saver_envs.people.manikin`), metres.

    :param part: of the body, one of :data:`CENTRAL_PARTS` or :data:`LIMB_PARTS`.
    :param begin: (3,) centre of one end.
    :param end: (3,) centre of the other one.
    :param radius: metres.
    """

    part: str
    begin: NDArray[np.float64]
    end: NDArray[np.float64]
    radius: float

    def mirrored(self) -> PartCapsule:
        """Return the capsule of the other side."""
        across = np.array([1.0, -1.0, 1.0])
        return PartCapsule(self.part, self.begin * across, self.end * across, self.radius)


def part_capsules(shape: BodyShape) -> dict[str, list[PartCapsule]]:
    """Return the capsules of every body, right ones being mirrored left ones.

    :param shape: of the person.
    """
    found = {"pelvis": _pelvis(shape), "torso": _torso(shape), "head": _head(shape)}
    for part in LIMB_PARTS:
        one = _foot(shape) if part == "foot" else PartCapsule(part, *_limb(shape, part))
        found |= {f"left_{part}": [one], f"right_{part}": [one.mirrored()]}
    return found


def _limb(shape: BodyShape, part: str) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    begin, end, radius = limb_capsule(f"left_{part}", shape)
    way = (end - begin) / np.linalg.norm(end - begin)
    # Round ends reach beyond the joints by half of the thickness only.
    return begin + 0.5 * radius * way, end - (0.0 if part == "hand" else 0.5 * radius) * way, radius


def _foot(shape: BodyShape) -> PartCapsule:
    """From heel to toes."""
    heel, toes = foot_ends(shape)
    points = shape.owned("left_foot")
    way = (toes - heel) / np.linalg.norm(toes - heel)
    aside = points - heel
    aside = aside - np.outer(aside @ way, way)
    radius = float(np.median(np.linalg.norm(aside, axis=1)))
    return PartCapsule("foot", heel + radius * way, toes - 0.8 * radius * way, radius)


def foot_ends(shape: BodyShape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the heel and the tip of the toes of the left foot, (3,) each, metres."""
    points = shape.owned("left_foot")
    middle = points.mean(axis=0)
    way = np.linalg.svd(points - middle)[2][0]
    way *= np.sign(way[2])  # toes are above heels
    along = (points - middle) @ way
    return middle + along.min() * way, middle + along.max() * way


def _pair(
    part: str, begin: tuple[float, ...], end: tuple[float, ...], radius: float
) -> list[PartCapsule]:
    """Return a capsule and its mirror image."""
    one = PartCapsule(part, np.array(begin), np.array(end), radius)
    return [one, one.mirrored()]


def _extent(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where most of some points begin and end along each axis, (3,) each."""
    low, high = np.percentile(points, [3, 97], axis=0)
    return low, high


def _pelvis(shape: BodyShape) -> list[PartCapsule]:
    low, high = _extent(shape.owned("pelvis"))
    radius = _PELVIS * (high[2] - low[2]) / 2
    aside = max(high[1] - radius, 0.5 * radius)
    height = low[2] + radius
    return _pair(
        "pelvis",
        (low[0] + 0.8 * radius, aside, height),
        (high[0] - 0.6 * radius, aside, height),
        radius,
    )


def _torso(shape: BodyShape) -> list[PartCapsule]:
    points = shape.owned("torso")
    waist, neck = shape.head("torso")[0], shape.head("head")[0]
    ribs = waist + _RIBS * (neck - waist)
    shoulder = shape.head("left_upper_arm")[0]
    low, high = _extent(points[points[:, 0] < ribs])
    depth = (high[2] - low[2]) / 2
    back, chest = _BACK * depth, _CHEST * depth
    wide = high[1]
    capsules = _pair(
        "back",
        (shoulder + 0.4 * back, wide - back, low[2] + back),
        (waist - 0.2 * back, wide - 1.15 * back, low[2] + back),
        back,
    )
    capsules += _pair(
        "chest",
        (shoulder + 0.8 * chest, wide - 1.2 * chest, high[2] - 1.1 * chest),
        (ribs - 0.5 * chest, wide - 1.2 * chest, high[2] - chest),
        chest,
    )
    low, high = _extent(points[points[:, 0] >= ribs])
    belly = (waist - ribs) / 2 + 0.02
    aside, middle = high[1] - 1.1 * belly, (waist + ribs) / 2 + 0.01
    ends = [np.array([middle, side * aside, high[2] - belly]) for side in (1, -1)]
    return [*capsules, PartCapsule("abdomen", ends[0], ends[1], belly)]


def _head(shape: BodyShape) -> list[PartCapsule]:
    points = shape.owned("head")
    nape, nose = shape.head("head"), shape.nose
    crown = points[:, 0].min()
    cranium = points[points[:, 0] < nose[0] - 0.03]
    low, high = _extent(cranium)
    radius = (high[1] - low[1]) / 2
    centre = crown + radius
    skull = PartCapsule(
        "skull",
        np.array([centre, 0.0, low[2] + radius]),
        np.array([centre, 0.0, high[2] - radius]),
        radius,
    )
    lower = 0.72 * radius
    front = nose[2] - 0.02 - lower
    chin = nape[0] - 0.35 * radius
    face = PartCapsule(
        "face",
        np.array([nose[0] - 0.2 * radius, 0.0, front]),
        np.array([max(chin - lower, nose[0]), 0.0, front - 0.3 * lower]),
        lower,
    )
    neck = points[points[:, 0] > nape[0] - 0.02]
    throat = float(np.median(np.abs(neck[:, 1])))
    stem = PartCapsule("neck", nape, np.array([centre + radius, 0.0, skull.begin[2]]), throat)
    return [skull, face, stem]
