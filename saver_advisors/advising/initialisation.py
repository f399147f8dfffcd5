"""A student whose networks start as its teachers', arm by arm.

A block-diagonal network of n teachers' layers computes what they compute side by side: two teachers
of 3 x 128 make a student of 3 x 256. Units beyond those start as they would anyway and lead
nowhere, zeros between the blocks are there to be learned over.

What is exact, and what is not:

- the actor and the normaliser, always
- the critics, where there is a value for each arm (`per_arm_critics`) and no LayerNorm. A LayerNorm
  of the student averages over all arms' units, each teacher's over its own: there the critics start
  near their teachers', not at them
- one value of all arms is none of the teachers' (it is worth something only when every arm is
  done): such critics, and quantile critics, start afresh
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch import nn

from saver_advisors.learner.policies import GoalCritic, NormalizedGoalFeatures
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.scripted import ScriptedTeacher
from saver_advisors.policies.teacher import Teacher, TeacherGroup

NORMALISER_COUNT: Final = 1_000_000
"""Samples that the teachers' statistics count as, when the student's go on from them. About what a
teacher of 500,000 steps has seen: later samples shift the input slowly, so that the weights follow.
"""

Critics = Literal["exact", "approximate", "fresh"]


def start_as_teachers(
    model: OffPolicyAlgorithm, teachers: TeacherGroup, mapping: ArmMapping
) -> Critics:
    """Overwrite a student's normaliser, actor and, where it can be, critics; then their targets.

    :param model: a goal learner that has not learned yet
    :param teachers: one for every arm
    :param mapping: where each arm's block lies
    :return: how the critics start
    :raises TypeError: for another normaliser or other layers than the goal learners have
    :raises ValueError: where the student's layers cannot hold the teachers', or inputs or actions
        differ; the message names what would fit
    """
    policy: Any = model.policy
    features = policy.actor.features_extractor
    if not isinstance(features, NormalizedGoalFeatures):
        raise TypeError(
            f"features extractor {type(features).__name__}: only a goal learner (GoalTD3, "
            "GoalSAC, ...) has a normaliser that can start as the teachers'"
        )
    for teacher in teachers.teachers:
        _check_teacher(teacher, features, model.action_space, mapping)
    columns = [
        _feature_columns(features, teacher, arm) for arm, teacher in enumerate(teachers.teachers)
    ]
    actor = _actor_layers(policy.actor)
    blocks = [_linears(teacher.networks.actor) for teacher in teachers.teachers]
    _check_hidden("actor", actor, blocks)
    _start_normaliser(features, teachers, columns)
    _place(actor, blocks, columns, _consecutive([mapping.action_size] * mapping.n_arms))
    critics = _start_critics(policy.critic, features, teachers, mapping, columns)
    for name in ("actor", "critic"):
        if getattr(policy, f"{name}_target", None) is not None:
            getattr(policy, f"{name}_target").load_state_dict(getattr(policy, name).state_dict())
    return critics


def _actor_layers(actor: Any) -> list[nn.Linear]:
    """SAC's actor keeps its hidden layers apart from the mean `mu`, TD3's has all in it."""
    hidden = [actor.latent_pi] if hasattr(actor, "latent_pi") else []
    return _linears(*hidden, actor.mu)


def _check_teacher(
    teacher: Teacher,
    features: NormalizedGoalFeatures,
    action_space: spaces.Space[Any],
    mapping: ArmMapping,
) -> None:
    """Refuse what a goal learner's actor does not compute."""
    name = f"teacher {teacher.name!r}"
    if isinstance(teacher, ScriptedTeacher):
        raise TypeError(f"{name} is scripted, and has no weights to start from: clone it instead")
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
    """Where each of a teacher's inputs lies among the student's."""
    observation = features._observation_space["observation"]  # type: ignore[index]
    offset = {"observation": 0, "desired_goal": observation.shape[0]}
    parts = [
        offset[key] + arm * size + th.arange(size) for key, size in teacher.networks.spec.inputs
    ]
    return th.cat(parts)


def _linears(*modules: nn.Module) -> list[nn.Linear]:
    return [one for m in modules for one in m.modules() if isinstance(one, nn.Linear)]


def _norms(module: nn.Module) -> list[nn.LayerNorm]:
    return [one for one in module.modules() if isinstance(one, nn.LayerNorm)]


