"""Adds estimated human joints to the observation, of a single environment or of a vector."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.cameras.rgbd import KINECT_V2, Camera, camera_of, measured_depth, pose_of
from saver_envs.envs.vector_env import reset_mask, seed_each
from saver_envs.episodes import Episodes
from saver_envs.perception.lifting import lift
from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import N_JOINTS, limb_indices
from saver_envs.simulation import ACTION_DURATION
from saver_envs.validation import require

Estimator = Callable[[NDArray[np.uint8]], Poses]
#: Parts of the observation that describe a person.
SHAPES: Final = {
    "pose_2d": (N_JOINTS, 2),
    "pose_3d": (N_JOINTS, 3),
    "pose_scores": (N_JOINTS,),
    "pose_scores_3d": (N_JOINTS,),
}
#: What is added to the observation.
KEYS: Final = (*SHAPES, "pose_age")
#: "Age" before the first result (s).
NEVER: Final = 1e3


class PoseObservation(
    gymnasium.Wrapper[dict[str, Any], Any, dict[str, Any], Any], RecordConstructorArgs
):
    """Adds the joints of the person with the highest confidence.

    The observation gains ``pose_2d`` (14, 2) in pixels, ``pose_3d`` (14, 3) in metres in the world
    frame, ``pose_scores`` (14,) and ``pose_scores_3d`` (14,), confidences in [0, 1], and
    ``pose_age`` (1,), the time since the picture was taken, in seconds. A joint that was not found,
    or that has no depth, reads zero with confidence zero.

    :param env: an environment of this package, with dictionary observations.
    :param camera: name of one of its cameras.
    :param limbs: limbs that the network detects; all 13 by default.
    :param estimator: from a picture (height, width, 3) to people; the shipped network where
        ``None``, which imports torch.
    :param rate: pictures per second.
    :param latency: seconds from a picture to its result: a slow network gives stale poses.
    :param turn: quarter turns that put heads roughly at the top of the picture.
    :param depth_noise: whether depth has the sensor's noise.
    :param width: of the pictures, pixels.
    :param height: of the pictures, pixels.
    :raises TypeError: for observations that are not dictionaries.
    :raises ValueError: for an unknown camera or limb, or a rate or latency out of range.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        camera: str,
        limbs: Sequence[str] | None = None,
        estimator: Estimator | None = None,
        **options: Any,
    ) -> None:
        RecordConstructorArgs.__init__(
            self, _disable_deepcopy=True, camera=camera, limbs=limbs, estimator=estimator, **options
        )
        gymnasium.Wrapper.__init__(self, env)
        unwrapped: Any = env.unwrapped
        self._eye = PoseCamera(unwrapped.episodes, camera, limbs, estimator, **options)
        self.observation_space = self._eye.extended(env.observation_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; the first picture is taken at once."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._eye.begin(0, seed)
        return {**observation, **self._eye.entries(0)}, info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Apply an action."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._eye.times += ACTION_DURATION
        seen = {**observation, **self._eye.entries(0)}
        return seen, reward, terminated, truncated, info

    def close(self) -> None:
        """Free the graphics context as well."""
        self._eye.close()
        super().close()


class VectorPoseObservation(VectorWrapper):
    """Does what :class:`PoseObservation` does for every environment of a vector.

    :param env: a vector of this package that resets at the next step, or leaves it to the caller.
    :param camera: name of one of its cameras.
    :param options: further arguments of :class:`PoseObservation`.
    :raises ValueError: for a vector that resets in the step that ends an episode: the last picture
        of an episode could not be taken.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], camera: str, **options: Any) -> None:
        super().__init__(env)
        self._mode = env.metadata.get("autoreset_mode")
        if self._mode is AutoresetMode.SAME_STEP:
            raise ValueError("autoreset_mode='SameStep': must be 'NextStep' or 'Disabled'")
        unwrapped: Any = env.unwrapped
        self._eye = PoseCamera(unwrapped.episodes, camera, **options)
        self.single_observation_space = self._eye.extended(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._over = np.zeros(env.num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start episodes, all or those of ``options["reset_mask"]``."""
        given: Any = seed  # Gymnasium's own type leaves out what its vectors take
        observation, info = self.env.reset(seed=given, options=options)
        seeds = seed_each(seed, self.num_envs)
        rows = np.flatnonzero(reset_mask(options, self.num_envs))
        for row in rows.tolist():
            self._eye.begin(row, seeds[row])
        self._over[rows] = False
        return self._with_poses(observation), info

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Apply one action to every environment."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self._eye.times += ACTION_DURATION
        if self._mode is AutoresetMode.NEXT_STEP:
            for row in np.flatnonzero(self._over).tolist():
                self._eye.begin(row)
        self._over = np.asarray(terminated) | np.asarray(truncated)
        return self._with_poses(observation), reward, terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Free the graphics context as well."""
        self._eye.close()
        super().close(**kwargs)

    def _with_poses(self, observation: dict[str, Any]) -> dict[str, Any]:
        rows = [self._eye.entries(row) for row in range(self.num_envs)]
        return {**observation, **{key: np.stack([one[key] for one in rows]) for key in KEYS}}


@dataclass(frozen=True)
class PoseReading:
    """One person, the most certain one, as observed.

    :param entries: by the names of :data:`SHAPES`: joints in pixels, joints in metres in the world
        frame, and confidences in [0, 1] of both; 0 where a joint was not found or has no depth.
    :param taken: when the picture was taken, seconds of the episode; minus infinity where there
        was none.
    """

    entries: dict[str, NDArray[np.float32]]
    taken: float = -math.inf

    @staticmethod
    def nothing(taken: float = -math.inf) -> PoseReading:
        """Return a reading without joints: before the first result, or of an empty picture."""
        return PoseReading({name: np.zeros(s, np.float32) for name, s in SHAPES.items()}, taken)


class PoseStream:
    """Takes pictures at a rate and returns each result after a latency.

    :param rate: pictures per second.
    :param latency: seconds from a picture to its result. Pictures may be taken meanwhile, as by a
        camera with a pipeline behind it.
    """

    def __init__(self, rate: float, latency: float) -> None:
        self._rate, self._latency = rate, latency
        self.reset()

    def reset(self) -> None:
        """Begin an episode at time 0."""
        self._taken = 0
        self._waiting: deque[PoseReading] = deque()
        self._latest = PoseReading.nothing()

    def read(self, time: float, look: Callable[[float], PoseReading]) -> PoseReading:
        """Return the newest result available at a time.

        :param time: seconds of the episode, not before the previous call's.
        :param look: takes a picture now and estimates the pose, whose ``taken`` is its argument.
        """
        tolerance = 1e-9
        if time + tolerance >= self._taken / self._rate:
            self._waiting.append(look(time))
            # Pictures that were due between two calls cannot be taken any more.
            self._taken = int((time + tolerance) * self._rate) + 1
        while self._waiting and self._waiting[0].taken + self._latency <= time + tolerance:
            self._latest = self._waiting.popleft()
        return self._latest


class PoseCamera:
    """Camera, estimator and a stream of poses for each of n episodes.

    :param episodes: of a single environment or a vector.

    See :class:`PoseObservation` for the other arguments.
    """

    def __init__(
        self,
        episodes: Episodes,
        camera: str,
        limbs: Sequence[str] | None = None,
        estimator: Estimator | None = None,
        rate: float = 25.0,
        latency: float = 0.0,
        turn: int = 0,
        depth_noise: bool = True,
        width: int = KINECT_V2.width,
        height: int = KINECT_V2.height,
    ) -> None:
        require("rate", rate, 0 < rate < math.inf, "above 0 pictures per second")
        require("latency", latency, 0 <= latency < math.inf, "at least 0 seconds")
        limb_indices(limbs)  # an unknown name is found out here
        self._episodes = episodes
        self._name, self._noise = camera, depth_noise
        scene = self._episodes.scene
        self._camera: Camera = camera_of(scene.model, camera, width, height)
        self._renderer = SceneRenderer(scene, width, height, camera)
        n = self._episodes.n
        self._random = [np.random.default_rng(row) for row in range(n)]
        self._streams = [PoseStream(rate, latency) for _ in range(n)]
        #: (n,) seconds since the episodes began.
        self.times = np.zeros(n)
        if estimator is None:
            from saver_envs.perception.estimator import PoseEstimator

            estimator = PoseEstimator.shipped(list(limbs) if limbs else None, turn=turn)
        self._estimator = estimator

    def begin(self, row: int, seed: int | None = None) -> None:
        """Begin an episode, with depth noise from its seed; ``None`` keeps its generator."""
        if seed is not None:
            self._random[row] = np.random.default_rng([seed, 0x905E])
        self._streams[row].reset()
        self.times[row] = 0.0

    def entries(self, row: int) -> dict[str, NDArray[np.float32]]:
        """Return what is added to the observation of an episode now."""
        time = float(self.times[row])
        reading = self._streams[row].read(time, partial(self._look, row))
        age = min(time - reading.taken, NEVER)
        seen = {name: values.copy() for name, values in reading.entries.items()}
        return {**seen, "pose_age": np.array([age], dtype=np.float32)}

    def _look(self, row: int, now: float) -> PoseReading:
        """Take a picture of an episode and find the person in it."""
        self._renderer.update(self._episodes, row)
        poses = self._estimator(self._renderer.rgb())
        if len(poses) == 0:
            return PoseReading.nothing(now)
        exact = self._renderer.depth()
        depth = measured_depth(exact, self._camera, self._random[row] if self._noise else None)
        space = lift(poses, depth, self._camera, pose_of(self._renderer.data, self._name))
        found = (poses.joints[0], space.positions[0], poses.scores[0], space.scores[0])
        values = (np.nan_to_num(part).astype(np.float32) for part in found)
        return PoseReading(dict(zip(SHAPES, values, strict=True)), now)

    def extended(self, space: Any) -> spaces.Dict:
        """Return the observation space of an episode with what is added to it."""
        if not isinstance(space, spaces.Dict):
            raise TypeError(f"observation space {space}: must be a dictionary")

        size = np.array([self._camera.width, self._camera.height], dtype=np.float32)
        limits = ((0.0, size), (-np.inf, np.inf), (0.0, 1.0), (0.0, 1.0), (0.0, NEVER))
        added = {}
        for key, shape, (low, high) in zip(KEYS, (*SHAPES.values(), (1,)), limits, strict=True):
            lower, upper = (np.full(shape, limit, np.float32) for limit in (low, high))
            added[key] = spaces.Box(lower, upper, dtype=np.float32)
        return spaces.Dict({**space.spaces, **added})

    def close(self) -> None:
        """Free the graphics context."""
        self._renderer.close()
