"""A buffer of whole episodes: storing, uniform sampling, files.

An episode of T transitions is stored as T + 1 observations in one slot. The next observation of a
transition is the following row, and every goal that the episode reached later is a row of the same
slot, so nothing is stored twice or searched.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from numpy.lib.npyio import NpzFile
from stable_baselines3.common.buffers import ReplayBuffer

from saver_advisors.learner.arms import GOAL_KEYS
from saver_envs.files import written_whole
from saver_envs.validation import require

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

FILE_FORMAT = "saver-goal-replay-1"
_MOST_HEADER_BYTES = 2**20
_SLOT_ARRAYS = ("length", "observation", "achieved_goal", "desired_goal", "action", "advised")


@dataclass(frozen=True)
class StoredEpisode:
    """An episode of T steps, as :class:`EpisodeBuffer` stores it.

    :param observation: (T + 1, observation_dim).
    :param achieved_goal: (T + 1, goal_dim).
    :param desired_goal: (goal_dim,).
    :param action: (T, action_dim), scaled to [-1, 1].
    :param advised: (T,), whether a teacher chose the action.
    :param cost: (T,), 0 if no costs are stored.
    """

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    advised: BoolArray
    cost: FloatArray


class EpisodeBuffer(ReplayBuffer):
    """Store episodes of goal-conditioned tasks; subclasses build batches from them.

    Episodes shorter than the horizon (a diverged simulation, a resumed training) and running
    episodes count as far as they are stored. A new episode begins after ``done``, or if the
    observation differs from the one that followed the last action.

    :param buffer_size: capacity in transitions; rounded down to whole episodes, the oldest of which
        are replaced first.
    :param observation_space: Dict with Boxes observation, achieved_goal and desired_goal, each 1-D.
    :param action_space: a 1-D Box.
    :param device: of sampled tensors.
    :param n_envs: environments that step together.
    :param horizon: maximum length of an episode in steps.
    :param seed: of the buffer's own random generator.
    :param cost_key: entry of ``info`` that is stored as the cost of a step; None stores none.
    :param labels: whether the entry ``label`` of ``info`` is stored: the teachers' actions, scaled
        to [-1, 1], where the executed ones may be the student's.
    :raises ValueError: if spaces or sizes do not fit.
    """

    # This buffer does not have the parent's arrays of single transitions.
    observations: Any
    next_observations: Any

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        device: th.device | str = "auto",
        n_envs: int = 1,
        *,
        horizon: int,
        seed: int | None = None,
        cost_key: str | None = None,
        labels: bool = False,
    ) -> None:
        _check_spaces(observation_space, action_space)
        require("horizon", horizon, horizon >= 1, "at least 1 step")
        least = horizon * n_envs
        product = f"at least horizon * n_envs = {horizon} * {n_envs} = {least}"
        wanted = f"{product}, one episode of each environment"
        require("buffer_size", buffer_size, buffer_size >= least, wanted)
        # ReplayBuffer's own constructor would allocate a row for every transition.
        super(ReplayBuffer, self).__init__(
            buffer_size, observation_space, action_space, device, n_envs=n_envs
        )
        self.horizon = horizon
        self.n_slots = buffer_size // horizon
        self._random = np.random.default_rng(seed)
        self.cost_key = cost_key
        self.labels = labels
        optional = {"cost": cost_key is not None, "label": labels}
        self._slot_arrays = (*_SLOT_ARRAYS, *(name for name, used in optional.items() if used))
        self._allocate()
        self.reset()

    def _allocate(self) -> None:
        """Allocate the slots; memory pages are committed only as episodes arrive."""
        assert isinstance(self.observation_space, spaces.Dict)
        observation_dim = self.observation_space["observation"].shape[0]  # type: ignore[index]
        goal_dim = self.observation_space["achieved_goal"].shape[0]  # type: ignore[index]
        rows = (self.n_slots, self.horizon + 1)
        self.observation = np.zeros((*rows, observation_dim), np.float32)
        self.achieved_goal = np.zeros((*rows, goal_dim), np.float32)
        self.desired_goal = np.zeros((self.n_slots, goal_dim), np.float32)
        self.action = np.zeros((self.n_slots, self.horizon, self.action_dim), np.float32)
        self.advised = np.zeros((self.n_slots, self.horizon), bool)
        # Unused, these only take up addresses. A label is NaN where the teachers were not asked.
        self.cost = np.zeros((self.n_slots, self.horizon), np.float32)
        self.label = np.zeros(self.action.shape, np.float32)
        self.length = np.zeros(self.n_slots, np.int64)

    def reset(self) -> None:
        """Remove every episode; the random generator keeps its state."""
        self.pos = 0
        self.full = False
        self.length[:] = 0
        self._slot = np.full(self.n_envs, -1, np.int64)
        self._running = np.zeros(self.n_envs, bool)
        self._ends: IntArray | None = None

    def size(self) -> int:
        """Return the number of stored transitions, of finished and running episodes."""
        return int(self.length.sum())

    # Storing ---------------------------------------------------------------------------------

    def add(  # type: ignore[override]  # SB3 passes dicts here too, against its own hints
        self,
        obs: Mapping[str, npt.NDArray[Any]],
        next_obs: Mapping[str, npt.NDArray[Any]],
        action: npt.NDArray[Any],
        reward: npt.NDArray[Any],
        done: npt.NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        """Store one step of every environment.

        :param obs: before the action, each entry (n_envs, dim).
        :param next_obs: after it; the last observation of the episode if ``done``.
        :param action: (n_envs, action_dim), scaled to [-1, 1].
        :param reward: (n_envs,), ignored: rewards are computed when sampled.
        :param done: (n_envs,), whether the episode ends here.
        :param infos: one dict per environment; ``advised``, ``cost_key`` and ``label`` are read.
        :raises ValueError: if a value is not finite, or an episode exceeds the horizon.
        :raises KeyError: if an environment does not report the cost.
        """
        del reward
        continued = self._continued(obs)
        if not continued.all():
            self._open_slots(np.flatnonzero(~continued), obs)
        slot = self._slot
        step = self.length[slot]
        if step.max() >= self.horizon:
            raise ValueError(
                f"environment {int(step.argmax())} exceeded horizon={self.horizon} steps without "
                "`done`; construct the buffer with the environment's episode length"
            )
        action = np.asarray(action, np.float32).reshape(self.n_envs, self.action_dim)
        _require_finite("next observation", next_obs["observation"])
        _require_finite("next achieved goal", next_obs["achieved_goal"])
        _require_finite("action", action)
        if self.cost_key is not None:
            cost = np.array([_cost_of(info, self.cost_key) for info in infos], np.float32)
            _require_finite(self.cost_key, cost)
            self.cost[slot, step] = cost
        self.observation[slot, step + 1] = next_obs["observation"]
        self.achieved_goal[slot, step + 1] = next_obs["achieved_goal"]
        self.action[slot, step] = action
        if self.labels:
            unknown = np.full(self.action_dim, np.nan, np.float32)
            self.label[slot, step] = [info.get("label", unknown) for info in infos]
        self.advised[slot, step] = [bool(info.get("advised", False)) for info in infos]
        self.length[slot] = step + 1
        self._running = ~np.asarray(done, bool)
        self._ends = None

    def _continued(self, obs: Mapping[str, npt.NDArray[Any]]) -> BoolArray:
        """Return which environments' running episodes continue from ``obs``, (n_envs,).

        An external reset (a second ``learn``, a resumed run) ends an episode without ``done``.
        Comparing the observation with the stored one is cheap and detects it reliably.
        """
        if not self._running.any():
            return self._running
        step = self.length[self._slot]
        same = self._running.copy()
        for key, stored in (
            ("observation", self.observation[self._slot, step]),
            ("achieved_goal", self.achieved_goal[self._slot, step]),
            ("desired_goal", self.desired_goal[self._slot]),
        ):
            same &= (stored == np.asarray(obs[key], np.float32)).all(axis=1)
        return same

    def _open_slots(self, environments: IntArray, obs: Mapping[str, npt.NDArray[Any]]) -> None:
        """Assign a new slot to each of these environments, replacing the oldest episodes."""
        for key in GOAL_KEYS:
            _require_finite(key, obs[key])
        self._running[environments] = False
        for environment in environments:
            # An environment with much shorter episodes than the others may reach their slots.
            while self.pos in self._slot[self._running]:
                self._advance()
            slot = self.pos
            self.observation[slot, 0] = obs["observation"][environment]
            self.achieved_goal[slot, 0] = obs["achieved_goal"][environment]
            self.desired_goal[slot] = obs["desired_goal"][environment]
            self.length[slot] = 0
            self._slot[environment] = slot
            self._running[environment] = True
            self._advance()

    def _advance(self) -> None:
        """Advance ``pos`` to the next slot of the ring."""
        self.pos = (self.pos + 1) % self.n_slots
        self.full = self.full or self.pos == 0

    def end_running_episodes(self) -> None:
        """End the running episodes, because the environments are about to be reset."""
        self._running[:] = False

    def episodes_of(self, environments: IntArray) -> dict[str, FloatArray]:
        """Return the steps of these environments' latest episodes, as a policy may see them.

        Each of m steps is there twice, with the episode's goal and with the goal achieved next,
        since the networks are trained on both.

        :param environments: (n,), indices of environments.
        :return: entries (2 m, dim).
        """
        slots = self._slot[environments]
        lengths = self.length[slots]
        slot = np.repeat(slots, lengths)
        step = np.concatenate([np.arange(length) for length in lengths])
        desired = self.desired_goal[slot], self.achieved_goal[slot, step + 1]
        return {
            "observation": np.tile(self.observation[slot, step], (2, 1)),
            "desired_goal": np.concatenate(desired),
            "achieved_goal": np.tile(self.achieved_goal[slot, step], (2, 1)),
        }

    # Drawing ---------------------------------------------------------------------------------

    def _draw(self, batch_size: int) -> tuple[IntArray, IntArray]:
        """Sample slots and steps of ``batch_size`` stored transitions uniformly.

        A cumulative sum over the slots' lengths maps a transition to its slot; it stays valid until
        the next ``add``.
        """
        if self._ends is None:
            self._ends = np.cumsum(self.length)
        stored = int(self._ends[-1])
        if stored == 0:
            raise ValueError("the replay buffer is empty: store transitions before sampling")
        index = self._random.integers(0, stored, batch_size)
        slot = np.searchsorted(self._ends, index, side="right")
        return slot, index - (self._ends[slot] - self.length[slot])

    def ended_slots(self) -> IntArray:
        """Return the slots of the episodes that have ended, the oldest first."""
        slots = np.roll(np.arange(self.n_slots), -self.pos) if self.full else np.arange(self.pos)
        running = self._slot[self._running]
        return slots[(self.length[slots] > 0) & ~np.isin(slots, running)]

    def stored_episode(self, slot: int) -> StoredEpisode:
        """Return a copy of an episode.

        :param slot: of :meth:`ended_slots`.
        """
        steps = int(self.length[slot])
        return StoredEpisode(
            observation=self.observation[slot, : steps + 1].copy(),
            achieved_goal=self.achieved_goal[slot, : steps + 1].copy(),
            desired_goal=self.desired_goal[slot].copy(),
            action=self.action[slot, :steps].copy(),
            advised=self.advised[slot, :steps].copy(),
            cost=self.cost[slot, :steps].copy(),
        )

    # Files -----------------------------------------------------------------------------------

    def save_npz(self, path: str | Path) -> None:
        """Write episodes and random state to a file, atomically and without pickle.

        :param path: of the file; an old one is replaced once the new one is complete.
        :raises OSError: if it cannot be written; an old file is then intact.
        """
        used = self.n_slots if self.full else self.pos
        with written_whole(path) as file:
            np.savez(
                file,
                header=np.array(json.dumps(self._header(used))),
                slot=self._slot,
                running=self._running,
                **{name: getattr(self, name)[:used] for name in self._slot_arrays},
            )

    def _header(self, used: int) -> dict[str, Any]:
        """Return what must agree between file and buffer (``shape``), and the scalar state."""
        return {
            "format": FILE_FORMAT,
            "shape": {
                "horizon": self.horizon,
                "n_envs": self.n_envs,
                "n_slots": self.n_slots,
                "observation_dim": self.observation.shape[-1],
                "goal_dim": self.achieved_goal.shape[-1],
                "action_dim": self.action_dim,
                "store_advised": True,  # read by earlier versions, where it was a setting
            },
            "used": used,
            "next_slot": self.pos,
            "full": self.full,
            "random": self._random.bit_generator.state,
        }

    def load_npz(self, path: str | Path) -> None:
        """Restore the state from a file of ``save_npz``; on any error nothing changes.

        :param path: of the file.
        :raises FileNotFoundError: if there is none.
        :raises ValueError: if the file is damaged, of another format, or of another shape.
        """
        path = Path(path)
        own: dict[str, npt.NDArray[Any]] = {name: getattr(self, name) for name in self._slot_arrays}
        others = {"slot": self._slot, "running": self._running}
        with _opened(path) as archive:
            header = self._checked_header(path, archive)
            used = header["used"]
            wanted = {name: ((used, *one.shape[1:]), one.dtype) for name, one in own.items()}
            wanted |= {name: (one.shape, one.dtype) for name, one in others.items()}
            # A small file may hold large arrays, compressed: look before they are read.
            for name, layout in wanted.items():
                if (found := _layout(archive, name)) != layout:
                    raise ValueError(f"{path}: {name} is {found}, should be {layout}")
            arrays = {name: archive[name] for name in wanted}
        self.reset()
        for name, target in own.items():
            target[:used] = arrays[name]
        self._slot, self._running = arrays["slot"], arrays["running"]
        self.pos = header["next_slot"]
        self.full = header["full"]
        self._random.bit_generator.state = header["random"]

    def _checked_header(self, path: Path, archive: NpzFile) -> dict[str, Any]:
        """Read the header of a file, and check that this buffer can hold its content."""
        shape, kind = _layout(archive, "header")
        if shape != () or kind.itemsize > _MOST_HEADER_BYTES:
            raise ValueError(f"{path}: its header is {shape} of {kind}")
        header = json.loads(str(archive["header"]))
        if not isinstance(header, dict) or header.get("format") != FILE_FORMAT:
            raise ValueError(f"{path}: its format is not {FILE_FORMAT!r}")
        for name, value in self._header(0)["shape"].items():
            if header["shape"].get(name) != value:
                raise ValueError(
                    f"{path}: {name} is {header['shape'].get(name)}, this buffer's is {value}"
                )
        for name, most in (("used", self.n_slots), ("next_slot", self.n_slots - 1)):
            valid = type(header[name]) is int and 0 <= header[name] <= most
            require(f"{path}: {name}", header[name], valid, f"from 0 to {most}")
        return header


@contextmanager
def _opened(path: Path) -> Iterator[NpzFile]:
    """Open a file of ``save_npz``; damage raises a ValueError that names the file."""
    try:
        with path.open("rb") as file, NpzFile(file) as archive:
            yield archive
    except FileNotFoundError:
        raise
    except (
        *(OSError, EOFError, LookupError, TypeError, ValueError, AttributeError, RuntimeError),
        *(zipfile.BadZipFile, zlib.error),
    ) as error:
        if str(error).startswith(str(path)):
            raise
        raise ValueError(
            f"{path} is not a complete file written by a replay buffer's save_npz: {error}"
        ) from error


def _layout(archive: NpzFile, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return the shape and the type of an array in a file, without reading the array."""
    assert archive.zip is not None, "it is open"
    with archive.zip.open(f"{name}.npy") as member:
        np.lib.format.read_magic(member)
        shape, _, kind = np.lib.format.read_array_header_1_0(member)
    return shape, kind


