"""Off-policy algorithms of SB3 with an advisor between the choice of an action and its execution.

`OffPolicyAlgorithm._sample_action` returns the action to execute and its scaled counterpart for the
replay buffer, after warm-up and exploration noise. Advising there keeps the two equal for every
off-policy algorithm, any number of environments, any action box and HER. A wrapper around the
policy would be bypassed during warm-up and would affect evaluation; a wrapper around the
environment would leave the unadvised action in the buffer.

There are two interfaces to one implementation: `AdvisedTD3(..., advisor=...)` and its siblings, or
`AdvisingCallback(advisor)` on a stock model.
"""

from __future__ import annotations

import io
import pathlib
import warnings
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sb3_contrib import TQC
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors.advising.advisor import Advice, Advisor, make_advisor
from saver_advisors.advising.context import Mask
from saver_advisors.advising.warm_start import warm_start_from_teachers
from saver_advisors.learner.algorithms import GoalLearnerMixin, attribute_of
from saver_advisors.learner.imitation import candidate_values


class AdvisedMixin(OffPolicyAlgorithm):
    """Add an advisor to an off-policy algorithm; put it first among the bases.

    `infos[i]["advised"]` reports to the replay buffer whether environment i was advised,
    `infos[i]["advised_arms"]` which arms were, and `infos[i]["label"]` the teachers' scaled actions
    if the strategy labels states. The saved zip does not contain the teacher: it keeps
    `advice_state` (spent budget, strategy, teacher names), loads with or without an advisor, and a
    resumed run calls `advisor.load_state_dict(model.advice_state)`.

    :param advisor: the advisor, or the arguments of `make_advisor` as a mapping (for configuration
        files; a model loaded with such a mapping continues with the budget that it has spent), or
        None for the plain algorithm. A mapping may also contain `warm_start`: a goal
        learner's networks then start from the teachers', see `warm_start_from_teachers`.
    """

    advisor: Advisor | Mapping[str, Any] | None
    advice_state: dict[str, Any] | None = None
    _advice_mask: Mask | None = None
    _labels: NDArray[np.float32] | None = None
    _episode_steps: NDArray[np.int64] | None = None

    def __init__(
        self, *args: Any, advisor: Advisor | Mapping[str, Any] | None = None, **kwargs: Any
    ) -> None:
        # Set first: SB3's constructor calls _setup_model, which checks the advisor.
        self.advisor = advisor
        super().__init__(*args, **kwargs)

    def _setup_model(self) -> None:
        warm_start = False
        if isinstance(self.advisor, Mapping):
            self.advisor = dict(self.advisor)
            warm_start = self.advisor.pop("warm_start", False)
        advisor = self._ready_advisor()
        if advisor is not None and advisor.gives_labels and isinstance(self, GoalLearnerMixin):
            self.replay_buffer_kwargs.setdefault("labels", True)
        super()._setup_model()
        # A model with an advice state is being loaded, and has trained weights already.
        if warm_start and advisor is not None and self.advice_state is None:
            warm_start_from_teachers(self, advisor.teachers, advisor.mapping)

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, BaseCallback]:
        if _unhook(self):
            # An AdvisingCallback's training was interrupted: start again as the stock model.
            return self._setup_learn(*args, **kwargs)
        # Checked again: the advisor may have been replaced since the model was built.
        advisor = self._ready_advisor()
        if advisor is not None and self.advice_state is not None:
            spent = self.advice_state["budget"]["spent"]
            if advisor.spent < spent:
                warnings.warn(
                    f"this model was saved after {spent} advised steps, but its advisor starts at "
                    f"{advisor.spent}: call advisor.load_state_dict(model.advice_state) to "
                    "continue with the same budget",
                    stacklevel=3,
                )
        return super()._setup_learn(*args, **kwargs)

    def _ready_advisor(self) -> Advisor | None:
        """Build the advisor from its arguments if needed, and check it against the spaces."""
        if isinstance(self.advisor, Mapping):
            self.advisor = make_advisor(
                **self.advisor,
                episodes=None if self.env is None else attribute_of(self.env, "episodes"),
                observation_space=self.observation_space,
                action_space=self.action_space,
            )
            if self.advice_state is not None:
                # A configuration file cannot call this itself.
                self.advisor.load_state_dict(self.advice_state)
        elif self.advisor is not None:
            self.advisor.check_spaces(self.observation_space, self.action_space)
        return self.advisor

    def _sample_action(
        self, learning_starts: int, action_noise: ActionNoise | None = None, n_envs: int = 1
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        action, buffer_action = super()._sample_action(learning_starts, action_noise, n_envs)
        advisor = self.advisor
        if not isinstance(advisor, Advisor):
            self._advice_mask = self._labels = None
            return action, buffer_action
        compared = None
        if advisor.needs_noise_free:
            assert self._last_obs is not None, "learn() resets the environments first"
            compared, _ = self.predict(self._last_obs, deterministic=True)
        advice = advisor.advise(
            self._raw_observation(),
            action,
            compared,
            episode_steps=self._count_episode_steps(),
            student_values=self._student_values,
        )
        self._labels = None
        if advisor.labels is not None:
            box: Any = self.action_space
            labels = np.clip(advisor.labels, box.low, box.high)
            self._labels = self.policy.scale_action(labels)
        return self._follow(advice, action, buffer_action)

    def _student_values(self, actions: NDArray[Any]) -> NDArray[np.float32]:
        """Compute the critics' conservative values of actions in the latest observation.

        :param actions: (k, n_envs, action size), in the environment's units, clipped to its box.
        :return: (k, n_envs, values): the minimum over the critics, or the mean of TQC's quantiles.
        :raises TypeError: if the model has no critic.
        """
        policy: Any = self.policy
        if getattr(policy, "critic", None) is None:
            raise TypeError(
                f"{type(self).__name__} has no critic of actions: use DDPG, TD3, SAC or TQC"
            )
        box: Any = self.action_space
        tensors, _ = policy.obs_to_tensor(self._last_obs)
        scaled = policy.scale_action(np.clip(actions, box.low, box.high))
        return candidate_values(policy.critic, tensors, scaled)

    def demonstrate(self, steps: int, replay_buffer: ReplayBuffer) -> None:
        """Let the teachers control every arm, without noise; each step costs one of the budget.

        :param steps: environment steps, summed over all environments; rounded up to whole steps of
            the vector environment.
        :param replay_buffer: where the transitions are stored.
        :raises ValueError: if the budget does not suffice, or some arm must not be advised.
        :raises TypeError: if the model has no advisor.
        """
        advisor = self._ready_advisor()
        if not isinstance(advisor, Advisor):
            raise TypeError("a model without an advisor has no teachers to demonstrate")
        assert self.env is not None and self._last_obs is not None, "reset the environments first"
        self._labels = None
        nothing = np.zeros((self.n_envs, *(self.action_space.shape or ())), np.float32)
        for _ in range(-(-steps // self.n_envs)):
            self._count_episode_steps()
            advice = advisor.demonstrate(self._raw_observation())
            executed, stored = self._follow(advice, nothing, nothing)
            new_obs, rewards, dones, infos = self.env.step(executed)
            self.num_timesteps += self.n_envs
            self._episode_num += int(dones.sum())
            self._store_transition(replay_buffer, stored, new_obs, rewards, dones, infos)  # type: ignore[arg-type]
        self._advice_mask = self._labels = None

    def _raw_observation(self) -> dict[str, NDArray[Any]]:
        """The observation before `VecNormalize`: teachers have a normaliser of their own."""
        observation = self._last_obs if self._vec_normalize_env is None else self._last_original_obs
        assert isinstance(observation, dict), "check_spaces lets only Dict observations through"
        return observation

    def _count_episode_steps(self) -> NDArray[np.int64]:
        """Return the steps since the start of each environment's episode, (n_envs,).

        SB3 marks the first observations after a reset in `_last_episode_starts`, but its off-policy
        algorithms do not update it afterwards; `_store_transition` does. If advice begins in the
        middle of an episode, that episode counts from there.
        """
        if self._episode_steps is None or self._last_episode_starts is None:
            self._episode_steps = np.zeros(self.n_envs, dtype=np.int64)
        else:
            self._episode_steps = np.where(self._last_episode_starts, 0, self._episode_steps + 1)
        return self._episode_steps

    def _follow(
        self, advice: Advice, action: NDArray[Any], buffer_action: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Replace the advised arms' blocks in the action to execute and its scaled counterpart."""
        advised_action, mask = advice
        self._advice_mask = mask
        if not mask.any():
            return action, buffer_action
        box: Any = self.action_space
        replaced = np.repeat(mask, action.shape[1] // mask.shape[1], axis=1)
        executed = np.where(replaced, np.clip(advised_action, box.low, box.high), action)
        # All other entries stay bit-equal to the student's.
        stored = np.where(replaced, self.policy.scale_action(executed), buffer_action)
        stored = stored.astype(buffer_action.dtype, copy=False)
        return executed.astype(action.dtype, copy=False), stored

    def _store_transition(
        self,
        replay_buffer: ReplayBuffer,
        buffer_action: NDArray[Any],
        new_obs: NDArray[Any] | dict[str, NDArray[Any]],
        reward: NDArray[Any],
        dones: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        if self._advice_mask is not None:
            # New dicts: an environment may return the same one twice.
            infos = [
                {**info, "advised": bool(arms.any()), "advised_arms": arms.tolist()}
                for info, arms in zip(infos, self._advice_mask, strict=True)
            ]
        if self._labels is not None:
            infos = [
                {**info, "label": label} for info, label in zip(infos, self._labels, strict=True)
            ]
        super()._store_transition(replay_buffer, buffer_action, new_obs, reward, dones, infos)
        self._last_episode_starts = dones

    def dump_logs(self) -> None:
        """Write log data, the advice figures among them."""
        if isinstance(self.advisor, Advisor):
            for name, value in self.advisor.log_values().items():
                self.logger.record(name, value)
            self.advisor.start_window()
        super().dump_logs()

    def save(self, path: str | pathlib.Path | io.BufferedIOBase, *args: Any, **kwargs: Any) -> None:
        """Save to a zip file, with the state of the advice but without the teacher.

        :param path: of the file.
        :param args: SB3's ``exclude`` and ``include``.
        :param kwargs: the same by name.
        """
        if isinstance(self.advisor, Advisor):
            self.advice_state = self.advisor.state_dict()
        super().save(path, *args, **kwargs)

    def _excluded_save_params(self) -> list[str]:
        own = ["advisor", "_advice_mask", "_labels", "_episode_steps", "_plain_class"]
        return [*super()._excluded_save_params(), *own]


@cache
def build_advised(algorithm_class: type[BaseAlgorithm]) -> type[AdvisedMixin]:
    """Return the advised subclass of an algorithm; the same class for every call.

    :param algorithm_class: an off-policy algorithm of SB3, sb3-contrib or your own.
    :return: a subclass of `AdvisedMixin` and the algorithm.
    :raises TypeError: for anything else, such as an on-policy algorithm.
    """
    if not isinstance(algorithm_class, type) or not issubclass(algorithm_class, OffPolicyAlgorithm):
        name = getattr(algorithm_class, "__name__", repr(algorithm_class))
        raise TypeError(
            f"{name} cannot be advised: it learns from its own policy's actions only, and a "
            "teacher's action in its rollouts would bias the update. Use an off-policy algorithm: "
            "DDPG, TD3, SAC, TQC or a subclass"
        )
    if issubclass(algorithm_class, AdvisedMixin):
        return algorithm_class
    name = algorithm_class.__name__
    doc = f"{name} with an advisor; constructor as {name}'s, plus `advisor`."
    body = {"__module__": __name__, "__doc__": doc}
    return type(f"Advised{name}", (AdvisedMixin, algorithm_class), body)


AdvisedDDPG = build_advised(DDPG)
AdvisedTD3 = build_advised(TD3)
AdvisedSAC = build_advised(SAC)
AdvisedTQC = build_advised(TQC)


def _unhook(model: Any) -> bool:
    """Give a stock model its own class back and keep `advice_state`.

    :return: whether it was a stock model that an `AdvisingCallback` had changed.
    """
    if "_plain_class" not in vars(model):
        return False
    model.advice_state = model.advisor.state_dict()
    model.__class__ = model._plain_class
    for name in ("advisor", "_advice_mask", "_labels", "_episode_steps", "_plain_class"):
        vars(model).pop(name, None)
    return True


class AdvisingCallback(BaseCallback):
    """Advise a stock off-policy model while `learn` runs.

    Meanwhile the model is an instance of `build_advised(its class)`, so the code of `AdvisedTD3`
    and its siblings runs, and checkpoints keep `advice_state` and omit the teacher. Afterwards the
    model has its own class again, and keeps `advice_state`.

    :param advisor: the advisor.
    :param verbose: as in SB3.
    """

    def __init__(self, advisor: Advisor, verbose: int = 0) -> None:
        super().__init__(verbose)
        self.advisor = advisor

    def _init_callback(self) -> None:
        """Check the model before training starts."""
        build_advised(type(self.model))
        if isinstance(self.model, AdvisedMixin) and self.model.advisor not in (None, self.advisor):
            raise ValueError(
                "the model has another advisor already: use either its own or the callback's"
            )
        self.advisor.check_spaces(self.model.observation_space, self.model.action_space)

    def _on_training_start(self) -> None:
        model: Any = self.model
        if not isinstance(model, AdvisedMixin):
            model._plain_class = type(model)
            model.__class__ = build_advised(type(self.model))
        model.advisor = self.advisor
        model._advice_mask = model._labels = model._episode_steps = None

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        model: Any = self.model
        # RL Zoo calls this twice; at the second call a stock model no longer has an advisor.
        if not _unhook(model) and isinstance(model, AdvisedMixin):
            model.advice_state = self.advisor.state_dict()
            model.advisor = None
