"""Experts solve their tasks from the observation alone. The bars here leave room for chance on few
episodes; the long tests hold the specification's bars on 200.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from reproduction.transfer.attempts import conditions
from saver_advisors.evaluation.episodes import evaluate_policy
from saver_envs.experts import make_expert
from saver_envs.experts.blocks import ArmView, Viewer
from saver_envs.experts.coordination import JACO_CLOSED, JACO_HOLDING, Coordinator, Plan
from saver_envs.experts.distance import turned
from saver_envs.experts.geometry import way_round
from saver_envs.experts.pick import PickSkill
from saver_envs.experts.push import PushSkill
from saver_envs.registration import make_episodes, task_and_settings
from saver_envs.robots import MICO
from saver_envs.simulation import ACTION_DURATION

#: Those of Table 5.4, with larger cubes.
ALL_DIFFERENCES = conditions("push")[-1].randomization


def success(env_id: str, episodes: int, **arguments: Any) -> float:
    """Return the success rate of an expert; see :func:`rates`."""
    return rates(env_id, episodes, **arguments)[0]


def rates(
    env_id: str,
    episodes: int,
    seed: int = 0,
    coordinated: bool = True,
    free_arm: int | None = None,
    **options: Any,
) -> tuple[float, float]:
    """Return an expert's success rate and safe success rate."""
    expert = make_expert(env_id, coordinated=coordinated, free_arm=free_arm, **options)
    result = evaluate_policy(
        lambda seen: expert.predict(seen)[0],
        env_id,
        episodes=episodes,
        seed=seed,
        env_kwargs=options,
    )
    return result.success_rate, result.safe_success_rate


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "episodes", "least"),
    [
        ("JacoPush-v0", 40, 0.92),
        ("JacoPickAndPlace-v0", 40, 0.95),
        ("MicoPush-v0", 40, 0.75),
        ("MicoPickAndPlace-v0", 40, 0.9),
        ("DualJacoPickAndPlace-v0", 30, 0.85),
        ("DualJacoDistance-v0", 30, 0.85),
        ("DualJacoPush-v0", 30, 0.85),
        ("DualJacoCarry-v0", 20, 0.95),
        ("WristPush-v0", 20, 0.9),
    ],
)
def test_an_expert_solves_its_task(env_id: str, episodes: int, least: float) -> None:
    assert success(env_id, episodes, seed=1000) >= least


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "DualJacoPickAndPlace-v0"])
def test_one_arm_cannot_serve_both_cubes(env_id: str) -> None:
    assert success(env_id, 30, seed=1000, free_arm=0) <= 0.2


@pytest.mark.slow
@pytest.mark.parametrize("free_arm", [0, 1])
def test_one_arm_cannot_carry_a_board(free_arm: int) -> None:
    """It lifts its own end, which tilts the board."""
    assert success("DualJacoCarry-v0", 10, free_arm=free_arm) == 0.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("env_id", "least"),
    [
        ("JacoPush-v0", 0.97),
        ("JacoPickAndPlace-v0", 0.97),
        ("DualJacoPush-v0", 0.97),
        ("DualJacoPickAndPlace-v0", 0.97),
        ("DualJacoDistance-v0", 0.90),
        ("DualJacoCarry-v0", 0.97),
        ("ArmStraighten-v0", 0.85),
        ("LegStraighten-v0", 0.85),
        ("LogRoll-v0", 0.85),
        ("Intake-v0", 0.60),
        ("MicoPush-v0", 0.90),
        ("WristPush-v0", 0.95),
    ],
)
def test_an_expert_reaches_the_specified_bar(env_id: str, least: float) -> None:
    assert success(env_id, 200) >= least


