"""Warm start: a student whose networks start from its teachers', arm by arm.

A block-diagonal network of n teachers' layers computes their outputs side by side: two teachers of
3 x 128 make a student of 3 x 256. Additional units keep their random start and do not reach the
teachers' units; the zeros between the blocks are trained like all other weights.

- The actor and the normaliser are always exact.
- Per-arm critics without LayerNorm are exact. A student's LayerNorm averages over the units of all
  arms, each teacher's over its own, so such critics only start near their teachers'.
- Networks that all arms share become the teacher's, with nothing seen of the neighbours at first:
  actor, critics and normaliser are exact.
- A joint critic differs from all teachers' (its value requires every arm to succeed): joint and
  quantile critics start from scratch, as do the value networks of on-policy algorithms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from torch import nn

from saver_advisors.learner.policies import (
    SETTLED_COUNT,
    GoalCritic,
    NormalizedGoalFeatures,
)
from saver_advisors.learner.shared_arms import ArmNetwork, SharedArmFeatures
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.teacher import FunctionTeacher, Teacher, TeacherGroup

Critics = Literal["exact", "approximate", "fresh"]


def warm_start_from_teachers(
    model: OffPolicyAlgorithm, teachers: TeacherGroup, mapping: ArmMapping
) -> Critics:
    """Copy the teachers into a student's normaliser, actor, critics if possible, and their targets.

    :param model: an untrained goal learner.
    :param teachers: one for every arm.
    :param mapping: where each arm's block lies.
    :return: how the critics start.
    :raises TypeError: if the normaliser or the layers are not a goal learner's.
    :raises ValueError: if the student's layers cannot hold the teachers', or inputs or actions
        differ; the message names what would fit.
    """
    critics = start_policy(model.policy, teachers, mapping)
    learner: Any = model
    learner.is_trained = True
    return critics


def start_policy(policy: BasePolicy, teachers: TeacherGroup, mapping: ArmMapping) -> Critics:
    """Copy the teachers into the networks of a policy and, if it has any, their targets.

    :param policy: of a goal learner, or an on-policy one with a normaliser, without a tanh but with
        a mean action that ends in one.
    :param teachers: one for every arm.
    :param mapping: where each arm's block lies.
    :return: how the critics start.
    :raises TypeError: as ``warm_start_from_teachers``.
    :raises ValueError: likewise.
    """
    features, actor, critic = _parts_of(policy)
    if not isinstance(features, NormalizedGoalFeatures):
        raise TypeError(
            f"features extractor {type(features).__name__}: only a goal learner (GoalTD3, "
            "GoalSAC, ...) has a normaliser that can start as the teachers'"
        )
    for teacher in teachers.teachers:
        _check_teacher(teacher, features, policy.action_space, mapping)
    if isinstance(features, SharedArmFeatures):
        if len(set(map(id, teachers.teachers))) > 1:
            raise ValueError(
                f"the teachers are {teachers.names}: arms that share their weights start from one "
                "teacher for all arms"
            )
        teachers = TeacherGroup(teachers.teachers[0], 1)
    columns = [
        _feature_columns(features, teacher, arm) for arm, teacher in enumerate(teachers.teachers)
    ]
    sources = [teacher.networks.actor for teacher in teachers.teachers]
    _check_hidden("actor", actor, sources)
    _start_normaliser(features, teachers, columns)
    _place(actor, sources, columns, mapping.action_size)
    critics = _start_critics(critic, features, teachers, columns)
    for name in ("actor", "critic"):
        if getattr(policy, f"{name}_target", None) is not None:
            getattr(policy, f"{name}_target").load_state_dict(getattr(policy, name).state_dict())
    return critics


def _parts_of(policy: Any) -> tuple[nn.Module, nn.ModuleList, nn.Module | None]:
    """Return a policy's normaliser, the layers of its mean action, and its critic of actions."""
    if isinstance(policy, ActorCriticPolicy):
        layers = nn.ModuleList([policy.mlp_extractor.policy_net, policy.action_net])
        return policy.features_extractor, layers, None
    layers = nn.ModuleList([getattr(policy.actor, "latent_pi", nn.Sequential()), policy.actor.mu])
    return policy.actor.features_extractor, layers, policy.critic


def _check_teacher(
    teacher: Teacher,
    features: NormalizedGoalFeatures,
    action_space: spaces.Space[Any],
    mapping: ArmMapping,
) -> None:
    """Reject a teacher whose computation a goal learner's actor cannot reproduce."""
    name = f"teacher {teacher.name!r}"
    if isinstance(teacher, FunctionTeacher):
        raise TypeError(f"{name} is code, and has no weights to start from: clone it instead")
    spec, networks = teacher.networks.spec, teacher.networks
    if "achieved_goal" in spec.sizes:
        raise ValueError(
            f"{name} reads the achieved goal, which a goal learner's networks do not: train one "
            "with GoalTD3 or its siblings"
        )
    if spec.activation != "relu" or spec.actor_layer_norm:
        raise ValueError(
            f"{name} has {spec.activation} layers{' with LayerNorm' * spec.actor_layer_norm} in "
            "its actor; the student's are relu without"
        )
    if not bool((networks.clip == features.clip).all()):
        raise ValueError(
            f"{name} clips its input at {sorted(set(networks.clip.tolist()))}, the student at "
            f"{features.clip}"
        )
    assert isinstance(action_space, spaces.Box)
    for end, given in (("low", networks.action_low), ("high", networks.action_high)):
        wanted = mapping.split_action(getattr(action_space, end))
        if not np.allclose(wanted, given.numpy(), atol=1e-6):
            raise ValueError(
                f"{name} has actions with {end} {given.tolist()}, the student's arms have "
                f"{wanted.tolist()}"
            )


