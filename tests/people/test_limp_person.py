"""A limp person's masses, lengths, ranges and shape, and that bad input is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from limp_worlds import MAN, WIDE, WOMAN, beyond_ranges, put, run

from saver_envs.people.anthropometry import DE_LEVA, SEXES
from saver_envs.people.bed import Bed, add_bed
from saver_envs.people.body_parts import CENTRAL_PARTS, LIMB_PARTS
from saver_envs.people.limp_joints import PASSIVE_JOINTS, joint_names
from saver_envs.people.limp_people import LIMP_PERSON_PARAMETERS, PEOPLE
from saver_envs.people.limp_person import LIMITS, LimpPerson, add_limp_person
from saver_envs.people.limp_sources import OURS, SOURCES
from saver_envs.people.lying import ArmPosture, LyingPosture, LyingWorld
from saver_envs.people.physique import DENSITY
from saver_envs.world import set_physics

SMALL = LimpPerson("female", 1.55, 18.5)
LARGE = LimpPerson("male", 1.90, 35.0)
EVERYBODY = [MAN, WOMAN, SMALL, LARGE]


def compiled(person: LimpPerson, skins: bool = False, prefix: str = "") -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    set_physics(spec)
    add_limp_person(spec, person, skins=skins, prefix=prefix)
    return spec.compile()


@pytest.mark.parametrize("person", EVERYBODY)
def test_the_segments_weigh_what_the_body_does(person: LimpPerson) -> None:
    model = compiled(person)
    assert model.body_mass.sum() == pytest.approx(person.bmi * person.height**2, rel=1e-9)
    table = DE_LEVA[person.sex]
    for side in ("left", "right"):
        for part in LIMB_PARTS:
            share = model.body(f"{side}_{part}").mass[0] / person.mass
            assert share == pytest.approx(table[part].mass, rel=1e-3), part
    trunk = model.body("torso").mass[0] + model.body("pelvis").mass[0]
    published = sum(table[f"{part}_trunk"].mass for part in ("upper", "middle", "lower"))
    assert trunk / person.mass == pytest.approx(published, rel=1e-3)


@pytest.mark.parametrize("sex", SEXES)
def test_the_published_shares_add_up(sex: str) -> None:
    table = DE_LEVA[sex]
    pairs = sum(table[part].mass for part in LIMB_PARTS)
    assert sum(row.mass for row in table.values()) + pairs == pytest.approx(1.0, abs=2e-4)
    whole = sum(table[part].length for part in ("upper_trunk", "middle_trunk", "lower_trunk"))
    assert whole == pytest.approx(0.35, abs=0.01)


@pytest.mark.parametrize("person", EVERYBODY)
def test_lengths_are_those_of_the_stature(person: LimpPerson) -> None:
    """Arms have the published lengths; legs, stature and centre of mass are close to them."""
    shape, table = person.body.shape, DE_LEVA[person.sex]

    def length(first: str, second: str) -> float:
        return float(np.linalg.norm(shape.head(first) - shape.head(second))) / person.height

    assert length("left_upper_arm", "left_forearm") == pytest.approx(table["upper_arm"].length)
    assert length("left_forearm", "left_hand") == pytest.approx(table["forearm"].length)
    leg = length("left_thigh", "left_shank") + length("left_shank", "left_foot")
    assert leg == pytest.approx(table["thigh"].length + table["shank"].length, rel=0.06)
    assert np.ptp(shape.vertices[:, 0]) == pytest.approx(person.height, rel=0.02)


@pytest.mark.parametrize("person", EVERYBODY)
def test_the_volume_is_that_of_the_mass(person: LimpPerson) -> None:
    shape = person.body.shape
    corners = shape.vertices[shape.faces]
    volume = np.linalg.det(corners).sum() / 6
    assert DENSITY * volume == pytest.approx(person.mass, rel=1e-3)


def test_inertia_grows_with_mass_and_length() -> None:
    thin, heavy = compiled(replace(MAN, bmi=20.0)), compiled(replace(MAN, bmi=30.0))
    np.testing.assert_allclose(heavy.body_inertia[1:], 1.5 * thin.body_inertia[1:], rtol=0.05)
    short, tall = compiled(replace(MAN, height=1.60)), compiled(replace(MAN, height=1.80))
    growth = (1.80 / 1.60) ** 4  # mass with the square at a constant index, radii with the length
    np.testing.assert_allclose(tall.body_inertia[1:], growth * short.body_inertia[1:], rtol=0.03)


def test_a_thigh_has_the_published_inertia() -> None:
    model, row = compiled(MAN), DE_LEVA["male"]["thigh"]
    shape = MAN.body.shape
    way = shape.head("left_shank") - shape.head("left_thigh")
    length, mass = np.linalg.norm(way), model.body("left_thigh").mass[0]
    np.testing.assert_allclose(model.body("left_thigh").ipos, row.centre * way, atol=1e-9)
    radii = np.sort([row.longitudinal, row.transverse, row.sagittal])
    expected = mass * (length * radii) ** 2
    np.testing.assert_allclose(np.sort(model.body("left_thigh").inertia), expected, rtol=1e-6)


@pytest.mark.parametrize("person", EVERYBODY)
def test_the_sides_mirror_each_other(person: LimpPerson) -> None:
    model = compiled(person)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    across = np.array([1.0, -1.0, 1.0])
    for name in [model.body(index).name for index in range(1, model.nbody)]:
        other = name.replace("left_", "right_") if "left_" in name else name
        here, there = data.body(name), data.body(other)
        if other == name and "right_" in name:
            continue
        np.testing.assert_allclose(here.xipos * across, there.xipos, atol=1e-9, err_msg=name)
        assert model.body(name).mass == model.body(other).mass
    for index in range(model.ngeom):
        name = model.geom(index).name
        if "left_" in name:
            twin = data.geom(name.replace("left_", "right_"))
            np.testing.assert_allclose(data.geom(name).xpos * across, twin.xpos, atol=1e-9)


def test_every_part_of_the_body_has_capsules() -> None:
    model = compiled(MAN)
    names = {model.geom(index).name.rpartition("_")[0] for index in range(model.ngeom)}
    sided = {f"{side}_{part}" for side in ("left", "right") for part in LIMB_PARTS}
    assert names == {*CENTRAL_PARTS, *sided}


def test_ranges_and_stiffness_are_those_of_the_table() -> None:
    person = replace(MAN, stiffness=2.0)
    model = compiled(person)
    for joint in PASSIVE_JOINTS:
        assert set(joint.sources) <= {*SOURCES, OURS}
        for name in joint_names(joint):
            compiled_joint = model.joint(name)
            np.testing.assert_allclose(np.degrees(compiled_joint.range), joint.range, atol=1e-9)
            assert compiled_joint.stiffness[0] == pytest.approx(2 * joint.stiffness[0])
            dof = model.jnt_dofadr[compiled_joint.id]
            assert model.dof_damping[dof] == pytest.approx(2 * joint.damping)
    assert model.nv == 32


def test_torque_of_a_bent_spine_hardens() -> None:
    """Springs have the table's cubic stiffness: 0.3 rad of bending take 11 N m."""
    world = LyingWorld(MAN, WIDE)
    put(world, LyingPosture(hinges={"spine_bend": np.degrees(0.3)}))
    dof = world.model.jnt_dofadr[world.model.joint("spine_bend").id]
    assert world.data.qfrc_spring[dof] == pytest.approx(-(14.0 * 0.3 + 260.0 * 0.3**3), rel=1e-6)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"sex": "other"}, "sex='other': must be 'female' or 'male'"),
        ({"height": 1.2}, "height=1.2: must be 1.55 to 1.9 m"),
        ({"height": float("nan")}, "height=nan"),
        ({"bmi": 40.0}, "bmi=40.0: must be 18.5 to 35 kg/m^2"),
        ({"stiffness": 0.0}, "stiffness=0.0: must be 0.3 to 3"),
        ({"friction": -1.0}, "friction=-1.0: must be 0.05 to 1.5"),
        ({"friction": "rough"}, "friction='rough': must be a finite number"),
    ],
)
def test_a_body_out_of_range_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("^", r"\^")):
        LimpPerson(**values)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"width": 0.0}, "width=0.0: must be above 0 m"),
        ({"friction": 3.0}, "friction=3.0: must be 0.02 to 1.5"),
    ],
)
def test_a_bed_out_of_range_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Bed(**values)


