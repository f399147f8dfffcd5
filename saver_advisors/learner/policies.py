"""SB3 policies for goal-conditioned tasks: normalised input, LayerNorm critics, bounded targets.

- running normalisation of observation and goal, clipped: from OpenAI baselines' HER
- target values clamped to the range of returns: from the same code; arXiv 2312.05787 finds it, with
  LayerNorm in the critics, the largest gain on sparse tasks
- a penalty on the actions in the actor's loss: from the same code; avoids saturation of tanh

All are arguments in ``policy_kwargs``, so that SB3's own ``save`` and ``load`` keep them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from sb3_contrib.tqc.policies import Critic as QuantileCritic
from sb3_contrib.tqc.policies import TQCPolicy
from stable_baselines3.common.policies import BasePolicy, ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.sac.policies import SACPolicy
from stable_baselines3.td3.policies import TD3Policy
from torch import nn

from saver_envs.validation import require

SETTLED_COUNT: Final = 1e9
"""Sample count of statistics with which networks were trained: later samples hardly change them."""


class NormalizedGoalFeatures(BaseFeaturesExtractor):
    """Concatenate observation and desired goal, normalised by running statistics.

    The achieved goal is omitted by default: the observation contains the objects' positions, and a
    network that can subtract the two goals ignores the rest. Include it if it holds more than
    positions, such as the distance of a constraint, which a network would have to compute to the
    millimetre.

    Only ``update`` changes the statistics. The buffers' names avoid "running_": SB3 averages
    buffers of that name between networks and their targets, but here all networks share one module,
    which that averaging would set to zero.

    :param observation_space: Dict with Boxes observation and desired_goal, 1-D.
    :param clip: bound on the normalised values.
    :param minimum_standard_deviation: lower bound, for coordinates that hardly vary.
    :param achieved_goal: whether the achieved goal follows the desired one.
    :raises ValueError: if a bound is not positive.
    """

    count: th.Tensor
    mean: th.Tensor
    squared_deviation: th.Tensor
    shift: th.Tensor
    scale: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Dict,
        clip: float = 5.0,
        minimum_standard_deviation: float = 0.01,
        achieved_goal: bool = False,
    ) -> None:
        least = minimum_standard_deviation
        require("clip", clip, clip > 0, "above 0")
        require("minimum_standard_deviation", least, least > 0, "above 0")
        self.keys = ("observation", "desired_goal") + ("achieved_goal",) * achieved_goal
        features_dim = sum(int(np.prod(observation_space[key].shape or ())) for key in self.keys)
        super().__init__(observation_space, features_dim)
        self.clip = clip
        self.minimum_standard_deviation = least
        # One count per feature: some may start from a teacher's statistics.
        for name in ("count", "mean", "squared_deviation"):
            self.register_buffer(name, th.zeros(features_dim, dtype=th.float64))
        self.register_buffer("shift", th.zeros(features_dim))
        self.register_buffer("scale", th.ones(features_dim))

    def forward(self, observations: Mapping[str, th.Tensor]) -> th.Tensor:
        """Normalise a batch.

        :param observations: entries (batch, dim).
        :return: (batch, features_dim), within +- ``clip``.
        """
        features = th.cat([observations[key] for key in self.keys], dim=1)
        return features.sub_(self.shift).mul_(self.scale).clamp_(-self.clip, self.clip)

    @th.no_grad()
    def update(self, observations: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add samples to the statistics (merge of Chan et al. 1979, in float64).

        :param observations: "observation" (n, observation_dim), "desired_goal" and, if it is an
            input, "achieved_goal" (n, goal_dim).
        :raises ValueError: if a value is not finite: it would corrupt the statistics permanently.
        """
        samples = th.as_tensor(
            np.concatenate([observations[key] for key in self.keys], axis=1),
            dtype=th.float64,
        )
        if not bool(th.isfinite(samples).all()):
            raise ValueError("observations given to the normaliser must be finite")
        if len(samples) == 0:
            return
        samples = samples.to(self.mean.device)
        sample_mean = samples.mean(dim=0)
        difference = sample_mean - self.mean
        total = self.count + len(samples)
        self.squared_deviation += (samples - sample_mean).square().sum(dim=0)
        self.squared_deviation += difference.square() * (self.count * len(samples) / total)
        self.mean += difference * (len(samples) / total)
        self.count.copy_(total)
        deviation = (self.squared_deviation / total).sqrt()
        self.shift.copy_(self.mean)
        self.scale.copy_(1.0 / deviation.clamp(min=self.minimum_standard_deviation))

    @th.no_grad()
    def settle(self) -> None:
        """Keep the statistics of inputs that have samples, with which the networks were trained."""
        factor = th.where(self.count > 0, SETTLED_COUNT / self.count, 1.0)
        self.count *= factor
        self.squared_deviation *= factor


