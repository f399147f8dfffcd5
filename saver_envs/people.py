"""The people of the scenes: a few bodies, and how their arms lie.

All points are in the manikin's frame (see :mod:`saver_envs.robots.manikin`), metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.postures import random_appearance
from saver_envs.robots.manikin import hinge, limb_capsule
from saver_envs.robots.manikin_surface import Appearance, body_shape

#: How many bodies there are of each split of :mod:`saver_envs.perception.postures`.
_PER_SPLIT: Final = {"test": 8, "validation": 4, "train": 4}
#: Seed of these bodies: which ones they are is part of the environments' version.
_SEED: Final = 8


def _bodies() -> tuple[Appearance, ...]:
    random = np.random.default_rng(_SEED)
    return tuple(
        random_appearance(random, split)
        for split, count in _PER_SPLIT.items()
        for _ in range(count)
    )


#: Who may lie on the bench: women and men of 1.5 to 1.95 m, slim to heavy.
BODIES: Final = _bodies()


@dataclass(frozen=True)
class Arm:
    """The geometry of an arm as its body is compiled, and what follows from it.

    :param shoulder: (3,) joint's centre.
    :param upper: (3,) from shoulder to elbow.
    :param fore: (3,) from elbow to wrist, with the elbow's angle at 0.
    :param axis: (3,) unit axis of the elbow, at a right angle to ``upper``.
    :param bent: how far the elbow is bent where its angle is 0, radians.
    :param hip: (3,) hip joint's centre at that side.
    :param elbow_height: of a resting elbow's centre, metres.
    :param wrist_height: of a resting wrist's centre, metres.
    :param sideways: 1 for a left arm, -1 for a right one.
    """

    shoulder: NDArray[np.float64]
    upper: NDArray[np.float64]
    fore: NDArray[np.float64]
    axis: NDArray[np.float64]
    bent: float
    hip: NDArray[np.float64]
    elbow_height: float
    wrist_height: float
    sideways: float

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

    def _bend_cosine(
        self, elbow: NDArray[np.float64], wrist: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Cosine (k,) of the elbow's bend; above 1 where the carrying angle does not allow it."""
        upper, fore = elbow - self.shoulder, wrist - elbow
        across = np.sqrt(np.sum(self.fore**2) - (self.fore @ self.axis) ** 2)
        cosine: NDArray[np.float64] = np.sum(upper * fore, axis=-1) / (
            np.sqrt(np.sum(upper * upper, axis=-1)) * across
        )
        return cosine

    def joints(
        self, elbow: NDArray[np.float64], wrist: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return the shoulder's rotation (3, 3) and the elbow's angle (rad) that lead there.

        :param elbow: (3,) as :meth:`elbow_at` returned it.
        :param wrist: (3,).
        """
        angle = float(np.arccos(self._bend_cosine(elbow[None], wrist[None])[0])) - self.bent
        turned = _about(self.axis, angle) @ self.fore
        before = _frame(self.upper, turned)
        after = _frame(elbow - self.shoulder, wrist - elbow)
        return after @ before.T, angle


@lru_cache(maxsize=64)
def arm_of(appearance: Appearance, side: str) -> Arm:
    """Return an arm of a body; ``side`` is ``left`` or ``right``."""
    shape = body_shape(appearance)
    shoulder, elbow, wrist = (
        shape.head(f"{side}_{part}") for part in ("upper_arm", "forearm", "hand")
    )
    axis, bent = hinge(f"{side}_forearm", shape, 1.0)
    thickness = {
        part: limb_capsule(f"{side}_{part}", shape)[2] for part in ("upper_arm", "forearm", "hand")
    }
    return Arm(
        shoulder=shoulder,
        upper=elbow - shoulder,
        fore=wrist - elbow,
        axis=axis,
        bent=bent,
        hip=shape.head(f"{side}_thigh"),
        elbow_height=thickness["upper_arm"] + 0.001,
        wrist_height=max(thickness["forearm"], thickness["hand"]) + 0.001,
        sideways=1.0 if side == "left" else -1.0,
    )


def _about(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) about a unit axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: NDArray[np.float64] = (
        np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    )
    return rotation


def _frame(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axes (3, 3), in columns, of which x is along ``first`` and z is across both."""
    x = first / np.linalg.norm(first)
    z = np.cross(first, second)
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)
