"""The Gymnasium vector adapter: n episodes in one batch, every automatic reset mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from saver_envs.cameras.rendering import DEFAULT_CAMERA, DEFAULT_SIZE
from saver_envs.control import InverseKinematics
from saver_envs.envs.pictures import RENDER_FPS, Pictures
from saver_envs.envs.spaces import GoalReward, action_space, observation_space, warn_if_short
from saver_envs.episodes import Outcome
from saver_envs.registration import make_episodes
from saver_envs.validation import require

DictObservation = dict[str, NDArray[np.float32]]
Infos = dict[str, Any]

#: A window shows one episode, so ``human`` is left to the single environment.
RENDER_MODES = ("rgb_array", "depth_array")


class SaverVectorEnv(GoalReward, VectorEnv[DictObservation, NDArray[np.floating], NDArray[Any]]):
    """n episodes of a registered id behind Gymnasium's vector API.

    Episode i is seeded with ``seed + i`` and is bit for bit the one that :class:`SaverGoalEnv`
    plays from that seed. A diverged episode ends before the others do; from then on they are out of
    phase, and each is reset by itself. It can be pickled and deep-copied within an episode.

    :param env_id: a registered id; ``gymnasium.make_vec`` fills it in.
    :param num_envs: number of episodes.
    :param render_mode: ``rgb_array``, ``depth_array`` or ``None``.
    :param autoreset_mode: when an episode that is over is reset: at the next step, which then
        ignores its action (``NextStep``), in the step that ends it (``SameStep``), or by the
        caller with ``reset(options={"reset_mask": ...})`` (``Disabled``).
    :param threads: native threads of the simulation; results do not depend on it.
    :param width: pixels of a picture.
    :param height: pixels of a picture.
    :param camera_name: ``front``, ``three_quarter``, ``side`` or ``overhead``.
    :param inverse_kinematics: replaces damped least squares.
    :param options: of :class:`saver_envs.registration.ControlOptions`, and the task's fields.
    :raises ValueError: for an unknown id, mode or camera, or an option out of range.
    :raises TypeError: for an unknown option.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's base class declares it like this)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera_name: str = DEFAULT_CAMERA,
        inverse_kinematics: InverseKinematics | None = None,
        **options: Any,
    ) -> None:
        self.autoreset_mode = _parse_mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.episodes = make_episodes(env_id, num_envs, threads, inverse_kinematics, **options)
        warn_if_short(self.episodes, self.episodes.settings.horizon)
        self.single_observation_space = observation_space(self.episodes)
        self.single_action_space = action_space(self.episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._over = np.ones(num_envs, dtype=bool)  # nothing has begun yet
        self._pictures = Pictures(
            self.episodes, render_mode, width, height, camera_name, RENDER_MODES
        )

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[DictObservation, Infos]:
        """Start episodes.

        :param seed: a number (episode i gets ``seed + i``), one for each episode, or ``None`` to
            continue with the current random generators.
        :param options: ``{"reset_mask": mask}`` resets those episodes alone whose entry of the
            boolean array (num_envs,) is True.
        :return: observations of all episodes, and infos of those that were reset.
        :raises ValueError: for another number of seeds or a mask that selects nothing.
        :raises TypeError: for a mask that is not a boolean array.
        """
        mask = reset_mask(options, self.num_envs)
        seeds = seed_each(seed, self.num_envs)
        rows = np.flatnonzero(mask)
        for row in rows.tolist():
            if seeds[row] is not None or self._generators[row] is None:
                generator = seeding.np_random(seeds[row])[0]
                self._generators[row] = generator
                self.episodes.set_generator(row, generator)
        outcome = self.episodes.reset(rows)
        self._over[rows] = False
        return self.episodes.observation().as_dict(), _infos(outcome, mask)

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[DictObservation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Apply one action to every episode for 0.04 s.

        :param actions: (num_envs, action_size), clipped to [-1, 1].
        :return: observations, rewards, terminated (never), truncated, infos.
        :raises ValueError: for a wrong shape or a value that is not finite; nothing has changed.
        :raises gymnasium.error.ResetNeeded: before the first reset, and without automatic reset
            when an episode is over; the message names the episodes.
        """
        self.episodes.require_begun()
        over, rows = self._over, None
        if over.any():
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise ResetNeeded(
                    f"episodes {np.flatnonzero(over).tolist()} are over: reset them with "
                    'reset(options={"reset_mask": mask})'
                )
            self.episodes.checked(actions)  # before anything changes, even if no episode continues
            rows = np.flatnonzero(~over)
        reward, truncated = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=bool)
        infos: Infos = {}
        if not over.all():
            outcome = self.episodes.step(actions, rows)
            reward[~over], truncated = outcome.reward[~over], outcome.truncated & ~over
            infos = _infos(outcome, ~over)
        at_once = self.autoreset_mode is AutoresetMode.SAME_STEP
        self._over = truncated & (not at_once)
        if over.any():
            self._begin(over, infos)
        elif at_once and truncated.any():
            observation, last = self.episodes.observation().as_dict(), np.full(self.num_envs, None)
            for row in np.flatnonzero(truncated):
                last[row] = {name: values[row] for name, values in observation.items()}
            infos["final_obs"], infos["_final_obs"] = last, truncated.copy()
            infos["final_info"], infos["_final_info"] = _infos(outcome, truncated), truncated.copy()
            self._begin(truncated, infos)
        observation = self.episodes.observation().as_dict()
        return observation, reward, np.zeros(self.num_envs, dtype=bool), truncated, infos

    def _begin(self, begins: NDArray[np.bool_], infos: Infos) -> None:
        """Reset episodes (num_envs,); their infos replace those of the step."""
        begun, present = self.episodes.reset(np.flatnonzero(begins)), np.ones_like(begins)
        for name, values in begun.info().items():
            infos[name] = np.where(begins, values, infos.get(name, values))
            infos[f"_{name}"] = present.copy()
        infos |= _parameters(begun, present)

    def render(self) -> tuple[Any, ...] | None:
        """Draw every episode.

        :return: a picture each, (height, width, 3) uint8 or (height, width) float32 metres;
            ``None`` without a render mode.
        """
        if self.render_mode is None:
            return None
        return tuple(self._pictures.draw(index) for index in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Free the graphics context."""
        self._pictures.close()


def reset_mask(options: dict[str, Any] | None, n: int) -> NDArray[np.bool_]:
    """Return which of n episodes (n,) the options of a reset select; all by default.

    :raises ValueError: for a mask of another shape, or one that selects nothing.
    :raises TypeError: for a mask that is not a boolean array.
    """
    if not options or "reset_mask" not in options:
        return np.ones(n, dtype=bool)
    mask = options["reset_mask"]
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        raise TypeError(f"reset_mask={mask!r}: must be a NumPy array of booleans")
    selects = mask.shape == (n,) and bool(mask.any())
    require("reset_mask", mask, selects, f"of shape {(n,)} and select an episode")
    return mask


def seed_each(seed: int | Sequence[int | None] | None, n: int) -> Sequence[int | None]:
    """Return the seeds of n episodes: ``seed + i`` for a number, ``None`` for none.

    :raises ValueError: for another number of seeds.
    """
    if seed is None:
        return [None] * n
    if isinstance(seed, int | np.integer):
        return [int(seed) + row for row in range(n)]
    if len(seed) != n:
        raise ValueError(f"{len(seed)} seeds: one is needed for each of {n} episodes")
    return [None if one is None else int(one) for one in seed]


def _parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the mode of that value (``NextStep``) or name (``NEXT_STEP``)."""
    for member in AutoresetMode:
        if mode in (member, member.value, member.name):
            return member
    valid = ", ".join(repr(member.value) for member in AutoresetMode)
    raise ValueError(f"autoreset_mode={mode!r}: valid modes are {valid}")


def _infos(outcome: Outcome, present: NDArray[np.bool_]) -> Infos:
    """Return infos in Gymnasium's format: ``key`` with values, ``_key`` with the mask of owners.

    :param outcome: of all episodes.
    :param present: (num_envs,) episodes that have infos; the values of the others are zero.
    """
    infos: Infos = {}
    for name, values in outcome.info().items():
        infos[name] = np.where(present, values, np.zeros_like(values))
        infos[f"_{name}"] = present.copy()
    return infos | _parameters(outcome, present)


def _parameters(outcome: Outcome, present: NDArray[np.bool_]) -> Infos:
    """Return what was drawn for the episodes, if they report it; see :func:`_infos`."""
    if outcome.parameters is None:
        return {}
    entry: Infos = {}
    for name, drawn in outcome.parameters.items():
        own = np.where(present[:, None], drawn, 0.0)
        entry[name] = own[:, 0] if own.shape[1] == 1 else own
        entry[f"_{name}"] = present.copy()
    return {"parameters": entry, "_parameters": present.copy()}
