"""Learning from a teacher's actions: imitation loss, bootstrapping (IBRL), behaviour cloning.

Early advice fills the replay buffer with good actions long before the student's own are good. A
critic trained on them alone overestimates out-of-distribution actions, which the actor then
exploits. The imitation loss keeps the actor near the advised actions (Nair et al., 2018,
"Overcoming Exploration in Reinforcement Learning with Demonstrations": behaviour cloning with a
Q-filter). The filter imitates only actions that the critic rates higher than the actor's; it starts
later, since such a critic rates none of them higher.

With ``bootstrap_proposals`` the critics' target takes, arm by arm, the better of the target actor's
action and the proposed one, by the target critics (Hu et al., arXiv 2311.02198: IBRL).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
import torch as th
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.td3 import TD3
from torch.nn import functional

from saver_advisors.learner.multiplier import LagrangeMultiplier
from saver_advisors.learner.policies import conservative_values, cost_values, goal_values
from saver_advisors.learner.replay import GoalReplayBuffer, GoalTransitions
from saver_envs.validation import require

Values = Callable[[npt.NDArray[Any]], npt.NDArray[np.float32]]
"""Actions of all arms, (k, batch, n_arms * action_size) -> values (k, batch, values)."""


Proposals = tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]
"""A second policy's actions, (batch, n_arms, action_size), scaled to [-1, 1], and which arms may
take them, (n_arms,)."""


COLLISION_COST: Final = "cost_collision"
"""Entry of ``info`` that is 1 in a step with contact: what costs by default."""

LABEL_LOSS: Final = functional.l1_loss
"""Where an expert takes one of several actions in alike states, the optimum of this loss is their
median. That of the squared difference is their mean, which may be none of them."""


class ImitatingTD3(TD3):
    """TD3 with an imitation loss on transitions whose action was a teacher's.

    :param arguments: as for TD3; the replay buffer must be a ``GoalReplayBuffer``.
    :param imitation_weight: of the mean squared difference, over advised transitions, between the
        actor's action and the advised one; 0 for plain TD3. If the replay buffer has labels: of the
        mean absolute difference from these, in states with the episodes' own goals, unfiltered.
    :param imitation_filter_start: environment step from which on only those advised actions are
        imitated that the critic rates higher than the actor's.
    :param contact_cost: weight of the cost's value in the actor's objective, relative to that of
        the goal: 0.5 means that a step with contact costs half of a step away from the goal. The
        cost is a further value of the critics, learned in the same replay.
    :param cost_key: entry of ``info`` that is the cost of a step; a step with contact by default.
    :param cost_limit: cost of an episode at the actor's actions, in steps; the weight, which starts
        at ``contact_cost``, then rises while the cost exceeds it and falls below it, as a Lagrange
        multiplier. It is updated once per call of ``train``, with the mean of the target critics'
        conservative values in sampled states, which keeps the noise of exploration out of it
        (off-policy Lagrangian: Ha et al., arXiv 2002.08550). None keeps the weight fixed.
    :param multiplier_lr: learning rate of the multiplier's Adam.
    :raises ValueError: if an argument is out of range.
    """

    bootstrap_proposals: Callable[[Mapping[str, th.Tensor]], Proposals | None] | None
    """Gives alternatives to the target actor's actions in the critics' target; not saved."""

    replay_buffer: GoalReplayBuffer

    value_weights: tuple[float, ...] | None
    """Weight of each part's value in the actor's objective; None for their mean."""

    def __init__(
        self,
        *arguments: Any,
        imitation_weight: float = 0.0,
        imitation_filter_start: int = 0,
        contact_cost: float = 0.0,
        cost_key: str = COLLISION_COST,
        cost_limit: float | None = None,
        multiplier_lr: float = 0.035,
        **named: Any,
    ) -> None:
        start = imitation_filter_start
        require("contact_cost", contact_cost, contact_cost >= 0, "0 or more")
        require("cost_limit", cost_limit, cost_limit is None or cost_limit >= 0, "0 or more")
        require("imitation_weight", imitation_weight, imitation_weight >= 0, "0 or more")
        require("imitation_filter_start", start, start >= 0, "0 or more")
        self.contact_cost = contact_cost
        self.cost_key = cost_key
        self.cost_limit = cost_limit
        self.multiplier_lr = multiplier_lr
        self.multiplier = LagrangeMultiplier(contact_cost, multiplier_lr)
        self.bootstrap_proposals = None
        self.value_weights = None
        self.imitation_weight = imitation_weight
        self.imitation_filter_start = imitation_filter_start
        super().__init__(*arguments, **named)

    @property
    def learns_costs(self) -> bool:
        """Whether the critics have a value of the cost."""
        return self.contact_cost > 0 or self.cost_limit is not None

    def _setup_model(self) -> None:
        # SB3's `load` sets the arguments after the constructor.
        self.multiplier = LagrangeMultiplier(self.contact_cost, self.multiplier_lr)
        super()._setup_model()

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Perform gradient steps; TD3's if the weight is 0 and the goal has one part.

        :param gradient_steps: critic updates.
        :param batch_size: transitions per update.
        """
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        critic_losses, actor_losses, imitation_losses = [], [], []
        self._costs: list[float] = []
        for _ in range(gradient_steps):
            self._n_updates += 1
            drawn = self.replay_buffer.sample_transitions(batch_size)
            batch = self.replay_buffer.as_samples(drawn)
            critic_losses.append(self._update_critic(batch))
            if self._n_updates % self.policy_delay == 0:
                actor_loss, imitation_loss = self._update_actor(batch, drawn)
                actor_losses.append(actor_loss)
                imitation_losses.append(imitation_loss)
                polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
                polyak_update(self.actor.parameters(), self.actor_target.parameters(), self.tau)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/critic_loss", np.mean(critic_losses))
        if actor_losses:
            self.logger.record("train/actor_loss", np.mean(actor_losses))
            self.logger.record("train/imitation_loss", np.mean(imitation_losses))
        if self._costs:
            self._update_multiplier(float(np.mean(self._costs)))

    def _update_multiplier(self, value: float) -> None:
        """Take a step of the multiplier, if the cost has a limit.

        :param value: mean discounted cost from a sampled state on.
        """
        # A constant cost per step of the same value, summed over an episode without discount.
        episode_cost = value * (1.0 - self.gamma) * self.replay_buffer.horizon
        if self.cost_limit is not None:
            self.multiplier.update(episode_cost, self.cost_limit)
        self.logger.record("train/episode_cost", episode_cost)
        self.logger.record("train/cost_multiplier", float(self.multiplier))

    def _update_critic(self, batch: DictReplayBufferSamples) -> float:
        """Take one step of the critics towards the minimum target value; return the loss."""
        with th.no_grad():
            noise = th.randn_like(batch.actions) * self.target_policy_noise
            noise = noise.clamp(-self.target_noise_clip, self.target_noise_clip)
            next_actions = (self.actor_target(batch.next_observations) + noise).clamp(-1, 1)
            if self.bootstrap_proposals is not None:
                next_actions = self._better_actions(batch.next_observations, next_actions)
            values = conservative_values(self.critic_target, batch.next_observations, next_actions)
            if self.learns_costs:
                # The actor exploits errors of the critic that it maximises; these are of both.
                self._costs.append(-float(cost_values(self.critic, values).mean()))
            rewards = batch.rewards
            critic: Any = self.critic
            if critic.reward_columns != tuple(range(rewards.shape[1])):
                rewards = rewards[:, critic.reward_columns]
            target = rewards + self.gamma * values
        estimates = self.critic(batch.observations, batch.actions)
        loss = th.stack([functional.mse_loss(value, target) for value in estimates]).sum()
        self.critic.optimizer.zero_grad()
        loss.backward()
        self.critic.optimizer.step()
        return float(loss.item())

    def _better_actions(self, observations: Any, own: th.Tensor) -> th.Tensor:
        """Replace ``own`` actions (batch, action_dim) where the target critics prefer proposals."""
        assert self.bootstrap_proposals is not None
        proposals = self.bootstrap_proposals(observations)
        if proposals is None:
            return own
        proposed, arms = proposals
        values = partial(candidate_values, self.critic_target, observations)
        by_arm = own.cpu().numpy().reshape(proposed.shape)
        chosen = better_by_arm(by_arm, proposed, values, arms)
        mixed = np.where(chosen[..., np.newaxis], proposed, by_arm)
        return th.as_tensor(mixed.reshape(len(own), -1), device=self.device)

    def _weighted(self, values: th.Tensor) -> th.Tensor:
        """Combine the critic's values (batch, values) into one (batch,)."""
        parts = goal_values(self.critic, values)
        if self.value_weights is None:
            goal = parts.mean(dim=1)
        else:
            weights = th.as_tensor(self.value_weights, dtype=values.dtype)
            goal = parts @ weights / weights.sum()
        if not self.learns_costs:
            return goal
        multiplier = float(self.multiplier)
        cost = cost_values(self.critic, values).sum(dim=1)
        return (goal + multiplier * cost) / (1.0 + multiplier)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "bootstrap_proposals", "multiplier", "_costs"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, variables = super()._get_torch_save_params()
        if self.cost_limit is None:
            return modules, variables
        return [*modules, "multiplier", "multiplier.optimizer"], variables

    def _update_actor(
        self, batch: DictReplayBufferSamples, drawn: GoalTransitions
    ) -> tuple[float, float]:
        """Take one step of the actor; return its loss without imitation, and the imitation loss.

        :param batch: the transitions as tensors.
        :param drawn: the same as arrays, with their origins.
        """
        actions = self.actor(batch.observations)
        # SB3's type hint does not cover the goal critic's dict observations.
        critic: Any = self.critic
        values = critic.q1_forward(batch.observations, actions)
        loss = -self._weighted(values).mean()
        imitation = th.zeros(())
        if self.imitation_weight > 0 and self.replay_buffer.labels:
            seen, wanted = self.replay_buffer.labelled(drawn)
            imitation = LABEL_LOSS(self.actor(seen), wanted) if len(wanted) else imitation
        elif self.imitation_weight > 0 and drawn.advised.any():
            imitation = self._advice_loss(batch, th.as_tensor(drawn.advised), actions, values)
        total = loss + self.imitation_weight * imitation
        self.actor.optimizer.zero_grad()
        total.backward()
        self.actor.optimizer.step()
        return float(loss.item()), float(imitation.item())

    def _advice_loss(
        self,
        batch: DictReplayBufferSamples,
        advised: th.Tensor,
        actions: th.Tensor,
        values: th.Tensor,
    ) -> th.Tensor:
        """Compute the mean squared difference between the actor's actions and the advised ones.

        :param batch: transitions.
        :param advised: (batch,), which of their actions were a teacher's; at least one was.
        :param actions: (batch, action_dim) of the actor.
        :param values: (batch, values) of these actions.
        """
        followed, critic = advised, cast("Any", self.critic)
        if self.num_timesteps >= self.imitation_filter_start:
            with th.no_grad():
                shown = critic.q1_forward(batch.observations, batch.actions)
            followed = advised & (self._weighted(shown) > self._weighted(values))
        difference = (actions - batch.actions).square().mean(dim=1)
        return (difference * followed).sum() / advised.sum()


