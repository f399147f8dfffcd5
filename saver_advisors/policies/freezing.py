"""Reads actor, critics and normaliser out of a Stable-Baselines3 model, as frozen networks of our
own.

Works for DDPG, TD3, SAC and TQC with a Dict observation, with SB3's `CombinedExtractor` (which
concatenates the entries in the space's own, sorted, order, achieved goal included) and with the
learner room's `NormalizedGoalFeatures`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor, nn

from saver_advisors.learner.policies import NormalizedGoalFeatures
from saver_advisors.policies.networks import ACTIVATIONS, NetworkSpec, PolicyNetworks

_LAYER_NORM_EPS: Final = 1e-5
"""torch's default, which `PolicyNetworks` uses: weights trained with another one would compute
something else.
"""


@dataclass(frozen=True)
class _Stack:
    """An MLP taken apart."""

    linears: list[nn.Linear]
    norms: list[nn.LayerNorm]
    activation: str | None

    @property
    def hidden(self) -> tuple[int, ...]:
        return tuple(layer.out_features for layer in self.linears[:-1])

    @property
    def layer_norm(self) -> bool:
        return bool(self.norms)


@dataclass(frozen=True)
class _Features:
    """Inputs in their order, and what normalises them."""

    inputs: tuple[tuple[str, int], ...]
    mean: Tensor
    std: Tensor
    clip: Tensor


def networks_from_sb3(model: OffPolicyAlgorithm) -> PolicyNetworks:
    """A frozen copy of a model's deterministic policy and critics.

    :param model: a trained off-policy model
    :return: networks on the CPU, in float32, that share no memory with the model
    :raises TypeError: for models whose parts cannot be represented; the message says which part and
        what works
    """
    actor, critic, action_space = _parts(model)
    features = _read_features(model, actor)
    actor_stack = _take_apart(_actor_layers(actor), "actor")
    critic_stacks = [_take_apart(layers, "critic") for layers in critic.q_networks]
    first = critic_stacks[0]
    activation = _common_activation([actor_stack, *critic_stacks])
    spec = NetworkSpec(
        inputs=features.inputs,
        action_size=int(action_space.shape[0]),
        actor_hidden=actor_stack.hidden,
        critic_hidden=first.hidden,
        n_critics=len(critic_stacks),
        critic_outputs=first.linears[-1].out_features,
        activation=activation,
        actor_layer_norm=actor_stack.layer_norm,
        critic_layer_norm=first.layer_norm,
    )
    networks = PolicyNetworks(spec)
    with torch.no_grad():
        for name in ("mean", "std", "clip"):
            getattr(networks, name).copy_(getattr(features, name))
        networks.action_low.copy_(torch.as_tensor(action_space.low))
        networks.action_high.copy_(torch.as_tensor(action_space.high))
    _copy(networks.actor, actor_stack)
    for target, stack in zip(networks.critics, critic_stacks, strict=True):
        _copy(target, stack)
    return networks


def _parts(model: OffPolicyAlgorithm) -> tuple[Any, Any, spaces.Box]:
    """:return: actor, critic and action space of a model that can be frozen"""
    policy = getattr(model, "policy", None)
    actor, critic = getattr(policy, "actor", None), getattr(policy, "critic", None)
    if actor is None or critic is None or not hasattr(critic, "q_networks"):
        raise TypeError(
            f"{type(model).__name__} has no deterministic actor with Q critics to freeze: use "
            f"DDPG, TD3, SAC or TQC"
        )
    if not isinstance(model.observation_space, spaces.Dict):
        raise TypeError("only policies of goal environments (Dict observation) can be frozen")
    if not isinstance(model.action_space, spaces.Box) or len(model.action_space.shape) != 1:
        raise TypeError(f"only flat Box actions can be frozen, not {model.action_space}")
    if getattr(actor, "use_sde", False):
        raise TypeError(
            "policies trained with gSDE (use_sde=True) cannot be frozen: train with use_sde=False"
        )
    return actor, critic, model.action_space


def _actor_layers(actor: Any) -> list[nn.Module]:
    """TD3-like actors keep it all in `mu`, SAC-like ones split it into `latent_pi` and the mean
    `mu`.
    """
    latent = list(_flatten([actor.latent_pi])) if hasattr(actor, "latent_pi") else []
    layers = [*latent, *_flatten([actor.mu])]
    # Where the tanh is a layer (TD3) it is dropped here; PolicyNetworks squashes in any case.
    return layers[:-1] if isinstance(layers[-1], nn.Tanh) else layers


def _flatten(modules: Iterable[nn.Module]) -> Iterable[nn.Module]:
    for module in modules:
        if isinstance(module, nn.Sequential):
            yield from _flatten(module)
        else:
            yield module


def _take_apart(layers: Iterable[nn.Module], part: str) -> _Stack:
    """:raises TypeError: on anything but Linear, LayerNorm and known activations in their usual
    order
    """
    linears: list[nn.Linear] = []
    norms: list[nn.LayerNorm] = []
    activations: list[str] = []
    names = {kind: name for name, kind in ACTIVATIONS.items()}
    for layer in _flatten(layers):
        if (
            isinstance(layer, nn.Linear)
            and layer.bias is not None
            and len(activations) == len(linears)
        ):
            linears.append(layer)
        elif (
            isinstance(layer, nn.LayerNorm)
            and len(linears) == len(norms) + 1 == len(activations) + 1
        ):
            norms.append(layer)
        elif type(layer) in names and len(linears) == len(activations) + 1:
            activations.append(names[type(layer)])
        else:
            raise TypeError(
                f"the {part}'s layer {layer} cannot be frozen: use Linear, LayerNorm, activation, "
                f"..."
            )
    wrong_norms = norms and (
        len(norms) != len(linears) - 1 or any(n.eps != _LAYER_NORM_EPS for n in norms)
    )
    if (
        not linears
        or len(activations) != len(linears) - 1
        or len(set(activations)) > 1
        or wrong_norms
    ):
        raise TypeError(
            f"the {part} cannot be frozen: its hidden layers must all be built alike, and end in a "
            f"Linear"
        )
    return _Stack(linears, norms, activations[0] if activations else None)


def _common_activation(stacks: list[_Stack]) -> str:
    used = {stack.activation for stack in stacks if stack.activation is not None}
    if len(used) > 1:
        raise TypeError(
            f"actor and critics use different activations {sorted(used)}: only one can be frozen"
        )
    return used.pop() if used else "relu"


def _copy(target: nn.Module, source: _Stack) -> None:
    """Copy weights layer by layer; the shapes agree by construction."""
    linears = [layer for layer in target.modules() if isinstance(layer, nn.Linear)]
    norms = [layer for layer in target.modules() if isinstance(layer, nn.LayerNorm)]
    for new, old in zip([*linears, *norms], [*source.linears, *source.norms], strict=True):
        new.load_state_dict(
            {name: value.detach().cpu().float() for name, value in old.state_dict().items()}
        )


def _read_features(model: OffPolicyAlgorithm, actor: Any) -> _Features:
    observation_space = model.observation_space
    assert isinstance(observation_space, spaces.Dict)
    extractor = actor.features_extractor
    if isinstance(extractor, NormalizedGoalFeatures):
        inputs = _inputs(observation_space, extractor.keys)
        return _Features(inputs, *_extractor_normaliser(model, extractor))
    if type(extractor) is CombinedExtractor:
        inputs = _inputs(observation_space, extractor.extractors)
        return _Features(inputs, *_vec_normalize_normaliser(model, inputs))
    raise TypeError(
        f"the features extractor {type(extractor).__name__} cannot be frozen: use SB3's "
        "CombinedExtractor or the learner room's NormalizedGoalFeatures"
    )


def _inputs(space: spaces.Dict, keys: Iterable[str]) -> tuple[tuple[str, int], ...]:
    return tuple((key, _flat_size(space, key)) for key in keys)


def _flat_size(space: spaces.Dict, key: str) -> int:
    box = space.spaces.get(key)
    if not isinstance(box, spaces.Box) or len(box.shape) != 1:
        raise TypeError(f"the observation's {key!r} is {box}: only flat Boxes can be frozen")
    return int(box.shape[0])


def _extractor_normaliser(
    model: OffPolicyAlgorithm, extractor: NormalizedGoalFeatures
) -> tuple[Tensor, Tensor, Tensor]:
    """The extractor's statistics; a critic with others would see another world than the actor."""
    critic: Any = model.policy.critic
    other = critic.features_extractor
    for name in ("shift", "scale"):
        if not torch.equal(getattr(extractor, name), getattr(other, name)):
            raise TypeError(
                f"actor and critic normalise with different {name}: share the extractor"
            )
    if _vec_normalize(model) is not None:
        raise TypeError(
            "the model normalises twice (features extractor and VecNormalize): drop one"
        )
    mean, scale = extractor.shift.detach().cpu(), extractor.scale.detach().cpu()
    return mean, 1.0 / scale, torch.full_like(mean, extractor.clip)


def _vec_normalize(model: OffPolicyAlgorithm) -> VecNormalize | None:
    wrapper = model.get_vec_normalize_env()
    return wrapper if wrapper is not None and wrapper.norm_obs else None


def _vec_normalize_normaliser(
    model: OffPolicyAlgorithm, inputs: tuple[tuple[str, int], ...]
) -> tuple[Tensor, Tensor, Tensor]:
    """Fold VecNormalize's statistics in, so that the frozen policy takes raw observations."""
    wrapper = _vec_normalize(model)
    means, stds, clips = [], [], []
    for key, size in inputs:
        if wrapper is not None and key in (wrapper.norm_obs_keys or ()):
            statistics = wrapper.obs_rms[key]
            means.append(torch.as_tensor(statistics.mean))
            stds.append(torch.as_tensor(np.sqrt(statistics.var + wrapper.epsilon)))
            clips.append(torch.full((size,), wrapper.clip_obs))
        else:
            means.append(torch.zeros(size))
            stds.append(torch.ones(size))
            clips.append(torch.full((size,), math.inf))
    return torch.cat(means).float(), torch.cat(stds).float(), torch.cat(clips).float()
