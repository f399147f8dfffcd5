"""The replay buffer against a plain list of episodes."""

from __future__ import annotations

import errno
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.vec_env import VecNormalize

from saver_advisors.learner import GoalReplayBuffer, reward_function_of

Observation = dict[str, npt.NDArray[Any]]
SPACE = spaces.Dict(
    {
        "observation": spaces.Box(-np.inf, np.inf, (3,), np.float32),
        "achieved_goal": spaces.Box(-np.inf, np.inf, (2,), np.float32),
        "desired_goal": spaces.Box(-np.inf, np.inf, (2,), np.float32),
    }
)
ACTION_SPACE = spaces.Box(-1.0, 1.0, (2,), np.float32)


def reward_of(achieved: Any, desired: Any) -> npt.NDArray[Any]:
    """Distinct for nearly every pair, so that a stale or misplaced reward shows."""
    return np.asarray(achieved[:, 0] - 3 * desired[:, 0] + 7 * desired[:, 1])


def make_buffer(n_envs: int = 2, horizon: int = 6, slots: int = 20, **arguments: Any) -> Any:
    named: dict[str, Any] = {"reward_function": reward_of, "seed": 0, "horizon": horizon}
    return GoalReplayBuffer(
        slots * horizon, SPACE, ACTION_SPACE, "cpu", n_envs, **(named | arguments)
    )


class Recorder:
    """Feeds a buffer with numbers that tell environment, episode and step, and keeps a list."""

    def __init__(self, buffer: GoalReplayBuffer) -> None:
        self.buffer = buffer
        n = buffer.n_envs
        self.episode = [0] * n
        self.step = [0] * n
        self.transitions: set[tuple[int, int, int]] = set()
        self.lengths: dict[tuple[int, int], int] = {}

    def observation(self) -> Observation:
        rows = [
            (environment, self.episode[environment], self.step[environment])
            for environment in range(self.buffer.n_envs)
        ]
        return {
            "observation": np.array(rows, np.float32),
            "achieved_goal": np.array([self.achieved(*row) for row in rows], np.float32),
            "desired_goal": np.array([(-1 - e, -1 - k) for e, k, _ in rows], np.float32),
        }

    @staticmethod
    def achieved(environment: int, episode: int, step: int) -> tuple[float, float]:
        return (step + 1, 100 * environment + episode)

    def add(self, ends: list[bool], advised: bool = False) -> None:
        before = self.observation()
        for environment, step in enumerate(self.step):
            key = (environment, self.episode[environment])
            self.transitions.add((*key, step))
            self.lengths[key] = step + 1
            self.step[environment] += 1
        action = before["observation"][:, 1:] / 64
        self.buffer.add(
            before,
            self.observation(),
            action,
            np.zeros(len(ends)),
            np.array(ends),
            [{"advised": advised}] * len(ends),
        )
        for environment, end in enumerate(ends):
            if end:
                self.restart(environment)

    def restart(self, environment: int) -> None:
        self.episode[environment] += 1
        self.step[environment] = 0


@st.composite
def histories(draw: st.DrawFn) -> tuple[GoalReplayBuffer, Recorder]:
    """Episodes of any length up to the horizon, some cut by a reset from outside."""
    n_envs = draw(st.integers(1, 3))
    horizon = draw(st.integers(1, 5))
    slots = draw(st.integers(n_envs, 12))
    buffer = make_buffer(n_envs, horizon, slots, seed=draw(st.integers(0, 99)))
    recorder = Recorder(buffer)
    for _ in range(draw(st.integers(1, 25))):
        ends = [step + 1 == horizon or draw(st.integers(0, 5)) == 0 for step in recorder.step]
        recorder.add(ends)
        if draw(st.integers(0, 7)) == 0:
            for environment in range(n_envs):
                if recorder.step[environment] > 0:
                    recorder.restart(environment)
    return buffer, recorder


