"""What sets the twins, the plants that stand in for the real arms, apart from their data sheets.

Every figure here is ours: of the size that such arms are known to show, chosen once, and never
fitted to a result. The links' inertia that they change is the maker's, not that of Appendix A.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class TwinParameters:
    """A plant, its sensors and its low-level controller; tuples have one entry a joint.

    Units are N m and radians, or N and metres of a lift.

    :param mass_scale: the links' masses as multiples of the maker's.
    :param centre_shift: displacement of all links' centres of mass along their frames' axes, m.
    :param friction: Coulomb friction.
    :param damping: viscous friction, per 1/s.
    :param armature: reflected inertia of motors and gears.
    :param torque_limit: where the drives saturate.
    :param lag: time constant of the drives' torque, s.
    :param torque_noise: standard deviation of a torque reading.
    :param encoder_noise: standard deviation of a position reading.
    :param velocity_noise: standard deviation of the velocity that the controller sees.
    :param stiffness: of the controller.
    :param controller_damping: of the controller.
    """

    mass_scale: tuple[float, ...]
    centre_shift: tuple[float, float, float]
    friction: tuple[float, ...]
    damping: tuple[float, ...]
    armature: tuple[float, ...]
    torque_limit: tuple[float, ...]
    lag: float
    torque_noise: tuple[float, ...]
    encoder_noise: tuple[float, ...]
    velocity_noise: tuple[float, ...]
    stiffness: tuple[float, ...]
    controller_damping: tuple[float, ...]


MICO_TWIN: Final = TwinParameters(
    # Cables, glue and screws are in no drawing; a hand with its wiring is the worst known part.
    mass_scale=(1.03, 1.05, 1.04, 1.08),
    # A few millimetres, as between drawing and build; the makers give millimetres.
    centre_shift=(0.002, -0.002, 0.003),
    # Strain wave gears turn heavily: some percent of the rated torque before anything moves.
    friction=(0.45, 0.60, 0.40, 0.15),
    # Their grease: at 0.3 rad/s about a quarter of the Coulomb part.
    damping=(0.50, 0.60, 0.40, 0.10),
    # A rotor of some 1e-5 kg m^2 behind a ratio of about 110 to 136.
    armature=(0.15, 0.15, 0.15, 0.05),
    # The makers' peak torques, less what an unsteady supply takes.
    torque_limit=(36.0, 72.0, 36.0, 18.0),
    # Current loop and elasticity of the gears: a few milliseconds.
    lag=0.004,
    # Strain gauges on the joints.
    torque_noise=(0.05, 0.05, 0.05, 0.03),
    # About 15 bits a turn.
    encoder_noise=(2e-4,) * 4,
    velocity_noise=(0.01,) * 4,
    # Natural frequency near 20 rad/s at the middle of the workspace, critically damped.
    stiffness=(200.0, 220.0, 120.0, 30.0),
    controller_damping=(20.0, 22.0, 12.0, 3.0),
)

FETCH_TWIN: Final = TwinParameters(
    mass_scale=(1.04, 1.03, 1.05, 1.04, 1.05, 1.03, 1.04, 1.06),
    centre_shift=(0.003, -0.003, 0.004),
    # The lift is a self-locking screw: it loses about a third of the 280 N that it carries. The
    # others are geared drives, some percent of their rating.
    friction=(100.0, 2.0, 3.5, 2.0, 2.0, 1.0, 1.0, 0.3),
    damping=(150.0, 1.5, 2.0, 1.2, 1.2, 0.6, 0.6, 0.2),
    # The motor of a screw turns fast: its rotor weighs as much as the arm.
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

TWINS: Final = {"mico": MICO_TWIN, "fetch": FETCH_TWIN}
