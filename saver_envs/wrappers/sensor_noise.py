"""Sensor noise on observations: errors at every step and an offset per episode.

:class:`SensorNoise` has the standard deviations. Three wrappers apply it: :class:`NoisySensors` to
    a single environment, :class:`NoisyVectorSensors` to a Gymnasium vector, and
    :class:`saver_envs.wrappers.sb3_sensor_noise.NoisyVecSensors` to one of Stable-Baselines3. An
    episode from the same seed has the same errors in all of them.

Only ``observation`` is disturbed. The achieved goal stays exact, because rewards are computed from
it: otherwise relabelling would give other rewards than the environment.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from saver_envs.envs.vector_env import reset_mask, seed_each
from saver_envs.episodes import Episodes
from saver_envs.robots.description import Fingers
from saver_envs.simulation import multiply_quaternions
from saver_envs.tasks.layout import Layout
from saver_envs.validation import require

Observation = dict[str, NDArray[np.float32]]

#: Separates the errors' random stream from that of the episode with the same seed.
STREAM = 0x5E2503
#: Parts of the observation that get an error of three numbers, in the order in which the errors
#: are drawn, with the field of :class:`SensorNoise` that says how large they are. The object's
#: orientation is turned by its error, the others are added.
_ORIENTATION = "object orientation, a quaternion with w >= 0"
_RELATIVE = "object position relative to the gripper"
_DRAWN = {
    "gripper position": "tool_position",
    "gripper linear velocity": "tool_velocity",
    "finger positions": "finger_position",
    "finger velocities": "finger_velocity",
    "object position": "object_position",
    _ORIENTATION: "object_orientation",
    "object linear velocity": "object_velocity",
    "object angular velocity": "object_angular_velocity",
}


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of Gaussian errors, in SI units, equal for the three axes.

    Arm and fingers have encoders, so their position errors are small, and their velocity errors are
    those of filtered differences. A depth camera 1.2 m above the table (Table 8.1) locates objects
    with errors of some millimetres; its calibration error to the arm's base is constant within an
    episode. Object velocities are differences of camera positions over a few frames. The values are
    ours: the dissertation gives none.

    :param tool_position: m.
    :param tool_velocity: m/s.
    :param finger_position: rad; locked fingers are no measurement and stay exact.
    :param finger_velocity: rad/s.
    :param object_position: m, drawn at every step.
    :param object_offset: m, drawn once per episode.
    :param object_orientation: rad, of a small turn about a random axis.
    :param object_velocity: m/s.
    :param object_angular_velocity: rad/s.
    :raises ValueError: for one that is negative or not finite.
    """

    tool_position: float = 0.001
    tool_velocity: float = 0.01
    finger_position: float = 0.01
    finger_velocity: float = 0.05
    object_position: float = 0.003
    object_offset: float = 0.005
    object_orientation: float = 0.03
    object_velocity: float = 0.03
    object_angular_velocity: float = 0.3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(name, value, 0 <= value < np.inf, "finite and at least 0")

    def scaled(self, factor: float) -> SensorNoise:
        """Return the same with every deviation multiplied by ``factor``."""
        return SensorNoise(**{name: factor * value for name, value in vars(self).items()})


class SensorErrors:
    """The errors of n episodes, each with its own random generator.

    :param noise: how large they are.
    :param n: number of episodes.
    :param layout: of the observation.
    :param moving_fingers: whether the fingers are measured.
    """

    def __init__(self, noise: SensorNoise, n: int, layout: Layout, moving_fingers: bool) -> None:
        self.noise = noise
        self._layout = layout
        self._generators = [np.random.default_rng() for _ in range(n)]
        self._offset = np.zeros((n, layout.n_arms, 3))
        measured = {
            part: getattr(noise, name) if moving_fingers or "finger" not in part else 0.0
            for part, name in _DRAWN.items()
        }
        # In the units of the observation, in the order in which they are drawn.
        self._deviation = np.array(
            [value * layout.part(part).scale for part, value in measured.items()]
        )[:, None]

    @classmethod
    def of(cls, noise: SensorNoise, episodes: Episodes) -> SensorErrors:
        """Return the errors for these episodes."""
        task = episodes.task
        moving = task.fingers is Fingers.ACTUATED
        return cls(noise, episodes.n, task.observation_layout, moving)

    def seed(self, index: int, seed: int | None) -> None:
        """Seed the errors of episode ``index`` from now on; ``None`` keeps its generator."""
        if seed is not None:
            self._generators[index] = np.random.default_rng([seed, STREAM])

    def begin(self, rows: Iterable[int]) -> None:
        """Draw the offsets of episodes that have just begun."""
        for row in rows:
            drawn = self._generators[row].standard_normal((self._layout.n_arms, 3))
            self._offset[row] = self.noise.object_offset * drawn

    def disturb(
        self, observation: NDArray[np.floating], rows: Sequence[int] | None = None
    ) -> NDArray[np.float32]:
        """Return observations as the sensors measure them.

        :param observation: (k, observation size), exact; not modified.
        :param rows: (k,) whose it is; all n in order by default.
        :return: (k, observation size). The object relative to the gripper is the difference of
            the two positions as they were measured.
        """
        chosen = list(range(len(self._generators))) if rows is None else list(rows)
        layout, shape = self._layout, (self._layout.n_arms, len(_DRAWN), 3)
        drawn = np.stack([self._generators[row].standard_normal(shape) for row in chosen])
        by_part = (drawn * self._deviation).swapaxes(1, 2).swapaxes(0, 1)
        error = dict(zip(_DRAWN, by_part, strict=True))
        error["object position"] = error["object position"] + self._offset[chosen]
        error[_RELATIVE] = error["object position"] - error["gripper position"]
        seen = np.array(observation, np.float64)
        turn = error.pop(_ORIENTATION)
        for part, values in error.items():
            layout.get(seen, part)[...] += values
        quaternion = layout.get(seen, _ORIENTATION)
        quaternion[...] = _turned(quaternion, turn)
        return seen.astype(np.float32)

    def seen(self, observation: Any, rows: Sequence[int] | None = None) -> Observation:
        """Return an observation as the sensors see it.

        :param observation: of k episodes, or of one without a leading dimension.
        :param rows: (k,) whose it is; all n in order by default.
        """
        exact = observation["observation"]
        disturbed = self.disturb(np.atleast_2d(exact), rows).reshape(exact.shape)
        return {**observation, "observation": disturbed}