@pytest.mark.long
@pytest.mark.parametrize(
    ("env_id", "options", "least", "safe"),
    [
        ("DualJacoPush-v0", {}, 0.95, 0.82),
        ("DualJacoPickAndPlace-v0", {}, 0.95, 0.82),
        ("DualJacoPush-v0", {"contested_share": 1.0}, 0.90, 0.58),
        ("DualJacoPickAndPlace-v0", {"contested_share": 1.0}, 0.90, 0.58),
        ("DualJacoPush-v0", {"n_arms": 3}, 0.85, 0.60),
        ("DualJacoPickAndPlace-v0", {"n_arms": 3}, 0.85, 0.60),
        ("DualJacoPush-v0", {"n_arms": 4}, 0.85, 0.60),
        ("DualJacoPickAndPlace-v0", {"n_arms": 4}, 0.85, 0.60),
        ("JacoPush-v0", {"object_size": 0.09}, 0.85, 0.82),
        ("DualJacoPush-v0", {"object_size": 0.09}, 0.85, 0.60),
        ("JacoPickAndPlace-v0", {"object_size": 0.09}, 0.85, 0.82),
        ("DualJacoPickAndPlace-v0", {"object_size": 0.09}, 0.85, 0.60),
        ("JacoPush-v0", {"randomization": "wide"}, 0.88, 0.65),
        ("DualJacoPush-v0", {"randomization": "wide"}, 0.88, 0.65),
        ("JacoPickAndPlace-v0", {"randomization": "wide"}, 0.88, 0.65),
        ("DualJacoPickAndPlace-v0", {"randomization": "wide"}, 0.88, 0.65),
        ("DualMicoPush-v0", {"randomization": ALL_DIFFERENCES}, 0.75, 0.75),
    ],
)
def test_experts_give_way(env_id: str, options: dict[str, Any], least: float, safe: float) -> None:
    rate, safe_rate = rates(env_id, 200, **options)
    assert rate >= least and safe_rate >= safe


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "episodes"),
    [
        ("JacoPush-v0", 30),
        ("JacoPickAndPlace-v0", 30),
        pytest.param("DualJacoCarry-v0", 10, marks=pytest.mark.long),
    ],
)
def test_an_expert_copes_with_worlds_that_vary(env_id: str, episodes: int) -> None:
    assert success(env_id, episodes, seed=2000, randomization="wide") >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["JacoPush-v0", "JacoPickAndPlace-v0"])
def test_an_expert_that_sees_pending_motion_copes_with_delays(env_id: str) -> None:
    options: dict[str, Any] = {"randomization": {"action_delay": 3, "observation_delay": 1}}
    blind = success(env_id, 32, **options)
    assert success(env_id, 32, observe_pending_motion=True, **options) >= max(0.8, blind + 0.2)


@pytest.mark.parametrize(
    ("options", "gentle"),
    [
        ({}, False),
        ({"object_friction": 0.2}, True),
        ({"randomization": "wide"}, True),
        ({"randomization": "held-out:object_size"}, False),
        ({"randomization": {"object_friction": 0.35}, "object_friction": 0.2}, False),
    ],
)
def test_pushes_are_gentle_where_cubes_may_glide(options: dict[str, Any], gentle: bool) -> None:
    planner = make_expert("DualJacoPush-v0", **options).planner
    assert isinstance(planner, Coordinator) and isinstance(planner.skill, PushSkill)
    assert planner.skill.gentle == gentle


@pytest.mark.slow
def test_cubes_that_may_glide_are_pushed_gently() -> None:
    glides = {"object_friction": 0.1}
    assert success("JacoPush-v0", 32, randomization=glides) >= 0.7
    hasty = make_expert("JacoPush-v0")  # made for the usual friction
    result = evaluate_policy(
        lambda seen: hasty.predict(seen)[0],
        "JacoPush-v0",
        episodes=32,
        env_kwargs={"randomization": glides},
    )
    assert result.success_rate <= 0.4


