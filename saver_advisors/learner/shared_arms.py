"""One actor and one set of critics for every arm: each arm of an episode is a sample of them.

A network sees its own arm's observation and goal, and a sum over the other arms of an encoding of
own arm, other arm, and where the other's base stands. The sum makes it independent of the order and
the number of the others (Zaheer et al., Deep Sets, arXiv 1703.06114): the same weights control one
arm to four. With `pool` at zero it is the network of a single arm.

An n-arm transition is n samples, so a network of half the width learns from twice as many. The
critics see the other arms' states, but not their actions: each arm regards the others as a part of
its environment (independent learners, Tan 1993).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.td3.policies import Actor
from torch import nn
from torch.nn import functional

from saver_advisors.learner.arms import POSE_SIZE, ArmBlocks
from saver_advisors.learner.policies import GoalCritic, GoalTD3Policy, NormalizedGoalFeatures

EPISODE_GOAL = "episode_goal"
"""Entry of a sampled observation: the goal before relabelling, as the neighbours see it."""

ENCODING = 64
"""Units that encode a neighbour."""

Features = tuple[th.Tensor, th.Tensor]
"""What each arm sees of itself, and what the others see of it, (batch, n_arms, size) each."""


class SharedArmFeatures(NormalizedGoalFeatures):
    """Normalise what each arm sees, with statistics over all arms.

    :param observation_space: of all arms.
    :param arms: where their blocks lie.
    :param named: as for ``NormalizedGoalFeatures``.
    """

    def __init__(self, observation_space: spaces.Dict, arms: ArmBlocks, **named: Any) -> None:
        super().__init__(arms.of_arm(observation_space), **named)
        self.arms = arms

    def forward(self, observations: Mapping[str, th.Tensor]) -> Features:  # type: ignore[override]
        """Normalise a batch.

        :param observations: entries (batch, dim) of all arms; ``episode_goal``, if it is there, is
            the goal that the others see.
        """
        own = self._normalized(observations)
        if EPISODE_GOAL not in observations:
            return own, own
        goal = observations[EPISODE_GOAL]
        return own, self._normalized({**observations, "desired_goal": goal})

    def _normalized(self, observations: Mapping[str, th.Tensor]) -> th.Tensor:
        split = {key: self.arms.split(key, observations[key]) for key in self.keys}
        return super().forward(split).unflatten(0, (-1, self.arms.n_arms))

    def update(self, observations: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add samples of all arms to the statistics.

        :param observations: entries (n, dim) of all arms.
        """
        super().update(
            {
                key: self.arms.split(key, th.as_tensor(observations[key])).numpy()
                for key in self.keys
            }
        )


class ArmNetwork(nn.Module):
    """A multi-layer perceptron for each arm, with shared weights.

    :param inputs: what an arm sees of itself, and its action in a critic.
    :param seen: what an arm sees of another.
    :param outputs: of one arm.
    :param net_arch: widths of the hidden layers, at least one.
    :param activation: of the hidden layers.
    :param layer_norm: whether LayerNorm precedes each activation.
    :param arms: the arms.
    """

    poses: th.Tensor

    def __init__(
        self,
        inputs: int,
        seen: int,
        outputs: int,
        net_arch: list[int],
        activation: type[nn.Module],
        layer_norm: bool,
        arms: ArmBlocks,
    ) -> None:
        super().__init__()
        self.n_arms = arms.n_arms
        self.sizes = [inputs, seen, POSE_SIZE]
        self.own = nn.Linear(inputs, net_arch[0])
        # It has the same weights for one arm, which has no neighbours.
        self.pair = nn.Linear(sum(self.sizes), ENCODING)
        self.pool = nn.Linear(ENCODING, net_arch[0], bias=False)
        norms: list[type[nn.Module]] = [nn.LayerNorm] if layer_norm else []
        tail = create_mlp(net_arch[0], outputs, net_arch[1:], activation, post_linear_modules=norms)
        self.tail = nn.Sequential(*(norm(net_arch[0]) for norm in norms), activation(), *tail)
        # Not saved: weights do not depend on the number of arms.
        self.register_buffer("poses", arms.poses(), persistent=False)

    def forward(self, own: th.Tensor, seen: th.Tensor) -> th.Tensor:
        """Evaluate the network for every arm.

        :param own: (batch, n_arms, inputs).
        :param seen: (batch, n_arms, seen).
        :return: (batch, n_arms, outputs).
        """
        hidden = self.own(own)
        if self.n_arms > 1:
            of_own, of_other, of_pose = self.pair.weight.split(self.sizes, dim=1)
            # Linear in all three, so that each arm is multiplied once.
            mine = functional.linear(own, of_own)
            theirs = functional.linear(seen, of_other)
            place = functional.linear(self.poses, of_pose, self.pair.bias)
            encoded = [
                # Of each arm and the one that follows it by `ahead`.
                (mine + theirs.roll(-ahead, 1) + place[:, ahead - 1]).relu()
                for ahead in range(1, self.n_arms)
            ]
            hidden = hidden + self.pool(sum(encoded[1:], start=encoded[0]))
        result: th.Tensor = self.tail(hidden)
        return result


