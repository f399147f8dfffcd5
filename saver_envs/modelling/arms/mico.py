"""The MICO: Table 7.1, Appendix A, its twin and its data."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from saver_envs.modelling.arms.description import Campaign, KinematicArm, Region, TwinParameters
from saver_envs.modelling.chain import Chain
from saver_envs.modelling.dh import DHRow, chain_of_table, translation
from saver_envs.modelling.newton_euler import Links
from saver_envs.robots.mico import MICO

_HALF_PI = math.pi / 2
# The maker's lengths (kinova-ros, m1n4s200), metres. Row 3 has the lateral offset of 7 mm that the
# table omits.
_SHOULDER_HEIGHT, _UPPER_ARM, _LATERAL = 0.15675 + 0.11875, 0.29, 0.0016 - 0.0086
_FOREARM = 0.1231

#: Table 7.1, modified (Craig). The end effector lies on the axis of joint 4: `chain` adds it.
DH_TABLE = (
    DHRow(0.0, 0.0, _SHOULDER_HEIGHT, direction=-1),
    DHRow(0.0, -_HALF_PI, 0.0, offset=_HALF_PI, direction=-1),
    DHRow(_UPPER_ARM, 0.0, _LATERAL, offset=-3 * _HALF_PI),
    DHRow(0.0, -_HALF_PI, _FOREARM, direction=-1),
)
#: Distance from joint 4 to the maker's end effector, and to the tool between the fingertips to
#: which the environments' set-points refer (m).
END_EFFECTOR, TOOL = 0.16, 0.188
#: Joint limits of Table 7.1, in the table's own angles (rad).
_TABLE_LIMITS = (
    (-math.pi, math.pi),
    (-11 / 18 * math.pi, 1 / 9 * math.pi),
    (-23 / 36 * math.pi, 5 / 36 * math.pi),
    (-math.pi, math.pi),
)

#: Masses of shoulder, arm, forearm, and hand with two fingers (kg): kinova-ros, m1n4s200.
_MASSES = (0.7477, 0.85968, 0.606, 0.78 + 4 * 0.01)
#: Table 1 of Appendix A. Centres of mass, mm.
_CENTRES = (
    (0.01, 8.46, -51.64),
    (140.80, 0.00, -20.61),
    (-0.04, 41.26, 16.21),
    (1.69, -1.31, -118.74),
)
#: Its moments of inertia in the printed order: xx xy yy yz zz xz, g mm^2.
_INERTIA = (
    (1066764.15, -31.86, 1112292.98, 112239.63, 294233.86, -156.65),
    (542848.18, -561.89, 18596075.98, -8.53, 18533418.58, -1428223.80),
    (1497076.78, -847.46, 258952.15, 152097.63, 1467115.33, -144.78),
    (5611391.53, -902.55, 5429904.00, 51034.36, 301540.64, -52563.36),
)

TWIN = TwinParameters(
    # Drawings omit cables, glue and screws; the wired hand is the least known part.
    mass_scale=(1.03, 1.05, 1.04, 1.08),
    # A few millimetres between drawing and build.
    centre_shift=(0.002, -0.002, 0.003),
    # Strain wave gears: a few percent of the rated torque before anything moves.
    friction=(0.45, 0.60, 0.40, 0.15),
    # Their grease: at 0.3 rad/s about a quarter of the Coulomb friction.
    damping=(0.50, 0.60, 0.40, 0.10),
    # A rotor of some 1e-5 kg m^2 behind a ratio of about 110 to 136.
    armature=(0.15, 0.15, 0.15, 0.05),
    # The maker's peak torques, reduced by what an unsteady supply costs.
    torque_limit=(36.0, 72.0, 36.0, 18.0),
    # Current loop and elasticity of the gears: a few milliseconds.
    lag=0.004,
    # Strain gauges on the joints.
    torque_noise=(0.05, 0.05, 0.05, 0.03),
    # About 15 bits per turn.
    encoder_noise=(2e-4,) * 4,
    velocity_noise=(0.01,) * 4,
    # Natural frequency near 20 rad/s at the middle of the workspace, critically damped.
    stiffness=(200.0, 220.0, 120.0, 30.0),
    controller_damping=(20.0, 22.0, 12.0, 3.0),
)

#: 800 s, a way-point every 8 s, logged at 500 Hz; two way-points are cut at either end, and one
#: sample in 32 is kept.
_CAMPAIGN = Campaign(6, 100, 8.0, 1, cut=16.0, window=50, keep_every=32)


def chain(tool_distance: float = END_EFFECTOR) -> Chain:
    """Return the chain of Table 7.1.

    :param tool_distance: distance of the tool from joint 4, on its axis, metres.
    """
    tool = translation(0, 0, tool_distance)
    return replace(chain_of_table(DH_TABLE, "modified"), tool=tool)


def appendix_links() -> Links:
    """Return the inertia of Appendix A in the frames of :func:`chain`."""
    centre = np.array(_CENTRES) * 1e-3
    centre[3, 2] += END_EFFECTOR  # the table's frame 4 is there, ours at joint 4
    inertia = np.take(_INERTIA, [[0, 1, 5], [1, 2, 3], [5, 3, 4]], axis=1) * 1e-9
    return Links(np.array(_MASSES), centre, inertia)


def arm() -> KinematicArm:
    """Return the MICO."""
    limits = [
        sorted((end - row.offset) / row.direction for end in pair)
        for row, pair in zip(DH_TABLE, _TABLE_LIMITS, strict=True)
    ]
    lower, upper = np.transpose(limits)
    return KinematicArm(
        MICO,
        chain(),
        chain(TOOL),
        lower,
        upper,
        # The environments' box, limited to what the hand reaches.
        Region(MICO.grid_lower, MICO.grid_upper, reach=0.59),
        appendix_links,
        TWIN,
        _CAMPAIGN,
        idle_joints=(3,),
    )