def test_a_pitched_hand_pushes_high_cubes_from_where_it_can_get() -> None:
    skill = PushSkill(trail=0.02, upright_at=MICO.upright_at, lead=MICO.wrist_lead)
    inward = np.array([[[-1.0, 0.0]]])
    for away, size, kept in ((0.30, 0.09, True), (0.45, 0.09, False), (0.45, 0.056, True)):
        cube, edge = np.array([[[away, 0.0]]]), np.array([[size]])
        heading = skill._attainable(cube, edge, inward)[0, 0]
        assert np.allclose(heading, inward) == kept
        assert np.hypot(*heading) == pytest.approx(1.0)
        if not kept:  # the hand is then within reach behind the cube
            hand = cube[0, 0] - skill.touch(edge)[0, 0] * heading
            assert np.hypot(*hand) < skill.REACH


def test_high_cubes_are_pushed_more_inward_than_straight_but_not_past_the_base() -> None:
    skill, cube = PushSkill(trail=0.02), np.array([0.4, 0.0])
    for off, left in ((1.0, 1.0 - skill.INWARD), (-1.0, skill.INWARD - 1.0), (0.1, 0.0)):
        heading = skill._inward(cube, -np.array([np.cos(off), np.sin(off)]))
        np.testing.assert_allclose(heading, [-np.cos(left), -np.sin(left)], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["JacoPush-v0", "JacoPickAndPlace-v0"])
def test_an_expert_sees_the_size_of_its_cube(env_id: str) -> None:
    world = make_episodes(env_id, 20, object_size=0.09)
    for index in range(20):
        world.set_generator(index, np.random.default_rng(index))
    world.reset()
    expert = make_expert(env_id)  # for cubes of the usual size
    for _ in range(world.settings.horizon):
        outcome = world.step(expert.predict(world.observation().as_dict())[0])
    assert outcome.success.mean() >= 0.85


def test_the_size_is_that_of_the_beginning() -> None:
    world = make_episodes("DualJacoPickAndPlace-v0", 2, object_size=0.08)
    for index in range(2):
        world.set_generator(index, np.random.default_rng(10 + index))
    world.reset()
    viewer, seen = Viewer(make_expert("DualJacoPickAndPlace-v0").task), world.observation()
    first = viewer(seen.as_dict())
    assert first.begins.all()
    np.testing.assert_allclose(first.object_size, 0.08, atol=1e-3)
    for _ in range(viewer.BEGINNING):
        first = viewer(seen.as_dict())
    later = seen.as_dict()
    later["observation"] = seen.observation.copy()
    world.task.observation_layout.get(later["observation"], "object position")[..., 2] += 0.01
    second = viewer(later)
    assert not second.begins.any()
    np.testing.assert_array_equal(second.object_size, first.object_size)


def test_heights_of_cubes_are_averaged_and_taken_from_targets_on_the_table() -> None:
    world = make_episodes("DualJacoPickAndPlace-v0", 2, object_size=0.08)
    world.reset()
    seen = world.observation().as_dict()
    layout, goal = world.task.observation_layout, world.task.goal_layout
    layout.get(seen["observation"], "object position")[..., 2] = [[0.047, 0.037], [0.041, 0.043]]
    goal.get(seen["desired_goal"], "object position")[..., 2] = [[0.20, 0.15], [0.04, 0.15]]
    view = Viewer(make_expert("DualJacoPickAndPlace-v0").task)(seen)
    # In the first episode both targets are in the air, in the second one is on the table.
    np.testing.assert_allclose(view.object_size, [[0.084, 0.084], [0.08, 0.08]], atol=1e-6)
    np.testing.assert_allclose(view.object[..., 2], [[0.042, 0.042], [0.04, 0.04]], atol=1e-6)


