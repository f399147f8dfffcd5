"""The interface between an arm's skill and the coordination of several arms."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saver_envs.experts.blocks import ArmView

FloatArray = NDArray[np.floating]


class Skill(Protocol):
    """What one arm can do by itself; leading dimensions (n, arms)."""

    @property
    def step(self) -> float:
        """Longest displacement of an action, metres."""

    @property
    def object_size(self) -> float:
        """Edge of the cubes, metres."""

    @property
    def ring(self) -> float:
        """Radius around a cube on which a low hand passes without touching it, metres.

        It is 0 for hands that pass over cubes.
        """

    def actions(self, view: ArmView, side: FloatArray | None = None) -> FloatArray:
        """Return the actions of arms that ignore one another."""

    def imagine(self, view: ArmView, actions: FloatArray, base: FloatArray) -> ArmView:
        """Predict what the arms see after these actions."""

    def finished(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which arms are done."""

    def give_way(self, view: ArmView, action: FloatArray, turned: NDArray[np.bool_]) -> FloatArray:
        """Return actions of which those of arms (n, arms) that are ``turned`` away are adapted."""
