"""Whole episodes in slots, kept for replay: storing, drawing at random, files.

An episode of T transitions is stored once, as T + 1 observations in a slot of its own. The next
observation of a transition is thus the row after it, and any goal that the episode reached later
is a row of the same slot: nothing is stored twice and nothing has to be searched.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer

from saver_envs.files import written_whole

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

GOAL_KEYS = ("observation", "achieved_goal", "desired_goal")
FILE_FORMAT = "saver-goal-replay-1"


class EpisodeBuffer(ReplayBuffer):
    """Episodes of goal-conditioned tasks; what a batch is made of them is a subclass's business.

    Episodes shorter than the horizon (a diverged simulation, a resumed training) and episodes
    still running count as far as they are stored. A new episode begins after ``done``, or when the
    observation handed in is not the one that followed the last action.

    :param buffer_size: transitions kept; rounded down to whole episodes, the oldest go first
    :param observation_space: Dict with Boxes observation, achieved_goal and desired_goal, each 1-D
    :param action_space: a 1-D Box
    :param device: where sampled tensors live
    :param n_envs: environments that step together
    :param horizon: the longest episode in steps
    :param seed: of the buffer's own random generator
    :param store_advised: keep ``infos[i]["advised"]`` of each transition
    :raises ValueError: for spaces or sizes that do not fit
    """

    # The parent's arrays of single transitions do not exist here.
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
        store_advised: bool = True,
    ) -> None:
        _check_spaces(observation_space, action_space)
        if horizon < 1:
            raise ValueError(f"horizon={horizon} must be at least 1 step")
        if buffer_size < horizon * n_envs:
            raise ValueError(
                f"buffer_size={buffer_size} must hold one episode of each environment: "
                f"at least horizon * n_envs = {horizon} * {n_envs} = {horizon * n_envs}"
            )
        # ReplayBuffer's own constructor would allocate a row for every transition.
        super(ReplayBuffer, self).__init__(
            buffer_size, observation_space, action_space, device, n_envs=n_envs
        )
        self.optimize_memory_usage = True
        self.horizon = horizon
        self.store_advised = store_advised
        self.n_slots = buffer_size // horizon
        self._random = np.random.default_rng(seed)
        self._allocate()
        self.reset()

    def _allocate(self) -> None:
        """Reserve the slots; the pages are touched only as episodes arrive."""
        assert isinstance(self.observation_space, spaces.Dict)
        observation_dim = self.observation_space["observation"].shape[0]  # type: ignore[index]
        goal_dim = self.observation_space["achieved_goal"].shape[0]  # type: ignore[index]
        rows = (self.n_slots, self.horizon + 1)
        self.observation = np.zeros((*rows, observation_dim), np.float32)
        self.achieved_goal = np.zeros((*rows, goal_dim), np.float32)
        self.desired_goal = np.zeros((self.n_slots, goal_dim), np.float32)
        self.action = np.zeros((self.n_slots, self.horizon, self.action_dim), np.float32)
        self.advised = np.zeros((self.n_slots, self.horizon if self.store_advised else 0), bool)
        self.length = np.zeros(self.n_slots, np.int64)

    def reset(self) -> None:
        """Forget every episode; the random generator runs on."""
        self.pos = 0
        self.full = False
        self.length[:] = 0
        self._next_slot = 0
        self._slot = np.full(self.n_envs, -1, np.int64)
        self._running = np.zeros(self.n_envs, bool)
        self._ends: IntArray | None = None

    def size(self) -> int:
        """
        :return: transitions stored, of finished and running episodes
        """
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

        :param obs: before the action, each entry (n_envs, dim)
        :param next_obs: after it, with the last observation of the episode where ``done``
        :param action: (n_envs, action_dim), scaled to [-1, 1]
        :param reward: (n_envs,), ignored: rewards are computed when sampled
        :param done: (n_envs,), whether the episode ends here
        :param infos: one dict an environment; ``advised`` is read
        :raises ValueError: for values that are not finite, or an episode beyond the horizon
        """
        del reward
        continued = self._continued(obs)
        if not continued.all():
            self._open_slots(np.flatnonzero(~continued), obs)
        slot = self._slot
        step = self.length[slot]
        if step.max() >= self.horizon:
            raise ValueError(
                f"environment {int(step.argmax())} went on beyond horizon={self.horizon} steps "
                "without `done`; construct the buffer with the environment's true episode length"
            )
        action = np.asarray(action, np.float32).reshape(self.n_envs, self.action_dim)
        _require_finite("next observation", next_obs["observation"])
        _require_finite("next achieved goal", next_obs["achieved_goal"])
        _require_finite("action", action)
        self.observation[slot, step + 1] = next_obs["observation"]
        self.achieved_goal[slot, step + 1] = next_obs["achieved_goal"]
        self.action[slot, step] = action
        if self.store_advised:
            self.advised[slot, step] = [bool(info.get("advised", False)) for info in infos]
        self.length[slot] = step + 1
        self._running = ~np.asarray(done, bool)
        self._ends = None

    def _continued(self, obs: Mapping[str, npt.NDArray[Any]]) -> BoolArray:
        """Which environments' running episodes go on from ``obs``; shape (n_envs,).

        A reset from outside (a second ``learn``, a resumed run) leaves an episode without its
        ``done``. Comparing the observation with the stored one is cheap and cannot miss it.
        """
        if not self._running.any():
            return self._running
        step = self.length[self._slot]
        same = (self.observation[self._slot, step] == _float32(obs["observation"])).all(axis=1)
        same &= (self.achieved_goal[self._slot, step] == _float32(obs["achieved_goal"])).all(axis=1)
        same &= (self.desired_goal[self._slot] == _float32(obs["desired_goal"])).all(axis=1)
        return np.asarray(same & self._running)

    def _open_slots(self, environments: IntArray, obs: Mapping[str, npt.NDArray[Any]]) -> None:
        """Give each of these environments a fresh slot, evicting the oldest episodes."""
        for key in GOAL_KEYS:
            _require_finite(key, obs[key])
        self._running[environments] = False
        for environment in environments:
            # Only an environment whose episodes are far shorter than the others' can lap the ring.
            while self._next_slot in self._slot[self._running]:
                self._advance()
            slot = self._next_slot
            self.observation[slot, 0] = obs["observation"][environment]
            self.achieved_goal[slot, 0] = obs["achieved_goal"][environment]
            self.desired_goal[slot] = obs["desired_goal"][environment]
            self.length[slot] = 0
            self._slot[environment] = slot
            self._running[environment] = True
            self._advance()

    def _advance(self) -> None:
        """Move on to the next slot of the ring."""
        self._next_slot = (self._next_slot + 1) % self.n_slots
        self.pos = self._next_slot
        self.full = self.full or self._next_slot == 0

    def end_running_episodes(self) -> None:
        """Cut the running episodes short, because the environments are about to be reset."""
        self._running[:] = False

    def episodes_of(
        self, environments: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The steps stored of these environments' latest episodes, one after the other.

        :param environments: (n,), indices of environments
        :return: observations (m, observation_dim), desired goals (m, goal_dim), the goals achieved
            with these observations and one step later (m, goal_dim)
        """
        slots = self._slot[environments]
        lengths = self.length[slots]
        slot = np.repeat(slots, lengths)
        step = np.concatenate([np.arange(length) for length in lengths])
        return (
            self.observation[slot, step],
            self.desired_goal[slot],
            self.achieved_goal[slot, step],
            self.achieved_goal[slot, step + 1],
        )

    # Drawing ---------------------------------------------------------------------------------

    def _draw(self, batch_size: int) -> tuple[IntArray, IntArray]:
        """Slots and steps of ``batch_size`` stored transitions, uniform over transitions.

        A running sum over the slots (some thousands, not the rows) finds a transition's slot
        whatever the episodes' lengths; it stays valid until the next ``add``.
        """
        if self._ends is None:
            self._ends = np.cumsum(self.length)
        stored = int(self._ends[-1])
        if stored == 0:
            raise ValueError("the replay buffer is empty: store transitions before sampling")
        index = self._random.integers(0, stored, batch_size)
        slot = np.searchsorted(self._ends, index, side="right")
        return slot, index - (self._ends[slot] - self.length[slot])

    # Files -----------------------------------------------------------------------------------

    def save_npz(self, path: str | Path) -> None:
        """Write episodes and random state to a file, without pickle, all of it or nothing.

        :param path: of the file; an old one is replaced only once the new one is complete
        :raises OSError: when it cannot be written; an old file is then intact
        """
        used = self.n_slots if self.full else self._next_slot
        with written_whole(path) as file:
            np.savez(
                file,
                header=np.array(json.dumps(self._header(used))),
                slot=self._slot,
                running=self._running,
                length=self.length[:used],
                observation=self.observation[:used],
                achieved_goal=self.achieved_goal[:used],
                desired_goal=self.desired_goal[:used],
                action=self.action[:used],
                advised=self.advised[:used],
            )

    def _header(self, used: int) -> dict[str, Any]:
        """What must agree between a file and a buffer (``shape``), and the scalars of the state."""
        return {
            "format": FILE_FORMAT,
            "shape": {
                "horizon": self.horizon,
                "n_envs": self.n_envs,
                "n_slots": self.n_slots,
                "observation_dim": self.observation.shape[-1],
                "goal_dim": self.achieved_goal.shape[-1],
                "action_dim": self.action_dim,
                "store_advised": self.store_advised,
            },
            "used": used,
            "next_slot": self._next_slot,
            "full": self.full,
            "random": self._random.bit_generator.state,
        }

    def load_npz(self, path: str | Path) -> None:
        """Take over the state of a file written by ``save_npz``; on any error nothing changes.

        :param path: of the file
        :raises FileNotFoundError: when there is none
        :raises ValueError: when the file is damaged, foreign, or of a buffer of another shape
        """
        header, arrays = _read_npz(Path(path))
        used = header["used"]
        expected = self._header(used)["shape"]
        for name, value in expected.items():
            if header["shape"].get(name) != value:
                raise ValueError(
                    f"{path}: {name} is {header['shape'].get(name)}, this buffer's is {value}"
                )
        targets = {
            "length": self.length,
            "observation": self.observation,
            "achieved_goal": self.achieved_goal,
            "desired_goal": self.desired_goal,
            "action": self.action,
            "advised": self.advised,
        }
        wanted = {name: (used, *target.shape[1:]) for name, target in targets.items()}
        wanted |= {"slot": (self.n_envs,), "running": (self.n_envs,)}
        for name, shape in wanted.items():
            if arrays[name].shape != shape:
                raise ValueError(f"{path}: {name} is {arrays[name].shape}, should be {shape}")
        self.reset()
        for name, target in targets.items():
            target[:used] = arrays[name]
        self._slot = arrays["slot"].astype(np.int64)
        self._running = arrays["running"].astype(bool)
        self._next_slot = self.pos = header["next_slot"]
        self.full = header["full"]
        self._random.bit_generator.state = header["random"]


def _read_npz(path: Path) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """The header and the arrays of a file, or a ValueError that names it."""
    names = ("slot", "running", "length", "observation", "achieved_goal", "desired_goal")
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
            arrays = {name: file[name] for name in (*names, "action", "advised")}
    except FileNotFoundError:
        raise
    except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"{path} is not a complete file written by a replay buffer's save_npz: {error}"
        ) from error
    if not isinstance(header, dict) or header.get("format") != FILE_FORMAT:
        raise ValueError(f"{path}: its format is not {FILE_FORMAT!r}")
    return header, arrays


def _float32(array: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(array, np.float32)


def _require_finite(name: str, values: npt.NDArray[Any]) -> None:
    """One value that is not a number would spread through the networks unseen: refuse it here."""
    finite = np.isfinite(values)
    if not finite.all():
        environment = int(np.flatnonzero(~finite.reshape(len(finite), -1).all(axis=1))[0])
        raise ValueError(
            f"{name} of environment {environment} is not finite; an environment whose simulation "
            "diverged must end the episode with its last finite observation"
        )


def _check_spaces(observation_space: spaces.Space[Any], action_space: spaces.Space[Any]) -> None:
    """Refuse spaces the slots cannot hold."""
    if not isinstance(observation_space, spaces.Dict) or set(observation_space) != set(GOAL_KEYS):
        raise ValueError(
            f"observation_space={observation_space} must be a Dict of exactly {GOAL_KEYS}"
        )
    for name, space in (*observation_space.items(), ("action_space", action_space)):
        if not isinstance(space, spaces.Box) or len(space.shape) != 1:
            raise ValueError(f"{name}={space} must be a Box with one dimension")
    if observation_space["achieved_goal"].shape != observation_space["desired_goal"].shape:
        raise ValueError("achieved_goal and desired_goal must have the same shape")
