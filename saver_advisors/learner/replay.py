"""A replay buffer for goal-conditioned tasks: "future" relabelling, rewards at the draw.

Relabelling follows Andrychowicz et al., Hindsight Experience Replay (arXiv 1707.01495), strategy
"future". Stock ``HerReplayBuffer`` recomputes the reward of relabelled transitions only, so that
a change of reward leaves stale rewards in the other fifth of each batch; here every reward is
computed when its transition is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from saver_advisors.learner.episodes import BoolArray, EpisodeBuffer, FloatArray, IntArray

RewardFunction = Callable[[FloatArray, FloatArray], npt.NDArray[Any]]


@dataclass(frozen=True)
class GoalTransitions:
    """A batch of transitions and where each came from.

    :param observation: (batch, observation_dim)
    :param achieved_goal: (batch, goal_dim), reached before the action
    :param desired_goal: (batch, goal_dim), the episode's own or a relabelled one
    :param action: (batch, action_dim), scaled to [-1, 1]
    :param reward: (batch, rewards), computed now from ``next_achieved_goal`` and ``desired_goal``
    :param next_observation: (batch, observation_dim)
    :param next_achieved_goal: (batch, goal_dim), reached after the action
    :param advised: (batch,), whether a teacher chose the action
    :param slot: (batch,), the episode's slot
    :param step: (batch,), the transition's place in its episode, from 0
    :param goal_step: (batch, parts), the row of the slot whose achieved goal became the desired one
        (``step + 1`` is the one just after the action), or -1 where the goal is the episode's own
    """

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    next_achieved_goal: FloatArray
    advised: BoolArray
    slot: IntArray
    step: IntArray
    goal_step: IntArray


def reward_function_of(env: VecEnv) -> RewardFunction:
    """The environment's ``compute_reward`` as a function of goals alone.

    :param env: a vector env whose envs (or itself) have gymnasium-robotics' method
        ``compute_reward(achieved_goal, desired_goal, info)``, batched and free of side effects
    :return: a function of (batch, goal_dim), (batch, goal_dim)
    :raises AttributeError: when the environment has no such method
    """
    compute_reward = env.get_attr("compute_reward", indices=[0])[0]

    def reward(achieved_goal: FloatArray, desired_goal: FloatArray) -> npt.NDArray[Any]:
        return np.asarray(compute_reward(achieved_goal, desired_goal, {}))

    return reward


class GoalReplayBuffer(EpisodeBuffer):
    """Replay of whole episodes with hindsight goals, for any off-policy SB3 algorithm.

    The sampled ``dones`` are all 0: these episodes end by the clock, and the value of a state does
    not depend on the clock.

    :param buffer_size: transitions kept; rounded down to whole episodes, the oldest go first
    :param observation_space: Dict with Boxes observation, achieved_goal and desired_goal, each 1-D
    :param action_space: a 1-D Box
    :param device: where sampled tensors live
    :param n_envs: environments that step together
    :param optimize_memory_usage: SB3's argument; always on here, the value is ignored
    :param horizon: the longest episode in steps
    :param relabel_probability: share of transitions whose goal is replaced by a later achieved one
    :param goal_parts: sizes of the goal's parts, such as three coordinates an arm, which are then
        taken apart: each is relabelled with a chance and a later step of its own, and gets the
        reward that there would be if all other parts were met; where None the goal is one part
    :param reward_function: (batch, goal_dim) achieved after the action, (batch, goal_dim) desired
        -> (batch,); may be set or replaced later through the attribute of the same name
    :param seed: of the buffer's own random generator
    :param store_advised: keep ``infos[i]["advised"]`` of each transition
    :raises ValueError: for spaces or sizes that do not fit
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        device: th.device | str = "auto",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        *,
        horizon: int,
        relabel_probability: float = 0.8,
        goal_parts: Sequence[int] | None = None,
        reward_function: RewardFunction | None = None,
        seed: int | None = None,
        store_advised: bool = True,
    ) -> None:
        if not 0.0 <= relabel_probability <= 1.0:
            raise ValueError(f"relabel_probability={relabel_probability} must lie in [0, 1]")
        super().__init__(
            buffer_size,
            observation_space,
            action_space,
            device,
            n_envs,
            horizon=horizon,
            seed=seed,
            store_advised=store_advised,
        )
        self.relabel_probability = relabel_probability
        self.reward_function = reward_function
        self.part_columns = _columns_of(goal_parts, observation_space)

    def sample(  # type: ignore[override]  # as SB3's own DictReplayBuffer
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Draw transitions, each stored one as likely as any other.

        :param batch_size: transitions to draw, with replacement
        :param env: normalises observations and rewards, if given
        :return: tensors on the buffer's device; rewards are (batch_size, rewards), one for each of
            ``goal_parts`` or one in all, dones (batch_size, 1)
        :raises ValueError: when the buffer is empty, or has no reward function
        """
        return self.as_samples(self.sample_transitions(batch_size), env)

    def as_samples(
        self, drawn: GoalTransitions, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Turn transitions into what SB3's algorithms take.

        :param drawn: the transitions
        :param env: normalises observations and rewards, if given
        :return: tensors on the buffer's device; rewards are (batch, rewards), dones (batch, 1)
        """
        observations = {
            "observation": drawn.observation,
            "achieved_goal": drawn.achieved_goal,
            "desired_goal": drawn.desired_goal,
        }
        next_observations = {
            "observation": drawn.next_observation,
            "achieved_goal": drawn.next_achieved_goal,
            "desired_goal": drawn.desired_goal,
        }
        reward = drawn.reward
        if env is not None:
            observations = env.normalize_obs(observations)  # type: ignore[assignment]
            next_observations = env.normalize_obs(next_observations)  # type: ignore[assignment]
            reward = env.normalize_reward(reward).astype(np.float32)
        return DictReplayBufferSamples(
            observations={key: self._tensor(value) for key, value in observations.items()},
            actions=self._tensor(drawn.action),
            next_observations={
                key: self._tensor(value) for key, value in next_observations.items()
            },
            dones=th.zeros((len(reward), 1), device=self.device),
            rewards=self._tensor(reward),
        )

    def sample_transitions(
        self, batch_size: int, *, relabel_probability: float | None = None
    ) -> GoalTransitions:
        """Draw transitions as arrays, with their origin.

        :param batch_size: transitions to draw, with replacement
        :param relabel_probability: another one than the buffer's own
        :return: the transitions
        :raises ValueError: when the buffer is empty, or has no reward function
        """
        slot, step = self._draw(batch_size)
        row = slot * (self.horizon + 1) + step
        observation = self.observation.reshape(-1, self.observation.shape[-1])
        achieved = self.achieved_goal.reshape(-1, self.achieved_goal.shape[-1])
        action_row = slot * self.horizon + step

        desired = np.take(self.desired_goal, slot, axis=0)
        share = self.relabel_probability if relabel_probability is None else relabel_probability
        goal_step = self._relabel(desired, achieved, slot, step, share)
        next_achieved = np.take(achieved, row + 1, axis=0)
        return GoalTransitions(
            observation=np.take(observation, row, axis=0),
            achieved_goal=np.take(achieved, row, axis=0),
            desired_goal=desired,
            action=np.take(self.action.reshape(-1, self.action_dim), action_row, axis=0),
            reward=self._rewards(next_achieved, desired),
            next_observation=np.take(observation, row + 1, axis=0),
            next_achieved_goal=next_achieved,
            advised=(
                np.take(self.advised.reshape(-1), action_row)
                if self.store_advised
                else np.zeros(batch_size, bool)
            ),
            slot=slot,
            step=step,
            goal_step=goal_step,
        )

    def _relabel(
        self,
        desired: FloatArray,
        achieved: FloatArray,
        slot: IntArray,
        step: IntArray,
        share: float,
    ) -> IntArray:
        """Replace parts of ``desired`` (batch, goal_dim) by ones achieved later, in place.

        :return: (batch, parts) the steps at which they were achieved, -1 where a part is kept
        """
        shape = (len(slot), len(self.part_columns))
        later = self._random.random(shape) * (self.length[slot] - step)[:, None]
        goal_step = step[:, None] + 1 + later.astype(np.int64)
        relabelled = self._random.random(shape) < share
        row = slot[:, None] * (self.horizon + 1) + goal_step
        for part, columns in enumerate(self.part_columns):
            chosen = relabelled[:, part]
            desired[chosen, columns] = achieved[row[chosen, part], columns]
        return np.where(relabelled, goal_step, -1)

    def _rewards(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Rewards (batch, rewards): the whole goal's, or each part's as if the others were met."""
        if len(self.part_columns) == 1:
            return self._reward(achieved, desired)[:, None]
        rewards = []
        for columns in self.part_columns:
            asked = achieved.copy()
            asked[:, columns] = desired[:, columns]
            rewards.append(self._reward(achieved, asked))
        return np.stack(rewards, axis=1)

    def _reward(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Rewards (batch,) of reaching ``achieved`` when ``desired`` was asked for."""
        if self.reward_function is None:
            raise ValueError(
                "reward_function is None: set it, e.g. "
                "`buffer.reward_function = reward_function_of(env)`"
            )
        reward = np.asarray(self.reward_function(achieved, desired), np.float32)
        if reward.shape != (len(achieved),):
            raise ValueError(
                f"reward_function returned shape {reward.shape} for {len(achieved)} transitions; "
                f"it must return ({len(achieved)},)"
            )
        return reward

    def _tensor(self, array: npt.NDArray[Any]) -> th.Tensor:
        return self.to_torch(np.asarray(array, np.float32), copy=False)


def _columns_of(
    goal_parts: Sequence[int] | None, observation_space: spaces.Space[Any]
) -> tuple[slice, ...]:
    """The columns of each part of a goal.

    :raises ValueError: for sizes that do not add up to the goal's
    """
    assert isinstance(observation_space, spaces.Dict)
    shape = observation_space["achieved_goal"].shape
    assert shape is not None
    parts = list(shape if goal_parts is None else goal_parts)
    if min(parts) < 1 or sum(parts) != shape[0]:
        raise ValueError(f"goal_parts={goal_parts} must be positive and add up to {shape[0]}")
    ends = np.cumsum(parts)
    return tuple(slice(int(end) - size, int(end)) for end, size in zip(ends, parts, strict=True))
