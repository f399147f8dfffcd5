"""Chains and links of a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.newton_euler import Links

#: Types of joints, and whether they slide.
_SLIDES = {int(mujoco.mjtJoint.mjJNT_HINGE): False, int(mujoco.mjtJoint.mjJNT_SLIDE): True}


def chain_of_model(model: mujoco.MjModel, base: str, joints: Sequence[str], site: str) -> Chain:
    """Return the chain from a base body through hinges and slides to a site.

    :param model: the compiled model.
    :param base: name of the base's body.
    :param joints: names of the joints, from the base on.
    :param site: name of the tool's site.
    :raises ValueError: for a joint that is neither a hinge nor a slide.
    """
    data = _at_zero(model, joints)
    ends = [_transform(data.body(base).xpos, data.body(base).xmat)]
    prismatic = []
    for name in joints:
        joint = model.joint(name)
        kind = int(joint.type[0])
        if kind not in _SLIDES:
            raise ValueError(f"joint {name!r} is neither a hinge nor a slide")
        prismatic.append(_SLIDES[kind])
        ends.append(_transform(data.xanchor[joint.id], _frame_along(data.xaxis[joint.id])))
    tool = _transform(data.site(site).xpos, data.site(site).xmat)
    before = [np.linalg.inv(first) @ second for first, second in pairwise(ends)]
    dof = len(joints)
    return Chain(
        np.array(before),
        np.tile(np.eye(4), (dof, 1, 1)),
        np.ones(dof),
        np.array(prismatic),
        np.linalg.inv(ends[-1]) @ tool,
    )


def links_of_model(model: mujoco.MjModel, base: str, joints: Sequence[str], chain: Chain) -> Links:
    """Return the links' inertia, each in its frame of ``chain``.

    A body without a joint of the chain belongs to the link that carries it. Bodies that the base
    carries do not move and are omitted.

    :param model: the compiled model.
    :param base: name of the base's body.
    :param joints: names of the chain's joints; all others are treated as fixed at zero.
    :param chain: the same arm's chain.
    """
    data = _at_zero(model, joints)
    frames = chain.frames(np.zeros((1, chain.dof)))
    origin, to_base = data.body(base).xpos.copy(), data.body(base).xmat.reshape(3, 3).T.copy()
    link_of_body = {int(model.joint(name).bodyid[0]): index for index, name in enumerate(joints)}
    parts: list[tuple[int, float, FloatArray, FloatArray]] = []
    mass, moment, inertia = (np.zeros((len(joints), *shape)) for shape in ((), (3,), (3, 3)))
    for body in range(1, model.nbody):
        carrier = body
        while carrier and carrier not in link_of_body:
            carrier = int(model.body_parentid[carrier])
        if not carrier:
            continue
        index = link_of_body[carrier]
        rotation = frames.link_rotation[index, 0]
        centre = to_base @ (data.xipos[body] - origin)
        axes = rotation.T @ to_base @ data.ximat[body].reshape(3, 3)
        local = rotation.T @ (centre - frames.link_position[index, 0])
        mass[index] += model.body_mass[body]
        moment[index] += model.body_mass[body] * local
        turned = axes @ np.diag(model.body_inertia[body]) @ axes.T
        parts.append((index, float(model.body_mass[body]), local, turned))
    centres = moment / np.where(mass > 0, mass, 1.0)[:, None]
    for index, part_mass, local, turned in parts:
        arm = local - centres[index]
        inertia[index] += turned
        inertia[index] += part_mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Links(mass, centres, inertia)


def _at_zero(model: mujoco.MjModel, joints: Sequence[str]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name in joints:
        data.joint(name).qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def _transform(position: FloatArray, rotation: FloatArray) -> FloatArray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation.reshape(3, 3), position
    return transform


def _frame_along(axis: FloatArray) -> FloatArray:
    """Return a rotation whose z axis is ``axis``."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=-1)
