"""Inverse dynamics of a chain by the recursive Newton-Euler method, batched.

An outward pass computes the velocities and accelerations of the links, an inward pass the forces
and moments that cause them (Luh, Walker and Paul, 1980), all in the frame of the base. Gravity is
an acceleration of the base. This is equation 7.2 without friction and external force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.simulation import cross

GRAVITY = 9.81  # m/s^2, MuJoCo's default
#: Rows computed at once: few enough to stay in the CPU's cache.
_ROWS = 4096


@dataclass(frozen=True)
class Links:
    """Inertia of a chain's links, each in its own frame.

    :param mass: (dof,), kilograms.
    :param centre: (dof, 3) centres of mass, metres.
    :param inertia: (dof, 3, 3) about the centre of mass, kg m^2.
    """

    mass: FloatArray
    centre: FloatArray
    inertia: FloatArray


def inverse_dynamics(
    chain: Chain,
    links: Links,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    """Return the joint torques (N m; N for slides) of a motion.

    :param chain: the arm.
    :param links: its inertia, in the frames of ``chain``.
    :param position: (n, dof), radians or metres.
    :param velocity: (n, dof), per second.
    :param acceleration: (n, dof), per second squared.
    :return: (n, dof).
    :raises ValueError: for mismatched shapes.
    """
    shape = np.shape(position)
    for name, values in (("velocity", velocity), ("acceleration", acceleration)):
        if np.shape(values) != shape:
            raise ValueError(f"{name} of shape {np.shape(values)}: must have shape {shape}")
    if len(links.mass) != chain.dof:
        raise ValueError(f"links={len(links.mass)} of them: the chain has {chain.dof} joints")
    torque = np.empty(shape)
    for start in range(0, shape[0], _ROWS):
        part = slice(start, start + _ROWS)
        motion = (one[part] for one in (position, velocity, acceleration))
        torque[part] = _part(chain, links, *motion)
    return torque


def _part(
    chain: Chain,
    links: Links,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    frames = chain.frames(position)
    n, dof = position.shape
    centre = frames.link_position + np.einsum("dnij,dj->dni", frames.link_rotation, links.centre)
    force, moment = np.empty((dof, n, 3)), np.empty((dof, n, 3))
    spin, spin_rate = np.zeros((n, 3)), np.zeros((n, 3))
    origin, linear = np.zeros((n, 3)), np.tile((0.0, 0.0, GRAVITY), (n, 1))
    for index in range(dof):
        axis, anchor = frames.axis[index], frames.anchor[index]
        linear = _carried(linear, spin, spin_rate, anchor - origin)
        if chain.prismatic[index]:
            # The point of the link at the anchor slides along the previous link.
            slide = axis * velocity[:, index, None]
            linear += axis * acceleration[:, index, None] + 2 * cross(spin, slide)
        else:
            turn = axis * velocity[:, index, None]
            spin_rate = spin_rate + axis * acceleration[:, index, None] + cross(spin, turn)
            spin = spin + turn
        origin = anchor
        arm = centre[index] - origin
        force[index] = links.mass[index] * _carried(linear, spin, spin_rate, arm)
        rotation = frames.link_rotation[index]
        momentum = _in_frame(rotation, links.inertia[index], spin)
        moment[index] = _in_frame(rotation, links.inertia[index], spin_rate) + cross(spin, momentum)
    # Inwards: sum the links' forces and moments from the last to the first.
    torque = np.empty((n, dof))
    total_force, total_moment = np.zeros((n, 3)), np.zeros((n, 3))
    for index in reversed(range(dof)):
        anchor = frames.anchor[index]
        if index < dof - 1:
            total_moment += cross(frames.anchor[index + 1] - anchor, total_force)
        total_moment += moment[index] + cross(centre[index] - anchor, force[index])
        total_force += force[index]
        along = total_force if chain.prismatic[index] else total_moment
        torque[:, index] = np.einsum("ni,ni->n", along, frames.axis[index])
    return torque


def _carried(
    acceleration: FloatArray, spin: FloatArray, spin_rate: FloatArray, arm: FloatArray
) -> FloatArray:
    """Return the acceleration of a rotating body at ``arm`` from a point with ``acceleration``."""
    return acceleration + cross(spin_rate, arm) + cross(spin, cross(spin, arm))


def _in_frame(rotation: FloatArray, matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return R M R^T v for rotations (n, 3, 3), one matrix (3, 3) and vectors (n, 3)."""
    local = np.einsum("nji,nj->ni", rotation, vector)
    return np.einsum("nij,nj->ni", rotation, local @ matrix.T)