@pytest.mark.parametrize("table_height", [-0.01, 0.0, 0.01])
def test_a_held_hand_shows_the_height_of_the_table(table_height: float) -> None:
    world = make_episodes("DualJacoPush-v0", 2, object_size=0.08, table_height=table_height)
    world.reset()
    view = Viewer(make_expert("DualJacoPush-v0").task)(world.observation().as_dict())
    np.testing.assert_allclose(view.table, table_height, atol=1e-3)
    np.testing.assert_allclose(view.object_size, 0.08, atol=2e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    "env_id",
    ["DualJacoPush-v0", "DualJacoPickAndPlace-v0"],
)
@pytest.mark.parametrize("free_arm", [0, 1])
def test_one_arm_alone_stays_below_the_specified_bar(env_id: str, free_arm: int) -> None:
    assert success(env_id, 200, free_arm=free_arm) <= 0.05


@pytest.mark.slow
def test_coordination_beats_arms_that_ignore_one_another() -> None:
    rates = {
        coordinated: success("DualJacoPush-v0", 20, coordinated=coordinated, contested_share=1.0)
        for coordinated in (True, False)
    }
    assert rates[True] >= rates[False] + 0.2


def test_three_arms_in_a_row() -> None:
    assert success("JacoPickAndPlace-v0", 8, n_arms=3) >= 0.5


def test_predict_takes_one_observation_or_many() -> None:
    world = make_episodes("DualJacoPickAndPlace-v0", 3)
    for index in range(3):
        world.set_generator(index, np.random.default_rng(index))
    world.reset()
    batch = world.observation().as_dict()
    many, state = make_expert("DualJacoPickAndPlace-v0").predict(batch, deterministic=True)
    assert many.shape == (3, 8) and state is None
    assert np.abs(many).max() <= 1
    single = {name: values[1] for name, values in batch.items()}
    one, _ = make_expert("DualJacoPickAndPlace-v0").predict(single)
    np.testing.assert_array_equal(one, many[1])


def test_a_new_episode_gets_a_new_plan() -> None:
    world = make_episodes("DualJacoPush-v0", 1, contested_share=1.0)
    used = make_expert("DualJacoPush-v0")
    for seed in range(3):
        world.set_generator(0, np.random.default_rng(seed))
        world.reset()
        observation = world.observation().as_dict()
        fresh = make_expert("DualJacoPush-v0").predict(observation)[0]
        np.testing.assert_array_equal(used.predict(observation)[0], fresh)


def test_errors_name_what_is_valid() -> None:
    with pytest.raises(ValueError, match="JacoPush-v0"):
        make_expert("JacoPsh-v0")
    with pytest.raises(TypeError, match="max_speed"):
        make_expert("JacoPush-v0", max_sped=1.0)
    with pytest.raises(ValueError, match="Cartesian"):
        make_expert("JacoPush-v0", control="joints")
    with pytest.raises(ValueError, match="row"):
        make_expert("DualJacoPush-v0", layout="ring")
    with pytest.raises(ValueError, match="0 to 1"):
        make_expert("DualJacoPush-v0", free_arm=2)
    with pytest.raises(ValueError, match="both arms as one"):
        make_expert("DualJacoDistance-v0", coordinated=False)


def test_plans_hold_every_order_and_way_round_once() -> None:
    plans = Coordinator(PushSkill(), np.array([[0.0, -0.36], [0.0, 0.36]]))._plans
    rows = {
        (float(first), float(waits), float(shoves), *map(float, side))
        for first, waits, shoves, side in zip(
            plans.first[:, 0], plans.waits, plans.shoves, plans.side, strict=True
        )
    }
    assert len(rows) == len(plans.waits) == 40


def test_a_way_passes_beside_a_disc() -> None:
    gap, disc, radius = np.array([[0.3, 0.0]]), np.array([[[0.15, 0.01]]]), np.array([[0.08]])
    shorter = way_round(gap, disc, radius, np.zeros(1))[0]
    assert shorter[0] > 0 > shorter[1]  # to the right of a disc that lies a little to the left
    # A tangent of the disc: its distance from the centre is the radius.
    np.testing.assert_allclose(
        abs(shorter[0] * disc[0, 0, 1] - shorter[1] * disc[0, 0, 0]), 0.08, rtol=1e-6
    )
    assert way_round(gap, disc, radius, np.full(1, -1.0))[0, 1] > 0
    np.testing.assert_allclose(way_round(-gap, disc, radius, np.zeros(1)), [[-1.0, 0.0]], atol=1e-9)
    beyond = disc + np.array([0.3, 0.0])
    np.testing.assert_allclose(way_round(gap, beyond, radius, np.zeros(1)), [[1.0, 0.0]], atol=1e-9)


