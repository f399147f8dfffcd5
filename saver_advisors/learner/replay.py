"""A replay buffer for goal-conditioned tasks: episodes in slots, "future" relabelling.

An episode of T transitions is stored once, as T + 1 observations in a slot of its own. The next
observation of a transition is thus the row after it, and any goal that the episode reached later
is a row of the same slot: nothing is stored twice and nothing has to be searched.

Relabelling follows Andrychowicz et al., Hindsight Experience Replay (arXiv 1707.01495), strategy
"future". Stock ``HerReplayBuffer`` recomputes the reward of relabelled transitions only, so that
a change of reward leaves stale rewards in the other fifth of each batch; here every reward is
computed when its transition is drawn.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch as th
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from saver_envs.files import written_whole

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
RewardFunction = Callable[[FloatArray, FloatArray], npt.NDArray[Any]]

GOAL_KEYS = ("observation", "achieved_goal", "desired_goal")
FILE_FORMAT = "saver-goal-replay-1"


@dataclass(frozen=True)
class GoalTransitions:
    """A batch of transitions and where each came from.

    :param observation: (batch, observation_dim)
    :param achieved_goal: (batch, goal_dim), reached before the action
    :param desired_goal: (batch, goal_dim), the episode's own or a relabelled one
    :param action: (batch, action_dim), scaled to [-1, 1]
    :param reward: (batch, rewards), computed now from ``next_achieved_goal`` and ``desired_goal``
    :param next_observation: (batch, observation_dim)
    :param next_achieved_goal: (batch, goal_dim), reached after the action
    :param advised: (batch,), whether a teacher chose the action
    :param slot: (batch,), the episode's slot
    :param step: (batch,), the transition's place in its episode, from 0
    :param goal_step: (batch, parts), the row of the slot whose achieved goal became the desired one
        (``step + 1`` is the one just after the action), or -1 where the goal is the episode's own
    """

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    next_achieved_goal: FloatArray
    advised: BoolArray
    slot: IntArray
    step: IntArray
    goal_step: IntArray


def reward_function_of(env: VecEnv) -> RewardFunction:
    """The environment's ``compute_reward`` as a function of goals alone.

    :param env: a vector env whose envs (or itself) have gymnasium-robotics' method
        ``compute_reward(achieved_goal, desired_goal, info)``, batched and free of side effects
    :return: a function of (batch, goal_dim), (batch, goal_dim)
    :raises AttributeError: when the environment has no such method
    """
    compute_reward = env.get_attr("compute_reward", indices=[0])[0]

    def reward(achieved_goal: FloatArray, desired_goal: FloatArray) -> npt.NDArray[Any]:
        return np.asarray(compute_reward(achieved_goal, desired_goal, {}))

    return reward


class GoalReplayBuffer(ReplayBuffer):
    """Replay of whole episodes with hindsight goals, for any off-policy SB3 algorithm.

    Episodes shorter than the horizon (a diverged simulation, a resumed training) and episodes
    still running are sampled up to what is stored of them. A new episode begins after ``done``,
    or when the observation handed in is not the one that followed the last action.

    The sampled ``dones`` are all 0: these episodes end by the clock, and the value of a state does
    not depend on the clock.

    :param buffer_size: transitions kept; rounded down to whole episodes, the oldest go first
    :param observation_space: Dict with Boxes observation, achieved_goal and desired_goal, each 1-D
    :param action_space: a 1-D Box
    :param device: where sampled tensors live
    :param n_envs: environments that step together
    :param optimize_memory_usage: SB3's argument; always on here, the value is ignored
    :param horizon: the longest episode in steps
    :param relabel_probability: share of transitions whose goal is replaced by a later achieved one
    :param goal_parts: sizes of the goal's parts, such as three coordinates an arm, which are then
        taken apart: each is relabelled with a chance and a later step of its own, and gets the
        reward that there would be if all other parts were met; where None the goal is one part
    :param reward_function: (batch, goal_dim) achieved after the action, (batch, goal_dim) desired
        -> (batch,); may be set or replaced later through the attribute of the same name
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
        optimize_memory_usage: bool = False,
        *,
        horizon: int,
        relabel_probability: float = 0.8,
        goal_parts: Sequence[int] | None = None,
        reward_function: RewardFunction | None = None,
        seed: int | None = None,
        store_advised: bool = True,
    ) -> None:
        _check_spaces(observation_space, action_space)
        if horizon < 1:
            raise ValueError(f"horizon={horizon} must be at least 1 step")
        if not 0.0 <= relabel_probability <= 1.0:
            raise ValueError(f"relabel_probability={relabel_probability} must lie in [0, 1]")
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
        self.relabel_probability = relabel_probability
        self.reward_function = reward_function
        self.store_advised = store_advised
        self.part_columns = _columns_of(goal_parts, observation_space)
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

    # Sampling --------------------------------------------------------------------------------

    def sample(  # type: ignore[override]  # as SB3's own DictReplayBuffer
        self, batch_size: int, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Draw transitions, each stored one as likely as any other.

        :param batch_size: transitions to draw, with replacement
        :param env: normalises observations and rewards, if given
        :return: tensors on the buffer's device; rewards are (batch_size, rewards), one for each of
            ``goal_parts`` or one in all, dones (batch_size, 1)
        :raises ValueError: when the buffer is empty, or has no reward function
        """
        return self.as_samples(self.sample_transitions(batch_size), env)

    def as_samples(
        self, drawn: GoalTransitions, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Turn transitions into what SB3's algorithms take.

        :param drawn: the transitions
        :param env: normalises observations and rewards, if given
        :return: tensors on the buffer's device; rewards are (batch, rewards), dones (batch, 1)
        """
        observations = {
            "observation": drawn.observation,
            "achieved_goal": drawn.achieved_goal,
            "desired_goal": drawn.desired_goal,
        }
        next_observations = {
            "observation": drawn.next_observation,
            "achieved_goal": drawn.next_achieved_goal,
            "desired_goal": drawn.desired_goal,
        }
        reward = drawn.reward
        if env is not None:
            observations = env.normalize_obs(observations)  # type: ignore[assignment]
            next_observations = env.normalize_obs(next_observations)  # type: ignore[assignment]
            reward = env.normalize_reward(reward).astype(np.float32)
        return DictReplayBufferSamples(
            observations={key: self._tensor(value) for key, value in observations.items()},
            actions=self._tensor(drawn.action),
            next_observations={
                key: self._tensor(value) for key, value in next_observations.items()
            },
            dones=th.zeros((len(reward), 1), device=self.device),
            rewards=self._tensor(reward),
        )

    def sample_transitions(
        self, batch_size: int, *, relabel_probability: float | None = None
    ) -> GoalTransitions:
        """Draw transitions as arrays, with their origin.

        :param batch_size: transitions to draw, with replacement
        :param relabel_probability: another one than the buffer's own
        :return: the transitions
        :raises ValueError: when the buffer is empty, or has no reward function
        """
        slot, step = self._draw(batch_size)
        row = slot * (self.horizon + 1) + step
        observation = self.observation.reshape(-1, self.observation.shape[-1])
        achieved = self.achieved_goal.reshape(-1, self.achieved_goal.shape[-1])
        action_row = slot * self.horizon + step

        desired = np.take(self.desired_goal, slot, axis=0)
        share = self.relabel_probability if relabel_probability is None else relabel_probability
        goal_step = self._relabel(desired, achieved, slot, step, share)
        next_achieved = np.take(achieved, row + 1, axis=0)
        return GoalTransitions(
            observation=np.take(observation, row, axis=0),
            achieved_goal=np.take(achieved, row, axis=0),
            desired_goal=desired,
            action=np.take(self.action.reshape(-1, self.action_dim), action_row, axis=0),
            reward=self._rewards(next_achieved, desired),
            next_observation=np.take(observation, row + 1, axis=0),
            next_achieved_goal=next_achieved,
            advised=(
                np.take(self.advised.reshape(-1), action_row)
                if self.store_advised
                else np.zeros(batch_size, bool)
            ),
            slot=slot,
            step=step,
            goal_step=goal_step,
        )

    def _relabel(
        self,
        desired: FloatArray,
        achieved: FloatArray,
        slot: IntArray,
        step: IntArray,
        share: float,
    ) -> IntArray:
        """Replace parts of ``desired`` (batch, goal_dim) by ones achieved later, in place.

        :return: (batch, parts) the steps at which they were achieved, -1 where a part is kept
        """
        shape = (len(slot), len(self.part_columns))
        later = self._random.random(shape) * (self.length[slot] - step)[:, None]
        goal_step = step[:, None] + 1 + later.astype(np.int64)
        relabelled = self._random.random(shape) < share
        row = slot[:, None] * (self.horizon + 1) + goal_step
        for part, columns in enumerate(self.part_columns):
            chosen = relabelled[:, part]
            desired[chosen, columns] = achieved[row[chosen, part], columns]
        return np.where(relabelled, goal_step, -1)

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

    def _rewards(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Rewards (batch, rewards): the whole goal's, or each part's as if the others were met."""
        if len(self.part_columns) == 1:
            return self._reward(achieved, desired)[:, None]
        rewards = []
        for columns in self.part_columns:
            asked = achieved.copy()
            asked[:, columns] = desired[:, columns]
            rewards.append(self._reward(achieved, asked))
        return np.stack(rewards, axis=1)

    def _reward(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Rewards (batch,) of reaching ``achieved`` when ``desired`` was asked for."""
        if self.reward_function is None:
            raise ValueError(
                "reward_function is None: set it, e.g. "
                "`buffer.reward_function = reward_function_of(env)`"
            )
        reward = np.asarray(self.reward_function(achieved, desired), np.float32)
        if reward.shape != (len(achieved),):
            raise ValueError(
                f"reward_function returned shape {reward.shape} for {len(achieved)} transitions; "
                f"it must return ({len(achieved)},)"
            )
        return reward

    def _tensor(self, array: npt.NDArray[Any]) -> th.Tensor:
        return self.to_torch(np.asarray(array, np.float32), copy=False)

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
            f"{path} is not a complete file written by GoalReplayBuffer.save_npz: {error}"
        ) from error
    if not isinstance(header, dict) or header.get("format") != FILE_FORMAT:
        raise ValueError(f"{path}: its format is not {FILE_FORMAT!r}")
    return header, arrays


def _float32(array: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(array, np.float32)


def _columns_of(
    goal_parts: Sequence[int] | None, observation_space: spaces.Space[Any]
) -> tuple[slice, ...]:
    """The columns of each part of a goal.

    :raises ValueError: for sizes that do not add up to the goal's
    """
    assert isinstance(observation_space, spaces.Dict)
    shape = observation_space["achieved_goal"].shape
    assert shape is not None
    parts = list(shape if goal_parts is None else goal_parts)
    if min(parts) < 1 or sum(parts) != shape[0]:
        raise ValueError(f"goal_parts={goal_parts} must be positive and add up to {shape[0]}")
    ends = np.cumsum(parts)
    return tuple(slice(int(end) - size, int(end)) for end, size in zip(ends, parts, strict=True))


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