@settings(max_examples=150, deadline=None)
@given(histories())
def test_every_drawn_transition_is_a_stored_one_with_a_goal_of_its_episode(
    history: tuple[GoalReplayBuffer, Recorder],
) -> None:
    buffer, recorder = history
    drawn = buffer.sample_transitions(200)
    relabelled = drawn.goal_step[:, 0] >= 0
    for row in range(200):
        environment, episode, step = (int(value) for value in drawn.observation[row])
        assert (environment, episode, step) in recorder.transitions
        assert tuple(drawn.next_observation[row]) == (environment, episode, step + 1)
        assert tuple(drawn.action[row] * 64) == (episode, step)
        expected = recorder.achieved(environment, episode, step + 1)
        assert tuple(drawn.next_achieved_goal[row]) == expected
        assert tuple(drawn.achieved_goal[row]) == recorder.achieved(environment, episode, step)
        if relabelled[row]:
            later = int(drawn.desired_goal[row, 0]) - 1
            assert step < later <= recorder.lengths[environment, episode]
            assert drawn.desired_goal[row, 1] == 100 * environment + episode
        else:
            assert tuple(drawn.desired_goal[row]) == (-1 - environment, -1 - episode)
    np.testing.assert_array_equal(
        drawn.reward[:, 0], reward_of(drawn.next_achieved_goal, drawn.desired_goal)
    )


@settings(max_examples=60, deadline=None)
@given(histories())
def test_the_newest_transitions_are_kept_and_each_can_be_drawn(
    history: tuple[GoalReplayBuffer, Recorder],
) -> None:
    buffer, recorder = history
    stored = buffer.size()
    drawn = buffer.sample_transitions(60 * stored)
    seen = {tuple(int(value) for value in row) for row in drawn.observation}
    assert len(seen) == stored
    episodes = {(environment, episode) for environment, episode, _ in seen}
    assert len(episodes) <= buffer.n_slots
    # An episode is kept whole, and none is kept whose successor in the same environment is gone.
    assert stored == sum(recorder.lengths[key] for key in episodes)
    for environment, episode in episodes:
        for later in range(episode, max(k for e, k in recorder.lengths if e == environment)):
            assert (environment, later) in episodes


def test_nothing_is_lost_before_the_buffer_is_full() -> None:
    buffer = make_buffer(n_envs=2, horizon=5, slots=20)
    recorder = Recorder(buffer)
    for step in range(50):
        recorder.add([step % 5 == 4, step % 5 == 4])
        assert buffer.size() == 2 * (step + 1)
    recorder.add([False, False])
    assert buffer.size() == 100 - 2 * 5 + 2


def test_short_episodes_do_not_lap_a_running_one() -> None:
    buffer = make_buffer(n_envs=2, horizon=6, slots=3)
    recorder = Recorder(buffer)
    for step in range(6):
        recorder.add([True, step == 5])
        drawn = buffer.sample_transitions(500)
        long = drawn.observation[drawn.observation[:, 0] == 1]
        assert set(long[:, 2]) == set(range(step + 1))
        assert (long[:, 1] == 0).all()


def test_short_and_long_episodes_are_drawn_by_their_length() -> None:
    buffer = make_buffer(n_envs=2, horizon=6)
    recorder = Recorder(buffer)
    for step in range(6):
        recorder.add([step % 2 == 1, step == 5])
    drawn = buffer.sample_transitions(30_000)
    counts = np.bincount(drawn.observation[:, 0].astype(int))
    assert abs(counts[0] / 30_000 - 0.5) < 0.02


def test_relabelling_probability_and_the_whole_future() -> None:
    buffer = make_buffer(n_envs=1, horizon=6, relabel_probability=0.8)
    recorder = Recorder(buffer)
    for step in range(6):
        recorder.add([step == 5])
    drawn = buffer.sample_transitions(20_000)
    assert abs((drawn.goal_step >= 0).mean() - 0.8) < 0.02
    first = drawn.goal_step[:, 0][(drawn.step == 0) & (drawn.goal_step[:, 0] >= 0)]
    counts = np.bincount(first, minlength=7)[1:]
    assert counts.min() > 0.8 * len(first) / 6
    last = drawn.goal_step[:, 0][(drawn.step == 5) & (drawn.goal_step[:, 0] >= 0)]
    assert set(last) == {6}


