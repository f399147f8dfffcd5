"""Behaviour cloning: the actor is fitted to demonstrated actions before it learns."""

from __future__ import annotations

from typing import Any

import torch as th
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch.nn import functional

from saver_advisors.learner.replay import GoalReplayBuffer


def clone(
    model: OffPolicyAlgorithm,
    demonstrations: GoalReplayBuffer,
    *,
    updates: int,
    batch_size: int,
    learning_rate: float,
) -> float:
    """Fit the deterministic action to the demonstrated one, in the mean square.

    Goals are the demonstrations' own: towards a goal relabelled in hindsight the teacher would have
    done something else. The optimizer is one of its own, so that the learner's starts as it would
    without cloning; so do the critics.

    :param model: a goal learner
    :param demonstrations: what the teachers did
    :param updates: gradient steps
    :param batch_size: transitions each
    :param learning_rate: of Adam
    :return: the last batch's loss, 0 without updates
    :raises ValueError: where there are no demonstrations
    """
    policy: Any = model.policy
    actor = policy.actor
    parameters = [one for one in actor.parameters() if one.requires_grad]
    optimizer = th.optim.Adam(parameters, lr=learning_rate)
    policy.set_training_mode(True)
    loss = th.zeros(())
    for _ in range(updates):
        drawn = demonstrations.sample_transitions(batch_size, relabel_probability=0.0)
        batch = demonstrations.as_samples(drawn)
        loss = functional.mse_loss(_deterministic(actor, batch.observations), batch.actions)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    actor.zero_grad()
    if getattr(policy, "actor_target", None) is not None:
        policy.actor_target.load_state_dict(actor.state_dict())
    return float(loss.item())


def _deterministic(actor: Any, observations: Any) -> th.Tensor:
    """SAC's actor has to be told; TD3's knows nothing else."""
    if hasattr(actor, "latent_pi"):
        action: th.Tensor = actor(observations, deterministic=True)
        return action
    only: th.Tensor = actor(observations)
    return only
