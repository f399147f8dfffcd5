"""The people of the scenes: a few bodies, and how their arms lie.

All points are in the manikin's frame (see :mod:`saver_envs.people.manikin`), metres.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.manikin import hinge, limb_capsule, trunk_capsules
from saver_envs.people.postures import random_appearance
from saver_envs.people.rotations import about, frame_of
from saver_envs.people.surface import Appearance, BodyShape

#: How many bodies there are of each split of :mod:`saver_envs.people.postures`.
_PER_SPLIT: Final = {"test": 8, "validation": 4, "train": 4}
#: Source of these bodies; its seed is part of the environments' version.
_RANDOM: Final = np.random.default_rng(8)

#: Gap under a resting arm (m), so that it starts without contact.
_AIR: Final = 0.0005

#: Number of points of a forearm at which its distance from the trunk is measured.
_POINTS: Final = 5

#: Who may lie on the bench: women and men of 1.5 to 1.95 m, slim to heavy.
BODIES: Final = tuple(
    random_appearance(_RANDOM, split) for split, count in _PER_SPLIT.items() for _ in range(count)
)


class PersonArm:
    """The geometry of an arm as its body is compiled, and what follows from it.

    :param appearance: of the person.
    :param side: ``left`` or ``right``.
    """

    def __init__(self, appearance: Appearance, side: str) -> None:
        shape = BodyShape(appearance)
        parts = ("upper_arm", "forearm", "hand")
        shoulder, elbow, wrist = (shape.head(f"{side}_{part}") for part in parts)
        capsules = [limb_capsule(f"{side}_{part}", shape) for part in parts]
        #: (3,) joint's centre.
        self.shoulder = shoulder
        #: (3,) from shoulder to elbow.
        self.upper = elbow - shoulder
        #: (3,) from elbow to wrist, with the elbow's angle at 0.
        self.fore = wrist - elbow
        #: (3,) unit axis of the elbow, at a right angle to ``upper``, and the bend of the elbow at
        #: joint angle 0, radians.
        self.axis, self.bent = hinge(f"{side}_forearm", shape, 1.0)
        #: (3,) hip joint's centre at that side.
        self.hip = shape.head(f"{side}_thigh")
        #: Of the upper arm, of the forearm and of the hand, metres.
        self.radius = [radius for _, _, radius in capsules]
        #: (3,) from the wrist to the end of the hand's capsule, as the mesh has it.
        self.hand = capsules[2][1] - wrist
        #: 1 for a left arm, -1 for a right one.
        self.sideways = 1.0 if side == "left" else -1.0
        columns = trunk_capsules("torso", shape)
        #: The capsule of the trunk at that side.
        self.trunk = min(columns, key=lambda one: -self.sideways * one[0][1])

    @property
    def elbow_height(self) -> float:
        """Height of a resting elbow's centre, metres."""
        return self.radius[0] + _AIR

    @property
    def hand_share(self) -> float:
        """Length of the hand relative to that of the forearm."""
        return float(np.linalg.norm(self.hand) / np.linalg.norm(self.fore))

    @property
    def wrist_height(self) -> float:
        """Height of a resting wrist's centre, metres.

        Forearm and hand are straight, and lie on the elbow and on the hand's end.
        """
        level = self.radius[2] + _AIR
        return (level + self.elbow_height * self.hand_share) / (1 + self.hand_share)

    @property
    def straightened(self) -> NDArray[np.float64]:
        """Rotation of the hand (quaternion, w first) that aligns it with the forearm."""
        first, second = (one / np.linalg.norm(one) for one in (self.hand, self.fore))
        half = np.append(1.0 + first @ second, np.cross(first, second))
        return half / np.linalg.norm(half)

    def elbow_at(
        self, wrist: NDArray[np.float64], outwards: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Return where a resting elbow is, for resting wrists.

        :param wrist: (k, 3).
        :param outwards: (k,) whether the elbow points away from the trunk, or towards it.
        :return: (k, 3); NaN where the arm is too short or too stiff for that.
        """
        height = self.elbow_height
        upper = float(np.sum(self.upper**2) - (height - self.shoulder[2]) ** 2)
        fore = np.sum(self.fore**2) - (height - wrist[:, 2]) ** 2
        way = wrist[:, :2] - self.shoulder[:2]
        distance = np.sqrt(np.sum(way * way, axis=-1))
        along = (distance**2 + upper - fore) / (2 * distance)
        with np.errstate(invalid="ignore"):
            aside = np.sqrt(upper - along**2)  # NaN where the circles do not meet
        forward = way / distance[:, None]
        left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
        turn = np.where(outwards, self.sideways, -self.sideways) * aside
        elbow = np.empty_like(wrist)
        elbow[:, :2] = self.shoulder[:2] + along[:, None] * forward + turn[:, None] * left
        elbow[:, 2] = height
        cosine = self._bend_cosine(elbow, wrist)
        elbow[~(np.abs(cosine) < 1.0)] = np.nan
        return elbow

    def bend(self, elbow: NDArray[np.float64], wrist: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angle (k,) between upper arm and forearm's line, radians; 0 is straight."""
        upper, fore = elbow - self.shoulder, wrist - elbow
        cosine = np.sum(upper * fore, axis=-1) / np.sqrt(
            np.sum(upper * upper, axis=-1) * np.sum(fore * fore, axis=-1)
        )
        return np.arccos(np.clip(cosine, -1.0, 1.0))

    def gap_to_trunk(
        self, elbow: NDArray[np.float64], wrist: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the gap (k,) between forearm and trunk, metres, measured at some points."""
        begin, end, radius = self.trunk
        shares = np.linspace(0.0, 1.0, _POINTS)[:, None, None]
        points = elbow + shares * (wrist - elbow)
        nearest = points.copy()
        nearest[..., 0] = np.clip(points[..., 0], begin[0], end[0])  # it lies along the x axis
        nearest[..., 1:] = begin[1:]
        apart = points - nearest
        distance = np.sqrt(np.sum(apart * apart, axis=-1)).min(axis=0)
        return distance - radius - self.radius[1]

    def swung(self, points: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (k, 3) turned by ``angle`` (k,), radians, about the vertical shoulder."""
        x, y = (points[:, :2] - self.shoulder[:2]).T
        cosine, sine = np.cos(angle), np.sin(angle)
        turned = points.copy()
        turned[:, 0] = self.shoulder[0] + cosine * x - sine * y
        turned[:, 1] = self.shoulder[1] + sine * x + cosine * y
        return turned

    def _bend_cosine(
        self, elbow: NDArray[np.float64], wrist: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Cosine (k,) of the elbow's bend; above 1 where the carrying angle does not allow it."""
        upper, fore = elbow - self.shoulder, wrist - elbow
        across = np.sqrt(np.sum(self.fore**2) - (self.fore @ self.axis) ** 2)
        return np.sum(upper * fore, axis=-1) / (np.sqrt(np.sum(upper * upper, axis=-1)) * across)

    def joints(
        self, elbow: NDArray[np.float64], wrist: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return the shoulder's rotation (3, 3) and the elbow's angle (rad) that lead there.

        :param elbow: (3,) as :meth:`elbow_at` returned it.
        :param wrist: (3,).
        """
        angle = float(np.arccos(self._bend_cosine(elbow[None], wrist[None])[0])) - self.bent
        turned = about(self.axis, angle) @ self.fore
        before = frame_of(self.upper, turned)
        after = frame_of(elbow - self.shoulder, wrist - elbow)
        return after @ before.T, angle


#: An arm of a body, computed once.
arm_of = lru_cache(maxsize=64)(PersonArm)