@contextmanager
def _frozen(module: nn.Module) -> Iterator[None]:
    """Record no gradients for a module's parameters; those for its input are still recorded."""
    parameters = [parameter for parameter in module.parameters() if parameter.requires_grad]
    for parameter in parameters:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)


def perceptron(
    inputs: int, outputs: int, hidden: Sequence[int], activation: type[nn.Module], layer_norm: bool
) -> nn.Sequential:
    """Build hidden layers of Linear, optional LayerNorm and activation, and a final Linear.

    :param inputs: number of inputs.
    :param outputs: number of outputs.
    :param hidden: widths of the hidden layers.
    :param activation: of the hidden layers.
    :param layer_norm: whether LayerNorm precedes each activation.
    """
    norms: list[type[nn.Module]] = [nn.LayerNorm] if layer_norm else []
    layers = create_mlp(inputs, outputs, list(hidden), activation, post_linear_modules=norms)
    return nn.Sequential(*layers)


def _add_networks(
    critic: Any, n_critics: int, output_dim: int, layer_norm: bool, arguments: Mapping[str, Any]
) -> None:
    """Add unbounded value networks to a critic, with LayerNorm before each hidden activation."""
    critic.value_bounds = None
    critic.n_critics = n_critics
    input_dim = arguments["features_dim"] + int(np.prod(critic.action_space.shape or ()))
    hidden, kind = arguments["net_arch"], arguments.get("activation_fn", nn.ReLU)
    for index in range(n_critics):
        network = perceptron(input_dim, output_dim, hidden, kind, layer_norm)
        critic.add_module(f"qf{index}", network)
        critic.q_networks.append(network)


class GoalCritic(ContinuousCritic):
    """Q-values of one or more networks, optionally bounded, for DDPG, TD3 and SAC.

    The values are those of the parts of the goal, then those of costs: the negative discounted sum
    of a cost.

    :param layer_norm: whether each hidden linear layer is followed by LayerNorm.
    :param action_penalty: weight of the actions' mean square in the actor's loss (DDPG and TD3).
    :param n_values: outputs of each network, one for each part of the goal.
    :param n_costs: further outputs, one for each cost.
    :param n_critics: number of networks.
    :param arguments: as for ``ContinuousCritic``.
    """

    value_bounds: tuple[float, float] | None

    reward_columns: tuple[int, ...]
    """The column of the sampled rewards that each value is learned from."""

    def __init__(
        self,
        *,
        layer_norm: bool = True,
        action_penalty: float = 0.0,
        n_values: int = 1,
        n_costs: int = 0,
        n_critics: int = 2,
        **arguments: Any,
    ) -> None:
        super().__init__(**arguments, n_critics=0)
        self.action_penalty = action_penalty
        self.n_values = n_values
        self.n_costs = n_costs
        self.reward_columns = tuple(range(n_values + n_costs))
        if n_costs > 0:
            # Readers of the weights see which outputs are not values of the goal.
            self.register_buffer("cost_outputs", th.tensor(n_costs))
        _add_networks(self, n_critics, n_values + n_costs, layer_norm, arguments)

    def _values(
        self, obs: PyTorchObs, actions: th.Tensor, networks: list[nn.Module]
    ) -> list[th.Tensor]:
        """Evaluate networks, (batch, values) each."""
        features = self.extract_features(obs, self.features_extractor)
        joined = th.cat([features, actions], dim=1)
        return [network(joined) for network in networks]

    def forward(self, obs: PyTorchObs, actions: th.Tensor) -> tuple[th.Tensor, ...]:
        """Evaluate every network.

        :param obs: entries (batch, dim).
        :param actions: (batch, action_dim), scaled to [-1, 1].
        :return: (batch, values) for each network, within ``value_bounds`` if there are any.
        """
        values = self._values(obs, actions, self.q_networks)
        if self.value_bounds is None:
            return tuple(values)
        return tuple(value.clamp(*self.value_bounds) for value in values)

    def q1_forward(self, obs: PyTorchObs, actions: th.Tensor) -> th.Tensor:
        """Compute the actor's objective: the first network's values, the goal's minus the penalty.

        SB3 calls this only in the actor's loss. The critic takes no step there, so its gradients,
        which SB3 would compute and discard, are not recorded.

        :param obs: entries (batch, dim).
        :param actions: (batch, action_dim), scaled to [-1, 1].
        :return: (batch, values).
        """
        with _frozen(self.q_networks[0]):
            value = self._values(obs, actions, self.q_networks[:1])[0]
        penalty = self.action_penalty * actions.square().mean(dim=1, keepdim=True)
        if self.n_costs == 0:
            return value - penalty
        n_goal = sum(column < self.n_values for column in self.reward_columns)
        return th.cat((value[:, :n_goal] - penalty, value[:, n_goal:]), dim=1)