def _feature_columns(features: NormalizedGoalFeatures, teacher: Teacher, arm: int) -> th.Tensor:
    """Return the student's input column of each of a teacher's inputs."""
    observation = features._observation_space["observation"]  # type: ignore[index]
    offset = {"observation": 0, "desired_goal": observation.shape[0]}
    parts = [
        offset[key] + arm * size + th.arange(size) for key, size in teacher.networks.spec.inputs
    ]
    return th.cat(parts)


def _linears(module: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of a network, of a shared one those that read an arm's own input."""
    hidden = {
        id(layer)
        for one in module.modules()
        if isinstance(one, ArmNetwork)
        for layer in (one.pair, one.pool)
    }
    layers = [one for one in module.modules() if isinstance(one, nn.Linear)]
    return [one for one in layers if id(one) not in hidden]


def _norms(module: nn.Module) -> list[nn.LayerNorm]:
    return [one for one in module.modules() if isinstance(one, nn.LayerNorm)]


def _widths(module: nn.Module) -> list[int]:
    """Return the widths of the hidden layers."""
    return [layer.out_features for layer in _linears(module)[:-1]]


def _check_hidden(part: str, student: nn.Module, sources: Sequence[nn.Module]) -> None:
    """Reject a student whose hidden layers differ in number or are too narrow."""
    own, each = _widths(student), list(map(_widths, sources))
    if len(set(map(len, each))) > 1:
        raise ValueError(f"the teachers' {part}s have {each} hidden units: use equally deep ones")
    needed = [sum(widths) for widths in zip(*each, strict=True)]
    if len(own) != len(needed) or any(a < b for a, b in zip(own, needed, strict=True)):
        raise ValueError(
            f"net_arch={own} cannot hold the teachers side by side, whose {part}s have {each} "
            f"hidden units: use net_arch={needed}, or wider layers"
        )


@th.no_grad()
def _start_normaliser(
    features: NormalizedGoalFeatures, teachers: TeacherGroup, columns: Sequence[th.Tensor]
) -> None:
    """Copy the teachers' statistics, to be kept; an input of no arm starts without samples."""
    deviation = th.ones_like(features.mean)
    for statistics in (features.mean, features.count, features.squared_deviation):
        statistics.zero_()
    for teacher, where in zip(teachers.teachers, columns, strict=True):
        features.mean[where] = teacher.networks.mean.double()
        deviation[where] = teacher.networks.std.double()
        features.count[where] = SETTLED_COUNT
        features.squared_deviation[where] = deviation[where].square() * SETTLED_COUNT
    features.shift.copy_(features.mean)
    features.scale.copy_(1.0 / deviation)


def _start_critics(
    critic: nn.Module | None,
    features: NormalizedGoalFeatures,
    teachers: TeacherGroup,
    columns: Sequence[th.Tensor],
) -> Critics:
    """Copy the teachers' critics into per-arm critics."""
    specs = [teacher.networks.spec for teacher in teachers.teachers]
    if not isinstance(critic, GoalCritic):
        return "fresh"
    networks: list[nn.Module] = list(critic.q_networks)
    layer_norm = bool(_norms(networks[0]))
    alike = all(
        spec.n_critics > 0 and spec.critic_outputs == 1 and spec.critic_layer_norm == layer_norm
        for spec in specs
    )
    if _linears(networks[0])[-1].out_features < teachers.n_arms or not alike:
        return "fresh"
    actions = features.features_dim + th.arange(teachers.n_arms * teachers.action_size)
    inputs = [
        th.cat((where, own))
        for where, own in zip(columns, actions.split(teachers.action_size), strict=True)
    ]
    for index, network in enumerate(networks):
        # A student with more critics than its teacher starts some of them identically.
        sources = [
            teacher.networks.critics[index % teacher.networks.spec.n_critics]
            for teacher in teachers.teachers
        ]
        _check_hidden("critic", network, sources)
        _place(network, sources, inputs, 1)
    # LayerNorm averages over all units, those that a wider student has besides too.
    widths = {tuple(_widths(networks[0])), *(spec.critic_hidden for spec in specs)}
    return "approximate" if layer_norm and len(widths) > 1 else "exact"


@th.no_grad()
def _place(
    student: nn.Module,
    sources: Sequence[nn.Module],
    inputs: Sequence[th.Tensor],
    outputs: int,
) -> None:
    """Write the teachers' layers into the student's, block by block, and hide the neighbours.

    :param student: a network of the student.
    :param sources: each teacher's network.
    :param inputs: for each teacher, its input columns in the student.
    :param outputs: number of outputs per teacher.
    """
    columns, layers = inputs, _linears(student)
    for layer, *own in zip(layers, *map(_linears, sources), strict=True):
        last = layer is layers[-1]
        sizes = [outputs if last else one.out_features for one in own]
        rows = th.arange(sum(sizes)).split(sizes)
        for source, row, column in zip(own, rows, columns, strict=True):
            # A teacher's units read the inputs of their own arm alone.
            layer.weight[row] = 0.0
            layer.weight[row[:, None], column[None, :]] = source.weight
            layer.bias[row] = source.bias
        columns = rows
    for norm, *norms in zip(_norms(student), *map(_norms, sources), strict=True):
        for name in ("weight", "bias"):
            placed = th.cat([getattr(one, name) for one in norms])
            getattr(norm, name)[: len(placed)] = placed
    for network in student.modules():
        if isinstance(network, ArmNetwork):
            network.pool.weight.zero_()
