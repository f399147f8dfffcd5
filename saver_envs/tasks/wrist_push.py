"""Wrist push: slide the wrists of a person on a stretcher to the sides of the hips (chapter 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Fingers
from saver_envs.tasks.base import FloatArray, Readings, Task
from saver_envs.tasks.push import PUSH_HEIGHT

#: How far beside its hip joint a wrist is to lie (m): the arms' motion stops that far from the
#: body, so as not to squeeze it (SPEC 5.5).
STANDOFF: Final = 0.15
#: Limits of what the torso may be put through (SPEC 5.6): newtons, metres.
FORCE_LIMIT, DISPLACEMENT_LIMIT = 50.0, 0.020
#: Actions in an episode (SPEC 5.6).
HORIZON: Final = 250


@dataclass(frozen=True)
class WristPush(Task):
    """Both wrists at the hips' sides, hands closed and held at pushing height.

    The reward knows the goal alone, so that it can be computed again for any goal. Success asks
    as well that the torso was never pressed nor moved too far since the episode began.
    """

    name: ClassVar[str] = "wrist push"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    held_height: ClassVar[float | None] = PUSH_HEIGHT
    cost_names: ClassVar[tuple[str, ...]] = ("torso_force", "torso_displacement")
    never: ClassVar[tuple[str, ...]] = ("torso_force", "torso_displacement")
    moves_person: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_arms != 2:
            raise ValueError(f"n_arms={self.n_arms!r}: a person's two wrists need exactly 2 arms")

    def costs(
        self,
        achieved: FloatArray,
        desired: FloatArray,
        collided: NDArray[np.bool_],
        readings: Readings | None = None,
    ) -> dict[str, NDArray[np.float64]]:
        """Return the costs of collision, and of pressing and of moving the torso too far."""
        costs = super().costs(achieved, desired, collided, readings)
        nothing = np.zeros(len(collided))
        for name, limit in (
            ("torso_force", FORCE_LIMIT),
            ("torso_displacement", DISPLACEMENT_LIMIT),
        ):
            measured = nothing if readings is None else readings[name]
            costs[name] = (measured > limit).astype(np.float64)
        return costs
