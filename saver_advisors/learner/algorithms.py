"""DDPG, TD3, SAC and TQC as goal-conditioned learners: one mixin over SB3's algorithms.

The mixin keeps the algorithm's own ``train`` and adds

- ``GoalReplayBuffer`` and the goal policies of this package as defaults, with the horizon, the
  reward function and the range of returns from the environment and the discount
- exploration by Gaussian noise and occasional uniform actions (OpenAI baselines' HER), which may be
  held for several steps
- statistics for the policies' normaliser, updated when an episode ends

It is cooperative: ``type("AdvisedTD3", (AdvisedMixin, GoalTD3), {})`` composes. The result of an
outer mixin's ``_sample_action`` is what the environment receives and the buffer stores.
"""

from __future__ import annotations

import io
import pathlib
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch as th
from sb3_contrib import TQC
from stable_baselines3 import DDPG, SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.learner.exploration import HeldActions
from saver_advisors.learner.imitation import ImitatingTD3, candidate_values
from saver_advisors.learner.policies import (
    GoalSACPolicy,
    GoalTD3Policy,
    GoalTQCPolicy,
    NormalizedGoalFeatures,
)
from saver_advisors.learner.replay import GoalReplayBuffer, reward_function_of
from saver_advisors.learner.shared_arms import SharedArmsPolicy
from saver_envs.validation import require

Policies = dict[str, type[BasePolicy]]


def episode_horizon(env: VecEnv) -> int:
    """Return the length of the environment's episodes in steps.

    :param env: a vector env whose environments have an attribute ``horizon``, or a ``spec`` with
        ``max_episode_steps``.
    :return: steps.
    :raises ValueError: if the environment has neither.
    """
    horizon = attribute_of(env, "horizon")
    if horizon is None:
        horizon = getattr(attribute_of(env, "spec"), "max_episode_steps", None)
    if horizon is None:
        # Our own vector env keeps it with the episodes' other settings.
        settings = getattr(attribute_of(env, "episodes"), "settings", None)
        horizon = getattr(settings, "horizon", None)
    if horizon is None:
        raise ValueError(
            "the environment does not report its episode length (no attribute `horizon`, no "
            "`spec.max_episode_steps`): pass replay_buffer_kwargs={'horizon': steps}"
        )
    return int(horizon)


def arms_of(env: VecEnv) -> ArmBlocks:
    """Return where the arms' blocks lie in an environment's observations and goals.

    :param env: our vector env, or SB3's vector env of our goal envs.
    :raises ValueError: for another environment.
    """
    if task_of(env) is None:
        raise ValueError(
            "weights shared by arms need an environment of saver_envs, whose task says where the "
            "arms' blocks are"
        )
    return ArmBlocks.of_episodes(attribute_of(env, "episodes"))


def task_of(env: VecEnv) -> Any:
    """Return the task of a vector environment, an immutable dataclass.

    :param env: our vector env, or SB3's vector env of our goal envs.
    :return: the task, None for a third-party environment.
    """
    return getattr(attribute_of(env, "episodes"), "task", None)


def attribute_of(env: VecEnv, name: str) -> Any:
    """Return an attribute of a vector env's first environment.

    :param env: the vector env.
    :param name: of the attribute.
    :return: its value, None if the environment lacks it.
    """
    # Asked first: in a worker process, a missing attribute ends the process.
    return env.get_attr(name, indices=[0])[0] if env.has_attr(name) else None