def test_parts_of_a_goal_are_relabelled_apart() -> None:
    buffer = make_buffer(n_envs=1, horizon=6, relabel_probability=0.5, goal_parts=(1, 1))
    recorder = Recorder(buffer)
    for step in range(6):
        recorder.add([step == 5])
    drawn = buffer.sample_transitions(20_000)
    chosen = drawn.goal_step >= 0
    # Both, either and none of two parts, each with its own step.
    assert abs((chosen.sum(axis=1) == 1).mean() - 0.5) < 0.02
    assert (drawn.goal_step[:, 0] != drawn.goal_step[:, 1])[chosen.all(axis=1)].any()
    for part in range(2):
        expected = np.array([recorder.achieved(0, 0, step)[part] for step in range(7)])
        rows = chosen[:, part]
        np.testing.assert_array_equal(
            drawn.desired_goal[rows, part], expected[drawn.goal_step[rows, part]]
        )
        assert (drawn.desired_goal[~rows, part] == -1).all()
        # A part's reward is that of a goal whose other parts are met.
        alone = drawn.next_achieved_goal.copy()
        alone[:, part] = drawn.desired_goal[:, part]
        np.testing.assert_array_equal(
            drawn.reward[:, part], reward_of(drawn.next_achieved_goal, alone)
        )
    assert buffer.sample(8).rewards.shape == (8, 2)


@pytest.mark.parametrize("parts", [(1,), (3,), (2, 0), (1, 2)])
def test_parts_that_do_not_make_up_the_goal_are_refused(parts: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="goal_parts"):
        make_buffer(goal_parts=parts)


@pytest.mark.parametrize(("probability", "share"), [(0.0, 0.0), (1.0, 1.0)])
def test_relabelling_never_and_always(probability: float, share: float) -> None:
    buffer = make_buffer(relabel_probability=probability)
    Recorder(buffer).add([False, False])
    assert (buffer.sample_transitions(100).goal_step >= 0).mean() == share


def test_a_new_reward_function_holds_for_every_transition() -> None:
    buffer = make_buffer()
    Recorder(buffer).add([False, False])
    buffer.reward_function = lambda achieved, desired: np.full(len(achieved), 5.0)
    samples = buffer.sample(64)
    assert samples.rewards.shape == (64, 1)
    assert (samples.rewards == 5).all()
    assert (samples.dones == 0).all()


def test_a_reset_from_outside_begins_a_new_episode() -> None:
    buffer = make_buffer(n_envs=1, relabel_probability=1.0)
    recorder = Recorder(buffer)
    recorder.add([False])
    recorder.restart(0)
    recorder.add([False])
    drawn = buffer.sample_transitions(200)
    np.testing.assert_array_equal(drawn.goal_step, 1)
    assert len(set(drawn.slot)) == 2


def test_end_running_episodes_cuts_them() -> None:
    buffer = make_buffer(n_envs=1, relabel_probability=1.0)
    recorder = Recorder(buffer)
    recorder.add([False])
    buffer.end_running_episodes()
    recorder.add([False])
    assert set(buffer.sample_transitions(100).goal_step[:, 0]) == {1}


def test_advice_is_remembered_with_its_transition() -> None:
    buffer = make_buffer(n_envs=1)
    recorder = Recorder(buffer)
    for step in range(6):
        recorder.add([step == 5], advised=step in (1, 4))
    drawn = buffer.sample_transitions(300)
    np.testing.assert_array_equal(drawn.advised, np.isin(drawn.step, (1, 4)))