def _cost_of(info: Mapping[str, Any], key: str) -> float:
    if key not in info:
        raise KeyError(f"cost_key={key!r}: the environment's info has only {sorted(info)}")
    return float(info[key])


def _require_finite(name: str, values: npt.NDArray[Any]) -> None:
    """Reject NaN and infinities here: they would spread through the networks unnoticed."""
    finite = np.isfinite(values)
    if not finite.all():
        environment = int(np.flatnonzero(~finite.reshape(len(finite), -1).all(axis=1))[0])
        raise ValueError(
            f"{name} of environment {environment} is not finite; an environment whose simulation "
            "diverged must end the episode with its last finite observation"
        )


def _check_spaces(observation_space: spaces.Space[Any], action_space: spaces.Space[Any]) -> None:
    """Check that the slots can hold these spaces."""
    whole = isinstance(observation_space, spaces.Dict) and set(observation_space) == set(GOAL_KEYS)
    require("observation_space", observation_space, whole, f"a Dict of exactly {GOAL_KEYS}")
    assert isinstance(observation_space, spaces.Dict)
    for name, space in (*observation_space.items(), ("action_space", action_space)):
        flat = isinstance(space, spaces.Box) and len(space.shape) == 1
        require(name, space, flat, "a Box with one dimension")
    if observation_space["achieved_goal"].shape != observation_space["desired_goal"].shape:
        raise ValueError("achieved_goal and desired_goal must have the same shape")
