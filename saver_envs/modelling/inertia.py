"""Inertia of a chain's links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saver_envs.modelling.chain import FloatArray


@dataclass(frozen=True)
class Links:
    """Inertia of a chain's links, each in its own frame.

    :param mass: (dof,), kilograms.
    :param centre: (dof, 3) centres of mass, metres.
    :param inertia: (dof, 3, 3) about the centre of mass, kg m^2.
    :raises ValueError: for mismatched shapes or a negative mass.
    """

    mass: FloatArray
    centre: FloatArray
    inertia: FloatArray

    def __post_init__(self) -> None:
        dof = len(self.mass)
        if self.centre.shape != (dof, 3) or self.inertia.shape != (dof, 3, 3):
            raise ValueError(
                f"centre of shape {self.centre.shape} and inertia of shape {self.inertia.shape}: "
                f"must have shapes {(dof, 3)} and {(dof, 3, 3)}"
            )
        if (self.mass < 0).any():
            raise ValueError(f"mass={self.mass!r}: must not be below 0 kg")

    @classmethod
    def joined(cls, parts: Sequence[Sequence[tuple[float, FloatArray, FloatArray]]]) -> Links:
        """Return links composed of several rigid parts each.

        :param parts: for each link (mass, centre of mass (3,), inertia (3, 3)) of its parts.
        """
        masses, centres, inertias = [], [], []
        for link in parts:
            mass = sum(part[0] for part in link)
            moment = sum((part[0] * part[1] for part in link), np.zeros(3))
            centre = moment / mass if mass > 0 else moment
            inertia = np.zeros((3, 3))
            for part_mass, part_centre, part_inertia in link:
                arm = part_centre - centre
                inertia += part_inertia
                inertia += part_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            masses.append(mass)
            centres.append(centre)
            inertias.append(inertia)
        return cls(np.array(masses), np.array(centres), np.array(inertias))


def symmetric(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> FloatArray:
    """Return a symmetric matrix (3, 3) from its six entries."""
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
