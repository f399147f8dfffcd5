"""Actuators of a robot's joints: position servos, or torque motors in their place."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco


def add_servo(
    spec: mujoco.MjSpec,
    name: str,
    joint: str,
    limit: float,
    stiffness: float,
    damping: float | None = None,
) -> None:
    """Add a position servo to a joint.

    :param spec: of the robot; it gets another actuator.
    :param name: of the actuator.
    :param joint: a hinge, or a slide in metres and newtons.
    :param limit: greatest torque, N m.
    :param stiffness: N m/rad.
    :param damping: N m s/rad; where ``None``, critical for the joint's inertia at the zero posture.
    """
    servo = _add_actuator(spec, name, joint, limit)
    if damping is None:
        servo.set_to_position(kp=stiffness, dampratio=1.0)
    else:
        servo.set_to_position(kp=stiffness, kv=damping)


def drive_by_torques(
    spec: mujoco.MjSpec, names: Sequence[str], joints: Sequence[str], limits: Sequence[float]
) -> None:
    """Reduce a robot to its links' inertia, and drive its joints by torques.

    Servos, armature and gravity compensation are removed.

    :param spec: of the robot, its fingers locked; changed in place.
    :param names: of the actuators; actuator i drives joint i.
    :param joints: the arm's.
    :param limits: greatest torques, N m.
    """
    for servo in list(spec.actuators):
        spec.delete(servo)
    for body in spec.bodies:
        body.gravcomp = 0
    for name, joint, limit in zip(names, joints, limits, strict=True):
        driven = spec.joint(joint)
        driven.armature, driven.actgravcomp = 0.0, 0
        _add_actuator(spec, name, joint, limit).set_to_motor()


def _add_actuator(spec: mujoco.MjSpec, name: str, joint: str, limit: float) -> mujoco.MjsActuator:
    return spec.add_actuator(
        name=name,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcelimited=True,
        forcerange=(-limit, limit),
    )
