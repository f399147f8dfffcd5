"""TD3 whose actor also imitates advised actions.

Early advice fills the replay buffer with good actions long before the student's own are any good.
A critic that has seen nothing else overrates actions that nobody took, and the actor runs after
them; the extra loss below keeps it near what it was shown (Nair et al., 2018, "Overcoming
Exploration in Reinforcement Learning with Demonstrations": behaviour cloning with a Q-filter). The
filter, imitating only what the critic finds better, is open at first: such a critic finds nothing
better than the actor's own action.

With ``proposals`` the critics' target takes, arm by arm, the better of the target actor's action
and the proposed one, in the eyes of the target critics (Hu et al., arXiv 2311.02198: IBRL's
bootstrapping).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch as th
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.td3 import TD3
from torch.nn import functional

from saver_advisors.learner.choice import Proposals, better_by_arm
from saver_advisors.learner.replay import GoalReplayBuffer


class ImitatingTD3(TD3):
    """TD3 with an imitation loss on transitions whose action was a teacher's.

    :param arguments: as for TD3; the replay buffer must be a ``GoalReplayBuffer``
    :param imitation_weight: of the mean squared difference, over advised transitions, between
        the actor's action and the advised one; 0 for plain TD3
    :param imitation_filter_start: environment steps from which on only those advised actions are
        imitated that the critic finds better than the actor's
    :raises ValueError: for a negative weight or step
    """

    proposals: Proposals | None
    """Actions for the critics' target to choose from beside the actor's, or None; not saved."""

    value_weights: tuple[float, ...] | None
    """How much the actor minds each part's value, the mean of all where None."""

    def __init__(
        self,
        *arguments: Any,
        imitation_weight: float = 0.0,
        imitation_filter_start: int = 0,
        **named: Any,
    ) -> None:
        if not imitation_weight >= 0:
            raise ValueError(f"imitation_weight={imitation_weight} must be 0 or more")
        if not imitation_filter_start >= 0:
            raise ValueError(f"imitation_filter_start={imitation_filter_start} must be 0 or more")
        self.proposals = None
        self.value_weights = None
        self.imitation_weight = imitation_weight
        self.imitation_filter_start = imitation_filter_start
        super().__init__(*arguments, **named)

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Do gradient steps; as TD3's where the weight is 0 and the goal has one part.

        :param gradient_steps: critic updates
        :param batch_size: transitions each
        """
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        critic_losses, actor_losses, imitation_losses = [], [], []
        for _ in range(gradient_steps):
            self._n_updates += 1
            batch, advised = self._draw(batch_size)
            critic_losses.append(self._update_critic(batch))
            if self._n_updates % self.policy_delay == 0:
                actor_loss, imitation_loss = self._update_actor(batch, advised)
                actor_losses.append(actor_loss)
                imitation_losses.append(imitation_loss)
                polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
                polyak_update(self.actor.parameters(), self.actor_target.parameters(), self.tau)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/critic_loss", np.mean(critic_losses))
        if actor_losses:
            self.logger.record("train/actor_loss", np.mean(actor_losses))
            self.logger.record("train/imitation_loss", np.mean(imitation_losses))

    def _draw(self, batch_size: int) -> tuple[DictReplayBufferSamples, th.Tensor]:
        """Transitions as tensors, and which of them were advised (batch,)."""
        assert isinstance(self.replay_buffer, GoalReplayBuffer)
        drawn = self.replay_buffer.sample_transitions(batch_size)
        return self.replay_buffer.as_samples(drawn), th.as_tensor(drawn.advised)

    def _update_critic(self, batch: DictReplayBufferSamples) -> float:
        """One step of the critics towards the smallest target value; the loss."""
        with th.no_grad():
            noise = th.randn_like(batch.actions) * self.target_policy_noise
            noise = noise.clamp(-self.target_noise_clip, self.target_noise_clip)
            next_actions = (self.actor_target(batch.next_observations) + noise).clamp(-1, 1)
            if self.proposals is not None:
                next_actions = self._better_actions(batch.next_observations, next_actions)
            values = th.stack(self.critic_target(batch.next_observations, next_actions))
            target = batch.rewards + self.gamma * values.amin(dim=0)
        estimates = self.critic(batch.observations, batch.actions)
        loss = th.stack([functional.mse_loss(value, target) for value in estimates]).sum()
        self.critic.optimizer.zero_grad()
        loss.backward()
        self.critic.optimizer.step()
        return float(loss.item())

    def _better_actions(self, observations: Any, own: th.Tensor) -> th.Tensor:
        """Proposed actions in place of ``own`` (batch, action_dim) where the target critics prefer
        them.
        """
        assert self.proposals is not None
        proposed = self.proposals(observations)
        if proposed is None:
            return own

        def values(actions: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
            repeated = {key: value.repeat(len(actions), 1) for key, value in observations.items()}
            flat = th.as_tensor(actions.reshape(-1, actions.shape[2]), device=self.device)
            least = th.stack(self.critic_target(repeated, flat)).amin(dim=0)
            return np.asarray(least.cpu().numpy().reshape(*actions.shape[:2], -1))

        by_arm = own.cpu().numpy().reshape(proposed.shape)
        chosen = better_by_arm(by_arm, proposed, values, self.proposals.arms)
        mixed = np.where(chosen[..., np.newaxis], proposed, by_arm)
        return th.as_tensor(mixed.reshape(len(own), -1), device=self.device)

    def _weighed(self, values: th.Tensor) -> th.Tensor:
        """The parts' values (batch, parts) as one (batch,)."""
        if self.value_weights is None:
            return values.mean(dim=1)
        weights = th.as_tensor(self.value_weights, dtype=values.dtype)
        return values @ weights / weights.sum()

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "proposals"]

    def _update_actor(
        self, batch: DictReplayBufferSamples, advised: th.Tensor
    ) -> tuple[float, float]:
        """One step of the actor; its loss and the imitation loss within it."""
        actions = self.actor(batch.observations)
        # The goal critic takes a dict of observations, of which SB3's hint does not know.
        critic: Any = self.critic
        values = critic.q1_forward(batch.observations, actions)
        loss = -self._weighed(values).mean()
        imitation = th.zeros(())
        if self.imitation_weight > 0 and advised.any():
            followed = advised
            if self.num_timesteps >= self.imitation_filter_start:
                with th.no_grad():
                    shown = critic.q1_forward(batch.observations, batch.actions)
                followed = advised & (self._weighed(shown) > self._weighed(values))
            difference = (actions - batch.actions).square().mean(dim=1)
            imitation = (difference * followed).sum() / advised.sum()
        total = loss + self.imitation_weight * imitation
        self.actor.optimizer.zero_grad()
        total.backward()
        self.actor.optimizer.step()
        return float(loss.item()), float(imitation.item())
