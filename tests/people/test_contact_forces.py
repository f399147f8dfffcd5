"""Forces on the parts of the body, torques at the ends of ranges, and their costs, in n worlds."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from saver_envs.people.bed import Bed, add_bed
from saver_envs.people.contact_forces import (
    FORCE_COSTS,
    FORCE_LIMITS,
    LASTING,
    NEVER_MORE,
    TORQUE_COSTS,
    PersonLoads,
    add_load_sensors,
    load_memory,
)
from saver_envs.people.limp_people import PEOPLE, LimpPeople
from saver_envs.people.limp_person import add_limp_person
from saver_envs.people.lying import ArmPosture, LyingPosture, LyingWorld, PersonLayout
from saver_envs.robots import JACO
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, Content, Scene, compose
from saver_envs.simulation import ACTION_DURATION, Simulation
from saver_envs.world import TABLE_BIT

BED = Bed((3.0, 0.0, 0.0), width=1.2)
#: A ball that presses parts of the person, on servos along the axes.
RADIUS, STIFFNESS = 0.03, 4000.0
RAIL = "rail"


class PressedPerson(Content):
    """A person on a bed, a ball on three servos over it, a rail, and an arm far away."""

    variants = 2
    table_height = -1.0

    def scene_key(self) -> str:
        return "pressed person"

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        add_limp_person(spec, PEOPLE[variant], BED.centre, skins=decorated)
        add_bed(spec, BED)
        ball = spec.worldbody.add_body(name="ball", pos=(0, 0, 1.0), gravcomp=1)
        for axis, name in zip(np.eye(3), "xyz", strict=True):
            ball.add_joint(
                name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, damping=(40, 0, 0)
            )
            servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=STIFFNESS, kv=200.0)
        size = (RADIUS, 0, 0)
        bits = {"contype": TABLE_BIT, "conaffinity": 0}
        ball.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size, mass=0.5, **bits)
        spec.worldbody.add_geom(
            name=RAIL,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(3.0, 0.9, 0.1),
            size=(1, 0.02, 0.1),
            **bits,
        )
        add_load_sensors(spec, [arms.body(0), "ball", RAIL])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return compose(Arms(JACO, 1, Fingers.LOCKED), PressedPerson())


@pytest.fixture(scope="module")
def rest() -> list[np.ndarray]:
    """How the persons of both variants rest."""
    poses = [LyingWorld(person, BED).laid(LyingPosture(), BED.centre[:2]) for person in PEOPLE[:2]]
    assert all(pose is not None for pose in poses)
    return poses


class Pressed:
    """n persons at rest, whom the ball can press.

    :param scene: of :class:`PressedPerson`.
    :param rest: poses by variant.
    :param who: variant of each.
    """

    def __init__(self, scene: Scene, rest: list[np.ndarray], who: list[int], threads: int = 1):
        n = len(who)
        self.simulation = Simulation(scene, n, threads=threads, keeps_peaks=True)
        people = self.simulation.keep(LimpPeople)
        rows, variants = np.arange(n), np.array(who)
        people.give(rows, variants, np.ones(n), np.full(n, 0.5))
        home = np.tile(JACO.home, (n, 1, 1))
        self.simulation.reset(rows, home, np.zeros((n, 1, 0)))
        people.lay(rows, np.stack([rest[one] for one in who]))
        self.simulation.refresh()
        self.loads, self.memory = self.simulation.keep(PersonLoads), load_memory(n)
        model = scene.model
        self.axes = np.array([model.joint(name).qposadr[0] for name in "xyz"])
        self.servos = np.array([model.actuator(name).id for name in "xyz"])

    def place_ball(self, points: np.ndarray) -> None:
        """Put the ball at points (n, 3), held by its servos."""
        values = points - (0, 0, 1.0)
        self.simulation.qpos[:, self.axes] = values
        self.simulation.ctrl[:, self.servos] = values
        self.simulation.refresh()

    def press(self, depth: float) -> dict[str, np.ndarray]:
        """Lower the servos' targets and act once."""
        targets = self.simulation.ctrl.copy()
        targets[:, self.servos[2]] -= depth
        assert not self.simulation.step(targets).any()
        return self.loads.readings(self.memory)

    def site(self, name: str) -> np.ndarray:
        return self.simulation.site_position[:, self.simulation.scene.model.site(name).id].copy()


def above(pressed: Pressed, name: str, gap: float = 0.03) -> np.ndarray:
    """Return the points (n, 3) so far above a capsule of each person."""
    scene = pressed.simulation.scene
    points = []
    for row in range(pressed.simulation.n):
        model = pressed.simulation.model_of(row)
        data = mujoco.MjData(model)
        pressed.simulation.copy_into(row, data)
        mujoco.mj_kinematics(model, data)
        geom = scene.model.geom(name).id
        top = data.geom_xpos[geom].copy()
        along = abs(data.geom_xmat[geom].reshape(3, 3)[2, 2]) * model.geom_size[geom, 1]
        top[2] += along + model.geom_size[geom, 0] + RADIUS + gap
        points.append(top)
    return np.stack(points)


