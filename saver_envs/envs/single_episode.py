"""What the adapters of a single episode share: how it is built and rendered."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import displays_named
from saver_envs.cameras.rendering import DEFAULT_CAMERA, DEFAULT_SIZE
from saver_envs.control import checked_action
from saver_envs.envs.pictures import RENDER_FPS, RENDER_MODES, Pictures
from saver_envs.envs.spaces import action_space, warn_if_short
from saver_envs.episodes import Outcome
from saver_envs.registration import make_episodes


class SingleEpisode:
    """One episode of a registered id that can be rendered; base of the adapters.

    Its arguments are documented at :class:`saver_envs.envs.goal_env.SaverGoalEnv`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's base class declares it like this)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(
        self,
        env_id: str,
        render_mode: str | None = None,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera_name: str = DEFAULT_CAMERA,
        **options: Any,
    ) -> None:
        self.render_mode = render_mode
        self.episodes = make_episodes(env_id, **options)
        self._pictures = Pictures(self.episodes, render_mode, width, height, camera_name)
        if not displays_named():
            # Gymnasium's checker opens every mode that an environment offers.
            modes = [mode for mode in RENDER_MODES if mode != "human"]
            self.metadata = {**self.metadata, "render_modes": modes}

    def _shown(self, outcome: Outcome) -> Outcome:
        """Show the present state in the window, if there is one."""
        if self.render_mode == "human":
            self.render()
        return outcome

    def _observation(self) -> dict[str, NDArray[Any]]:
        """Return what the episode's agent sees: observation, achieved goal, desired goal."""
        return {name: rows[0] for name, rows in self.episodes.observation().as_dict().items()}

    @property
    def model(self) -> mujoco.MjModel:
        """The model of the episode, with the fields that it has now; changing it has no effect."""
        return self.episodes.simulation.model_of(0)

    @property
    def data(self) -> mujoco.MjData:
        """The state of the episode as MuJoCo's data, copied; changing it has no effect."""
        data = mujoco.MjData(self.episodes.scene.model)
        self.episodes.simulation.copy_into(0, data)
        return data

    def render(self) -> Any:
        """Draw the scene.

        :return: (height, width, 3) uint8 or (height, width) float32 metres; ``None`` in ``human``
            mode, where a window shows it, and without a render mode.
        """
        return self._pictures.draw()

    def close(self) -> None:
        """Close the window and free the graphics context."""
        self._pictures.close()


class GymnasiumEpisode(SingleEpisode, gymnasium.Env[Any, Any]):
    """Base of Gymnasium's adapters."""

    def __init__(self, env_id: str, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(env_id, render_mode, **options)
        self.action_space = action_space(self.episodes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode.

        :param seed: makes this and the following episodes reproducible.
        :param options: none are known; given for the API's sake.
        :return: observation and info.
        """
        super().reset(seed=seed)
        if self.spec is not None:
            warn_if_short(self.episodes, int(self.episodes.elapsed[0]))
        self.episodes.set_generator(0, self.np_random)
        outcome = self._shown(self.episodes.reset())
        return self._observation(), self._info(outcome)

    def step(
        self, action: NDArray[np.floating]
    ) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Apply one action for 0.04 s.

        :param action: (action_size,), clipped to [-1, 1].
        :return: observation, reward, terminated (never), truncated, info.
        :raises ValueError: for a wrong shape or a value that is not finite; nothing has changed.
        :raises gymnasium.error.ResetNeeded: before the first reset.
        """
        checked = checked_action(action, (self.episodes.action_size,))
        outcome = self._shown(self.episodes.step(checked[None]))
        # Gymnasium's `TimeLimit` counts the steps of what `gymnasium.make` built.
        over = outcome.truncated if self.spec is None else outcome.diverged
        seen = self._observation()
        return seen, float(outcome.reward[0]), False, bool(over[0]), self._info(outcome)

    def _info(self, outcome: Outcome) -> dict[str, Any]:
        return outcome.info_of(0)
