"""Extract actor, critics and normaliser from a Stable-Baselines3 model, as frozen networks.

Supports DDPG, TD3, SAC and TQC with a Dict observation and one of two features extractors: SB3's
`CombinedExtractor`, which concatenates the entries in the space's sorted order, achieved goal
included, or `NormalizedGoalFeatures` of the `learner` package.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor, nn

from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.learner.policies import NormalizedGoalFeatures
from saver_advisors.learner.shared_arms import ArmNetwork, SharedArmFeatures
from saver_advisors.policies.expanding import joint_columns, joint_layers, single_arm_layers
from saver_advisors.policies.mapping import flat_size
from saver_advisors.policies.networks import ACTIVATIONS, NetworkSpec, PolicyNetworks

Layers = Sequence[tuple[Tensor, Tensor]]
EXTRACTOR: Final = "actor.features_extractor."
NORMALISER_CLIP: Final = 5.0
"""Default of `NormalizedGoalFeatures`."""
UNTRAINED: Final = "critic.untrained"
"""Entry of a policy's state if its critics are not trained; they are omitted."""
SHARED: Final = "actor.mu.pool.weight"
"""Entry of a policy's state if arms share its networks."""


def networks_from_sb3(model: OffPolicyAlgorithm) -> PolicyNetworks:
    """Return a frozen copy of a model's deterministic policy and critics.

    :param model: a trained off-policy model.
    :return: networks on the CPU, in float32, that share no memory with the model.
    :raises TypeError: for models that cannot be represented; the message names the part and what is
        supported.
    """
    actor, critic, box = _parts(model)
    extractor = actor.features_extractor
    wrapper = _wrapper(model, extractor)
    assert isinstance(model.observation_space, spaces.Dict), "checked by _parts"
    sizes = {key: flat_size(key, space) for key, space in model.observation_space.items()}
    given = [_leaves(getattr(actor, "latent_pi", nn.Sequential()), actor.mu)]
    # TD3's last layer is the tanh; `FrozenPolicy` applies it in any case.
    given = [given[0][:-1] if isinstance(given[0][-1], nn.Tanh) else given[0]]
    trained = UNTRAINED not in model.policy.state_dict()
    given += [_leaves(network) for network in critic.q_networks if trained]
    bounds = torch.as_tensor(box.low), torch.as_tensor(box.high)
    arms = (lambda: extractor.arms) if isinstance(extractor, SharedArmFeatures) else None
    try:
        networks = networks_of_state(
            model.policy.state_dict(), sizes, bounds, _activation(given), arms
        )
    except (LookupError, RuntimeError, ValueError) as error:
        raise TypeError(
            f"the layers of {type(model).__name__} cannot be frozen: {error}"
        ) from error
    own = [list(network.children()) for network in (networks.actor, *networks.critics)]
    # Those of shared networks are rearranged.
    for built, layers in zip(own, given, strict=True) if arms is None else ():
        if [_kind(layer) for layer in built] != [_kind(layer) for layer in layers]:
            raise TypeError(
                f"the layers {layers} cannot be frozen: use Linear, LayerNorm (optional) and "
                "activation for each hidden layer, then Linear"
            )
    if isinstance(extractor, NormalizedGoalFeatures):
        networks.clip.fill_(extractor.clip)
    elif wrapper is not None:
        _copy_statistics(wrapper, networks)
    return networks


def networks_of_state(
    state: Mapping[str, Tensor],
    sizes: Mapping[str, int],
    bounds: tuple[Tensor, Tensor],
    activation: str,
    arms: Callable[[], ArmBlocks] | None,
) -> PolicyNetworks:
    """Build frozen networks from the tensors of a policy of SB3 or of a goal learner.

    The critics of several arms with shared weights are omitted: their LayerNorm is one for each
    arm, which a perceptron of all arms cannot represent.

    :param state: of the policy.
    :param sizes: of the observation's entries.
    :param bounds: least and greatest action.
    :param activation: a key of `ACTIVATIONS`.
    :param arms: gives the arms, for networks that they share.
    :return: networks on the CPU, in float32, that share no memory with the tensors; a goal
        learner's clip is the default.
    :raises LookupError: for tensors that are missing.
    :raises ValueError: for sizes out of range, or networks that cannot be represented.
    :raises RuntimeError: for weights that do not fit together.
    """
    found = {int(match[1]) for name in state if (match := _CRITIC.match(name))}
    numbers = sorted(found) if UNTRAINED not in state else []
    if SHARED in state:
        if arms is None or activation != "relu":
            known = "the arms are not described" if arms is None else f"{activation}, not relu"
            raise ValueError(f"arms share the networks: {known}")
        blocks, normaliser = arms(), _statistics(state)
        keys = _goal_keys(blocks.sizes_of_arm(), normaliser[0])
        columns, sizes = joint_columns(blocks, keys), blocks.sizes()
        normaliser = tuple(values[columns] for values in normaliser)
        actor = joint_layers(_part(state, "actor.mu"), blocks, keys)
        alone = numbers if blocks.n_arms == 1 else []
        critics = [single_arm_layers(_part(state, f"critic.qf{one}"), outputs=1) for one in alone]
    else:
        actor = _layers(state, "actor.mu")
        if not actor:  # SAC and TQC keep the last layer apart
            last = state["actor.mu.weight"], state["actor.mu.bias"]
            actor = [*_layers(state, "actor.latent_pi"), last]
        critics = [_layers(state, f"critic.qf{one}") for one in numbers]
        for layers in critics:
            # The values of costs are the last outputs.
            weight, bias = layers[-1]
            end = len(bias) - int(state.get("critic.cost_outputs", 0))
            layers[-1] = weight[:end], bias[:end]
        # SB3 reads the entries in sorted order, the goal learners in their own.
        keys, read = tuple(sorted(sizes)), actor[0][0].shape[-1]
        normaliser = torch.zeros(read), torch.ones(read), torch.full((read,), math.inf)
        if f"{EXTRACTOR}shift" in state:
            normaliser = _statistics(state)
            keys = _goal_keys(sizes, normaliser[0])
    inputs = tuple((key, sizes[key]) for key in keys)
    return _frozen_networks(actor, critics, inputs, (*normaliser, *bounds), activation)


