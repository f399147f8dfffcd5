"""Constrained policy optimization: a trust-region step under a linear cost constraint."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from sb3_contrib import TRPO
from sb3_contrib.common.utils import flat_grad
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.distributions import kl_divergence
from stable_baselines3.common.utils import explained_variance
from torch import nn
from torch.nn import functional
from torch.nn.utils import parameters_to_vector

from saver_advisors.safe_baselines.constrained import CostConstrainedMixin
from saver_advisors.safe_baselines.trust_region import Step, best_step, solve


@dataclass(frozen=True)
class Surrogates:
    """Surrogates of a policy's return and cost, and its divergence from the old policy.

    :param reward: mean of ratio times advantage.
    :param cost: mean of ratio times advantage of cost.
    :param divergence: mean Kullback-Leibler divergence from the old policy.
    """

    reward: th.Tensor
    cost: th.Tensor
    divergence: th.Tensor


class CPO(CostConstrainedMixin, TRPO):
    """Constrained policy optimization (Achiam et al., 2017); constructor as sb3-contrib's TRPO's.

    Every step maximises the surrogate of the reward within the trust region ``target_kl`` under
    c + b'x <= 0, with c = J_c - cost_limit and b the gradient of the surrogate of the cost; if no
    point of the region satisfies that, the step only lowers the cost. A line search follows, on
    the divergence, on the cost and, while the constraint is satisfied, on the reward.

    :param args: as for TRPO.
    :param divide_by_episode_length: whether c is divided by the mean length of an episode, so that
        it has the unit of the surrogate, which is a mean over steps (as in OpenAI's reference;
        without, as in OmniSafe, an excess is larger by a factor of the episode's length).
    :param kwargs: as for TRPO and `CostConstrainedMixin`, notably ``cost_limit``: the mean
        undiscounted sum of ``info["cost"]`` over an episode.
    """

    def __init__(self, *args: Any, divide_by_episode_length: bool = True, **kwargs: Any) -> None:
        self.divide_by_episode_length = divide_by_episode_length
        super().__init__(*args, **kwargs)

    def train(self) -> None:
        """Update policy and critics with the last rollout."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        self._flatten_rollout()
        parameters = self._update_policy(self._comparison())
        self._train_value_function(parameters)
        self._train_cost_critic(self.batch_size)
        self._n_updates += 1
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _comparison(self) -> Callable[[], Surrogates]:
        """Return what compares the current policy with the one that collected the rollout."""
        buffer = self.rollout_buffer
        indices = np.arange(0, buffer.buffer_size * buffer.n_envs, self.sub_sampling_factor)
        samples = buffer._get_samples(indices)
        actions = samples.actions
        if isinstance(self.action_space, spaces.Discrete):
            actions = actions.long().flatten()
        advantages = samples.advantages
        if self.normalize_advantage:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        costs = th.as_tensor(RolloutBuffer.swap_and_flatten(self._cost_rollout.advantages))
        costs = costs.flatten()[th.as_tensor(indices)].to(self.device)
        costs = costs - costs.mean()
        with th.no_grad():
            old = copy.copy(self.policy.get_distribution(samples.observations))

        def compare() -> Surrogates:
            distribution = self.policy.get_distribution(samples.observations)
            ratio = th.exp(distribution.log_prob(actions) - samples.old_log_prob)
            divergence = kl_divergence(distribution, old).mean()
            return Surrogates((advantages * ratio).mean(), (costs * ratio).mean(), divergence)

        return compare

    def _excess(self) -> float:
        """Compute c, the excess over the limit in the unit of the surrogate of the cost."""
        assert self.mean_episode_cost is not None and self.mean_episode_length is not None
        excess = self.mean_episode_cost - self.cost_limit
        return excess / self.mean_episode_length if self.divide_by_episode_length else excess

    def _update_policy(self, compare: Callable[[], Surrogates]) -> list[nn.Parameter]:
        """Take one constrained step; return the parameters that the distribution depends on."""
        before = compare()
        parameters, reward_gradient, divergence_gradient, _ = self._compute_actor_grad(
            before.divergence, before.reward
        )
        if self.mean_episode_cost is None:
            # No episode has ended yet, so no direction is known to satisfy the constraint.
            return parameters
        cost_gradient = flat_grad(before.cost, parameters, retain_graph=True)
        product = partial(self.hessian_vector_product, parameters, divergence_gradient)
        x = solve(product, reward_gradient, self.cg_max_steps)
        p = solve(product, cost_gradient, self.cg_max_steps)
        # Conjugate gradients stop early. With products of their results instead of the gradients
        # the step still ends exactly on the boundary of the trust region.
        of_x, of_p = product(x), product(p)
        q, r, s = float(x @ of_x), float(x @ of_p), float(p @ of_p)
        excess = self._excess()
        step = best_step(q, r, s, excess, self.target_kl)
        direction = step.reward * x - step.cost * p
        after, taken = self._line_search(compare, parameters, direction, before, step, excess)
        self.logger.record("train/policy_objective", after.reward.item())
        self.logger.record("train/cost_change", (after.cost - before.cost).item())
        self.logger.record("train/cost_excess", excess)
        self.logger.record("train/kl_divergence_loss", after.divergence.item())
        self.logger.record("train/case", step.case)
        self.logger.record("train/step_share", taken)
        self.logger.record("train/is_line_search_success", float(taken > 0.0))
        if hasattr(self.policy, "log_std"):
            self.logger.record("train/std", th.exp(self.policy.log_std).mean().item())
        return parameters

    def _line_search(
        self,
        compare: Callable[[], Surrogates],
        parameters: list[nn.Parameter],
        direction: th.Tensor,
        before: Surrogates,
        step: Step,
        excess: float,
    ) -> tuple[Surrogates, float]:
        """Move along a direction as far as the surrogates' true values allow.

        :return: the surrogates at the end, and the fraction of the direction taken.
        """
        origin = parameters_to_vector(parameters).detach().clone()
        # While the limit is exceeded, lowering the cost has priority.
        needs_reward = step.case in ("unconstrained", "feasible")
        fraction = 1.0
        with th.no_grad():
            for _ in range(self.line_search_max_iter):
                _move(parameters, origin + fraction * direction)
                after = compare()
                if (
                    after.divergence <= self.target_kl
                    and after.cost - before.cost <= max(-excess, 0.0)
                    and (not needs_reward or after.reward > before.reward)
                ):
                    return after, fraction
                fraction *= self.line_search_shrinking_factor
            _move(parameters, origin)
        return before, 0.0

    def _train_value_function(self, actor: list[nn.Parameter]) -> None:
        """Fit the value function to the rollout's returns, as TRPO does.

        :param actor: parameters that only the constrained step may change.
        """
        buffer, optimizer = self.rollout_buffer, self.policy.optimizer
        losses = []
        for _ in range(self.n_critic_updates):
            for samples in buffer.get(self.batch_size):
                values = self.policy.predict_values(samples.observations).flatten()
                loss = functional.mse_loss(samples.returns, values)
                optimizer.zero_grad()
                loss.backward()
                for parameter in actor:
                    parameter.grad = None
                optimizer.step()
                losses.append(loss.item())
        self.logger.record("train/value_loss", float(np.mean(losses)))
        variance = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.logger.record("train/explained_variance", variance)


def _move(parameters: list[nn.Parameter], vector: th.Tensor) -> None:
    """Write a flat vector into the parameters, in place."""
    sizes = [one.numel() for one in parameters]
    for one, values in zip(parameters, vector.split(sizes), strict=True):
        one.copy_(values.view_as(one))
