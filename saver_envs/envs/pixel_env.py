"""The adapter whose observations are pictures of the RGB-D camera over the bench."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import KINECT_V2, measured_depth
from saver_envs.envs.pictures import Pictures
from saver_envs.envs.single_episode import GymnasiumEpisode
from saver_envs.episodes import Outcome
from saver_envs.people.bench import CAMERA
from saver_envs.simulation import ACTION_DURATION, CONTACT_SAMPLES

#: Separates the noise's random stream from that of the episode with the same seed.
_NOISE_STREAM = 0x905E
#: Tolerance for rounding where actions and pictures coincide (s).
_ROUNDING = 1e-9


class SaverPixelEnv(GymnasiumEpisode):
    """An episode of an id with a camera, observed through that camera.

    The observation is the newest picture: ``rgb`` (424, 512, 3) and ``depth`` (424, 512), in metres
    along the view, with the Kinect's noise, and 0 where it measures nothing. The camera takes 30
    pictures per second and an agent acts 25 times, so a picture is up to 0.033 s old;
    ``info["picture_age"]`` has its age. It shows the last of the four samples of an action before
    the picture is due.

    The goal follows from the hips, which the picture shows, so there is no ``desired_goal``.
    Episodes, actions, rewards and ``info`` are those of the underlying id from the same seed. It
    can be pickled and deep-copied within an episode.

    :param env_id: the underlying id; ``gymnasium.make`` fills it in.
    :param depth_noise: whether depth has the sensor's noise.
    :param options: of :class:`SaverGoalEnv`; ``width``, ``height`` and ``camera_name`` are those of
        rendered pictures, not of the observation.
    :raises ValueError: for an id without a camera, an unknown render mode or camera, or an option
        out of range.
    :raises TypeError: for an unknown option.
    """

    def __init__(self, env_id: str, *, depth_noise: bool = True, **options: Any) -> None:
        super().__init__(env_id, **options)
        view = KINECT_V2.width, KINECT_V2.height, CAMERA
        self._eye = Pictures(self.episodes, None, *view, plain=True)
        self.episodes.simulation.keep_samples = True
        size = (KINECT_V2.height, KINECT_V2.width)
        self.observation_space = spaces.Dict(
            {
                "rgb": spaces.Box(0, 255, (*size, 3), np.uint8),
                "depth": spaces.Box(0.0, KINECT_V2.farthest, size, np.float32),
            }
        )
        self._depth_noise = depth_noise
        self._noise = np.random.default_rng()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.episodes.simulation.keep_samples = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode; the first picture is taken at once.

        :param seed: makes this and the following episodes reproducible, with their noise.
        :param options: none are known; given for the API's sake.
        :return: observation and info.
        """
        if seed is not None:
            self._noise = np.random.default_rng([seed, _NOISE_STREAM])
        return super().reset(seed=seed, options=options)

    def _times(self) -> tuple[float, float]:
        """Return the time of the episode now, and that of its newest picture, seconds."""
        now = int(self.episodes.elapsed[0]) * ACTION_DURATION
        return now, math.floor(now * KINECT_V2.rate + _ROUNDING) / KINECT_V2.rate

    def _observation(self) -> dict[str, NDArray[Any]]:
        now, taken = self._times()
        simulation = self.episodes.simulation
        qpos = simulation.qpos[0]
        if now:
            since_action = taken - (now - ACTION_DURATION)
            sample = math.floor(since_action / ACTION_DURATION * CONTACT_SAMPLES + _ROUNDING)
            qpos = simulation.samples[sample, 0]
        picture = self._eye.of(0, qpos)
        exact = picture.depth()
        depth = measured_depth(exact, KINECT_V2, self._noise if self._depth_noise else None)
        return {"rgb": picture.rgb(), "depth": np.clip(depth, 0.0, KINECT_V2.farthest)}

    def _info(self, outcome: Outcome) -> dict[str, Any]:
        now, taken = self._times()
        return {**super()._info(outcome), "picture_age": now - taken}

    def close(self) -> None:
        """Free windows and graphics contexts."""
        super().close()
        self._eye.close()