def test_drawn_persons_are_valid_and_repeat() -> None:
    first, second = np.random.default_rng(4), np.random.default_rng(4)
    drawn = [LimpPerson.drawn(first) for _ in range(200)]
    assert drawn == [LimpPerson.drawn(second) for _ in range(200)]
    women = [person for person in drawn if person.sex == "female"]
    assert 70 < len(women) < 130
    assert np.mean([one.height for one in women]) < np.mean([one.height for one in drawn])
    for name, (least, greatest, _) in LIMITS.items():
        values = [getattr(person, name) for person in drawn]
        assert least <= min(values) < max(values) <= greatest
        assert np.std(values) > 0.05 * (greatest - least)


def test_the_people_of_the_tasks_span_the_ranges() -> None:
    heights, builds = ([getattr(one, name) for one in PEOPLE] for name in ("height", "bmi"))
    assert min(heights) == LIMITS["height"][0] and max(heights) == LIMITS["height"][1]
    assert min(builds) < 20 and max(builds) > 33
    assert sum(one.sex == "female" for one in PEOPLE) == len(PEOPLE) // 2


def test_parameters_are_within_what_a_person_allows() -> None:
    for parameter in LIMP_PERSON_PARAMETERS:
        name = parameter.name.removeprefix("person_")
        for distribution in (parameter.wide, parameter.held_out):
            for end in distribution.ends if distribution else ():
                assert parameter.allows(end)
                if name in LIMITS:
                    LimpPerson(**{name: end})