@th.no_grad()
def candidate_values(
    critic: Any, observations: Mapping[str, th.Tensor], actions: npt.NDArray[Any]
) -> npt.NDArray[np.float32]:
    """Compute a critic's conservative values of k candidate actions in each state.

    :param critic: a critic of this package or of SB3.
    :param observations: entries (batch, dim).
    :param actions: (k, batch, action_dim), scaled to [-1, 1].
    :return: (k, batch, values).
    """
    repeated = {key: value.repeat(len(actions), 1) for key, value in observations.items()}
    flat = actions.reshape(-1, actions.shape[2])
    scaled = th.as_tensor(flat, dtype=th.float32, device=critic.device)
    values = goal_values(critic, conservative_values(critic, repeated, scaled)).cpu().numpy()
    return np.asarray(values.reshape(*actions.shape[:2], -1))


def better_by_arm(
    own: npt.NDArray[Any],
    proposed: npt.NDArray[Any],
    values: Values,
    arms: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]:
    """Decide which arms should take the proposed action instead of their own.

    With a joint value the best of all combinations of own and proposed actions wins. With several
    values, value i is arm i's, and those after the last arm's are shared: each arm compares the two
    actions while all others keep their own. Ties go to the own action.

    :param own: (batch, n_arms, action_size).
    :param proposed: (batch, n_arms, action_size).
    :param values: the critics, in the states of the actions.
    :param arms: (n_arms,) which arms may take a proposed action.
    :return: (batch, n_arms).
    :raises ValueError: if there are several values, but fewer than arms.
    """
    n_arms = own.shape[1]
    free = np.flatnonzero(arms)
    # In the order of `combinations`: no arm, then each arm alone, then all larger sets.
    sets = [
        chosen for size in range(len(free) + 1) for chosen in itertools.combinations(free, size)
    ]
    masks = np.array([[arm in chosen for arm in range(n_arms)] for chosen in sets])
    n_single = 1 + len(free)
    alone = _mixture_values(values, own, proposed, masks[:n_single])
    n_values = alone.shape[2]
    if n_values == 1:
        rated = [alone]
        if len(masks) > n_single:
            rated.append(_mixture_values(values, own, proposed, masks[n_single:]))
        return masks[np.concatenate(rated)[:, :, 0].argmax(axis=0)]
    if n_values < n_arms:
        raise ValueError(f"the critic gives {n_values} values for {n_arms} arms: one each, or one")
    better = np.zeros(own.shape[:2], dtype=bool)
    for row, arm in enumerate(free, start=1):
        gain = alone[row] - alone[0]
        better[:, arm] = gain[:, arm] + gain[:, n_arms:].sum(axis=1) > 0
    return better