def test_discs_without_room_between_them_are_passed_as_one() -> None:
    gap = np.array([[0.4, 0.0]])
    discs = np.array([[[0.2, 0.05], [0.2, -0.09]]])
    way = way_round(gap, discs, np.full((1, 2), 0.08), np.zeros(1))[0]
    bearing = np.arctan2(way[1], way[0])
    edges = [
        np.arctan2(y, 0.2) + sign * np.arcsin(0.08 / np.hypot(0.2, y))
        for y, sign in ((0.05, 1.0), (-0.09, -1.0))
    ]
    assert min(abs(bearing - edge) for edge in edges) < 1e-6


def test_a_push_beside_another_cube_begins_aside() -> None:
    """The direct place behind the cube is where another cube lies; the hand goes beside it."""
    skill = PushSkill()
    cube, target, other = np.array([0.40, 0.0]), np.array([0.40, -0.2]), np.array([0.40, 0.09])
    around = (other - cube)[None, None, None]
    ring = skill.ring(np.array([0.056]))
    rings = ring[None, None]
    heading = skill._clear_of(
        around, rings, rings, np.array([[[0.0, -1.0]]]), np.array([[[0.15, 0.0]]]), np.zeros((1, 1))
    )[0, 0]
    behind = cube - ring * heading
    assert np.linalg.norm(behind - other) > ring[0] - 0.015
    assert heading @ (target - cube) > 0


def test_clearance_lets_a_left_hand_pass_far_behind_a_right_one() -> None:
    least = JACO_CLOSED(np.array([-0.2, 0.0, 0.2]))
    assert least[1] > least[0] > least[2]


def test_a_bar_turns_by_a_share_of_the_angle() -> None:
    start, end = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    half = turned(start, end, np.array([[0.5]]))
    np.testing.assert_allclose(half, [[np.sqrt(0.5), np.sqrt(0.5), 0.0]], atol=1e-12)
    np.testing.assert_allclose(turned(start, start, np.array([[0.5]])), start)


def test_plans_can_be_followed_one_by_one() -> None:
    world = make_episodes("DualJacoPush-v0", 1, contested_share=1.0)
    world.set_generator(0, np.random.default_rng(0))
    world.reset()
    planner = make_expert("DualJacoPush-v0").planner
    assert planner is not None and planner.plans == 40
    view = Viewer(world.task)(world.observation().as_dict())
    actions = [planner.follow(view, np.array([plan])) for plan in range(planner.plans)]
    assert len({action.tobytes() for action in actions}) > 1
    assert any(np.array_equal(planner.actions(view), action) for action in actions)


def over_its_cube(size: float, tool_velocity: float, fingers: float) -> ArmView:
    """Return what a hand 0.03 m above the place of its grasp sees that comes down."""
    point, zeros = np.array([[[0.4, 0.1, size / 2]]]), np.zeros((1, 1, 3))
    edge = np.array([[size]])
    view = ArmView(
        tool=zeros,
        tool_velocity=zeros - np.array([0.0, 0.0, tool_velocity]),
        top_speed=np.zeros((1, 1)),
        fingers=np.full((1, 1, 3), fingers),
        finger_velocity=zeros,
        object=point,
        object_quaternion=np.array([[[1.0, 0.0, 0.0, 0.0]]]),
        object_velocity=zeros,
        target=point + np.array([0.0, 0.2, 0.1]),
        object_size=edge,
        table=np.zeros((1, 1)),
        begins=np.ones(1, dtype=bool),
    )
    return replace(view, tool=PickSkill().place(view) + np.array([0.0, 0.0, 0.03]))


