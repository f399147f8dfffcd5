"""Extract actor, critics and normaliser from a Stable-Baselines3 model, as frozen networks.

Supports DDPG, TD3, SAC and TQC with a Dict observation and one of two features extractors: SB3's
`CombinedExtractor`, which concatenates the entries in the space's sorted order, achieved goal
included, or `NormalizedGoalFeatures` of the `learner` package.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor, nn

from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.learner.policies import NormalizedGoalFeatures
from saver_advisors.learner.shared_arms import SharedArmFeatures
from saver_advisors.policies.expanding import joint_columns, joint_layers, single_arm_layers
from saver_advisors.policies.networks import ACTIVATIONS, NetworkSpec, PolicyNetworks

Layers = Sequence[tuple[Tensor, Tensor]]


def networks_from_sb3(model: OffPolicyAlgorithm) -> PolicyNetworks:
    """Return a frozen copy of a model's deterministic policy and critics.

    :param model: a trained off-policy model.
    :return: networks on the CPU, in float32, that share no memory with the model.
    :raises TypeError: for models that cannot be represented; the message names the part and what is
        supported.
    """
    actor, critic, action_space = _parts(model)
    if isinstance(actor.features_extractor, SharedArmFeatures):
        return _shared_networks(actor, critic, action_space)
    inputs, normaliser = _normaliser(model, actor.features_extractor)
    layers = actor_layers(actor)
    critics = [list(_flatten([network])) for network in critic.q_networks]
    try:
        networks = build_frozen(
            _tensors(layers),
            [without_costs(_tensors(one), getattr(critic, "n_costs", 0)) for one in critics],
            inputs,
            normaliser,
            (torch.as_tensor(action_space.low), torch.as_tensor(action_space.high)),
            _activation([layers, *critics]),
        )
    except (RuntimeError, ValueError) as error:
        raise TypeError(
            f"the layers of {type(model).__name__} cannot be frozen: {error}"
        ) from error
    own = [list(network.children()) for network in (networks.actor, *networks.critics)]
    for built, given in zip(own, [layers, *critics], strict=True):
        if [_kind(layer) for layer in built] != [_kind(layer) for layer in given]:
            raise TypeError(
                f"the layers {given} cannot be frozen: use Linear, LayerNorm (optional) and "
                "activation for each hidden layer, then Linear"
            )
    return networks


def build_frozen(
    actor: Layers,
    critics: Sequence[Layers],
    inputs: tuple[tuple[str, int], ...],
    normaliser: tuple[Tensor, Tensor, Tensor],
    bounds: tuple[Tensor, Tensor],
    activation: str,
) -> PolicyNetworks:
    """Build frozen networks, whose shapes follow from the weights.

    :param actor: weight and bias of each layer; those of a LayerNorm have one dimension.
    :param critics: the same for each critic; none for a policy without.
    :param inputs: names and sizes of the inputs, in order.
    :param normaliser: mean, standard deviation and clip of each input.
    :param bounds: least and greatest action.
    :param activation: a key of `ACTIVATIONS`.
    :return: networks on the CPU, in float32, that share no memory with the weights.
    :raises ValueError: for sizes out of range.
    :raises RuntimeError: for weights that do not fit together.
    """
    spec = NetworkSpec(
        inputs=inputs,
        action_size=len(actor[-1][1]),
        actor_hidden=_widths(actor)[:-1],
        critic_hidden=_widths(critics[0])[:-1] if critics else (),
        n_critics=len(critics),
        critic_outputs=len(critics[0][-1][1]) if critics else 1,
        activation=activation,
        actor_layer_norm=any(weight.dim() == 1 for weight, _ in actor),
        critic_layer_norm=any(weight.dim() == 1 for one in critics[:1] for weight, _ in one),
    )
    with torch.device("meta"):  # nothing is allocated before all shapes have been compared
        networks = PolicyNetworks(spec)
    parts = ("mean", "std", "clip", "action_low", "action_high")
    tensors = dict(zip(parts, (*normaliser, *bounds), strict=True))
    for prefix, layers in (("actor", actor), *((f"critics.{k}", c) for k, c in enumerate(critics))):
        names = [name for name in networks.state_dict() if name.startswith(f"{prefix}.")]
        tensors |= zip(names, (one for layer in layers for one in layer), strict=True)
    copies = {name: one.detach().cpu().float().clone() for name, one in tensors.items()}
    networks.load_state_dict(copies, assign=True)
    return networks.requires_grad_(False)


def without_costs(layers: Layers, n_costs: int) -> Layers:
    """Return a critic's layers without the values of costs, which are its last outputs.

    :param layers: weight and bias of each.
    :param n_costs: number of costs.
    """
    weight, bias = layers[-1]
    end = len(bias) - n_costs
    return [*layers[:-1], (weight[:end], bias[:end])]


def _shared_networks(actor: Any, critic: Any, action_space: spaces.Box) -> PolicyNetworks:
    """Return a frozen copy of networks that arms share."""
    features = actor.features_extractor
    if actor.activation_fn is not nn.ReLU:
        raise TypeError(
            f"shared arms with {actor.activation_fn.__name__} cannot be frozen: use relu layers"
        )
    return build_shared(
        actor.mu.state_dict(),
        [network.state_dict() for network in critic.q_networks],
        features.arms,
        features.keys,
        (features.shift, 1.0 / features.scale, torch.full_like(features.shift, features.clip)),
        (torch.as_tensor(action_space.low), torch.as_tensor(action_space.high)),
    )


def build_shared(
    actor: Mapping[str, Tensor],
    critics: Sequence[Mapping[str, Tensor]],
    arms: ArmBlocks,
    keys: tuple[str, ...],
    normaliser: tuple[Tensor, Tensor, Tensor],
    bounds: tuple[Tensor, Tensor],
) -> PolicyNetworks:
    """Build frozen networks of all arms from networks that the arms share.

    The critics of several arms are omitted: their LayerNorm is one for each arm, which a
    perceptron of all arms cannot represent.

    :param actor: state of an `ArmNetwork`.
    :param critics: the same for each critic.
    :param arms: the arms.
    :param keys: observation entries that an arm's network reads, in order.
    :param normaliser: mean, standard deviation and clip of each input of one arm.
    :param bounds: least and greatest action of all arms.
    :return: as `build_frozen`.
    """
    sizes = arms.sizes()
    columns = joint_columns(arms, keys)
    mean, std, clip = (values[columns] for values in normaliser)
    own = [single_arm_layers(one, outputs=1) for one in critics] if arms.n_arms == 1 else []
    inputs = tuple((key, sizes[key]) for key in keys)
    layers = joint_layers(actor, arms, keys)
    return build_frozen(layers, own, inputs, (mean, std, clip), bounds, "relu")


def _parts(model: OffPolicyAlgorithm) -> tuple[Any, Any, spaces.Box]:
    """Return actor, critic and action space of a model that can be frozen."""
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


def actor_layers(actor: Any) -> list[nn.Module]:
    """Return the layers of SB3's actor without a final tanh.

    :param actor: TD3's, which has all layers in `mu`, or SAC's, which has the hidden ones in
        `latent_pi`.
    """
    layers = list(_flatten([getattr(actor, "latent_pi", nn.Sequential()), actor.mu]))
    # TD3's last layer is the tanh; `FrozenPolicy` applies it in any case.
    return layers[:-1] if isinstance(layers[-1], nn.Tanh) else layers


def _flatten(modules: Iterable[nn.Module]) -> Iterator[nn.Module]:
    for module in modules:
        if isinstance(module, nn.Sequential):
            yield from _flatten(module)
        else:
            yield module


def _tensors(layers: list[nn.Module]) -> Layers:
    return [(layer.weight, layer.bias) for layer in layers if hasattr(layer, "weight")]  # type: ignore[misc]


def _widths(layers: Layers) -> tuple[int, ...]:
    return tuple(len(bias) for weight, bias in layers if weight.dim() == 2)


def _activation(networks: list[list[nn.Module]]) -> str:
    """Return the name of the only activation of all networks."""
    kinds = {type(layer) for layers in networks for layer in layers}
    names = {kind: name for name, kind in ACTIVATIONS.items()}
    used = [names.get(kind, kind.__name__) for kind in kinds - {nn.Linear, nn.LayerNorm}]
    if len(used) > 1 or not set(used) <= set(ACTIVATIONS):
        raise TypeError(
            f"actor and critics with layers {sorted(used)} cannot be frozen: apart from Linear and "
            f"LayerNorm, all hidden layers must have one activation of {', '.join(ACTIVATIONS)}"
        )
    return used[0] if used else "relu"


def _kind(layer: nn.Module) -> tuple[Any, ...]:
    """Return what two layers must have in common to compute the same from equal weights."""
    return type(layer), getattr(layer, "eps", None)


def _normaliser(
    model: OffPolicyAlgorithm, extractor: nn.Module
) -> tuple[tuple[tuple[str, int], ...], tuple[Tensor, Tensor, Tensor]]:
    """Return the inputs in their order, with sizes, and their mean, standard deviation and clip."""
    wrapper = model.get_vec_normalize_env()
    wrapper = wrapper if wrapper is not None and wrapper.norm_obs else None
    if isinstance(extractor, NormalizedGoalFeatures):
        if wrapper is not None:
            raise TypeError(
                "the model normalises twice (features extractor and VecNormalize): drop one"
            )
        inputs = tuple((key, _flat_size(model, key)) for key in extractor.keys)
        return inputs, _extractor_statistics(model, extractor)
    if type(extractor) is CombinedExtractor:
        inputs = tuple((key, _flat_size(model, key)) for key in extractor.extractors)
        return inputs, _wrapper_statistics(wrapper, inputs)
    raise TypeError(
        f"the features extractor {type(extractor).__name__} cannot be frozen: use SB3's "
        "CombinedExtractor or saver_advisors.learner.NormalizedGoalFeatures"
    )


def _flat_size(model: OffPolicyAlgorithm, key: str) -> int:
    assert isinstance(model.observation_space, spaces.Dict), "checked by _parts"
    box = model.observation_space.spaces.get(key)
    if not isinstance(box, spaces.Box) or len(box.shape) != 1:
        raise TypeError(f"the observation's {key!r} is {box}: only flat Boxes can be frozen")
    return int(box.shape[0])


def _extractor_statistics(
    model: OffPolicyAlgorithm, extractor: NormalizedGoalFeatures
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the statistics that actor and critic share."""
    critic: Any = model.policy.critic
    for name in ("shift", "scale"):
        if not torch.equal(getattr(extractor, name), getattr(critic.features_extractor, name)):
            raise TypeError(
                f"actor and critic normalise with different {name}: share the extractor"
            )
    mean = extractor.shift.cpu()
    return mean, 1.0 / extractor.scale.cpu(), torch.full_like(mean, extractor.clip)


def _wrapper_statistics(
    wrapper: VecNormalize | None, inputs: tuple[tuple[str, int], ...]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return VecNormalize's statistics, so that the frozen policy takes raw observations."""
    parts = []
    for key, size in inputs:
        if wrapper is not None and key in (wrapper.norm_obs_keys or ()):
            statistics = wrapper.obs_rms[key]
            std = np.sqrt(statistics.var + wrapper.epsilon)
            parts.append((statistics.mean, std, np.full(size, wrapper.clip_obs)))
        else:
            parts.append((np.zeros(size), np.ones(size), np.full(size, math.inf)))
    values = [torch.as_tensor(np.concatenate(each)).float() for each in zip(*parts, strict=True)]
    return values[0], values[1], values[2]