def test_samples_pass_through_vec_normalize(make_env: Any) -> None:
    env = VecNormalize(make_env(2), norm_obs_keys=["observation"])
    env.reset()
    buffer = GoalReplayBuffer(
        100,
        env.observation_space,
        env.action_space,
        n_envs=2,
        horizon=10,
        reward_function=reward_function_of(env),
        seed=0,
    )
    observation: Any = env.get_original_obs()
    action = np.zeros((2, 2), np.float32)
    _, _, done, infos = env.step(action)
    buffer.add(observation, env.get_original_obs(), action, np.zeros(2), done, infos)  # type: ignore[arg-type]
    buffer._random = np.random.default_rng(1)
    normalised = buffer.sample(4, env)
    buffer._random = np.random.default_rng(1)
    plain = buffer.sample_transitions(4)
    expected = env.normalize_obs({"observation": plain.next_observation})["observation"]
    np.testing.assert_allclose(normalised.next_observations["observation"].numpy(), expected)


def test_the_same_seed_draws_the_same() -> None:
    buffers = [make_buffer(seed=seed) for seed in (3, 3, 4)]
    for buffer in buffers:
        recorder = Recorder(buffer)
        for _ in range(5):
            recorder.add([False, False])
    drawn = [buffer.sample(20).observations["observation"] for buffer in buffers]
    assert (drawn[0] == drawn[1]).all()
    assert not (drawn[0] == drawn[2]).all()


