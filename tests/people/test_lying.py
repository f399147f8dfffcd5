"""A limp person falls, stays and rests as a limp body does, and postures hold."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from limp_worlds import MAN, WIDE, WOMAN, angle, put, roll_of, run, site

from saver_envs.people.bed import Bed
from saver_envs.people.limp_person import LimpPerson
from saver_envs.people.lying import ArmPosture, LegPosture, LyingPosture, LyingWorld
from saver_envs.people.lying_starts import ARM_STARTS, LEG_STARTS, drawn_on_side, drawn_supine
from saver_envs.world import TIMESTEP

GRAVITY = 9.81
#: Most that anything of a person at rest moves in 60 s (m): on the back, where limbs or the body
#: rest on edges, and with an arm over the bed's edge.
DRIFT, DRIFT_ON_EDGE, DRIFT_HANGING = 0.005, 0.015, 0.025


def straight_arm(world: LyingWorld) -> None:
    """Lock the left elbow and wrist, straight, by springs."""
    for name in ("left_elbow", "left_wrist"):
        joint = world.model.joint(name)
        joint.stiffness[0] = 1000.0
        world.model.jnt_stiffnesspoly[joint.id] = 0.0
        world.model.qpos_spring[joint.qposadr[0]] = 0.0
        world.model.dof_damping[joint.dofadr[0]] = 5.0


def elevation(world: LyingWorld) -> float:
    """Return the elevation of the left upper arm, radians."""
    way = site(world, "left_elbow") - site(world, "left_shoulder")
    return float(np.arcsin(way[2] / np.linalg.norm(way)))


def pendulum_time(world: LyingWorld, fall: float) -> float:
    """Return how long the left arm takes as a rigid pendulum to fall by an angle, s."""
    model, data = world.model, world.data
    bodies = [model.body(f"left_{part}").id for part in ("upper_arm", "forearm", "hand")]
    pivot = data.xpos[bodies[0]]
    mass = model.body_mass[bodies].sum()
    centre = model.body_mass[bodies] @ data.xipos[bodies] / mass - pivot
    distance = np.linalg.norm(centre)
    axis = np.cross(centre, (0.0, 0.0, -1.0))
    axis /= np.linalg.norm(axis)
    inertia = 0.0
    for body in bodies:
        frame, lever = data.ximat[body].reshape(3, 3), data.xipos[body] - pivot
        own = axis @ frame @ np.diag(model.body_inertia[body]) @ frame.T @ axis
        inertia += own + model.body_mass[body] * (lever @ lever - (lever @ axis) ** 2)
    angle = np.arcsin(centre[2] / distance)
    # Energy gives the speed at each angle; the middle of each step avoids the start at rest.
    edges = angle - fall * (np.linspace(0, 1, 20001) ** 2)
    middle = (edges[:-1] + edges[1:]) / 2
    height = distance * (np.sin(angle) - np.sin(middle))
    speed = np.sqrt(2 * mass * GRAVITY * height / inertia)
    return float(np.sum((edges[:-1] - edges[1:]) / speed))


@pytest.mark.parametrize("person", [MAN, WOMAN])
def test_a_lifted_arm_falls_like_a_pendulum(person: LimpPerson) -> None:
    """A straight arm takes up to a fifth longer than a pendulum without damping, never less."""
    world = LyingWorld(person, WIDE)
    straight_arm(world)
    assert world.laid(LyingPosture()) is not None
    lifted = world.layout.pose(LyingPosture(arms=(ArmPosture(10, 60, 0, 0), ArmPosture())))
    moved = np.isin(world.layout.qpos, world.layout.joint_qpos["left_shoulder"])
    world.data.qpos[world.layout.qpos[moved]] = lifted[moved]
    world.data.qvel[:] = 0.0
    mujoco.mj_forward(world.model, world.data)
    fall = np.radians(40.0)
    end, expected = elevation(world) - fall, pendulum_time(world, fall)
    steps = 0
    while elevation(world) > end:
        mujoco.mj_step(world.model, world.data)
        mujoco.mj_kinematics(world.model, world.data)
        steps += 1
    assert 1.0 < steps * TIMESTEP / expected < 1.2


def test_a_limp_arm_folds_as_it_falls() -> None:
    """The forearm lags behind, the arm lies on the bed within a second, and does not bounce off."""
    world = LyingWorld(MAN, WIDE)
    assert world.laid(LyingPosture()) is not None
    rest = site(world, "left_wrist")[2]
    lifted = world.layout.pose(LyingPosture(arms=(ArmPosture(10, 60, 0, 0), ArmPosture())))
    arm = ("left_shoulder", "left_elbow")
    moved = np.isin(world.layout.qpos, np.concatenate([world.layout.joint_qpos[n] for n in arm]))
    world.data.qpos[world.layout.qpos[moved]] = lifted[moved]
    world.data.qvel[:] = 0.0
    bends, heights = [], []
    for _ in range(100):
        run(world, 0.02)
        bends.append(angle(world, "left_elbow"))
        heights.append(site(world, "left_wrist")[2] - rest)
    assert max(bends) > 30.0
    assert heights[0] > 0.3 and max(heights[60:]) < 0.15


@pytest.mark.parametrize("friction", [0.25, 0.5])
def test_a_pushed_leg_stays(friction: float) -> None:
    """It moves while it is pushed at the ankle, rolls on its heel, and then stays."""
    world = LyingWorld(MAN, replace(WIDE, friction=friction))
    legs = (LegPosture(0, 22, 20, 2), LegPosture())
    assert world.laid(LyingPosture(legs=legs)) is not None
    shank, before = world.model.body("left_shank").id, site(world, "left_ankle")
    push = np.array([0.0, -70.0 * friction, 0.0])
    while site(world, "left_ankle")[1] > before[1] - 0.10:
        lever = site(world, "left_ankle") - world.data.xipos[shank]
        world.data.xfrc_applied[shank] = np.concatenate([push, np.cross(lever, push)])
        run(world, 0.02)
        assert world.data.time < 20.0
    world.data.xfrc_applied[shank] = 0.0
    run(world, 1.5)
    let_go = site(world, "left_ankle")
    assert let_go[1] < before[1] - 0.08
    run(world, 5.0)
    assert np.linalg.norm(site(world, "left_ankle") - let_go) < 0.005


POSTURES = {
    "straight": LyingPosture(),
    "chest": LyingPosture(arms=(ArmPosture(5, 35, -80, 100), ArmPosture(10, 25, -65, 85))),
    "bent": LyingPosture(arms=(ArmPosture(38, 0, -82, 70), ArmPosture(15, 0, -30, 10))),
    "spread": LyingPosture(
        arms=(ArmPosture(45, 0, -30, 15), ArmPosture(25, 0, -20, 15)),
        legs=(LegPosture(0, 20, 20, 2), LegPosture(0, 12, 15, 2)),
    ),
    "bent leg": LyingPosture(legs=(LegPosture(25, 20, 44, 120), LegPosture())),
    "on the side": LyingPosture(
        roll=92.0,
        arms=(ArmPosture(40, 70, 0, 60), ArmPosture(10, 30, -30, 60)),
        legs=(LegPosture(45, 0, 0, 60), LegPosture(55, -8, 0, 80)),
    ),
}


ON_EDGE = ("bent leg", "on the side")


def drift(world: LyingWorld, seconds: float) -> float:
    """Return how far the farthest moving point gets, m."""
    before = world.points()
    run(world, seconds)
    return float(np.linalg.norm(world.points() - before, axis=-1).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "straight",
        *(pytest.param(name, marks=pytest.mark.long) for name in POSTURES if name != "straight"),
    ],
)
def test_nothing_drifts_in_a_minute_of_rest(name: str) -> None:
    world = LyingWorld(MAN, WIDE)
    assert world.laid(POSTURES[name]) is not None
    assert drift(world, 60.0) < (DRIFT_ON_EDGE if name in ON_EDGE else DRIFT)


def test_an_arm_over_the_edge_hangs_and_hardly_drifts() -> None:
    world = LyingWorld(MAN, Bed(width=0.66))
    posture = drawn_supine(np.random.default_rng(3), ("overhanging", "side"))
    assert world.laid(posture) is not None
    assert site(world, "left_wrist")[2] < 0.0 < site(world, "right_wrist")[2]
    assert drift(world, 60.0) < DRIFT_HANGING


@pytest.mark.parametrize(
    "posture",
    [
        LyingPosture(
            arms=(ArmPosture(20, 60, 0, 40), ArmPosture(60, 20, 0, 20)),
            legs=(LegPosture(45, 10, 10, 60), LegPosture(20, 0, 0, 0)),
        ),
        LyingPosture(roll=60.0),
    ],
)
def test_energy_does_not_grow(posture: LyingPosture) -> None:
    """A falling person only loses energy, but for what bent flesh and ends of ranges give back."""
    world = LyingWorld(MAN, WIDE)
    world.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    put(world, posture, lift=0.30)
    energy = [float(world.data.energy.sum())]
    for _ in range(1500):
        mujoco.mj_step(world.model, world.data)
        energy.append(float(world.data.energy.sum()))
    lost = energy[0] - energy[-1]
    rise = (np.array(energy) - np.minimum.accumulate(energy)).max()
    assert lost > 50.0
    assert max(energy) < energy[0] + 0.01
    assert rise < 0.05 * lost


def test_a_mirrored_person_behaves_mirrored() -> None:
    arms = (ArmPosture(50, 30, -40, 60), ArmPosture(10, 10, 0, 20))
    legs = (LegPosture(30, 15, 20, 50), LegPosture(0, 5, 10, 5))
    hinges = {"neck_rotation": 30.0, "spine_bend": 8.0, "spine_twist": -6.0, "left_ankle": 25.0}
    posture = LyingPosture(25.0, arms, legs, hinges)
    across, found = np.array([1.0, -1.0, 1.0]), []
    for one in (posture, posture.mirrored()):
        world = LyingWorld(WOMAN, WIDE)
        put(world, one, lift=0.1)
        run(world, 0.6)
        found.append(world)
    for joint in ("wrist", "ankle", "knee", "elbow"):
        for side, other in (("left", "right"), ("right", "left")):
            place, twin = (
                site(world, f"{which}_{joint}")
                for world, which in zip(found, (side, other), strict=True)
            )
            np.testing.assert_allclose(place * across, twin, atol=1e-3, err_msg=joint)
    apart = site(found[0], "left_wrist") - site(found[0], "right_wrist") * across
    assert np.linalg.norm(apart) > 0.03  # the posture itself is not symmetric


def test_a_turned_person_lies_on_the_bed_at_any_roll() -> None:
    """A torque turns pelvis and thorax by 45 degrees; the bed carries the weight all the while."""
    world = LyingWorld(MAN, WIDE)
    legs = (LegPosture(), LegPosture())
    assert (
        world.laid(LyingPosture(arms=(ArmPosture(50), ArmPosture(8, 28, -70, 90)), legs=legs))
        is not None
    )
    model, data = world.model, world.data
    for _ in range(2000):
        for body in ("pelvis", "torso"):
            error = np.radians(45.0 - roll_of(world, body))
            speed = data.body(body).cvel[0]
            data.xfrc_applied[model.body(body).id, 3] = -(
                150 * np.clip(error, -0.3, 0.3) + 25 * speed
            )
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
    mujoco.mj_forward(model, data)
    for body in ("pelvis", "torso"):
        assert roll_of(world, body) == pytest.approx(45.0, abs=12.0)
    weight = MAN.mass * GRAVITY
    force = np.zeros(6)
    carried = 0.0
    for index in range(data.ncon):
        contact = data.contact[index]
        if "bed" in (model.geom(contact.geom1).name, model.geom(contact.geom2).name):
            mujoco.mj_contactForce(model, data, index, force)
            carried += abs(contact.frame[2]) * force[0]
    assert carried == pytest.approx(weight, rel=0.1)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_person_on_the_side_lies_as_in_the_recovery_position(side: str) -> None:
    world = LyingWorld(MAN, WIDE)
    assert world.laid(drawn_on_side(np.random.default_rng(6), side)) is not None
    sign = 1.0 if side == "left" else -1.0
    for body in ("pelvis", "torso"):
        assert 90.0 < sign * roll_of(world, body) < 165.0


@pytest.mark.parametrize("kind", ["side", "abducted", "bent", "chest"])
def test_arms_come_to_rest_as_they_were_drawn(kind: str) -> None:
    world, random = LyingWorld(WOMAN, WIDE), np.random.default_rng(12)
    for _ in range(3):
        assert world.laid(drawn_supine(random, (kind, kind))) is not None
        wrist, hip = site(world, "left_wrist"), site(world, "left_hip")
        bent = angle(world, "left_elbow")
        way = site(world, "left_elbow") - site(world, "left_shoulder")
        spread = np.degrees(np.arctan2(way[1], way[0]))
        on_bed = wrist[2] < 0.10
        assert on_bed == (kind != "chest")
        if kind == "side":
            assert spread < 25 and bent < 30
        elif kind == "abducted":
            assert 20 < spread < 80 and wrist[1] > hip[1] + 0.1
        elif kind == "bent":
            assert bent > 30
        else:
            assert bent > 70 and wrist[2] > 0.15


@pytest.mark.parametrize("kind", LEG_STARTS)
def test_legs_come_to_rest_as_they_were_drawn(kind: str) -> None:
    world, random = LyingWorld(MAN, WIDE), np.random.default_rng(5)
    other = "spread" if kind == "adducted" else "straight"
    rests = [world.laid(drawn_supine(random, legs=(kind, other))) for _ in range(2)]
    assert all(rest is not None for rest in rests)
    spread = angle(world, "left_hip_abduction")
    if kind == "bent":
        assert angle(world, "left_knee") > 60
    elif kind == "adducted":
        assert spread < -5
    else:
        assert abs(angle(world, "left_knee")) < 10
        assert (spread > 9) == (kind == "spread")


def test_a_resting_person_starts_at_rest_in_another_world() -> None:
    """The 35 numbers are all that rest needs; another world takes them up by name."""
    first, second = LyingWorld(MAN, WIDE), LyingWorld(MAN, WIDE)
    pose = first.laid(LyingPosture(), place=(0.2, -0.1), yaw=0.1)
    assert pose is not None and pose.shape == (35,)
    second.data.qpos[second.layout.qpos] = pose
    mujoco.mj_forward(second.model, second.data)
    assert drift(second, 2.0) < 0.002
    hips = (site(second, "left_hip") + site(second, "right_hip")) / 2
    np.testing.assert_allclose(hips[:2], (0.2, -0.1), atol=0.03)


def test_settling_repeats_exactly() -> None:
    world = LyingWorld(WOMAN, WIDE)
    first = world.laid(POSTURES["chest"])
    np.testing.assert_array_equal(first, world.laid(POSTURES["chest"]))


def test_a_person_on_a_moving_bed_is_carried() -> None:
    world = LyingWorld(MAN, replace(WIDE, speed=-0.08))
    put(world, LyingPosture(), lift=0.02)
    run(world, 3.0)
    before = site(world, "neck")
    run(world, 5.0)
    assert site(world, "neck")[0] - before[0] == pytest.approx(-0.40, abs=0.01)
    world.model.geom_surfacevel[world.model.geom("bed").id, 0] = 0.0
    run(world, 1.0)
    before = site(world, "neck")
    run(world, 1.0)
    assert abs(site(world, "neck")[0] - before[0]) < 0.002


def test_drawn_postures_are_within_the_joints_ranges_and_repeat() -> None:
    layout, random = LyingWorld(MAN, WIDE).layout, np.random.default_rng(0)
    for arm in ARM_STARTS:
        for leg in LEG_STARTS:
            for _ in range(20):
                layout.pose(drawn_supine(random, (arm, arm), (leg, leg)))
    for side in ("left", "right"):
        for _ in range(50):
            layout.pose(drawn_on_side(random, side))
    one, two = (drawn_supine(np.random.default_rng(8)) for _ in range(2))
    assert one == two


def test_bad_postures_are_refused() -> None:
    random = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"arms=\('up', 'side'\): must be two of side, abducted"):
        drawn_supine(random, ("up", "side"))
    with pytest.raises(ValueError, match="side='back': must be 'left' or 'right'"):
        drawn_on_side(random, "back")
    with pytest.raises(ValueError, match="roll=200: must be -180 to 180 degrees"):
        LyingPosture(roll=200)
    world = LyingWorld(MAN, WIDE)
    with pytest.raises(ValueError, match=r"left_elbow=170.0: must be 0 to 143 degrees"):
        world.laid(LyingPosture(arms=(ArmPosture(elbow=170), ArmPosture())))
    with pytest.raises(ValueError, match=r"right_shoulder=.*must be 0 to 105 degrees \(turn"):
        world.laid(LyingPosture(arms=(ArmPosture(), ArmPosture(0, -90, 0, 0))))
    with pytest.raises(ValueError, match="hinges='tail': must be hinges of limp_joints"):
        world.laid(LyingPosture(hinges={"tail": 1.0}))
    with pytest.raises(ValueError, match=r"place=\(5, 0\): must be over the bed"):
        world.laid(LyingPosture(), place=(5, 0))
