"""Episodes in worlds that vary: the same in every adapter, in copies, and with threads."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from rollouts import (
    SPARSE_IDS,
    assert_same,
    begun,
    cubes_of,
    objects_of,
    pickled_and_back,
    random_actions,
)

from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.parallel_env import SaverParallelEnv
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.envs.vector_env import SaverVectorEnv
from saver_envs.episodes import Episodes
from saver_envs.registration import make_episodes
from saver_envs.tasks.contract import PENDING, NoStart

HORIZON = 6
KEYS = ("observation", "achieved_goal", "desired_goal")
PUSH, PICK, WRISTS = "JacoPush-v0", "JacoPickAndPlace-v0", "WristPush-v0"


def seen(episodes: Episodes) -> dict[str, NDArray[np.float32]]:
    return episodes.observation().as_dict()


def play_and_compare(first: Episodes, second: Episodes, actions: NDArray[np.float32]) -> None:
    """Step both, reset what is over in both, and compare all that can be seen."""
    for action in actions:
        one, other = first.step(action), second.step(action)
        assert_same(one.info(), other.info())
        over = np.flatnonzero(one.truncated)
        if over.size:
            first.reset(over)
            second.reset(over)
        assert_same(seen(first), seen(second))
        assert_same(first.worlds.values, second.worlds.values)


# ---------------------------------------------------------------- one, many, copies


IDS = [
    "DualJacoPush-v0",
    pytest.param("JacoPickAndPlace-v0", marks=pytest.mark.slow),
    pytest.param("DualMicoPickAndPlace-v0", marks=pytest.mark.slow),
    pytest.param("DualJacoDistance-v0", marks=pytest.mark.slow),
    pytest.param("WristPush-v0", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("env_id", IDS)
def test_single_equals_vector_with_one_and_two_threads(env_id: str) -> None:
    """Bit for bit under `wide`: 3 seeds, 200 steps, ends of episodes included."""
    n, seed = 3, 40
    options: dict[str, Any] = {"randomization": "wide", "max_episode_steps": 45}
    several = [begun(env_id, n, seed, threads=threads, **options) for threads in (1, 2)]
    singles = [begun(env_id, 1, seed + row, **options) for row in range(n)]
    for action in random_actions(several[0].action_size, 200, n):
        outcomes = [episodes.step(action) for episodes in several]
        assert_same(outcomes[0].info(), outcomes[1].info())
        alone = [one.step(action[[row]]) for row, one in enumerate(singles)]
        for row, outcome in enumerate(alone):
            for name, values in outcome.info().items():
                assert_same(values[0], outcomes[0].info()[name][row], name)
        over = np.flatnonzero(outcomes[0].truncated)
        if over.size:
            for episodes in several:
                episodes.reset(over)
            for row in over.tolist():
                singles[row].reset()
        assert_same(seen(several[0]), seen(several[1]))
        for row, one in enumerate(singles):
            for name, values in seen(one).items():
                assert_same(values[0], seen(several[0])[name][row], name)


@pytest.mark.parametrize("how", [copy.deepcopy, pickled_and_back])
@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", PICK, WRISTS])
def test_copies_continue_identically(env_id: str, how: Any) -> None:
    episodes = begun(env_id, 3, randomization="wide", max_episode_steps=16)
    actions = random_actions(episodes.action_size, 40, 3)
    for action in actions[:9]:
        episodes.step(action)
    episodes.reset([1])
    for action in actions[9:12]:
        episodes.step(action)
    copied = how(episodes)
    assert_same(seen(episodes), seen(copied))
    play_and_compare(episodes, copied, actions[12:])


def test_a_state_can_be_returned_to() -> None:
    """Also from another world: the state carries the worlds."""
    episodes = begun("DualJacoPush-v0", 2, randomization="wide", max_episode_steps=30)
    actions = random_actions(episodes.action_size, 25, 2)
    for action in actions[:5]:
        episodes.step(action)
    state = episodes.get_state()
    first = []
    for action in actions:
        episodes.step(action)
        first.append(seen(episodes))
    episodes.reset()
    episodes.set_state(state)
    for action, before in zip(actions, first, strict=True):
        episodes.step(action)
        assert_same(seen(episodes), before)


@pytest.mark.parametrize("env_id", [PUSH, WRISTS])
def test_copies_of_episodes_that_have_not_begun(env_id: str) -> None:
    episodes = make_episodes(env_id, 2, randomization="wide")
    copied = pickled_and_back(episodes)
    for one in (episodes, copied):
        for row in range(2):
            one.set_generator(row, np.random.default_rng(row))
        one.reset()
    assert_same(seen(episodes), seen(copied))


@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", WRISTS])
def test_resets_of_some_leave_the_others_alone(env_id: str) -> None:
    one, other = (begun(env_id, 4, randomization="wide") for _ in range(2))
    actions = random_actions(one.action_size, 24, 4)
    rest = [0, 3]
    for step, action in enumerate(actions):
        if step in (3, 11, 12):
            one.reset([1, 2])
        one.step(action)
        other.step(action)
        for name, values in seen(one).items():
            assert_same(values[rest], seen(other)[name][rest], name)
        for name, values in one.worlds.values.items():
            assert_same(values[rest], other.worlds.values[name][rest], name)
    assert (one.worlds.values["max_speed"][1] != other.worlds.values["max_speed"][1]).all()


# ---------------------------------------------------------------- delays


def delayed_pair(env_id: str, name: str, delay: float) -> tuple[Episodes, Episodes]:
    """Episodes without a delay and with one, from the same starts."""
    plain = begun(env_id, 2, randomization={name: 0})
    return plain, begun(env_id, 2, randomization={name: delay})


@pytest.mark.parametrize("delay", [1, 2, 3])
@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", PICK])
def test_an_action_takes_effect_so_many_steps_later(env_id: str, delay: int) -> None:
    plain, late = delayed_pair(env_id, "action_delay", delay)
    assert_same(seen(plain), seen(late))
    actions = random_actions(plain.action_size, 12, 2)
    resting = late._resting_actions()
    if late.action_size_per_arm == 4:  # the open hand of the start stays open
        assert (resting.reshape(2, -1, 4)[..., 3] == 1).all()
    for _ in range(2):  # the line is emptied by a reset
        for _ in range(delay):
            plain.step(resting)
        for step, action in enumerate(actions):
            late.step(action)
            if step < delay:
                # Nothing has arrived: the set-points are those of the start.
                continue
            plain.step(actions[step - delay])
            assert_same(late.set_point, plain.set_point)
            assert_same(seen(late), seen(plain))
        for episodes in (plain, late):
            for row in range(2):
                episodes.set_generator(row, np.random.default_rng(7 + row))
            episodes.reset()


@pytest.mark.parametrize("delay", [1, 2])
@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", WRISTS])
def test_the_observation_is_so_many_steps_old_and_the_goal_is_not(env_id: str, delay: int) -> None:
    plain, late = delayed_pair(env_id, "observation_delay", delay)
    actions = random_actions(plain.action_size, 12, 2)
    for reset in (False, True):
        if reset:
            for episodes in (plain, late):
                episodes.reset([1])
        history = [seen(plain)["observation"]]
        row = 1 if reset else slice(None)
        assert_same(seen(late)["observation"][row], history[0][row])
        for action in actions:
            ours, theirs = late.step(action), plain.step(action)
            assert_same(ours.info(), theirs.info())
            assert_same(ours.reward, theirs.reward)
            history.append(seen(plain)["observation"])
            old = history[max(len(history) - 1 - delay, 0)]
            assert_same(seen(late)["observation"][row], old[row])
            for name in ("achieved_goal", "desired_goal"):
                assert_same(seen(late)[name], seen(plain)[name])


def test_each_episode_has_its_own_delay() -> None:
    episodes = begun(PUSH, 8, randomization={"action_delay": {"choice": [0, 2]}})
    delays = episodes.worlds.values["action_delay"][:, 0]
    assert set(delays.tolist()) == {0.0, 2.0}
    before = episodes.set_point.copy()
    episodes.step(np.ones((8, 3)))
    moved = (episodes.set_point != before).any(axis=(1, 2))
    np.testing.assert_array_equal(moved, delays == 0)


@pytest.mark.parametrize("delays", [(0, 0), (2, 0), (0, 1), (2, 1)])
@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", PICK])
def test_pending_motion_is_that_of_actions_that_cannot_be_seen_yet(
    env_id: str, delays: tuple[int, int]
) -> None:
    names = ("action_delay", "observation_delay")
    worlds = {"max_speed": 0.3, **dict(zip(names, delays, strict=True))}
    late = begun(env_id, 2, randomization=worlds, observe_pending_motion=True)
    plain = begun(env_id, 2, randomization=worlds)
    layout, sent = late.task.observation_layout, [np.zeros((2, late.task.n_arms, 3))]
    assert layout.size == plain.observation_size + 3 * late.task.n_arms
    for action in random_actions(late.action_size, 9, 2):
        for episodes in (late, plain):
            episodes.step(action)
        motion = action.reshape(2, late.task.n_arms, -1)[..., :3]
        longest = np.linalg.norm(motion, axis=-1, keepdims=True)
        motion = 0.3 * 0.04 * motion / np.maximum(longest, 1.0)
        motion[..., 2] *= late.task.held_height is None
        sent.append(motion)
        if len(sent) == 7:
            late.reset([1])
            plain.reset([1])
            sent = [of * [[[1]], [[0]]] for of in sent]
        pending = layout.get(seen(late)["observation"], PENDING.name)
        expected = sum(sent[len(sent) - sum(delays) :], np.zeros_like(sent[0]))
        np.testing.assert_allclose(pending, expected, atol=1e-7)
        blocks = layout.blocks(seen(late)["observation"])[..., :-3]
        assert_same(blocks.reshape(2, -1), seen(plain)["observation"])
    copied = pickled_and_back(late)
    play_and_compare(late, copied, random_actions(late.action_size, 5, 2))


def test_pending_motion_is_one_of_set_points() -> None:
    with pytest.raises(ValueError, match=r"observe_pending_motion=True.*not 'joints'"):
        make_episodes(PICK, control="joints", observe_pending_motion=True)


# ---------------------------------------------------------------- speeds and friction


@pytest.mark.parametrize("control", ["cartesian", "joints"])
def test_the_top_speed_is_the_episodes(control: str) -> None:
    options: dict[str, Any] = {"control": control}
    episodes = begun(PICK, 6, randomization={"max_speed": [0.1, 0.4]}, **options)
    speeds = episodes.worlds.values["max_speed"][:, 0]
    up = np.zeros((6, episodes.action_size))
    up[:, 2 if control == "cartesian" else 0] = 1.0
    set_point, targets = episodes.set_point.copy(), episodes.simulation.ctrl.copy()
    episodes.step(up)
    if control == "cartesian":
        moved = np.linalg.norm(episodes.set_point - set_point, axis=-1)[:, 0]
        np.testing.assert_allclose(moved, speeds * 0.04, rtol=1e-9)
    else:
        moved = np.abs(episodes.simulation.ctrl - targets)[:, episodes.scene.arm_ctrl[0, 0]]
        limit = episodes.settings.robot.joint_speed_limits[0]
        np.testing.assert_allclose(moved, limit * speeds / 0.2 * 0.04, rtol=1e-9)


def test_friction_in_the_joints_holds_the_arm_back() -> None:
    """With the same targets the joints lag behind more; a weak torque does not move them at all."""
    lags = []
    for share in (0.0, 0.05, 0.2):
        episodes = begun(PICK, 2, randomization={"joint_friction": share})
        simulation, scene = episodes.simulation, episodes.scene
        up = np.tile([0.0, 0, 1, 1], (2, 1))
        for _ in range(6):
            episodes.step(up)
        lag = simulation.ctrl[:, scene.arm_ctrl] - episodes.simulation.arm_state().joint_position
        lags.append(np.abs(lag).sum(axis=(1, 2)))
    assert (lags[0] < lags[1]).all()
    assert (lags[1] < lags[2]).all()


def test_a_torque_below_the_friction_hardly_moves_a_joint() -> None:
    """Servos without stiffness: a joint that turns freely is stopped by its dry friction."""
    turned = []
    for share in (0.0, 0.1):
        episodes = begun(PUSH, 1, randomization={"joint_friction": share, "servo_stiffness": 0.3})
        simulation, scene = episodes.simulation, episodes.scene
        wrist = scene.joint_dof[0, -1]
        gains = simulation.per_simulation("actuator_gainprm")
        bias = simulation.per_simulation("actuator_biasprm")
        gains[0, scene.arm_ctrl[0, -1], 0] = bias[0, scene.arm_ctrl[0, -1], 1:3] = 0.0
        simulation.qvel[0, wrist] = 1.0
        before = simulation.qpos[0, scene.joint_qpos[0, -1]]
        simulation.advance(250)
        turned.append(abs(simulation.qpos[0, scene.joint_qpos[0, -1]] - before))
    assert turned[1] < 0.2 * turned[0]


# ---------------------------------------------------------------- what is reported


OPTIONS: dict[str, Any] = {
    "randomization": {"object_size": [0.04, 0.09], "tool_offset": [-0.005, 0.005]},
    "report_parameters": True,
    "max_episode_steps": HORIZON,
}


def drawn(env: Any, row: int) -> dict[str, Any]:
    values = env.unwrapped.episodes.worlds.values
    return {"object_size": values["object_size"][row, 0], "tool_offset": values["tool_offset"][row]}


def test_nothing_is_reported_unasked() -> None:
    quiet = {**OPTIONS, "report_parameters": False}
    assert "parameters" not in SaverGoalEnv(PUSH, **quiet).reset(seed=0)[1]
    assert "parameters" not in SaverVectorEnv(PUSH, 2, **quiet).reset(seed=0)[1]


def test_the_single_environment_reports() -> None:
    env = gymnasium.make(PUSH, **OPTIONS)
    for seed in (0, 1):
        _, info = env.reset(seed=seed)
        assert_same(info["parameters"], drawn(env, 0))
        assert isinstance(info["parameters"]["object_size"], float)
        first = info["parameters"]
        info = env.step(env.action_space.sample())[4]
        assert_same(info["parameters"], first)
    env.reset()
    assert first["tool_offset"].shape == (3,)
    assert (first["tool_offset"] != drawn(env, 0)["tool_offset"]).all()


def test_every_agent_reports() -> None:
    env = SaverParallelEnv("DualJacoPush-v0", **OPTIONS)
    _, infos = env.reset(seed=0)
    for agent in env.agents:
        assert_same(infos[agent]["parameters"], drawn(env, 0))
        assert infos[agent]["parameters"]["tool_offset"].shape == (6,)


def test_agents_share_the_world_of_the_single_environment() -> None:
    env = SaverParallelEnv("DualJacoPush-v0", randomization="wide", max_episode_steps=HORIZON)
    single = SaverGoalEnv("DualJacoPush-v0", randomization="wide", max_episode_steps=HORIZON)
    for seed in (4, None):
        env.reset(seed=seed)
        alone = single.reset(seed=seed)[0]
        for action in random_actions(6, HORIZON, 1)[:, 0]:
            assert_same(env.state(), np.concatenate([alone[name] for name in KEYS]))
            blocks = dict(zip(env.agents, action.reshape(2, 3), strict=True))
            _, rewards, _, truncated, _ = env.step(blocks)
            alone, reward, _, over, _ = single.step(action)
            assert set(rewards.values()) == {reward}
            assert set(truncated.values()) == {over}
        assert over


@pytest.mark.slow
def test_pictures_as_observations_report_and_show_the_same_world() -> None:
    options: dict[str, Any] = {"randomization": "wide", "report_parameters": True}
    env = gymnasium.make("WristPushPixels-v0", **options)
    plain = gymnasium.make(WRISTS, **options)
    infos = env.reset(seed=3)[1], plain.reset(seed=3)[1]
    assert_same(infos[0]["parameters"], infos[1]["parameters"])
    assert len(infos[0]["parameters"]) == 17
    usual = gymnasium.make("WristPushPixels-v0")
    seen, other = env.reset(seed=3)[0], usual.reset(seed=3)[0]
    assert all((seen[name] != other[name]).any() for name in ("rgb", "depth"))


def test_the_batch_of_stable_baselines_reports() -> None:
    env = SaverVecEnv(PUSH, 3, seed=0, **OPTIONS)
    env.reset()
    before = [drawn(env, row) for row in range(3)]
    before = copy.deepcopy(before)
    for row, info in enumerate(env.reset_infos):
        assert_same(info["parameters"], before[row])
    for _ in range(HORIZON):
        _, _, dones, infos = env.step(np.zeros((3, 3)))
        for row, info in enumerate(infos):  # also in the step that ends the episode
            assert_same(info["parameters"], before[row])
    assert dones.all()
    for row, info in enumerate(env.reset_infos):
        assert_same(info["parameters"], drawn(env, row))
        assert info["parameters"]["object_size"] != before[row]["object_size"]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_vector_reports_as_gymnasiums_own_does(mode: AutoresetMode) -> None:
    ours = SaverVectorEnv(PUSH, 3, autoreset_mode=mode, **OPTIONS)
    single = SaverGoalEnv(PUSH, **OPTIONS)
    theirs = gymnasium.vector.SyncVectorEnv(
        [lambda: copy.deepcopy(single)] * 3, autoreset_mode=mode
    )
    one: Any = ours.reset(seed=0)
    other: Any = theirs.reset(seed=0)
    assert_same(one[0], other[0])
    for action in [None, *random_actions(3, 3 * HORIZON, 3)]:
        if action is not None:
            one, other = ours.step(action), theirs.step(action)
            if "final_info" in one[-1]:
                assert_same(one[-1]["final_info"], other[-1]["final_info"])
        reported = one[-1]["parameters"]
        assert_same(reported, other[-1]["parameters"])
        assert_same(one[-1]["_parameters"], other[-1]["_parameters"])
        for row in range(3):
            assert_same({name: reported[name][row] for name in drawn(ours, row)}, drawn(ours, row))
        if mode is AutoresetMode.DISABLED and action is not None and one[3].any():
            one = ours.reset(options={"reset_mask": one[3]})
            other = theirs.reset(options={"reset_mask": one[1]["_parameters"].copy()})
            assert_same(one[1]["parameters"], other[1]["parameters"])


# ---------------------------------------------------------------- trouble


def test_a_diverged_episode_keeps_its_world() -> None:
    episodes = begun("DualJacoPush-v0", 3, randomization="wide", report_parameters=True)
    before = copy.deepcopy(episodes.worlds.values)
    model = episodes.simulation.model_of(1)
    episodes.simulation.qvel[1, 0] = np.nan
    outcome = episodes.step(np.zeros((3, episodes.action_size)))
    assert outcome.diverged.tolist() == [False, True, False]
    assert outcome.parameters is not None
    assert_same(outcome.parameters, before)
    np.testing.assert_array_equal(episodes.simulation.model_of(1).geom_size, model.geom_size)
    episodes.reset([1])
    assert (episodes.worlds.values["object_size"][1] != before["object_size"][1]).all()
    np.testing.assert_array_equal(
        episodes.worlds.values["object_size"][[0, 2]], before["object_size"][[0, 2]]
    )


def test_a_world_without_a_start_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two sizes, one never has a start: all episodes get the other."""
    kind = type(make_episodes(PUSH).task)
    sample = kind.sample

    def picky(self: Any, generator: Any, scene: Any) -> Any:
        if self.object_size > 0.06:
            raise NoStart("too large today")
        return sample(self, generator, scene)

    monkeypatch.setattr(kind, "sample", picky)
    episodes = begun(PUSH, 8, randomization={"object_size": {"choice": [0.05, 0.08]}})
    np.testing.assert_array_equal(episodes.worlds.values["object_size"], 0.05)
    half = episodes.simulation.per_simulation("geom_size")[
        :, episodes.scene.model.geom("object0").id
    ]
    np.testing.assert_array_equal(half, 0.025)
    with pytest.raises(
        NoStart, match=r"50 worlds of randomization=\{'object_size': 0.08\} in a row"
    ):
        begun(PUSH, 1, randomization={"object_size": 0.08})
    with pytest.raises(NoStart, match="too large today"):
        begun(PUSH, 1, object_size=0.08)