def _turned(quaternion: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn (..., 4) unit quaternions with w >= 0 by (..., 3) rotation vectors, radians."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    half = angle / 2
    # sin(a/2)/a without a division by zero; NumPy's sinc has a factor pi.
    small = np.concatenate([np.cos(half), rotation * np.sinc(half / np.pi) / 2], axis=-1)
    turned = multiply_quaternions(small, quaternion)
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(turned[..., :1] < 0, -turned, turned)


def episodes_of(env: Any) -> Episodes:
    """Return the episodes of an environment of this package.

    :raises TypeError: for another environment.
    """
    episodes = getattr(env.unwrapped, "episodes", None)
    if not isinstance(episodes, Episodes):
        raise TypeError(f"env={env!r}: must be an environment of saver_envs")
    return episodes


class NoisySensors(
    gymnasium.Wrapper[Observation, NDArray[Any], Observation, NDArray[Any]],
    gymnasium.utils.RecordConstructorArgs,
):
    """A single environment with sensor noise.

    :param env: an environment of this package, possibly wrapped.
    :param noise: how large the errors are.
    :raises TypeError: for another environment.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], noise: SensorNoise | None = None) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, noise=noise)
        gymnasium.Wrapper.__init__(self, env)
        self.noise = noise or SensorNoise()
        self._errors = SensorErrors.of(self.noise, episodes_of(env))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; ``seed`` makes its errors reproducible too."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._errors.seed(0, seed)
        self._errors.begin([0])
        return self._errors.seen(observation), info

    def step(self, action: NDArray[Any]) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Apply one action."""
        observation, *rest = self.env.step(action)
        return self._errors.seen(observation), *rest  # type: ignore[return-value]


class NoisyVectorSensors(VectorWrapper[Observation, NDArray[Any], NDArray[Any]]):
    """A Gymnasium vector environment with sensor noise, in every autoreset mode.

    :param env: a vector environment of this package.
    :param noise: how large the errors are.
    :raises TypeError: for another environment.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], noise: SensorNoise | None = None) -> None:
        super().__init__(env)
        self.noise = noise or SensorNoise()
        self._errors = SensorErrors.of(self.noise, episodes_of(env))
        self._mode = env.metadata["autoreset_mode"]
        self._over = np.zeros(env.num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes; ``seed`` makes their errors reproducible too."""
        # A seed for each: Gymnasium's own vectors take them, its hints forget it.
        given_seed: Any = seed
        observation, infos = self.env.reset(seed=given_seed, options=options)
        rows = np.flatnonzero(reset_mask(options, self.num_envs))
        seeds = seed_each(seed, self.num_envs)
        for row in rows.tolist():
            self._errors.seed(row, seeds[row])
        self._errors.begin(rows)
        self._over[rows] = False
        return self._errors.seen(observation), infos

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Apply one action to every episode."""
        observation, reward, terminated, truncated, infos = self.env.step(actions)
        over = np.asarray(terminated) | np.asarray(truncated)
        if self._mode is AutoresetMode.SAME_STEP:
            for row in np.flatnonzero(over).tolist():
                infos["final_obs"][row] = self._errors.seen(infos["final_obs"][row], [row])
            self._errors.begin(np.flatnonzero(over))
        elif self._mode is AutoresetMode.NEXT_STEP:
            self._errors.begin(np.flatnonzero(self._over))
        self._over = over
        return self._errors.seen(observation), reward, terminated, truncated, infos
