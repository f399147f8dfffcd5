"""Chains and links read off a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np

from saver_envs.modelling.chain import Chain, FloatArray
from saver_envs.modelling.inertia import Links


def chain_of_model(
    model: mujoco.MjModel, base: str, joints: Sequence[str], site: str | None, body: str = ""
) -> Chain:
    """Return the chain from a base body through hinges and slides to a site.

    :param model: the compiled model.
    :param base: name of the base's body.
    :param joints: names of the joints, from the base on.
    :param site: name of the tool's site, or None where ``body`` is the tool.
    :param body: name of the tool's body.
    :raises ValueError: for a joint that is neither hinge nor slide.
    """
    data = mujoco.MjData(model)
    _to_zero(model, data, joints)
    ends = [_transform(data.body(base).xpos, data.body(base).xmat)]
    prismatic = []
    for name in joints:
        joint = model.joint(name)
        kind = int(joint.type[0])
        if kind not in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
            raise ValueError(f"joint {name!r} is neither a hinge nor a slide")
        prismatic.append(kind == int(mujoco.mjtJoint.mjJNT_SLIDE))
        ends.append(_transform(data.xanchor[joint.id], _frame_along(data.xaxis[joint.id])))
    if site is not None:
        tool = _transform(data.site(site).xpos, data.site(site).xmat)
    else:
        tool = _transform(data.body(body).xpos, data.body(body).xmat)
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

    Bodies without a joint of their own belong to the link that carries them; what the base carries
    does not move and is left out.

    :param model: the compiled model.
    :param base: name of the base's body.
    :param joints: names of the chain's joints; all others stay at zero and are taken as fixed.
    :param chain: the same arm's.
    """
    data = mujoco.MjData(model)
    _to_zero(model, data, joints)
    frames = chain.frames(np.zeros((1, chain.dof)))
    origin, to_base = data.body(base).xpos.copy(), data.body(base).xmat.reshape(3, 3).T.copy()
    link_of_body = {int(model.joint(name).bodyid[0]): index for index, name in enumerate(joints)}
    parts: list[list[tuple[float, FloatArray, FloatArray]]] = [[] for _ in joints]
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
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        local = rotation.T @ (centre - frames.link_position[index, 0])
        parts[index].append((float(model.body_mass[body]), local, inertia))
    return Links.joined(parts)


def _to_zero(model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[str]) -> None:
    data.qpos[:] = model.qpos0
    for name in joints:
        data.joint(name).qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def _transform(position: FloatArray, rotation: FloatArray) -> FloatArray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation.reshape(3, 3), position
    return transform


def _frame_along(axis: FloatArray) -> FloatArray:
    """A rotation whose z axis is ``axis``."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=-1)