def two_episodes(**options: Any) -> None:
    """One that ends as Gymnasium says, and the start of the next."""
    env = gymnasium.make(PUSH, **options)
    env.reset(seed=0)
    while not env.step(np.zeros(3))[3]:
        pass
    env.reset()


def make_vector(**options: Any) -> None:
    gymnasium.make_vec(PUSH, num_envs=1, **options)


@pytest.mark.parametrize("make", [two_episodes, make_vector])
def test_slow_episodes_that_end_early_are_warned_of(make: Any) -> None:
    slow = {"max_speed": [0.2, 0.5]}
    message = "a top speed from 0.2 m/s need more: pass max_episode_steps=125"
    with pytest.warns(UserWarning, match=message):
        make(randomization=slow)
    quiet: tuple[dict[str, Any], ...] = (
        {"randomization": slow, "max_episode_steps": 125},
        {"randomization": {"max_speed": [0.5, 0.6]}},
        {"randomization": "held-out:object_mass"},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for options in quiet:
            make(**options)


def test_slow_episodes_are_longer() -> None:
    """Where Gymnasium does not say how long they are."""
    slow = {"max_speed": [0.2, 0.5]}
    assert make_episodes(PUSH, randomization=slow).settings.horizon == 125
    assert make_episodes(PUSH, randomization="wide").settings.horizon == 125
    assert make_episodes(PUSH, randomization="held-out:object_mass").settings.horizon == 50
    assert make_episodes(PUSH, randomization="wide", max_episode_steps=60).settings.horizon == 60


def test_starts_and_success_know_the_size_of_the_cube() -> None:
    episodes = begun(PICK, 16, randomization={"object_size": [0.04, 0.09]})
    size = episodes.worlds.values["object_size"]
    np.testing.assert_allclose(objects_of(episodes).position[..., 2], size / 2, atol=1e-12)
    assert (episodes.goal.reshape(16, 3)[:, 2:] >= size / 2 - 1e-12).all()
    for _ in range(10):
        episodes.step(np.zeros((16, 4)))
    height = episodes.simulation.qpos[:, cubes_of(episodes).qpos[0, 2]]
    resting = np.abs(height - size[:, 0] / 2) < 1e-3
    assert resting.mean() > 0.8


@pytest.mark.long
@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_a_hundred_thousand_steps_without_divergence(env_id: str) -> None:
    """A million over the ten ids, of 64 episodes each, with random and with extreme actions."""
    n, steps = 64, 100_000 // 64 + 1
    episodes = begun(env_id, n, randomization="wide", threads=2)
    generator = np.random.default_rng(0)
    diverged = 0
    for step in range(steps):
        action = generator.uniform(-1, 1, (n, episodes.action_size))
        outcome = episodes.step(action if step % 100 < 50 else np.sign(action))
        diverged += int(outcome.diverged.sum())
        over = np.flatnonzero(outcome.truncated)
        if over.size:
            episodes.reset(over)
    assert diverged == 0