class SharedArmsActor(Actor):
    """TD3's actor with the same weights for every arm.

    :param arms: the arms.
    :param arguments: as for SB3's ``Actor``.
    """

    def __init__(self, *, arms: ArmBlocks, net_arch: list[int], **arguments: Any) -> None:
        super().__init__(net_arch=[], **arguments)
        self.net_arch = net_arch
        size, kind = self.features_dim, self.activation_fn
        actions = int(np.prod(self.action_space.shape or ())) // arms.n_arms
        self.mu: Any = ArmNetwork(size, size, actions, net_arch, kind, False, arms)

    def forward(self, obs: PyTorchObs) -> th.Tensor:
        """Return the actions (batch, action_dim), scaled to [-1, 1]."""
        return th.tanh(self.mu(*self.features_extractor(obs))).flatten(1)


class SharedArmsCritic(GoalCritic):
    """Critics with the same weights for every arm.

    Their values are those of the arms' own goals, then each arm's value of what all arms share:
    a shared part of the goal, and costs.

    :param arms: the arms.
    :param arguments: as for ``GoalCritic``.
    """

    def __init__(self, *, arms: ArmBlocks, n_values: int, n_costs: int, **arguments: Any) -> None:
        critics = arguments.pop("n_critics", 2)
        norm = arguments.get("layer_norm", True)
        net_arch = arguments.pop("net_arch")
        super().__init__(**arguments, net_arch=[], n_values=n_values, n_costs=n_costs, n_critics=0)
        shared = n_values - arms.n_arms + n_costs
        n = arms.n_arms
        self.reward_columns = (*range(n), *(n + k for k in range(shared) for _ in range(n)))
        actions = int(np.prod(self.action_space.shape or ())) // n
        size = arguments["features_dim"]
        kind = arguments.get("activation_fn", nn.ReLU)
        self.n_critics = critics
        self.n_arms = n
        for index in range(critics):
            network = ArmNetwork(size + actions, size, 1 + shared, net_arch, kind, norm, arms)
            self.add_module(f"qf{index}", network)
            self.q_networks.append(network)

    def _values(self, obs: Any, actions: th.Tensor, networks: list[Any]) -> list[th.Tensor]:
        own, seen = self.features_extractor(obs)
        joined = th.cat((own, actions.unflatten(1, (self.n_arms, -1))), dim=2)
        return [network(joined, seen).transpose(1, 2).flatten(1) for network in networks]


class SharedArmsPolicy(GoalTD3Policy):
    """Actor and critics of TD3 with the same weights for every arm.

    :param observation_space: of all arms.
    :param action_space: of all arms.
    :param lr_schedule: SB3's learning-rate schedule.
    :param arms: the fields of ``ArmBlocks``; goal learners take them from the environment.
    :param arguments: as for the goal policy of TD3.
    :raises ValueError: without ``arms``, or if they do not fit the spaces.
    """

    critic_class = SharedArmsCritic
    arms: ArmBlocks

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        arms: Mapping[str, Any],
        features_extractor_kwargs: Mapping[str, Any] | None = None,
        **arguments: Any,
    ) -> None:
        blocks = ArmBlocks.from_mapping(arms)
        arguments.setdefault("features_extractor_class", SharedArmFeatures)
        arguments.setdefault("n_values", blocks.n_arms + (blocks.shared_goal > 0))
        arguments["features_extractor_kwargs"] = {
            **(features_extractor_kwargs or {}),
            "arms": blocks,
        }
        # Set first: SB3's constructor builds the networks.
        self.__dict__["arms"] = blocks
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """Build an actor on the shared features unless others are given."""
        arguments = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return SharedArmsActor(**arguments, arms=self.arms).to(self.device)

    def _critic_arguments(self) -> dict[str, Any]:
        return {**super()._critic_arguments(), "arms": self.arms}

    def _get_constructor_parameters(self) -> dict[str, Any]:
        data = {**super()._get_constructor_parameters(), "arms": self.arms.to_mapping()}
        given = data["features_extractor_kwargs"]
        data["features_extractor_kwargs"] = {k: v for k, v in given.items() if k != "arms"}
        return data
