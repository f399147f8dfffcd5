"""Inertia of a chain's links."""

from __future__ import annotations

from dataclasses import dataclass

from saver_envs.modelling.chain import FloatArray


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