def test_sampling_is_fast() -> None:
    horizon, n_envs = 50, 16
    buffer = make_buffer(n_envs, horizon, slots=4000)
    buffer.length[:] = horizon
    times = []
    for _ in range(50):
        buffer._ends = None
        start = time.perf_counter()
        buffer.sample(256)
        times.append(time.perf_counter() - start)
    # 0.2 ms on one core of 2021; an index scan over the 200,000 rows takes 2.6 ms.
    assert min(times) < 1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": 0}, "horizon=0"),
        ({"relabel_probability": 1.5}, "relabel_probability=1.5"),
        ({"n_envs": 21}, "buffer_size=120"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_buffer(**arguments)


def test_spaces_are_checked() -> None:
    box = spaces.Box(-1, 1, (2,))
    with pytest.raises(ValueError, match="Dict"):
        GoalReplayBuffer(10, box, ACTION_SPACE, horizon=5)
    with pytest.raises(ValueError, match="action_space"):
        GoalReplayBuffer(10, SPACE, spaces.Discrete(2), horizon=5)
    other = spaces.Dict({**SPACE, "desired_goal": spaces.Box(-1, 1, (3,))})
    with pytest.raises(ValueError, match="same shape"):
        GoalReplayBuffer(10, other, ACTION_SPACE, horizon=5)


def test_errors_when_sampling() -> None:
    buffer = make_buffer(reward_function=None)
    with pytest.raises(ValueError, match="empty"):
        buffer.sample(2)
    Recorder(buffer).add([False, False])
    with pytest.raises(ValueError, match="reward_function is None"):
        buffer.sample(2)
    buffer.reward_function = lambda achieved, desired: np.zeros((len(achieved), 1))
    with pytest.raises(ValueError, match=r"shape \(2, 1\)"):
        buffer.sample(2)


def test_an_episode_beyond_the_horizon_is_refused() -> None:
    buffer = make_buffer(n_envs=1, horizon=2)
    recorder = Recorder(buffer)
    recorder.add([False])
    recorder.add([False])
    with pytest.raises(ValueError, match="horizon=2"):
        recorder.add([False])


@pytest.mark.parametrize("key", ["observation", "achieved_goal"])
def test_values_that_are_not_finite_are_refused(key: str) -> None:
    buffer = make_buffer(n_envs=3)
    recorder = Recorder(buffer)
    before, after = recorder.observation(), recorder.observation()
    after[key][1:, 0] = np.nan
    with pytest.raises(ValueError, match="environment 1 is not finite"):
        buffer.add(before, after, np.zeros((3, 2)), np.zeros(3), np.zeros(3, bool), [{}] * 3)
    assert buffer.size() == 0


# Files -------------------------------------------------------------------------------------------


def filled(steps: int = 70, **arguments: Any) -> tuple[GoalReplayBuffer, Recorder]:
    buffer = make_buffer(n_envs=2, horizon=6, slots=20, **arguments)
    recorder = Recorder(buffer)
    for count in range(steps):
        recorder.add(
            [step == 5 or (index == 0 and count == 8) for index, step in enumerate(recorder.step)]
        )
    return buffer, recorder


@pytest.mark.parametrize("steps", [3, 9, 70])
def test_a_loaded_buffer_goes_on_exactly_like_the_saved_one(tmp_path: Path, steps: int) -> None:
    buffer, recorder = filled(steps)
    buffer.sample(10)
    buffer.save_npz(tmp_path / "replay.npz")
    loaded = make_buffer(n_envs=2, horizon=6, slots=20, seed=99)
    Recorder(loaded).add([False, False])
    loaded.load_npz(tmp_path / "replay.npz")
    for _ in range(2):
        mine, other = buffer.sample_transitions(50), loaded.sample_transitions(50)
        for name in vars(mine):
            np.testing.assert_array_equal(getattr(mine, name), getattr(other, name))
        # One step more, by the same recorder, goes to the same slots.
        before = recorder.observation()
        recorder.step = [step + 1 for step in recorder.step]
        for each in (buffer, loaded):
            each.add(
                before,
                recorder.observation(),
                np.zeros((2, 2)),
                np.zeros(2),
                np.array([True, True]),
                [{}, {}],
            )
        for environment in range(2):
            recorder.restart(environment)
    # What was loaded is all there when saved again.
    loaded.save_npz(tmp_path / "again.npz")
    again = make_buffer(n_envs=2, horizon=6, slots=20)
    again.load_npz(tmp_path / "again.npz")
    assert buffer.size() == loaded.size() == again.size()
    np.testing.assert_array_equal(again.observation, loaded.observation)


def test_a_damaged_or_foreign_file_is_named(tmp_path: Path) -> None:
    buffer, _ = filled()
    path = tmp_path / "replay.npz"
    buffer.save_npz(path)
    content = path.read_bytes()
    observation = buffer.observation.copy()
    for damaged in (content[: len(content) // 2], b"", b"not a file of ours"):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"replay\.npz"):
            buffer.load_npz(path)
    np.savez(path, something=np.zeros(3))
    with pytest.raises(ValueError, match="header"):
        buffer.load_npz(path)
    np.savez(path, header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match=r"allow_pickle|[Oo]bject"):
        buffer.load_npz(path)
    np.testing.assert_array_equal(buffer.observation, observation)


@pytest.mark.parametrize("name", ["used", "next_slot"])
@pytest.mark.parametrize("value", [-1, 21, 1.0, True, "1", None])
def test_a_header_out_of_range_is_named(tmp_path: Path, name: str, value: Any) -> None:
    buffer, _ = filled()
    path = tmp_path / "replay.npz"
    buffer.save_npz(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    np.savez(path, **arrays | {"header": np.array(json.dumps({**header, name: value}))})
    with pytest.raises(ValueError, match=rf"replay\.npz: {name}={value!r}: must be from 0 to"):
        buffer.load_npz(path)


def test_a_file_of_another_shape_names_the_difference(tmp_path: Path) -> None:
    buffer, _ = filled()
    buffer.save_npz(tmp_path / "replay.npz")
    with pytest.raises(ValueError, match="horizon is 6, this buffer's is 5"):
        make_buffer(n_envs=2, horizon=5, slots=20).load_npz(tmp_path / "replay.npz")
    with pytest.raises(FileNotFoundError):
        buffer.load_npz(tmp_path / "nothing.npz")


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    buffer, recorder = filled(9)
    path = tmp_path / "replay.npz"
    buffer.save_npz(path)
    content = path.read_bytes()
    recorder.add([True, True])

    def full_disk(file: Any, **arrays: Any) -> None:
        file.write(b"the first part")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match="No space"):
        buffer.save_npz(path)
    assert path.read_bytes() == content
    assert [file.name for file in tmp_path.iterdir()] == ["replay.npz"]