_CRITIC: Final = re.compile(r"critic\.qf(\d+)\.")


def _frozen_networks(
    actor: Layers,
    critics: Sequence[Layers],
    inputs: tuple[tuple[str, int], ...],
    scales: tuple[Tensor, ...],
    activation: str,
) -> PolicyNetworks:
    """Build frozen networks, whose shapes follow from the weights.

    :param actor: weight and bias of each layer; those of a LayerNorm have one dimension.
    :param critics: the same for each critic; none for a policy without.
    :param inputs: names and sizes of the inputs, in order.
    :param scales: mean, standard deviation and clip of each input, least and greatest action.
    :param activation: a key of `ACTIVATIONS`.
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
    tensors = dict(zip(parts, scales, strict=True))
    for prefix, layers in (("actor", actor), *((f"critics.{k}", c) for k, c in enumerate(critics))):
        names = [name for name in networks.state_dict() if name.startswith(f"{prefix}.")]
        tensors |= zip(names, (one for layer in layers for one in layer), strict=True)
    copies = {name: one.detach().cpu().float().clone() for name, one in tensors.items()}
    networks.load_state_dict(copies, assign=True)
    return networks.requires_grad_(False)


def _goal_keys(sizes: Mapping[str, int], mean: Tensor) -> tuple[str, ...]:
    """Return the entries that a goal learner with these statistics reads, in order."""
    keys = ("observation", "desired_goal", "achieved_goal")
    return keys[:2] if sum(sizes.get(key, 0) for key in keys[:2]) == len(mean) else keys


def _statistics(state: Mapping[str, Tensor]) -> tuple[Tensor, ...]:
    """Return mean, standard deviation and clip of a goal learner's inputs."""
    mean = state[f"{EXTRACTOR}shift"]
    return mean, 1.0 / state[f"{EXTRACTOR}scale"], torch.full_like(mean, NORMALISER_CLIP)


def _part(state: Mapping[str, Tensor], name: str) -> dict[str, Tensor]:
    """Return the entries of one network."""
    prefix = f"{name}."
    return {k.removeprefix(prefix): one for k, one in state.items() if k.startswith(prefix)}


def _layers(state: Mapping[str, Tensor], prefix: str) -> list[tuple[Tensor, Tensor]]:
    """Return weight and bias of each layer of a sequence, in order."""
    pattern = re.compile(re.escape(prefix) + r"\.(\d+)\.weight")
    numbers = sorted(int(found[1]) for name in state if (found := pattern.fullmatch(name)))
    return [(state[f"{prefix}.{one}.weight"], state[f"{prefix}.{one}.bias"]) for one in numbers]


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
    flat_size("action", model.action_space)
    if getattr(actor, "use_sde", False):
        raise TypeError(
            "policies trained with gSDE (use_sde=True) cannot be frozen: train with use_sde=False"
        )
    assert isinstance(model.action_space, spaces.Box), "it is flat"
    return actor, critic, model.action_space


def _leaves(*modules: nn.Module) -> list[nn.Module]:
    """Return the layers of modules, those of nested ones too."""
    every = [one for module in modules for one in module.modules()]
    return [one for one in every if not isinstance(one, (nn.Sequential, ArmNetwork))]


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


def _wrapper(model: OffPolicyAlgorithm, extractor: nn.Module) -> VecNormalize | None:
    """Return the wrapper that normalises the observations, and check the features extractor."""
    wrapper = model.get_vec_normalize_env()
    wrapper = wrapper if wrapper is not None and wrapper.norm_obs else None
    if isinstance(extractor, NormalizedGoalFeatures):
        if wrapper is not None:
            raise TypeError(
                "the model normalises twice (features extractor and VecNormalize): drop one"
            )
        critic: Any = model.policy.critic
        for name in ("shift", "scale"):
            if not torch.equal(getattr(extractor, name), getattr(critic.features_extractor, name)):
                raise TypeError(
                    f"actor and critic normalise with different {name}: share the extractor"
                )
    elif type(extractor) is not CombinedExtractor:
        raise TypeError(
            f"the features extractor {type(extractor).__name__} cannot be frozen: use SB3's "
            "CombinedExtractor or saver_advisors.learner.NormalizedGoalFeatures"
        )
    return wrapper


def _copy_statistics(wrapper: VecNormalize, networks: PolicyNetworks) -> None:
    """Copy VecNormalize's statistics, so that the frozen policy takes raw observations."""
    start = 0
    for key, size in networks.spec.inputs:
        own, start = slice(start, start + size), start + size
        if key in (wrapper.norm_obs_keys or ()):
            statistics = wrapper.obs_rms[key]
            networks.mean[own] = torch.as_tensor(statistics.mean)
            networks.std[own] = torch.as_tensor(np.sqrt(statistics.var + wrapper.epsilon))
            networks.clip[own] = wrapper.clip_obs