class GoalQuantileCritic(QuantileCritic):
    """Quantiles of the return, optionally bounded, for TQC.

    :param layer_norm: whether each hidden linear layer is followed by LayerNorm.
    :param n_critics: number of networks.
    :param arguments: as for ``sb3_contrib.tqc.policies.Critic``.
    """

    value_bounds: tuple[float, float] | None

    def __init__(self, *, layer_norm: bool = True, n_critics: int = 2, **arguments: Any) -> None:
        super().__init__(**arguments, n_critics=0)
        self.quantiles_total = self.n_quantiles * n_critics
        _add_networks(self, n_critics, self.n_quantiles, layer_norm, arguments)

    def forward(self, obs: PyTorchObs, action: th.Tensor) -> th.Tensor:
        """Evaluate every network.

        :param obs: entries (batch, dim).
        :param action: (batch, action_dim), scaled to [-1, 1].
        :return: (batch, n_critics, n_quantiles), within ``value_bounds`` if there are any.
        """
        quantiles = super().forward(obs, action)
        return quantiles if self.value_bounds is None else quantiles.clamp(*self.value_bounds)


def conservative_values(critic: Any, observations: Any, actions: th.Tensor) -> th.Tensor:
    """Compute the critics' conservative estimate of Q: the minimum, or the mean of TQC's quantiles.

    :param critic: a critic of this package or of SB3.
    :param observations: entries (batch, dim).
    :param actions: (batch, action_dim), scaled to [-1, 1].
    :return: (batch, values), one joint value or one per part of the goal, and those of costs.
    """
    values: Any = critic(observations, actions)
    least: th.Tensor = (
        th.stack(values).amin(dim=0)
        if isinstance(values, tuple)
        else values.mean(dim=(1, 2)).unsqueeze(1)
    )
    return least


def goal_values(critic: Any, values: th.Tensor) -> th.Tensor:
    """Return the values of the parts of the goal, without those of costs.

    :param critic: a critic of this package or of SB3.
    :param values: (batch, values), as the critic computes them.
    :return: (batch, parts): the mean where several values are of the same part.
    """
    columns = getattr(critic, "reward_columns", None)
    if columns is None or columns == tuple(range(critic.n_values)):
        return values
    return _column_means(values, columns, range(critic.n_values))


def cost_values(critic: Any, values: th.Tensor) -> th.Tensor:
    """Return the values of costs, which are negative.

    :param critic: a critic of this package.
    :param values: (batch, values), as the critic computes them.
    :return: (batch, costs): the mean where several values are of the same cost.
    """
    columns = range(critic.n_values, critic.n_values + critic.n_costs)
    return _column_means(values, critic.reward_columns, columns)