def test_the_limits_are_those_of_the_standard() -> None:
    assert FORCE_LIMITS == {
        "skull": 130, "face": 65, "neck": 150, "back": 210, "chest": 140, "abdomen": 110,
        "pelvis": 180, "upper_arm": 150, "forearm": 160, "hand": 140, "thigh": 220,
        "lower_leg": 130,
    }  # fmt: skip
    assert LASTING == 0.5 and NEVER_MORE == ("skull", "face")
    assert len(FORCE_COSTS) == 12
    assert set(TORQUE_COSTS) == {
        f"torque_{joint}"
        for joint in ("spine", "neck", "shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    }


def test_a_person_at_rest_feels_nothing(scene: Scene, rest: list[np.ndarray]) -> None:
    """What the person lies on does not count, and no torque is near its limit."""
    pressed = Pressed(scene, rest, [0, 1])
    for _ in range(5):
        readings = pressed.press(0.0)
    assert set(readings) == {
        *FORCE_COSTS, *TORQUE_COSTS, *(f"cost_{name}" for name in (*FORCE_COSTS, *TORQUE_COSTS))
    }  # fmt: skip
    for cost in (*FORCE_COSTS, *TORQUE_COSTS):
        assert readings[cost].shape == (2,)
        assert not readings[f"cost_{cost}"].any()
    assert max(readings[cost].max() for cost in FORCE_COSTS) < 1.0
    assert readings["torque_knee"].max() < 10.0


@pytest.mark.parametrize(
    ("capsule", "part"),
    [
        ("chest_0", "chest"),
        ("abdomen_0", "abdomen"),
        ("pelvis_1", "pelvis"),
        ("left_thigh_0", "thigh"),
        ("right_shank_0", "lower_leg"),
        ("left_forearm_0", "forearm"),
        ("right_upper_arm_0", "upper_arm"),
        ("face_0", "face"),
    ],
)
def test_a_part_that_is_pressed_feels_the_force(
    scene: Scene, rest: list[np.ndarray], capsule: str, part: str
) -> None:
    """The reading is the force that the servo presses with, and only that part feels most of it."""
    pressed = Pressed(scene, rest, [0, 1])
    pressed.place_ball(above(pressed, capsule))
    for _ in range(30):
        readings = pressed.press(0.002)
    state = pressed.simulation
    height = state.qpos[:, pressed.axes[2]]
    force = STIFFNESS * (height - state.ctrl[:, pressed.servos[2]])
    felt = readings[f"force_{part}"]
    assert (felt > 20.0).all()
    # The ball sinks on slowly, and slips aside on round limbs: damping and side forces differ.
    np.testing.assert_allclose(felt, force, rtol=0.25)
    others = [readings[name] for name in FORCE_COSTS if name != f"force_{part}"]
    assert (np.max(others, axis=0) < 0.8 * felt).all()


def test_a_brief_contact_may_press_twice_as_hard(scene: Scene, rest: list[np.ndarray]) -> None:
    """The limit of a lasting contact holds from half a second on; before, the double."""
    pressed = Pressed(scene, rest, [0])
    pressed.place_ball(above(pressed, "chest_0", gap=0.005))
    limit = FORCE_LIMITS["chest"]
    seen = []
    for action in range(40):
        readings = pressed.press(0.012 if action < 6 else 0.0)
        force, cost = readings["force_chest"][0], readings["cost_force_chest"][0]
        seen.append((force, cost))
    touching = [index for index, (force, _) in enumerate(seen) if force >= 1.0]
    first = touching[0]
    assert touching == list(range(first, 40))
    lasts = first + round(LASTING / ACTION_DURATION + 0.5) - 1
    for index, (force, cost) in enumerate(seen):
        allowed = limit if index >= lasts else 2 * limit
        assert cost == float(force > allowed), index
    assert seen[lasts - 1][1] == 0.0 and limit < seen[lasts - 1][0] < 2 * limit
    assert seen[lasts][1] == 1.0


def test_faces_are_never_pressed_harder(scene: Scene, rest: list[np.ndarray]) -> None:
    pressed = Pressed(scene, rest, [0])
    pressed.place_ball(above(pressed, "face_0", gap=0.005))
    costs = []
    for _ in range(8):
        readings = pressed.press(0.012)
        costs.append((readings["force_face"][0], readings["cost_force_face"][0]))
    assert any(cost for _, cost in costs)
    assert all(cost == float(force > FORCE_LIMITS["face"]) for force, cost in costs)


def test_reading_twice_changes_nothing(scene: Scene, rest: list[np.ndarray]) -> None:
    """A reset of some episodes reads all of them again."""
    pressed = Pressed(scene, rest, [0, 1])
    pressed.place_ball(above(pressed, "chest_0"))
    for _ in range(10):
        once = pressed.press(0.004)
        since = pressed.memory["contact_since"].copy()
        twice = pressed.loads.readings(pressed.memory)
        np.testing.assert_array_equal(since, pressed.memory["contact_since"])
        for name, values in once.items():
            np.testing.assert_array_equal(values, twice[name])


def test_an_arm_pressed_onto_the_chest_presses_the_chest(
    scene: Scene, rest: list[np.ndarray]
) -> None:
    arms = (ArmPosture(5, 30, -75, 95), ArmPosture())
    pose = LyingWorld(PEOPLE[0], BED).laid(LyingPosture(arms=arms), BED.centre[:2])
    assert pose is not None
    pressed = Pressed(scene, [pose, rest[1]], [0])
    resting = pressed.press(0.0)
    trunk = ("force_chest", "force_abdomen")
    before = max(resting[name][0] for name in trunk)
    assert 1.0 < before < 60.0  # the forearm's own weight
    pressed.place_ball(above(pressed, "left_forearm_0", gap=0.01))
    seen = [pressed.press(0.005) for _ in range(30)]  # in the end the ball slips off the arm
    assert max(one["force_forearm"][0] for one in seen) > 30.0
    assert max(one[name][0] for one in seen for name in trunk) > before + 20.0


def test_torque_at_the_end_of_a_range(scene: Scene, rest: list[np.ndarray]) -> None:
    """A torque that overstretches a knee is read, and costs above 30 N m."""
    pressed = Pressed(scene, rest, [0, 1])
    model = scene.model
    thigh, shank = model.body("left_thigh").id, model.body("left_shank").id
    for torque in (15.0, 90.0):
        for _ in range(15):
            axis = np.array([0.0, -1.0, 0.0])  # straightens the left knee of a person on the back
            pressed.simulation.applied_force[:, shank, 3:] = torque * axis
            pressed.simulation.applied_force[:, thigh, 3:] = -torque * axis
            readings = pressed.press(0.0)
        # The bed takes a part of it.
        assert (0.4 * torque < readings["torque_knee"]).all()
        assert (readings["torque_knee"] < torque + 10.0).all()
        assert (readings["cost_torque_knee"] == float(torque > 30.0)).all()
        assert not readings["cost_torque_elbow"].any()


def test_single_and_vector_agree_bit_for_bit(scene: Scene, rest: list[np.ndarray]) -> None:
    together = Pressed(scene, rest, [0, 1, 0], threads=2)
    apart = [Pressed(scene, rest, [who]) for who in (0, 1, 0)]
    for world in (together, *apart):
        world.place_ball(above(world, "chest_0"))
    for _ in range(15):
        several = together.press(0.005)
        for row, world in enumerate(apart):
            for name, value in world.press(0.005).items():
                assert value[0] == several[name][row], name
    for row, world in enumerate(apart):
        np.testing.assert_array_equal(world.simulation.qpos[0], together.simulation.qpos[row])


def test_models_get_bodies_stiffness_and_friction(scene: Scene, rest: list[np.ndarray]) -> None:
    """A row's model equals the compiled one of its person, but for what was asked to differ."""
    pressed = Pressed(scene, rest, [0, 1])
    people = pressed.simulation.keep(LimpPeople)
    people.give(np.arange(2), np.array([1, 0]), np.array([2.0, 1.0]), np.array([0.3, 0.5]))
    stiff, plain = pressed.simulation.model_of(0), pressed.simulation.model_of(1)
    np.testing.assert_array_equal(plain.body_mass, scene.models[0].body_mass)
    np.testing.assert_array_equal(stiff.body_mass, scene.models[1].body_mass)
    layout = PersonLayout(scene.model)
    np.testing.assert_allclose(stiff.geom_friction[layout.geoms, 0], 0.3)
    np.testing.assert_allclose(plain.geom_friction[layout.geoms, 0], 0.5)
    joints = layout.joints
    np.testing.assert_allclose(stiff.jnt_stiffness[joints], 2 * plain.jnt_stiffness[joints])
    np.testing.assert_allclose(stiff.jnt_stiffnesspoly[joints], 2 * plain.jnt_stiffnesspoly[joints])
    moved = np.isin(scene.model.dof_jntid, joints)
    np.testing.assert_allclose(stiff.dof_damping[moved], 2 * plain.dof_damping[moved])
    np.testing.assert_array_equal(stiff.dof_damping[~moved], plain.dof_damping[~moved])
    reference = LyingWorld(replace(PEOPLE[1], stiffness=2.0, friction=0.3), BED).model
    for name in ("left_knee", "spine_bend"):
        assert stiff.joint(name).stiffness[0] == pytest.approx(reference.joint(name).stiffness[0])
    angles = people.angles("left_knee", "spine_twist")
    assert angles.shape == (2, 2) and np.isfinite(angles).all()


def test_a_scene_without_sensors_is_refused() -> None:
    simulation = Simulation(compose(Arms(JACO, 1, Fingers.LOCKED)), 1, keeps_peaks=True)
    with pytest.raises(ValueError, match="of a scene with add_load_sensors"):
        PersonLoads(simulation)
