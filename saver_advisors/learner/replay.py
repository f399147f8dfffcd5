"""Replay buffers for goal-conditioned tasks: "future" relabelling, rewards computed when sampled.

Relabelling follows Andrychowicz et al., Hindsight Experience Replay (arXiv 1707.01495), strategy
"future". The stock ``HerReplayBuffer`` recomputes rewards of relabelled transitions only, so after
a change of reward the remaining fifth of each batch keeps old rewards; here every reward is
computed when its transition is sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from saver_advisors.learner.episodes import BoolArray, EpisodeBuffer, FloatArray, IntArray
from saver_envs.validation import require, require_share

RewardFunction = Callable[[FloatArray, FloatArray], npt.NDArray[Any]]
"""Achieved and desired goals, (batch, goal_dim) each -> rewards (batch,)."""

DEMONSTRATIONS_FILE: Final = "demonstrations.npz"


@dataclass(frozen=True)
class GoalTransitions:
    """A batch of transitions and their origins.

    :param observation: (batch, observation_dim).
    :param achieved_goal: (batch, goal_dim), before the action.
    :param desired_goal: (batch, goal_dim), the episode's own or a relabelled one.
    :param action: (batch, action_dim), scaled to [-1, 1].
    :param episode_goal: (batch, goal_dim), the episode's own goal.
    :param reward: (batch, rewards), computed from ``next_achieved_goal`` and ``desired_goal``.
    :param label: (batch, action_dim), the teachers' actions, scaled to [-1, 1]; NaN where they were
        not asked, 0 if no labels are stored.
    :param cost: (batch,), of the step; it does not depend on goals. 0 if no costs are stored.
    :param next_observation: (batch, observation_dim).
    :param next_achieved_goal: (batch, goal_dim), after the action.
    :param advised: (batch,), whether a teacher chose the action.
    :param slot: (batch,), the episode's slot.
    :param step: (batch,), the transition's index in its episode, from 0.
    :param goal_step: (batch, parts), the row of the slot whose achieved goal became the desired one
        (``step + 1`` is the row after the action), or -1 if the goal is the episode's own.
    """

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    episode_goal: FloatArray
    reward: FloatArray
    label: FloatArray
    cost: FloatArray
    next_observation: FloatArray
    next_achieved_goal: FloatArray
    advised: BoolArray
    slot: IntArray
    step: IntArray
    goal_step: IntArray


def reward_function_of(env: VecEnv) -> RewardFunction:
    """Return the environment's ``compute_reward`` as a function of goals alone.

    :param env: a vector env that has, or whose envs have, gymnasium-robotics' method
        ``compute_reward(achieved_goal, desired_goal, info)``, batched and without side effects.
    :return: the reward function.
    :raises AttributeError: if the environment has no such method.
    """
    compute_reward = env.get_attr("compute_reward", indices=[0])[0]

    def reward(achieved_goal: FloatArray, desired_goal: FloatArray) -> npt.NDArray[Any]:
        return np.asarray(compute_reward(achieved_goal, desired_goal, {}))

    return reward


class GoalReplayBuffer(EpisodeBuffer):
    """Replay of whole episodes with hindsight goals, for any off-policy SB3 algorithm.

    The sampled ``dones`` are all 0: episodes end by a time limit, which the value of a state does
    not depend on.

    :param buffer_size: capacity in transitions; rounded down to whole episodes.
    :param observation_space: Dict with Boxes observation, achieved_goal and desired_goal, each 1-D.
    :param action_space: a 1-D Box.
    :param optimize_memory_usage: SB3's argument, ignored: memory use is always optimised.
    :param relabel_probability: of replacing a transition's goal by a later achieved one.
    :param goal_parts: sizes of the goal's parts, e.g. three coordinates per arm. Each part is
        relabelled independently, and gets the reward that applies if all other parts are reached;
        None for a goal of one part.
    :param reward_function: computes rewards from goals; an attribute that may be replaced later.
    :param team_rewards: whether each part of the goal gets the mean reward of all parts.
    :param episode_goals: whether sampled observations also have the episode's own goal, as
        ``episode_goal``.
    :param named: further arguments of ``EpisodeBuffer``; ``horizon`` is required.
    :raises ValueError: if spaces or sizes do not fit.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        *arguments: Any,
        optimize_memory_usage: bool = False,
        relabel_probability: float = 0.8,
        goal_parts: Sequence[int] | None = None,
        reward_function: RewardFunction | None = None,
        team_rewards: bool = False,
        episode_goals: bool = False,
        **named: Any,
    ) -> None:
        require_share("relabel_probability", relabel_probability)
        super().__init__(buffer_size, observation_space, action_space, *arguments, **named)
        self.relabel_probability = relabel_probability
        self.reward_function = reward_function
        self.team_rewards = team_rewards
        self.episode_goals = episode_goals
        self.part_columns = _columns_of(goal_parts, observation_space)

    def sample(  # type: ignore[override]  # as SB3's own DictReplayBuffer
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Sample transitions uniformly.

        :param batch_size: transitions to sample, with replacement.
        :param env: normalises observations and rewards, if given.
        :return: tensors on the buffer's device; rewards are (batch_size, rewards), one for each of
            ``goal_parts`` or one in total, then minus the cost if costs are stored; dones are
            (batch_size, 1).
        :raises ValueError: if the buffer is empty, or has no reward function.
        """
        return self.as_samples(self.sample_transitions(batch_size), env)

    def as_samples(
        self, drawn: GoalTransitions, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Convert transitions to the type that SB3's algorithms use.

        :param drawn: the transitions.
        :param env: normalises observations and rewards, if given.
        :return: tensors on the buffer's device; rewards are (batch, rewards), dones (batch, 1).
        """
        goals = {"desired_goal": drawn.desired_goal}
        if self.episode_goals:
            goals["episode_goal"] = drawn.episode_goal
        seen, seen_next = drawn.observation, drawn.next_observation
        observations = {"observation": seen, "achieved_goal": drawn.achieved_goal, **goals}
        achieved = drawn.next_achieved_goal
        next_observations = {"observation": seen_next, "achieved_goal": achieved, **goals}
        reward = drawn.reward
        if env is not None:
            observations = env.normalize_obs(observations)  # type: ignore[assignment]
            next_observations = env.normalize_obs(next_observations)  # type: ignore[assignment]
            reward = env.normalize_reward(reward).astype(np.float32)
        if self.cost_key is not None:
            reward = np.column_stack((reward, -drawn.cost))
        return DictReplayBufferSamples(
            observations={key: self._tensor(value) for key, value in observations.items()},
            actions=self._tensor(drawn.action),
            next_observations={
                key: self._tensor(value) for key, value in next_observations.items()
            },
            dones=th.zeros((len(reward), 1), device=self.device),
            rewards=self._tensor(reward),
        )

    def labelled(self, drawn: GoalTransitions) -> tuple[dict[str, th.Tensor], th.Tensor]:
        """Return the states in which teachers were asked, with the episodes' own goals.

        :param drawn: transitions of a buffer with labels.
        :return: entries (k, dim) of the observations, and the teachers' actions (k, action_dim),
            scaled to [-1, 1].
        """
        own = self.as_samples(replace(drawn, desired_goal=drawn.episode_goal)).observations
        known = th.as_tensor(np.isfinite(drawn.label).all(axis=1))
        seen = {name: values[known] for name, values in own.items()}
        return seen, self._tensor(drawn.label)[known]

    def sample_transitions(self, batch_size: int) -> GoalTransitions:
        """Sample transitions as arrays, with their origins.

        :param batch_size: transitions to sample, with replacement.
        :return: the transitions.
        :raises ValueError: if the buffer is empty, or has no reward function.
        """
        slot, step = self._draw(batch_size)
        row = slot * (self.horizon + 1) + step
        observation = self.observation.reshape(-1, self.observation.shape[-1])
        achieved = self.achieved_goal.reshape(-1, self.achieved_goal.shape[-1])
        action_row = slot * self.horizon + step

        episode_goal = np.take(self.desired_goal, slot, axis=0)
        desired = episode_goal.copy()
        goal_step = self._relabel(desired, slot, step)
        next_achieved = np.take(achieved, row + 1, axis=0)
        return GoalTransitions(
            observation=np.take(observation, row, axis=0),
            achieved_goal=np.take(achieved, row, axis=0),
            desired_goal=desired,
            action=np.take(self.action.reshape(-1, self.action_dim), action_row, axis=0),
            episode_goal=episode_goal,
            reward=self._rewards(next_achieved, desired),
            label=np.take(self.label.reshape(-1, self.action_dim), action_row, axis=0),
            cost=np.take(self.cost.reshape(-1), action_row),
            next_observation=np.take(observation, row + 1, axis=0),
            next_achieved_goal=next_achieved,
            advised=np.take(self.advised.reshape(-1), action_row),
            slot=slot,
            step=step,
            goal_step=goal_step,
        )

    def _relabel(self, desired: FloatArray, slot: IntArray, step: IntArray) -> IntArray:
        """Replace parts of ``desired`` (batch, goal_dim) by parts achieved later, in place.

        :return: (batch, parts) the steps at which they were achieved, -1 where a part is unchanged.
        """
        shape = (len(slot), len(self.part_columns))
        later = self._random.random(shape) * (self.length[slot] - step)[:, None]
        goal_step = step[:, None] + 1 + later.astype(np.int64)
        relabelled = self._random.random(shape) < self.relabel_probability
        for part, columns in enumerate(self.part_columns):
            chosen = relabelled[:, part]
            rows = slot[chosen], goal_step[chosen, part]
            desired[chosen, columns] = self.achieved_goal[*rows, columns]
        return np.where(relabelled, goal_step, -1)

    def _rewards(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Compute (batch, rewards): of the goal, or of each part as if the others are reached."""
        if len(self.part_columns) == 1:
            return self._reward(achieved, desired)[:, None]
        rewards = []
        for columns in self.part_columns:
            asked = achieved.copy()
            asked[:, columns] = desired[:, columns]
            rewards.append(self._reward(achieved, asked))
        joined = np.stack(rewards, axis=1)
        if self.team_rewards:
            joined[:] = joined.mean(axis=1, keepdims=True)
        return joined

    def _reward(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Compute rewards (batch,) and check their shape."""
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


class DemonstrationReplayBuffer(GoalReplayBuffer):
    """Replay that draws a fixed fraction of each batch from a second buffer, ``demonstrations``.

    The fraction does not depend on the number of demonstrations, as in RLPD (Ball et al.,
    arXiv 2302.02948: one half). Both buffers relabel goals. ``add`` and ``size`` refer to the
    student's own transitions. While one buffer is empty, batches come from the other.

    :param buffer_size: of the student's own transitions.
    :param arguments: as for ``GoalReplayBuffer``.
    :param demonstration_size: capacity of ``demonstrations`` in transitions.
    :param demonstration_fraction: fraction of each batch, in [0, 1).
    :raises ValueError: if the fraction or a size does not fit.
    """

    def __init__(
        self,
        buffer_size: int,
        *arguments: Any,
        demonstration_size: int,
        demonstration_fraction: float = 0.5,
        **named: Any,
    ) -> None:
        share = demonstration_fraction
        require("demonstration_fraction", share, 0.0 <= share < 1.0, "in [0, 1)")
        super().__init__(buffer_size, *arguments, **named)
        seed = named.pop("seed", None)
        # A separate stream: one buffer's draws must not shift the other's.
        own = None if seed is None else int(np.random.SeedSequence([seed, 1]).generate_state(1)[0])
        self.demonstrations = GoalReplayBuffer(demonstration_size, *arguments, seed=own, **named)
        self.demonstration_fraction = share

    def sample_transitions(self, batch_size: int) -> GoalTransitions:
        """Sample transitions from both buffers; demonstrations' slots start at ``n_slots``.

        :param batch_size: transitions to sample, with replacement.
        :return: the transitions, the student's own first.
        :raises ValueError: if both buffers are empty, or there is no reward function.
        """
        n_shown = round(self.demonstration_fraction * batch_size)
        if self.size() == 0:
            n_shown = batch_size
        if self.demonstrations.size() == 0:
            n_shown = 0
        # It may have been set, or replaced, after construction.
        self.demonstrations.reward_function = self.reward_function
        if n_shown == 0:
            return super().sample_transitions(batch_size)
        demonstrated = self.demonstrations.sample_transitions(n_shown)
        demonstrated.slot[:] += self.n_slots
        if n_shown == batch_size:
            return demonstrated
        own, shown = vars(super().sample_transitions(batch_size - n_shown)), vars(demonstrated)
        joined = {name: np.concatenate((value, shown[name])) for name, value in own.items()}
        return GoalTransitions(**joined)

    def end_running_episodes(self) -> None:
        """End the running episodes of both buffers."""
        super().end_running_episodes()
        self.demonstrations.end_running_episodes()

    def save_npz(self, path: str | Path) -> None:
        """Write both buffers, the demonstrations to ``demonstrations.npz`` in the same folder.

        :param path: of the student's own transitions.
        :raises OSError: if a file cannot be written.
        """
        super().save_npz(path)
        self.demonstrations.save_npz(Path(path).with_name(DEMONSTRATIONS_FILE))

    def load_npz(self, path: str | Path) -> None:
        """Restore both buffers from ``save_npz``.

        :param path: of the student's own transitions.
        :raises FileNotFoundError: if a file is missing.
        :raises ValueError: if a file is damaged, of another format, or of another shape.
        """
        super().load_npz(path)
        self.demonstrations.load_npz(Path(path).with_name(DEMONSTRATIONS_FILE))


def _columns_of(
    goal_parts: Sequence[int] | None, observation_space: spaces.Space[Any]
) -> tuple[slice, ...]:
    """Return the columns of each part of a goal.

    :raises ValueError: if the sizes do not add up to the goal's.
    """
    assert isinstance(observation_space, spaces.Dict)
    shape = observation_space["achieved_goal"].shape
    assert shape is not None
    parts = list(shape if goal_parts is None else goal_parts)
    valid = min(parts) >= 1 and sum(parts) == shape[0]
    require("goal_parts", goal_parts, valid, f"positive and add up to {shape[0]}")
    ends = np.cumsum(parts)
    return tuple(slice(int(end) - size, int(end)) for end, size in zip(ends, parts, strict=True))