def _column_means(values: th.Tensor, columns: Sequence[int], wanted: Iterable[int]) -> th.Tensor:
    """Average the values that are learned from the same column of the rewards."""
    means = []
    for column in wanted:
        # Equal columns are neighbours.
        first = columns.index(column)
        means.append(values[:, first : first + columns.count(column)].mean(dim=1))
    return th.stack(means, dim=1)


class GoalPolicyMixin(BasePolicy):
    """Common part of the goal policies, over an SB3 actor-critic policy.

    :param observation_space: Dict of observation, achieved_goal, desired_goal.
    :param action_space: a 1-D Box.
    :param lr_schedule: SB3's learning-rate schedule.
    :param layer_norm: whether the critics have LayerNorm.
    :param q_min: lower bound of the target critics' values; None for no bounds.
    :param q_max: upper bound of the target critics' values.
    :param action_penalty: weight of the actions' mean square in the actor's loss.
    :param n_values: outputs of a critic, one for each part of the goal; for algorithms that support
        several, such as ``ImitatingTD3``.
    :param n_costs: further outputs, one for each cost; for the same algorithms.
    :param arguments: as for the SB3 policy; without ``optimizer_kwargs`` Adam is fused.
    :raises ValueError: if the bounds are reversed, the penalty is negative, or the critics do not
        support ``n_values``.
    """

    critic_class: type[GoalCritic] | type[GoalQuantileCritic] = GoalCritic
    actor: Any
    critic: Any
    critic_target: Any
    critic_kwargs: dict[str, Any]

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        layer_norm: bool = True,
        q_min: float | None = None,
        q_max: float = 0.0,
        action_penalty: float = 0.0,
        n_values: int = 1,
        n_costs: int = 0,
        **arguments: Any,
    ) -> None:
        require("n_costs", n_costs, n_costs >= 0, "0 or more")
        require("n_values", n_values, n_values >= 1, "at least 1")
        require("q_min", q_min, q_min is None or q_min < q_max, f"less than q_max={q_max}")
        require("action_penalty", action_penalty, action_penalty >= 0, "0 or more")
        if n_values + n_costs != 1 and not issubclass(self.critic_class, GoalCritic):
            raise ValueError(
                f"n_values={n_values}, n_costs={n_costs}: quantile critics give one value, so only "
                "1 and 0"
            )
        # Set first: SB3's constructor builds the networks.
        self._options: dict[str, Any] = {
            "layer_norm": layer_norm,
            "q_min": q_min,
            "q_max": q_max,
            "action_penalty": action_penalty,
            "n_values": n_values,
            "n_costs": n_costs,
        }
        arguments.setdefault("features_extractor_class", NormalizedGoalFeatures)
        if arguments.get("optimizer_kwargs") is None:
            arguments["optimizer_kwargs"] = {"fused": True}
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)  # type: ignore[misc]
        q_min, q_max = self._options["q_min"], self._options["q_max"]
        self.critic_target.value_bounds = None if q_min is None else (q_min, q_max)

    def make_features_extractor(self) -> BaseFeaturesExtractor:
        """Return one shared module for the actor, the critics and their targets."""
        if "shared_features" not in self._modules:
            self.shared_features = super().make_features_extractor()
        return self.shared_features

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Build a critic of ``critic_class``, on the shared features unless others are given."""
        arguments = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return self.critic_class(**arguments, **self._critic_arguments()).to(self.device)

    def _critic_arguments(self) -> dict[str, Any]:
        """Return the arguments of ``critic_class`` that SB3's critics do not have."""
        names = ["layer_norm"]
        if issubclass(self.critic_class, GoalCritic):
            names += ["action_penalty", "n_values", "n_costs"]
        return {name: self._options[name] for name in names}

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), **self._options}


class GoalTD3Policy(GoalPolicyMixin, TD3Policy):
    """Actor and critics of DDPG and TD3."""


class GoalSACPolicy(GoalPolicyMixin, SACPolicy):
    """Actor and critics of SAC. The bounds include the entropy bonus in the values."""


class GoalTQCPolicy(GoalPolicyMixin, TQCPolicy):
    """Actor and quantile critics of TQC. The bounds include the entropy bonus in the values."""

    critic_class = GoalQuantileCritic