def test_a_hand_that_comes_to_rest_over_its_cube_closes() -> None:
    comes, rests = (PickSkill().actions(over_its_cube(0.056, v, 0.58)) for v in (0.1, 0.0))
    assert comes[0, 0, 3] > 0 > comes[0, 0, 2]
    assert rests[0, 0, 3] == -1.0


def test_cubes_of_unusual_sizes_are_carried_slowly() -> None:
    usual, large = (PickSkill().actions(over_its_cube(edge, 0.0, 0.8)) for edge in (0.056, 0.08))
    assert np.linalg.norm(usual[0, 0, :3]) == pytest.approx(1.0)
    assert np.linalg.norm(large[0, 0, :3]) == pytest.approx(PickSkill().gentle)


def test_short_episodes_have_no_time_to_carry_slowly() -> None:
    _, settings = task_and_settings("JacoPickAndPlace-v0", {})
    for horizon, share in ((20, 1.0), (50, 1.0), (125, 0.4)):
        assert PickSkill().fitted(replace(settings, horizon=horizon)).gentle == share


def test_arms_that_are_slow_anyway_are_not_slowed_down() -> None:
    skill, large = PickSkill(), over_its_cube(0.08, 0.0, 0.8)
    full = skill.REACHED * skill.step / ACTION_DURATION
    for top, speed in ((full, skill.gentle), (0.5 * full, 2 * skill.gentle), (0.1 * full, 1.0)):
        action = skill.actions(replace(large, top_speed=np.full((1, 1), top)))
        assert np.linalg.norm(action[0, 0, :3]) == pytest.approx(speed)


def test_the_top_speed_of_an_episode_is_known_once_arms_have_moved() -> None:
    world = make_episodes("JacoPickAndPlace-v0", 1)
    world.set_generator(0, np.random.default_rng(0))
    world.reset()
    look, known = Viewer(world.task), []
    for _ in range(Viewer.MOVED + 1):
        known.append(look(world.observation().as_dict()).top_speed.item())
        world.step(np.array([[0.0, 0.0, 1.0, 0.0]]))
    assert known[:-1] == [0.0] * Viewer.MOVED
    assert 0.2 < known[-1] < world.settings.max_speed


def test_arms_that_are_done_hold_their_places_near_one_another() -> None:
    """One that follows keeps more distance, but not at the cost of its target."""
    base = np.array([[0.0, -0.36], [0.0, 0.36]])
    planner = Coordinator(PickSkill(), base, JACO_HOLDING)
    apart = JACO_HOLDING(np.zeros(1))[0] + planner.BUFFER / 2
    hand = np.array([[[0.4, -apart / 2], [0.4, apart / 2]]])
    view = over_its_cube(0.056, 0.0, 0.8)
    both = {
        name: np.repeat(value, 2, axis=1) for name, value in vars(view).items() if value.ndim > 1
    }
    view = replace(view, **both)
    plan = Plan(np.ones((1, 1)), np.zeros(1), np.zeros(1), np.zeros((1, 2)))
    for done in (False, True):
        served = np.full((1, 2), done)
        move, turned = planner._give_way(view, plan, hand, 0 * hand, served)
        assert turned.any() != done
        assert np.any(move != 0) != done


def test_an_arm_that_was_done_gives_way_as_long_as_it_holds_its_cube() -> None:
    planner = Coordinator(PickSkill(), np.zeros((1, 2)))
    away = over_its_cube(0.056, 0.0, 0.8)
    there, left = replace(away, target=away.object), replace(away, fingers=0.2 + 0 * away.fingers)
    nobody, done = np.zeros((1, 1), dtype=bool), np.ones((1, 1), dtype=bool)
    for view, before, after in ((there, nobody, True), (away, nobody, False), (away, done, True)):
        assert planner._update(view, before).all() == after
    assert not planner._update(left, done).any()
