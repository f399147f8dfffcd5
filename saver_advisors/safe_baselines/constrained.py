"""The mixin that adds a cost limit to SB3's on-policy algorithms.

`OnPolicyAlgorithm.collect_rollouts` passes the `infos` of every step to `_update_info_buffer`, once
and before the observation is replaced. Reading the costs there leaves the collection of rollouts to
SB3, with any vector environment, any observation space, callbacks and time limits.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.utils import explained_variance, obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv
from torch.nn import functional

from saver_advisors.learner.policies import NormalizedGoalFeatures
from saver_advisors.safe_baselines.costs import Array, CostCritic, EpisodeCosts, read_costs
from saver_envs.validation import require, require_share

DEFAULT_COST_LIMIT = 1.0
#: Position of ``tb_log_name`` among the optional arguments of SB3's ``learn``, from 1.
_PLACE_OF_NAME = 3


class CostConstrainedMixin(OnPolicyAlgorithm):
    """Add a cost limit to an on-policy algorithm; put it first among the bases.

    The limit applies to the mean, over episodes, of the undiscounted sum of ``info["cost"]``. It is
    estimated from the episodes that ended in the latest rollout, so a rollout should contain
    several: ``n_steps`` well above the episodes' length, or many environments.

    :param args: as for the algorithm.
    :param cost_limit: d, the permitted mean cost of an episode, at least 0; the default permits one
        step of violation if costs are 0 or 1.
    :param cost_key: the entry of ``info`` that holds a step's cost.
    :param cost_gamma: discount of costs in the cost critic and its advantages.
    :param cost_gae_lambda: of the generalized advantage estimates of costs.
    :param n_cost_critic_updates: epochs of the cost critic on each rollout.
    :param kwargs: as for the algorithm.
    :raises ValueError: if an argument is out of range; when learning, if ``cost_key`` is missing in
        an ``info`` or a cost is not a finite number.
    """

    cost_critic: CostCritic
    mean_episode_cost: float | None
    """J_c of the episodes that ended in the latest rollout with any; None before."""
    mean_episode_length: float | None
    """Mean number of steps of the same episodes."""

    def __init__(
        self,
        *args: Any,
        cost_limit: float = DEFAULT_COST_LIMIT,
        cost_key: str = "cost",
        cost_gamma: float = 0.99,
        cost_gae_lambda: float = 0.95,
        n_cost_critic_updates: int = 10,
        **kwargs: Any,
    ) -> None:
        # Before super(), which calls _setup_model.
        self.cost_limit = cost_limit
        self.cost_key = cost_key
        self.cost_gamma = cost_gamma
        self.cost_gae_lambda = cost_gae_lambda
        self.n_cost_critic_updates = n_cost_critic_updates
        self.mean_episode_cost = None
        self.mean_episode_length = None
        super().__init__(*args, **kwargs)

    def _check_arguments(self) -> None:
        limit = self.cost_limit
        number = isinstance(limit, int | float | np.number) and not isinstance(limit, bool)
        wanted = "a finite number of at least 0: the permitted mean cost of an episode"
        require("cost_limit", limit, number and 0 <= limit < math.inf, wanted)
        require("cost_gamma", self.cost_gamma, 0.0 < self.cost_gamma <= 1.0, "in (0, 1]")
        require_share("cost_gae_lambda", self.cost_gae_lambda)
        updates = self.n_cost_critic_updates
        require("n_cost_critic_updates", updates, updates >= 1, "at least 1")

    def _setup_model(self) -> None:
        self._check_arguments()
        super()._setup_model()
        self.cost_critic = CostCritic(self.policy, self.lr_schedule(1))
        # Costs in place of rewards; observations and actions are in the algorithm's own buffer.
        nothing = spaces.Box(0.0, 1.0, (0,))
        self._cost_rollout = RolloutBuffer(
            self.n_steps,
            nothing,
            nothing,
            "cpu",
            gamma=self.cost_gamma,
            gae_lambda=self.cost_gae_lambda,
            n_envs=self.n_envs,
        )
        self._episode_costs = EpisodeCosts(self.n_envs)

    def learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> Self:
        """Learn, as SB3's algorithms do; TensorBoard's name of the run is by default the class's.

        :param total_timesteps: environment steps.
        :param args: SB3's ``callback``, ``log_interval``, ``tb_log_name``, ...
        :param kwargs: the same by name.
        :return: itself.
        """
        if len(args) < _PLACE_OF_NAME:
            kwargs.setdefault("tb_log_name", type(self).__name__)
        return super().learn(total_timesteps, *args, **kwargs)

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, BaseCallback]:
        before = self._last_episode_starts
        prepared = super()._setup_learn(*args, **kwargs)
        if self._last_episode_starts is not before:
            # SB3 has reset the environments.
            self._episode_costs.restart()
        return prepared

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: RolloutBuffer,
        n_rollout_steps: int,
    ) -> bool:
        """Collect rollouts as SB3 does, and the costs of the same steps."""
        if rollout_buffer.full:
            self._update_normaliser(rollout_buffer.observations)
        if not super().collect_rollouts(env, callback, rollout_buffer, n_rollout_steps):
            # SB3 returns before it passes on the infos of the step at which a callback stops.
            self._episode_costs.interrupt()
            return False
        self._cost_rollout.episode_starts = rollout_buffer.episode_starts
        last_values = th.as_tensor(self._cost_values(self._last_obs))
        dones = np.asarray(self._last_episode_starts)
        self._cost_rollout.compute_returns_and_advantage(last_values, dones)
        self._measure_episodes()
        return True

    def _update_normaliser(self, observations: Any) -> None:
        """Add the last rollout to the statistics of a policy that normalises its inputs.

        They change between an update and the next rollout, so that rollout and update agree.

        :param observations: of the rollout, which ``train`` has flattened.
        """
        if isinstance(self.policy.features_extractor, NormalizedGoalFeatures):
            flat = {name: one.reshape(-1, one.shape[-1]) for name, one in observations.items()}
            self.policy.features_extractor.update(flat)

    def _update_info_buffer(
        self, infos: list[dict[str, Any]], dones: NDArray[Any] | None = None
    ) -> None:
        super()._update_info_buffer(infos, dones)
        assert dones is not None, "on-policy algorithms pass it"
        costs = read_costs(infos, self.cost_key)
        self._episode_costs.add(costs, dones)
        # `_last_obs` still holds the states before the step, which SB3 stores next.
        step = self.rollout_buffer.pos
        self._cost_rollout.rewards[step] = costs + self._cut_off_costs(infos, dones)
        self._cost_rollout.values[step] = self._cost_values(self._last_obs)

    def _cut_off_costs(self, infos: Sequence[dict[str, Any]], dones: NDArray[Any]) -> Array:
        """Bootstrap values of episodes that a time limit truncated, (n_envs,)."""
        beyond = np.zeros(len(infos), np.float32)
        cut = [
            index
            for index in map(int, np.flatnonzero(dones))
            if infos[index].get("TimeLimit.truncated", False)
            and infos[index].get("terminal_observation") is not None
        ]
        if cut:
            last = [infos[index]["terminal_observation"] for index in cut]
            stacked = (
                {name: np.stack([one[name] for one in last]) for name in last[0]}
                if isinstance(last[0], dict)
                else np.stack(last)
            )
            beyond[cut] = self.cost_gamma * self._cost_values(stacked)
        return beyond

    def _cost_values(self, observation: Any) -> Array:
        """Evaluate the cost critic for n observations, (n,)."""
        with th.no_grad():
            values = self.cost_critic(obs_as_tensor(observation, self.device))
        return np.asarray(values.cpu().numpy(), np.float32)

    def _measure_episodes(self) -> None:
        """Compute J_c and the mean length from the episodes that ended in this rollout."""
        sums, lengths = self._episode_costs.take()
        if len(sums) > 0:
            self.mean_episode_cost = float(sums.mean())
            self.mean_episode_length = float(lengths.mean())
        elif self.mean_episode_cost is None:
            warnings.warn(
                f"no episode ended in {self.n_steps} steps of {self.n_envs} environments, so the "
                "cost limit cannot be checked: a rollout (n_steps * n_envs) should contain several "
                "episodes",
                stacklevel=2,
            )
        if self.mean_episode_cost is not None:
            self.logger.record("rollout/ep_cost_mean", self.mean_episode_cost)
        self.logger.record("rollout/cost_limit", self.cost_limit)

    def _flatten_rollout(self) -> None:
        """Make SB3 flatten steps and environments into one axis, as at the first batch."""
        next(self.rollout_buffer.get(batch_size=1))

    def _train_cost_critic(self, batch_size: int) -> None:
        """Fit the cost critic to the rollout's returns.

        :param batch_size: of its minibatches.
        """
        self._flatten_rollout()
        rollout, optimizer = self._cost_rollout, self.cost_critic.optimizer
        self._update_learning_rate(optimizer)
        returns = th.as_tensor(RolloutBuffer.swap_and_flatten(rollout.returns)).flatten()
        returns = returns.to(self.device)
        losses = []
        for _ in range(self.n_cost_critic_updates):
            for indices in th.randperm(len(returns)).split(batch_size):
                samples = self.rollout_buffer._get_samples(indices.numpy())
                values = self.cost_critic(samples.observations)
                loss = functional.mse_loss(values, returns[indices])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                losses.append(loss.item())
        self.logger.record("train/cost_value_loss", float(np.mean(losses)))
        self.logger.record(
            "train/cost_explained_variance",
            explained_variance(rollout.values.flatten(), rollout.returns.flatten()),
        )

    def _excluded_save_params(self) -> list[str]:
        own = ["cost_critic", "_cost_rollout", "_episode_costs"]
        return [*super()._excluded_save_params(), *own]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        state_dicts, variables = super()._get_torch_save_params()
        return [*state_dicts, "cost_critic", "cost_critic.optimizer"], variables
