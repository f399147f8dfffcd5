"""The Fetch: Table 7.2, Appendix A, its twin and its data."""

from __future__ import annotations

import math
from functools import cache

import mujoco
import numpy as np

from saver_envs.modelling.arms.description import (
    Campaign,
    KinematicArm,
    Region,
    TwinParameters,
    within_one_turn,
)
from saver_envs.modelling.chain import Chain
from saver_envs.modelling.dh import DHRow, chain_of_table
from saver_envs.modelling.newton_euler import Links
from saver_envs.robots.drives import torque_driven
from saver_envs.robots.fetch import BASE_BODY, FETCH

_HALF_PI = math.pi / 2
#: Distance of the gripper's frame from the last joint (m).
_GRIPPER = 0.1664

#: Table 7.2, standard, with the lengths of the MJCF in the gymnasium-robotics wheel (m). The last
#: row ends at the frame of the gripper.
DH_TABLE = (
    DHRow(-0.0869 + 0.1195, 0.0, 0.3774 + 0.3486, prismatic=True),
    DHRow(0.117, -_HALF_PI, 0.06),
    DHRow(0.0, -_HALF_PI, 0.0, offset=-_HALF_PI),
    DHRow(0.0, _HALF_PI, 0.219 + 0.133),
    DHRow(0.0, -_HALF_PI, 0.0),
    DHRow(0.0, _HALF_PI, 0.197 + 0.1245),
    DHRow(0.0, -_HALF_PI, 0.0),
    DHRow(0.0, 0.0, 0.1385 + _GRIPPER),
)

#: Masses of torso with head, shoulder pan and lift, upper arm, elbow, forearm, wrist flex and roll
#: (kg): Fetch's URDF, as in the gymnasium-robotics wheel. Table 2 has no gripper.
_MASSES = (10.7796 + 2.2556 + 0.9087, 2.5587, 2.6615, 2.3311, 2.1299, 1.6563, 1.725, 0.1354)
#: Table 2 of Appendix A. Centres of mass, m.
_CENTRES = (
    (-0.1208, -0.0009, -0.1151),
    (-0.0243, 0.0036, -0.0056),
    (-0.0001, -0.0072, 0.1432),
    (0.0, -0.0165, 0.0014),
    (0.0, -0.0073, 0.1279),
    (0.0, -0.0148, -0.0266),
    (-0.0001, -0.0009, 0.0882),
    (-0.0002, -0.0004, 0.0095),
)
#: Its moments of inertia, kg m^2, as xx xy xz yy yz zz: in the printed order an Izz is negative.
_INERTIA = (
    (0.3354, 0.0, -0.0162, 0.3354, -0.0006, 0.0954),
    (0.0043, -0.0010, -0.0001, 0.0087, 0.0001, 0.0087),
    (0.0112, 0.0, 0.0, 0.0111, 0.0021, 0.0028),
    (0.0047, 0.0, 0.0, 0.0019, -0.0001, 0.0045),
    (0.0084, 0.0, 0.0, 0.0082, 0.0016, 0.0024),
    (0.0035, 0.0, 0.0, 0.0016, -0.0003, 0.0030),
    (0.0042, 0.0, 0.0, 0.0042, 0.0001, 0.0018),
    (0.0001, 0.0, 0.0, 0.0001, 0.0, 0.0001),
)

_TWIN = TwinParameters(
    mass_scale=(1.04, 1.03, 1.05, 1.04, 1.05, 1.03, 1.04, 1.06),
    centre_shift=(0.003, -0.003, 0.004),
    # The lift is a self-locking screw: it loses about a third of the 280 N that it carries. The
    # other drives are geared and lose a few percent of their rating.
    friction=(100.0, 2.0, 3.5, 2.0, 2.0, 1.0, 1.0, 0.3),
    damping=(150.0, 1.5, 2.0, 1.2, 1.2, 0.6, 0.6, 0.2),
    # A screw's motor turns fast: the reflected inertia of its rotor is that of the arm's mass.
    armature=(20.0, 0.4, 0.4, 0.25, 0.25, 0.12, 0.12, 0.05),
    torque_limit=(450.0, 32.0, 125.0, 73.0, 62.0, 28.0, 24.0, 7.0),
    lag=0.005,
    # Torque is estimated from the motors' current.
    torque_noise=(5.0, 0.4, 0.6, 0.4, 0.4, 0.2, 0.2, 0.1),
    encoder_noise=(2e-5, *(2e-4,) * 7),
    velocity_noise=(1e-3, *(0.01,) * 7),
    stiffness=(20000.0, 1000.0, 1200.0, 350.0, 350.0, 120.0, 100.0, 30.0),
    controller_damping=(2000.0, 100.0, 120.0, 35.0, 35.0, 12.0, 10.0, 3.0),
)

#: 2,400 s between the cuts, a way-point every 4 s, logged at 100 Hz; the window spans 0.1 s.
_CAMPAIGN = Campaign(2, 602, 4.0, 5, cut=4.0, window=10, keep_every=4)


def chain() -> Chain:
    """Return the chain of Table 7.2, in the frame of the mobile base."""
    return chain_of_table(DH_TABLE, "standard")


def appendix_links() -> Links:
    """Return the inertia of Appendix A in the frames of :func:`chain`."""
    centre = np.array(_CENTRES)
    centre[7, 2] -= _GRIPPER  # the appendix gives the last link at joint 7
    inertia = np.take(_INERTIA, [[0, 1, 2], [1, 3, 4], [2, 4, 5]], axis=1)
    return Links(np.array(_MASSES), centre, inertia)


@cache
def _collision_model() -> mujoco.MjModel:
    """Return the robot on the ground."""
    spec = torque_driven(FETCH)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(2, 2, 0.1), contype=2, conaffinity=0
    )
    # The base's hull reaches below its wheels' contact with the ground: only the arm matters.
    for geom in spec.geoms:
        if geom.contype and geom.parent.name not in ("world", BASE_BODY):
            geom.conaffinity = 3
    return spec.compile()


def arm() -> KinematicArm:
    """Return the Fetch."""
    return KinematicArm(
        FETCH,
        chain(),
        chain(),
        *within_one_turn(FETCH),
        region=Region((0.45, -0.60, 0.35), (0.95, 0.60, 1.30)),
        appendix_links=appendix_links,
        twin=_TWIN,
        campaign=_CAMPAIGN,
        collision_model=_collision_model,
    )
