"""Frozen policy networks: the weights of teachers and shipped policies.

A policy consists of a concatenation of observation entries, a fixed normaliser, an actor and
optionally critics. `NetworkSpec` describes them; `PolicyNetworks` is the module, whose `state_dict`
is the content of a weight file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor, nn

from saver_advisors.learner.arms import GOAL_KEYS
from saver_advisors.learner.policies import perceptron
from saver_envs.validation import require, require_kind

ACTIVATIONS: Final[Mapping[str, type[nn.Module]]] = {
    "relu": nn.ReLU,
    "tanh": nn.Tanh,
    "elu": nn.ELU,
    "silu": nn.SiLU,
    "gelu": nn.GELU,
    "leaky_relu": nn.LeakyReLU,
}
"""The activations that a weight file may name; each with torch's default parameters."""

MAX_WIDTH: Final = 65_536
MAX_DEPTH: Final = 64
"""Bounds on the sizes in a weight file: a third-party header must not allocate gigabytes."""


@dataclass(frozen=True)
class NetworkSpec:
    """Shapes and activations of networks, and the order of their inputs.

    :param inputs: observation entries with their sizes, in the order in which the network reads
        them.
    :param action_size: size of an action.
    :param actor_hidden: widths of the actor's hidden layers.
    :param critic_hidden: widths of each critic's hidden layers.
    :param n_critics: number of critics; 0 if the policy has none.
    :param critic_outputs: outputs of a critic, whose mean is the value: 1, one per part of the
        goal, or the quantiles of TQC.
    :param activation: a key of `ACTIVATIONS`.
    :param actor_layer_norm: whether LayerNorm precedes each hidden activation of the actor.
    :param critic_layer_norm: the same for the critics.
    :raises ValueError: if a size, a name or a width is out of range.
    """

    inputs: tuple[tuple[str, int], ...]
    action_size: int
    actor_hidden: tuple[int, ...]
    critic_hidden: tuple[int, ...] = ()
    n_critics: int = 0
    critic_outputs: int = 1
    activation: str = "relu"
    actor_layer_norm: bool = False
    critic_layer_norm: bool = False

    def __post_init__(self) -> None:
        _check_inputs(self.inputs)
        known = self.activation in ACTIVATIONS
        require("activation", self.activation, known, f"one of {sorted(ACTIVATIONS)}")
        for name in ("actor_hidden", "critic_hidden"):
            widths = getattr(self, name)
            require(
                f"layers of {name}", len(widths), len(widths) <= MAX_DEPTH, f"up to {MAX_DEPTH}"
            )
            for width in widths:
                _check_size(name, width)
        _check_size("action_size", self.action_size)
        _check_size("critic_outputs", self.critic_outputs)
        possible = type(self.n_critics) is int and 0 <= self.n_critics <= MAX_DEPTH
        require("n_critics", self.n_critics, possible, f"from 0 to {MAX_DEPTH}")
        for name in ("actor_layer_norm", "critic_layer_norm"):
            require_kind(name, getattr(self, name), bool)

    @property
    def feature_size(self) -> int:
        """The sum of the input sizes."""
        return sum(size for _, size in self.inputs)

    @property
    def sizes(self) -> dict[str, int]:
        """Input sizes by observation entry."""
        return dict(self.inputs)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> NetworkSpec:
        """Create a description from the fields as JSON holds them.

        :param values: by name.
        :raises ValueError: for missing, surplus or ill-typed entries.
        """
        try:
            fields = dict(values)
            fields["inputs"] = tuple((key, size) for key, size in fields["inputs"])
            for name in ("actor_hidden", "critic_hidden"):
                fields[name] = tuple(fields[name])
            return cls(**fields)
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a network description: {error}") from error


def _check_size(name: str, value: object) -> None:
    if type(value) is not int or not 1 <= value <= MAX_WIDTH:
        raise ValueError(f"{name} holds {value!r}: sizes are whole numbers from 1 to {MAX_WIDTH}")


def _check_inputs(inputs: tuple[tuple[str, int], ...]) -> None:
    keys = [key for key, _ in inputs]
    if not keys or len(set(keys)) != len(keys) or not set(keys) <= set(GOAL_KEYS):
        raise ValueError(
            f"inputs are {keys}: they must be one or more of {list(GOAL_KEYS)}, each once"
        )
    for key, size in inputs:
        _check_size(f"inputs[{key!r}]", size)


class PolicyNetworks(nn.Module):
    """Normaliser, actor and critics with frozen weights, in float32 on the CPU.

    Their `state_dict` is the content of a weight file; `FrozenPolicy` runs the forward pass.

    Actions of the networks lie in [-1, 1]; `action_low` and `action_high` are the box of the
    environment in which the policy was trained, in that environment's units.

    :param spec: the shapes; the weights start random, for `load_state_dict` to overwrite.
    """

    mean: Tensor
    std: Tensor
    clip: Tensor
    action_low: Tensor
    action_high: Tensor

    def __init__(self, spec: NetworkSpec) -> None:
        super().__init__()
        self.spec = spec
        size = spec.feature_size
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))
        # Per feature: VecNormalize may clip some entries and not others.
        self.register_buffer("clip", torch.full((size,), math.inf))
        self.register_buffer("action_low", -torch.ones(spec.action_size))
        self.register_buffer("action_high", torch.ones(spec.action_size))
        kind, joined = ACTIVATIONS[spec.activation], size + spec.action_size
        actor = size, spec.action_size, spec.actor_hidden, kind, spec.actor_layer_norm
        critic = joined, spec.critic_outputs, spec.critic_hidden, kind, spec.critic_layer_norm
        self.actor = perceptron(*actor)
        self.critics = nn.ModuleList(perceptron(*critic) for _ in range(spec.n_critics))
        self.requires_grad_(False)
        self.eval()