def test_the_skin_follows_the_bodies() -> None:
    model = compiled(MAN, skins=True)
    assert model.nskin >= 5 and model.nv == 32
    moving = {model.body(int(body)).name for body in model.skin_bonebodyid}
    assert moving == {model.body(index).name for index in range(1, model.nbody)}


def test_two_persons_in_one_world() -> None:
    spec = mujoco.MjSpec()
    set_physics(spec)
    add_bed(spec, Bed(width=3.0))
    for prefix, aside in (("one_", -0.7), ("two_", 0.7)):
        add_limp_person(spec, MAN, (0.0, aside, 0.05), prefix=prefix, skins=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert model.nv == 64
    across = np.array([1.0, -1.0, 1.0])
    heads = data.body("one_head").xpos * across, data.body("two_head").xpos
    np.testing.assert_allclose(*heads, atol=1e-3)


def test_a_dropped_person_keeps_within_the_ranges() -> None:
    """Limits yield by some degrees to a fall of half a metre, and hold afterwards."""
    for seed, person in enumerate((MAN, WOMAN)):
        world = LyingWorld(person, WIDE)
        arms = (ArmPosture(60, 20, -40, 20), ArmPosture(10, 60, -30, 90))
        put(world, LyingPosture(roll=40.0, arms=arms), lift=0.5)
        world.data.qvel[3:6] = np.random.default_rng(seed).normal(size=3)
        worst = 0.0
        for _ in range(100):
            run(world, 0.02)
            worst = max(worst, *beyond_ranges(world).values())
        assert worst < 12.0
        run(world, 1.0)
        assert max(beyond_ranges(world).values()) < 2.0
