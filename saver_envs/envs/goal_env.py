"""The Gymnasium adapter: one episode, goal-conditioned."""

from __future__ import annotations

from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium_robotics.core import GoalEnv
from numpy.typing import NDArray

from saver_envs.cameras.rendering import DEFAULT_CAMERA, DEFAULT_SIZE
from saver_envs.control import InverseKinematics
from saver_envs.envs.pictures import RENDER_FPS, RENDER_MODES, Pictures
from saver_envs.envs.spaces import action_space, observation_space
from saver_envs.registration import make_episodes


class SaverGoalEnv(GoalEnv):
    """One episode of a registered id behind the goal API.

    It can be pickled and deep-copied in the midst of an episode: the copy goes on identically.

    :param env_id: a registered id; ``gymnasium.make`` fills it in.
    :param render_mode: ``human``, ``rgb_array``, ``depth_array`` or ``None``.
    :param width: pixels of a picture.
    :param height: pixels of a picture.
    :param camera_name: ``front``, ``three_quarter``, ``side`` or ``overhead``.
    :param inverse_kinematics: replaces damped least squares.
    :param options: of :class:`saver_envs.registration.ControlOptions`, and the task's fields.
    :raises ValueError: for an unknown id, render mode or camera, or an option out of range.
    :raises TypeError: for an unknown option.
    """

    metadata: ClassVar[dict[str, Any]] = {
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
        inverse_kinematics: InverseKinematics | None = None,
        **options: Any,
    ) -> None:
        self.render_mode = render_mode
        self.episodes = make_episodes(env_id, 1, 1, inverse_kinematics, **options)
        self.observation_space = observation_space(self.episodes)
        self.action_space = action_space(self.episodes)
        self._pictures = Pictures(self.episodes, render_mode, width, height, camera_name)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
        """Start an episode.

        :param seed: makes this and the following episodes reproducible.
        :param options: none are known; given for the API's sake.
        :return: observation and info.
        """
        super().reset(seed=seed)
        self.episodes.set_generator(0, self.np_random)
        outcome = self.episodes.reset()
        if self.render_mode == "human":
            self.render()
        return self._observation(), outcome.info_of(0)

    def step(
        self, action: NDArray[np.floating]
    ) -> tuple[dict[str, NDArray[np.float32]], float, bool, bool, dict[str, Any]]:
        """Apply one action for 0.04 s.

        :param action: (action_size,), clipped to [-1, 1].
        :return: observation, reward, terminated (never), truncated, info.
        :raises ValueError: for a wrong shape or a value that is not finite; nothing has changed.
        """
        values = np.asarray(action)
        if values.shape != self.action_space.shape:
            raise ValueError(
                f"action of shape {values.shape}: must have shape {self.action_space.shape}"
            )
        outcome = self.episodes.step(values[None])
        if self.render_mode == "human":
            self.render()
        return (
            self._observation(),
            float(outcome.reward[0]),
            False,
            bool(outcome.truncated[0]),
            outcome.info_of(0),
        )

    def _observation(self) -> dict[str, NDArray[np.float32]]:
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

    def compute_reward(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> Any:
        """Return the reward of goals (..., goal_size), shape (...); pure."""
        return self.episodes.task.reward(np.asarray(achieved_goal), np.asarray(desired_goal))

    def compute_terminated(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> Any:
        """Return False for each of the goals (..., goal_size): episodes never end early."""
        return np.zeros(np.shape(achieved_goal)[:-1], dtype=bool)[()]

    def compute_truncated(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: Any = None,
    ) -> Any:
        """Return False for each of the goals: the clock, not the goal, truncates."""
        return np.zeros(np.shape(achieved_goal)[:-1], dtype=bool)[()]

    def render(self) -> Any:
        """Draw the scene.

        :return: (height, width, 3) uint8 or (height, width) float32 metres; ``None`` in ``human``
            mode, where a window shows it, and without a render mode.
        """
        return self._pictures.draw()

    def close(self) -> None:
        """Free window and graphics context."""
        self._pictures.close()