def _check_hidden(
    part: str, student: Sequence[nn.Linear], blocks: Sequence[Sequence[nn.Linear]]
) -> None:
    """Refuse a student whose hidden layers are too few, too many or too narrow."""
    own = [layer.out_features for layer in student[:-1]]
    each = [[layer.out_features for layer in block[:-1]] for block in blocks]
    depths = {len(widths) for widths in each}
    if len(depths) > 1:
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
    """The teachers' statistics, as if they came of `NORMALISER_COUNT` samples; an input that is no
    arm's starts without any.
    """
    deviation = th.ones_like(features.mean)
    for statistics in (features.mean, features.count, features.squared_deviation):
        statistics.zero_()
    for teacher, where in zip(teachers.teachers, columns, strict=True):
        features.mean[where] = teacher.networks.mean.double()
        deviation[where] = teacher.networks.std.double()
        features.count[where] = NORMALISER_COUNT
        features.squared_deviation[where] = deviation[where].square() * NORMALISER_COUNT
    features.shift.copy_(features.mean)
    features.scale.copy_(1.0 / deviation)


def _start_critics(
    critic: nn.Module,
    features: NormalizedGoalFeatures,
    teachers: TeacherGroup,
    mapping: ArmMapping,
    columns: Sequence[th.Tensor],
) -> Critics:
    """Critics with a value for each arm take over the teachers'."""
    specs = [teacher.networks.spec for teacher in teachers.teachers]
    if not isinstance(critic, GoalCritic):
        return "fresh"
    networks: list[nn.Module] = list(critic.q_networks)
    outputs = _linears(networks[0])[-1].out_features
    layer_norm = bool(_norms(networks[0]))
    alike = all(
        spec.n_critics > 0 and spec.critic_outputs == 1 and spec.critic_layer_norm == layer_norm
        for spec in specs
    )
    if outputs < mapping.n_arms or (mapping.n_arms > 1 and outputs == 1) or not alike:
        return "fresh"
    actions = features.features_dim + th.arange(mapping.n_arms * mapping.action_size)
    inputs = [
        th.cat((where, own))
        for where, own in zip(columns, actions.split(mapping.action_size), strict=True)
    ]
    for index, network in enumerate(networks):
        # A student with more critics than its teacher starts some of them alike.
        sources = [
            teacher.networks.critics[index % teacher.networks.spec.n_critics]
            for teacher in teachers.teachers
        ]
        linears, blocks = _linears(network), [_linears(source) for source in sources]
        _check_hidden("critic", linears, blocks)
        _place(linears, blocks, inputs, _consecutive([1] * mapping.n_arms))
        _place_norms(_norms(network), [_norms(source) for source in sources])
    return "approximate" if layer_norm and mapping.n_arms > 1 else "exact"


def _consecutive(sizes: Sequence[int]) -> list[th.Tensor]:
    return list(th.arange(sum(sizes)).split(list(sizes)))


@th.no_grad()
def _place(
    student: Sequence[nn.Linear],
    blocks: Sequence[Sequence[nn.Linear]],
    inputs: Sequence[th.Tensor],
    outputs: Sequence[th.Tensor],
) -> None:
    """Write the teachers' layers into the student's, block by block.

    :param student: its layers
    :param blocks: each teacher's layers
    :param inputs: for each teacher, its inputs among the student's
    :param outputs: for each teacher, its outputs among the student's
    """
    columns = list(inputs)
    for depth, layer in enumerate(student):
        own = [block[depth] for block in blocks]
        last = depth == len(student) - 1
        rows = list(outputs) if last else _consecutive([one.out_features for one in own])
        for source, row, column in zip(own, rows, columns, strict=True):
            # No unit of a teacher listens to anything but its own arm.
            layer.weight[row] = 0.0
            layer.weight[row[:, None], column[None, :]] = source.weight
            layer.bias[row] = source.bias
        columns = rows


@th.no_grad()
def _place_norms(student: Sequence[nn.LayerNorm], blocks: Sequence[Sequence[nn.LayerNorm]]) -> None:
    """Gains and offsets of the units that came from a teacher."""
    for depth, norm in enumerate(student):
        own = [block[depth] for block in blocks]
        rows = _consecutive([one.weight.shape[0] for one in own])
        for source, row in zip(own, rows, strict=True):
            norm.weight[row] = source.weight
            norm.bias[row] = source.bias
