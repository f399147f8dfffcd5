"""The person on the stretcher: size, mass, joints, skin, and that a pushed arm stays."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from saver_envs.people.manikin import (
    MASS_SHARE,
    SKELETON_BODIES,
    add_manikin,
    joint_centres,
    segment,
    total_mass,
)
from saver_envs.people.stretcher import add_stretcher
from saver_envs.people.surface import ASSET, AVERAGE_MAN, Appearance, BodyShape
from saver_envs.perception.skeleton import JOINTS


def lying(appearance: Appearance = AVERAGE_MAN, steps: int = 0, prefix: str = ""):
    """A person on a plane, after so many steps of 2 ms."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(3, 3, 0.1), contype=1, conaffinity=0
    )
    add_manikin(spec, appearance, prefix=prefix)
    add_stretcher(spec, appearance=appearance, prefix=prefix)
    model = spec.compile()
    data = mujoco.MjData(model)
    if steps:
        mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize(
    "appearance",
    [
        Appearance(),
        Appearance(gender=1.0, heaviness=0.0, stature=1.58),
        Appearance(gender=0.3, heaviness=1.0, stature=1.92, bald=True, shoes=None),
    ],
)
def test_size_and_mass(appearance: Appearance) -> None:
    shape = BodyShape(appearance)
    # Heels to crown; the feet, bent down, reach a little farther.
    assert np.ptp(shape.vertices[:, 0]) == pytest.approx(appearance.stature, rel=0.08)
    model, _ = lying(appearance)
    assert model.body_subtreemass[model.body("pelvis").id] == pytest.approx(
        total_mass(appearance), rel=1e-6
    )
    assert model.nskin >= 5


def test_the_average_man_weighs_seventy_kilograms_in_the_published_shares() -> None:
    assert total_mass(Appearance()) == pytest.approx(70.0)
    both = {"pelvis", "torso", "head"}
    assert sum(v * (1 if k in both else 2) for k, v in MASS_SHARE.items()) == pytest.approx(1.0)


def test_joints_are_those_of_the_skeleton_and_on_the_right_side() -> None:
    assert tuple(SKELETON_BODIES) == JOINTS
    model, data = lying()
    joints = dict(zip(JOINTS, joint_centres(model, data), strict=True))
    for name, place in joints.items():
        if name.startswith("left"):
            mirrored = joints[name.replace("left", "right")] * (1, -1, 1)
            assert place[1] > 0
            assert np.abs(place - mirrored).max() < 0.002
    assert np.abs((joints["left_hip"] + joints["right_hip"])[:2]).max() < 1e-3  # the origin
    assert joints["head"][0] < joints["neck"][0] < 0 < joints["left_knee"][0]
    assert joints["head"][2] > joints["neck"][2] > 0  # on the back


def test_skin_follows_the_bodies() -> None:
    """Vertices at an elbow move with it, those of the trunk do not."""
    shape = BodyShape(Appearance())
    assert np.allclose(shape.weights.sum(axis=1), 1.0)
    forearm = shape.owned("left_forearm")
    centre = shape.head("left_forearm")
    assert np.linalg.norm(forearm - centre, axis=1).min() < 0.06
    assert ASSET.stat().st_size < 300_000


def test_somebody_left_alone_comes_to_rest_and_stays() -> None:
    model, data = lying(steps=1500)
    assert np.abs(data.qvel).max() < 0.05
    before = joint_centres(model, data)
    mujoco.mj_step(model, data, 1000)
    mujoco.mj_forward(model, data)
    assert np.abs(joint_centres(model, data) - before).max() < 0.005
    assert (before[:, 2] > 0.01).all()  # nothing sank in
    assert before[[4, 7], 2].max() < 0.12  # wrists lie down


def test_a_pushed_arm_moves_and_stays_where_it_is_left() -> None:
    model, data = lying(steps=1500)
    hand = model.body("left_hand").id
    wrist = JOINTS.index("left_wrist")
    before = joint_centres(model, data)
    for _ in range(500):
        data.xfrc_applied[hand, :3] = (0, -25.0, 0)  # towards the body
        mujoco.mj_step(model, data)
    data.xfrc_applied[:] = 0
    mujoco.mj_step(model, data, 250)
    mujoco.mj_forward(model, data)
    pushed = joint_centres(model, data)
    assert before[wrist, 1] - pushed[wrist, 1] > 0.08
    assert np.abs(pushed[[0, 8, 11]] - before[[0, 8, 11]]).max() < 0.01  # the trunk did not move
    mujoco.mj_step(model, data, 1000)
    mujoco.mj_forward(model, data)
    assert np.abs(joint_centres(model, data)[wrist] - pushed[wrist]).max() < 0.01


def test_the_trunk_slides_only_when_it_is_pushed_hard() -> None:
    moved = []
    for force in (50.0, 400.0):
        model, data = lying(steps=500)
        start = joint_centres(model, data)[0].copy()
        for _ in range(250):
            data.xfrc_applied[model.body("torso").id, :3] = (0, force, 0)
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        moved.append(abs(joint_centres(model, data)[0, 1] - start[1]))
    assert moved[0] < 0.005
    assert moved[1] > 0.02


def test_names_take_a_prefix_so_that_two_can_lie_side_by_side() -> None:
    spec = mujoco.MjSpec()
    add_manikin(spec, prefix="a_")
    add_manikin(spec, Appearance(gender=1.0), (0, 1.0, 0), 0.3, prefix="b_")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hips = joint_centres(model, data, "b_")[[8, 11]].mean(axis=0)
    assert hips[:2] == pytest.approx([0.0, 1.0], abs=1e-6)
    assert {segment("left_thigh"), segment("torso")} == {"thigh", "torso"}


@pytest.mark.parametrize("degrees", [True, False])
def test_ranges_do_not_depend_on_the_specifications_unit(degrees: bool) -> None:
    spec = mujoco.MjSpec()
    spec.compiler.degree = degrees
    add_manikin(spec)
    low, high = spec.compile().joint("left_forearm").range
    assert np.degrees(high - low) == pytest.approx(145.0)


@pytest.mark.parametrize("bad", [{"heaviness": 1.5}, {"stature": 0.9}, {"gender": float("nan")}])
def test_bodies_that_cannot_be_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=rf"{next(iter(bad))}=.*must be "):
        Appearance(**bad)
