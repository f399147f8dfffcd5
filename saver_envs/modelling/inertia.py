"""Inertia of links: the container, and the paper's figures for both arms (Appendix A).

Appendix A gives centres of mass and inertia in the frames of the DH tables; the masses are the
makers'. Its Fetch has no gripper, and its MICO was read off the maker's drawings: that, and all
that a drawing does not say of friction, is what sets the analytic model apart from an arm.
"""

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
    :raises ValueError: for shapes that do not fit, or a mass below zero.
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
        """Return links that are made of several rigid parts each.

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


def _symmetric(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> FloatArray:
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


#: Masses of shoulder, arm, forearm, and hand with two fingers (kg): kinova-ros, m1n4s200.
MICO_MASSES = (0.7477, 0.85968, 0.606, 0.78 + 4 * 0.01)
#: Table 1 of Appendix A. Centres of mass, mm.
_MICO_CENTRES = (
    (0.01, 8.46, -51.64),
    (140.80, 0.00, -20.61),
    (-0.04, 41.26, 16.21),
    (1.69, -1.31, -118.74),
)
#: Its moments of inertia in the order that it prints: xx xy yy yz zz xz, g mm^2.
_MICO_INERTIA = (
    (1066764.15, -31.86, 1112292.98, 112239.63, 294233.86, -156.65),
    (542848.18, -561.89, 18596075.98, -8.53, 18533418.58, -1428223.80),
    (1497076.78, -847.46, 258952.15, 152097.63, 1467115.33, -144.78),
    (5611391.53, -902.55, 5429904.00, 51034.36, 301540.64, -52563.36),
)
#: Frame 4 of Table 7.1 lies at the end effector, 0.16 m behind joint 4, where our chain has it.
_MICO_HAND_FRAME = 0.16

#: Masses of torso with head, shoulder pan and lift, upper arm, elbow, forearm, wrist flex and roll
#: (kg): Fetch's URDF, as in the gymnasium-robotics wheel. No gripper: Table 2 has none.
FETCH_MASSES = (
    10.7796 + 2.2556 + 0.9087,
    2.5587,
    2.6615,
    2.3311,
    2.1299,
    1.6563,
    1.725,
    0.1354,
)
#: Table 2 of Appendix A. Centres of mass, m.
_FETCH_CENTRES = (
    (-0.1208, -0.0009, -0.1151),
    (-0.0243, 0.0036, -0.0056),
    (-0.0001, -0.0072, 0.1432),
    (0.0, -0.0165, 0.0014),
    (0.0, -0.0073, 0.1279),
    (0.0, -0.0148, -0.0266),
    (-0.0001, -0.0009, 0.0882),
    (-0.0002, -0.0004, 0.0095),
)
#: Its moments of inertia, kg m^2. The order is xx xy xz yy yz zz, not the printed one, by which an
#: Izz would be negative.
_FETCH_INERTIA = (
    (0.3354, 0.0, -0.0162, 0.3354, -0.0006, 0.0954),
    (0.0043, -0.0010, -0.0001, 0.0087, 0.0001, 0.0087),
    (0.0112, 0.0, 0.0, 0.0111, 0.0021, 0.0028),
    (0.0047, 0.0, 0.0, 0.0019, -0.0001, 0.0045),
    (0.0084, 0.0, 0.0, 0.0082, 0.0016, 0.0024),
    (0.0035, 0.0, 0.0, 0.0016, -0.0003, 0.0030),
    (0.0042, 0.0, 0.0, 0.0042, 0.0001, 0.0018),
    (0.0001, 0.0, 0.0, 0.0001, 0.0, 0.0001),
)


def mico_appendix_links() -> Links:
    """Return Appendix A's MICO in the frames of `saver_envs.modelling.dh.mico_chain`."""
    centre = np.array(_MICO_CENTRES) * 1e-3
    centre[3, 2] += _MICO_HAND_FRAME
    inertia = [
        _symmetric(xx, xy, xz, yy, yz, zz) * 1e-9 for xx, xy, yy, yz, zz, xz in _MICO_INERTIA
    ]
    return Links(np.array(MICO_MASSES), centre, np.array(inertia))


def fetch_appendix_links() -> Links:
    """Return Appendix A's Fetch in the frames of `saver_envs.modelling.dh.fetch_chain`.

    The wrist's last link is given at joint 7; the frame of the table's last row is the gripper's.
    """
    centre = np.array(_FETCH_CENTRES)
    centre[7, 2] -= 0.1664
    return Links(
        np.array(FETCH_MASSES), centre, np.array([_symmetric(*row) for row in _FETCH_INERTIA])
    )