class GoalLearnerMixin(OffPolicyAlgorithm):
    """Goal-conditioned learning over an off-policy SB3 algorithm; put it first among the bases.

    :param arguments: as for the algorithm. ``replay_buffer_class`` defaults to
        ``GoalReplayBuffer``; ``horizon`` and ``reward_function`` in ``replay_buffer_kwargs`` to the
        environment's; ``q_min`` in ``policy_kwargs`` to the return of permanent failure, at the
        task's least reward per step.
    :param exploration_noise: standard deviation of Gaussian noise on the scaled action, which spans
        [-1, 1]; SB3's ``action_noise`` works too, with NumPy's global generator.
    :param random_action_probability: fraction of steps with a uniform action instead; see
        ``HeldActions``.
    :param random_action_steps: mean number of steps for which a uniform action is held.
    :raises ValueError: if the probability is outside [0, 1], the noise negative, an action is held
        for less than a step, or the horizon unknown.
    :raises TypeError: if the replay buffer is of another kind.
    """

    replay_buffer: GoalReplayBuffer

    learns_values: ClassVar[bool] = True
    """Whether the critics are trained."""

    is_trained: bool = False
    """Whether the policy was trained before: it then acts from the first step on."""

    training_cost: float
    """Sum of ``cost`` over all collected transitions, if the environment reports it."""

    def __init__(
        self,
        *arguments: Any,
        exploration_noise: float = 0.0,
        random_action_probability: float = 0.2,
        random_action_steps: int = 1,
        **named: Any,
    ) -> None:
        require("exploration_noise", exploration_noise, exploration_noise >= 0, "0 or more")
        self.held_actions = HeldActions(random_action_probability, random_action_steps)
        self.exploration_noise = exploration_noise
        self.random_action_probability = random_action_probability
        self.random_action_steps = random_action_steps
        self.training_cost = 0.0
        super().__init__(*arguments, **named)

    def _setup_model(self) -> None:
        """Build buffer and networks with defaults from the environment and the discount."""
        # Separate streams: the draws of one part must not shift another's.
        seeds = np.random.SeedSequence(self.seed).generate_state(2)
        # Rebuilt here, since SB3's `load` sets the arguments after the constructor.
        self.held_actions = HeldActions(self.random_action_probability, self.random_action_steps)
        self._exploration_random = np.random.default_rng(int(seeds[0]))
        if self.replay_buffer_class is None:
            self.replay_buffer_class = GoalReplayBuffer
        if not issubclass(self.replay_buffer_class, GoalReplayBuffer):
            raise TypeError(
                f"replay_buffer_class={self.replay_buffer_class.__name__} must be "
                "GoalReplayBuffer or a subclass of it"
            )
        if "horizon" not in self.replay_buffer_kwargs:
            if self.env is None:
                raise ValueError("env=None needs replay_buffer_kwargs={'horizon': steps}")
            self.replay_buffer_kwargs["horizon"] = episode_horizon(self.env)
        self._share_arms()
        if isinstance(self, ImitatingTD3) and self.learns_costs:
            self.policy_kwargs.setdefault("n_costs", 1)
            self.replay_buffer_kwargs.setdefault("cost_key", self.cost_key)
        task = None if self.env is None else task_of(self.env)
        least_reward = float(getattr(task, "least_reward", -1.0))
        self.policy_kwargs.setdefault("q_min", least_reward / (1.0 - self.gamma))
        permanent = self.replay_buffer_kwargs
        self.replay_buffer_kwargs = {"seed": int(seeds[1]), **permanent}
        if self.env is not None:
            self.replay_buffer_kwargs.setdefault("reward_function", reward_function_of(self.env))
        try:
            super()._setup_model()
        finally:
            # The reward function holds the environment, which SB3's `save` must not pickle.
            self.replay_buffer_kwargs = permanent

    def _share_arms(self) -> None:
        """Set the arguments that a policy of shared arms needs, as far as they are missing."""
        if not issubclass(self.policy_class, SharedArmsPolicy):
            return
        if not isinstance(self, ImitatingTD3):
            raise TypeError(
                f"{type(self).__name__} learns one value: SharedArmsPolicy, which has one for each "
                "arm, needs GoalTD3"
            )
        if "arms" not in self.policy_kwargs:
            if self.env is None:
                raise ValueError("env=None needs policy_kwargs={'arms': ...} of SharedArmsPolicy")
            self.policy_kwargs["arms"] = arms_of(self.env).to_mapping()
        arms = ArmBlocks.from_mapping(self.policy_kwargs["arms"])
        replay = self.replay_buffer_kwargs
        if replay.get("goal_parts") is None:
            shared = (arms.shared_goal,) * (arms.shared_goal > 0)
            replay["goal_parts"] = (arms.goal,) * arms.n_arms + shared
        # An arm's own goal may be relabelled; what the others did had to do with their own goals.
        replay.setdefault("episode_goals", not replay.get("team_rewards", False))

    def set_env(self, env: Any, force_reset: bool = True) -> None:
        """Set the environment as SB3 does; a buffer without a reward function takes its own."""
        super().set_env(env, force_reset)
        if self.replay_buffer.reward_function is None:
            assert self.env is not None
            self.replay_buffer.reward_function = reward_function_of(self.env)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_exploration_random", "held_actions"]

    def _sample_action(
        self,
        learning_starts: int,
        action_noise: ActionNoise | None = None,
        n_envs: int = 1,
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the algorithm's actions with noise, some of them replaced by uniform ones.

        :return: actions for the environment, and the same scaled to [-1, 1] for the buffer.
        """
        starts = 0 if self.is_trained else learning_starts
        _, stored = super()._sample_action(starts, action_noise, n_envs)
        random = self._exploration_random
        if self.exploration_noise > 0.0:
            noise = self.exploration_noise * random.standard_normal(stored.shape)
            stored = np.clip(stored + noise, -1.0, 1.0)
        stored = self.held_actions.replace(stored, random, self._n_explorers())
        # Rounded as in the buffer, so that executed and stored actions are equal.
        stored = stored.astype(np.float32)
        return np.asarray(self.policy.unscale_action(stored)), stored

    def _n_explorers(self) -> int:
        """Return how many parts of an action take random actions independently of one another."""
        arms = getattr(self.policy, "arms", None)
        return 1 if arms is None else int(arms.n_arms)

    def _store_transition(
        self,
        replay_buffer: ReplayBuffer,
        buffer_action: npt.NDArray[Any],
        new_obs: Any,
        reward: npt.NDArray[Any],
        dones: npt.NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        super()._store_transition(replay_buffer, buffer_action, new_obs, reward, dones, infos)
        self.training_cost += sum(float(info.get("cost", 0.0)) for info in infos)
        features = getattr(self.policy, "shared_features", None)
        if dones.any() and isinstance(features, NormalizedGoalFeatures):
            assert isinstance(replay_buffer, GoalReplayBuffer), "checked by _setup_model"
            features.update(replay_buffer.episodes_of(np.flatnonzero(dones)))

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Train as the algorithm does, unless the buffer is empty."""
        if self.replay_buffer.size() > 0:
            super().train(gradient_steps, batch_size)

    def save_replay_buffer(self, path: str | pathlib.Path | io.BufferedIOBase) -> None:
        """Write the replay buffer by ``GoalReplayBuffer.save_npz``: SB3 would pickle it.

        :param path: of the file.
        :raises TypeError: if it is an open file.
        """
        self.replay_buffer.save_npz(_file_path(path))

    def load_replay_buffer(
        self, path: str | pathlib.Path | io.BufferedIOBase, truncate_last_traj: bool = True
    ) -> None:
        """Restore the replay buffer from ``save_replay_buffer``.

        :param path: of the file.
        :param truncate_last_traj: whether to end running episodes, since the environments are
            reset.
        :raises TypeError: if it is an open file.
        :raises ValueError: if the file is damaged, of another format or of another shape.
        """
        self.replay_buffer.load_npz(_file_path(path))
        if truncate_last_traj:
            self.replay_buffer.end_running_episodes()

    def student_value(
        self, observation: dict[str, npt.NDArray[Any]], action: npt.NDArray[Any]
    ) -> npt.NDArray[Any]:
        """Compute the critics' conservative estimate of Q, averaged over the parts of the goal.

        :param observation: entries (batch, dim).
        :param action: (batch, action_dim), in the environment's units.
        :return: (batch,).
        """
        policy: Any = self.policy
        tensors, _ = policy.obs_to_tensor(observation)
        scaled = policy.scale_action(action)[np.newaxis]
        values = candidate_values(policy.critic, tensors, scaled)[0]
        return th.from_numpy(values).mean(dim=1).numpy()


def _file_path(path: str | pathlib.Path | io.BufferedIOBase) -> str | pathlib.Path:
    if not isinstance(path, (str, pathlib.Path)):
        raise TypeError(f"path={path!r} must be the path of a file, which is written as a whole")
    return path


class GoalDDPG(GoalLearnerMixin, DDPG):
    """``DDPG`` with ``GoalLearnerMixin``."""

    policy_aliases: ClassVar[Policies] = {"MultiInputPolicy": GoalTD3Policy}


class GoalTD3(GoalLearnerMixin, ImitatingTD3):
    """``ImitatingTD3`` with ``GoalLearnerMixin``.

    With the policy ``SharedArmsPolicy``, all arms share the weights of actor and critics; each arm
    has its own hindsight goal and reward.
    """

    policy_aliases: ClassVar[Policies] = {
        "MultiInputPolicy": GoalTD3Policy,
        "SharedArmsPolicy": SharedArmsPolicy,
    }


class GoalSAC(GoalLearnerMixin, SAC):
    """``SAC`` with ``GoalLearnerMixin``."""

    policy_aliases: ClassVar[Policies] = {"MultiInputPolicy": GoalSACPolicy}


class GoalTQC(GoalLearnerMixin, TQC):
    """``TQC`` with ``GoalLearnerMixin``."""

    policy_aliases: ClassVar[Policies] = {"MultiInputPolicy": GoalTQCPolicy}
