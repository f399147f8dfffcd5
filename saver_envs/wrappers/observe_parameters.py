"""Adds what was drawn for an episode to its observation, as privileged information."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from saver_envs.envs.spaces import episodes_of
from saver_envs.episodes import Episodes

#: Entry of the observation. SB3 names a module by it, so it cannot be `parameters`.
KEY = "world_parameters"


class ObserveParameters(
    gymnasium.ObservationWrapper[Any, Any, Any], gymnasium.utils.RecordConstructorArgs
):
    """Adds ``world_parameters`` to the observation: what was drawn for the episode.

    That is privileged information, for teachers and critics.

    The entry has all parameters that vary, in the order of ``info["parameters"]``. Each number is
    scaled to [-1, 1] between the ends of its distribution; one that is always the same is 0.

    :param env: an environment of this package with ``randomization``, possibly wrapped.
    :raises TypeError: for an environment of another package.
    :raises ValueError: for one whose worlds do not vary.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        gymnasium.ObservationWrapper.__init__(self, env)
        self.observation_space = with_parameters(env.observation_space, episodes_of(env))

    def observation(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Return an observation with the parameters of the episode."""
        return {**observation, KEY: scaled_parameters(episodes_of(self.env))[0]}


class VectorObserveParameters(VectorWrapper[Any, Any, Any]):
    """Does what :class:`ObserveParameters` does for every environment of a vector.

    :param env: a vector environment of this package with ``randomization``, in any autoreset mode.
    :raises TypeError: for an environment of another package.
    :raises ValueError: for one whose worlds do not vary.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        episodes = episodes_of(env)
        self.single_observation_space = with_parameters(env.single_observation_space, episodes)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start episodes."""
        observation, infos = self.env.reset(seed=seed, options=options)
        return self._extended(observation), infos

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Apply one action to every episode."""
        before = scaled_parameters(episodes_of(self.env))
        observation, reward, terminated, truncated, infos = self.env.step(actions)
        for row in np.flatnonzero(infos.get("_final_obs", ())).tolist():
            infos["final_obs"][row] = {**infos["final_obs"][row], KEY: before[row]}
        return self._extended(observation), reward, terminated, truncated, infos

    def _extended(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        return {**observation, KEY: scaled_parameters(episodes_of(self.env))}


def scaled_parameters(episodes: Episodes) -> NDArray[np.float32]:
    """Return what was drawn for n episodes (n, size), each number within [-1, 1]."""
    columns = []
    for parameter, distribution in episodes.settings.randomization.varied:
        low, high = distribution.ends
        drawn = episodes.worlds.values[parameter.name]
        same = high == low
        columns.append(np.zeros_like(drawn) if same else 2 * (drawn - low) / (high - low) - 1)
    return np.clip(np.concatenate(columns, axis=1), -1, 1).astype(np.float32)


def with_parameters(space: Any, episodes: Episodes) -> spaces.Dict:
    """Return the observation space of an episode with its parameters.

    :raises TypeError: for a space that is not a dictionary.
    :raises ValueError: for episodes whose worlds do not vary.
    """
    if not isinstance(space, spaces.Dict):
        raise TypeError(f"observation space {space}: must be a dictionary")
    if not episodes.settings.randomization:
        raise ValueError(
            "randomization='none': nothing varies that could be observed; choose another one when "
            "the environment is made, such as 'wide'"
        )
    size = sum(values.shape[1] for values in episodes.worlds.values.values())
    return spaces.Dict({**space.spaces, KEY: spaces.Box(-1.0, 1.0, (size,), np.float32)})