def _mixture_values(
    values: Values,
    own: npt.NDArray[Any],
    proposed: npt.NDArray[Any],
    masks: npt.NDArray[np.bool_],
) -> npt.NDArray[np.float32]:
    """Evaluate the k mixtures of own and proposed actions; (k, batch, values)."""
    mixed = np.where(masks[:, np.newaxis, :, np.newaxis], proposed, own)
    return values(mixed.reshape(len(masks), len(own), -1))


def clone(
    model: OffPolicyAlgorithm,
    demonstrations: GoalReplayBuffer,
    *,
    updates: int,
    batch_size: int,
    learning_rate: float,
) -> float:
    """Clone the behaviour: fit the actor's deterministic action to the demonstrated one (MSE).

    Goals are the demonstrations' own: for a relabelled goal the teacher would have acted
    differently. The optimizer is separate, so that the learner's own optimizer and the critics
    start as they would without cloning.

    :param model: a goal learner.
    :param demonstrations: the teachers' transitions.
    :param updates: gradient steps.
    :param batch_size: transitions per step.
    :param learning_rate: of Adam.
    :return: the last batch's loss, 0 without updates.
    :raises ValueError: if there are no demonstrations.
    """
    policy: Any = model.policy
    actor = policy.actor
    parameters = [one for one in actor.parameters() if one.requires_grad]
    optimizer = th.optim.Adam(parameters, lr=learning_rate)
    policy.set_training_mode(True)
    loss = 0.0
    for _ in range(updates):
        drawn = demonstrations.sample_transitions(batch_size)
        batch = demonstrations.as_samples(replace(drawn, desired_goal=drawn.episode_goal))
        loss = fit(actor, optimizer, batch.observations, batch.actions)
    actor.zero_grad()
    if getattr(policy, "actor_target", None) is not None:
        policy.actor_target.load_state_dict(actor.state_dict())
    return loss


def fit(
    actor: Any,
    optimizer: th.optim.Optimizer,
    observations: Any,
    wanted: th.Tensor,
    loss_function: Callable[[th.Tensor, th.Tensor], th.Tensor] = functional.mse_loss,
) -> float:
    """Take one step of an actor towards wanted actions.

    :param actor: of SB3's TD3 or SAC.
    :param optimizer: of its parameters.
    :param observations: entries (batch, dim).
    :param wanted: (batch, action_dim), scaled to [-1, 1].
    :param loss_function: of the actor's actions and the wanted ones.
    :return: the loss before the step.
    """
    # SAC's actor samples unless it is asked for the deterministic action; TD3's does not sample.
    mode = {"deterministic": True} if hasattr(actor, "latent_pi") else {}
    loss = loss_function(actor(observations, **mode), wanted)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    return float(loss.item())
