"""The Stable-Baselines3 adapter: n episodes in one batch, same-step automatic reset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from saver_envs.cameras.rendering import DEFAULT_CAMERA
from saver_envs.control import InverseKinematics
from saver_envs.envs.pictures import Pictures
from saver_envs.envs.spaces import GoalReward, action_space, observation_space
from saver_envs.episodes import Outcome
from saver_envs.registration import make_episodes

DictObservation = dict[str, NDArray[np.float32]]


class BatchVecEnv(VecEnv):
    """A vector environment that steps all episodes as one batch, without environment objects."""

    _actions: NDArray[np.floating]

    def step_async(self, actions: NDArray[np.floating]) -> None:
        """Keep the actions (n_envs, action_size) for :meth:`step_wait`."""
        self._actions = actions

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for every episode asked for."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the whole vector."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method once and return its result for every episode asked for."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Return False for every episode: there are no single environments to wrap."""
        return [False] * len(list(self._get_indices(indices)))


class SaverVecEnv(GoalReward, BatchVecEnv):
    """n episodes of a registered id as one SB3 vector environment.

    Episode i is seeded with ``seed + i``. It is reset in the step that ends it, with the last
    observation in ``info["terminal_observation"]``.

    :param env_id: a registered id.
    :param n_envs: number of episodes.
    :param seed: seed of episode 0; ``None`` draws one.
    :param threads: native threads of the simulation.
    :param inverse_kinematics: replaces damped least squares.
    :param options: of :class:`saver_envs.registration.ControlOptions`, and the task's fields.
    """

    def __init__(
        self,
        env_id: str,
        n_envs: int = 1,
        seed: int | None = None,
        threads: int = 1,
        inverse_kinematics: InverseKinematics | None = None,
        **options: Any,
    ) -> None:
        self.env_id = env_id
        self.render_mode = "rgb_array"
        self.episodes = make_episodes(env_id, n_envs, threads, inverse_kinematics, **options)
        self._pictures: dict[str, Pictures] = {}
        super().__init__(n_envs, observation_space(self.episodes), action_space(self.episodes))
        if seed is not None:
            self.seed(seed)

    def reset(self) -> DictObservation:
        """Start all episodes and return their observations, (n_envs, ...) each."""
        for index, seed in enumerate(self._seeds):
            if seed is not None:
                self.episodes.set_generator(index, seeding.np_random(seed)[0])
        outcome = self.episodes.reset()
        self.reset_infos = self._infos(outcome)
        self._reset_seeds()
        self._reset_options()
        return self.episodes.observation().as_dict()

    def reset_episodes(self, seeds: Sequence[int]) -> DictObservation:
        """Start all episodes, episode i from ``seeds[i]``.

        :raises ValueError: for another number of seeds than episodes.
        """
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds: one is needed for each of {self.num_envs} envs")
        self._seeds = [int(seed) for seed in seeds]
        return self.reset()

    def step_wait(
        self,
    ) -> tuple[DictObservation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Apply the actions; episodes that end are reset at once."""
        outcome = self.episodes.step(self._actions)
        infos = self._infos(outcome)
        observation = self.episodes.observation().as_dict()
        ended = np.flatnonzero(outcome.truncated)
        if ended.size:
            for index in ended:
                infos[index]["TimeLimit.truncated"] = True
                infos[index]["terminal_observation"] = {
                    name: rows[index].copy() for name, rows in observation.items()
                }
            reset_infos = self._infos(self.episodes.reset(ended))
            for index in ended:
                self.reset_infos[index] = reset_infos[index]
            observation = self.episodes.observation().as_dict()
        return observation, outcome.reward, outcome.truncated, infos

    def _infos(self, outcome: Outcome) -> list[dict[str, Any]]:
        columns = {name: values.tolist() for name, values in outcome.info().items()}
        return [
            dict(zip(columns, row, strict=True)) | outcome.parameters_of(index)
            for index, row in enumerate(zip(*columns.values(), strict=True))
        ]

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """Return a picture of every episode, (480, 640, 3) each."""
        return [self.picture(index) for index in range(self.num_envs)]

    def picture(self, index: int, camera: str = DEFAULT_CAMERA) -> NDArray[np.uint8]:
        """Return a picture (480, 640, 3) of episode ``index``."""
        if camera not in self._pictures:
            self._pictures[camera] = Pictures(self.episodes, "rgb_array", camera=camera)
        return self._pictures[camera].draw(index)

    def close(self) -> None:
        """Free the graphics contexts."""
        while self._pictures:
            self._pictures.popitem()[1].close()
