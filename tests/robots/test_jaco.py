"""Our Jaco against dm-control's model of it, and its collision primitives against its meshes."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from saver_envs.robots import JACO
from saver_envs.robots.description import COLLISION_GROUP, Fingers

#: Bodies of dm-control's model and ours.
BODIES = {
    "b_base": "base",
    **{f"b_{index}": f"link_{index}" for index in range(1, 7)},
    "hand_hand": "hand",
    **{f"hand_b_finger_{index}": f"finger_proximal_{index}" for index in range(1, 4)},
    **{f"hand_b_finger_tip_{index}": f"finger_distal_{index}" for index in range(1, 4)},
}
#: How far a vertex of a body's mesh may stick out of the arm's primitives (m). A fingertip is
#: slimmer than the pad's capsule at its end; everything else is covered more closely.
TOLERANCE = 0.015


@pytest.fixture(scope="module")
def ours() -> mujoco.MjModel:
    return JACO.build(Fingers.ACTUATED).compile()


@pytest.fixture(scope="module")
def theirs() -> mujoco.MjModel:
    found = importlib.util.find_spec("dm_control")  # finds the folder, imports nothing
    if found is None or found.origin is None:
        pytest.skip("dm-control is not installed: a development dependency on Python below 3.13")
    folder = Path(found.origin).parent / "third_party" / "kinova"
    arm = mujoco.MjSpec.from_file(str(folder / "jaco_arm.xml"))
    hand = mujoco.MjSpec.from_file(str(folder / "jaco_hand.xml"))
    arm.attach(hand, site=arm.site("wristsite"), prefix="hand_")
    return arm.compile()


def test_masses_are_those_of_dm_control(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> None:
    for their_name, our_name in BODIES.items():
        expected = theirs.body(their_name).mass[0]
        # dm-control gives the massless last link 1e-9 kg, which MuJoCo asks for.
        assert ours.body(our_name).mass[0] == pytest.approx(expected, abs=2e-9), our_name


def test_inertia_is_that_of_dm_control(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> None:
    for their_name, our_name in BODIES.items():
        if our_name == "link_6":
            continue
        first, second = theirs.body(their_name), ours.body(our_name)
        np.testing.assert_allclose(second.inertia, first.inertia, rtol=1e-3, err_msg=our_name)
        np.testing.assert_allclose(second.ipos, first.ipos, atol=1e-6, err_msg=our_name)


def test_kinematics_are_those_of_dm_control(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> None:
    names = [f"joint_{index}" for index in range(1, 7)]
    fingers = [f"finger_{index}" for index in range(1, 4)]
    our_data, their_data = mujoco.MjData(ours), mujoco.MjData(theirs)
    generator = np.random.default_rng(0)
    for _ in range(50):
        arm, hand = generator.uniform(-math.pi, math.pi, 6), generator.uniform(0.15, 1.35, 3)
        for name, angle in zip(names, arm, strict=True):
            our_data.joint(name).qpos = their_data.joint(name).qpos = angle
        for name, angle in zip(fingers, hand, strict=True):
            our_data.joint(name).qpos = their_data.joint(f"hand_{name}").qpos = angle
        mujoco.mj_kinematics(ours, our_data)
        mujoco.mj_kinematics(theirs, their_data)
        for their_name, our_name in BODIES.items():
            first, second = their_data.body(their_name), our_data.body(our_name)
            np.testing.assert_allclose(second.xpos, first.xpos, atol=1e-6, err_msg=our_name)
            np.testing.assert_allclose(second.xmat, first.xmat, atol=1e-6, err_msg=our_name)
        for name in names:
            axes = our_data.joint(name).xaxis, their_data.joint(name).xaxis
            np.testing.assert_allclose(*axes, atol=1e-6, err_msg=name)
        # Our tool point lies on the hand's axis, 24 mm beyond dm-control's grip site.
        tool, grip = our_data.site(JACO.tool_site), their_data.site("hand_gripsite")
        assert np.linalg.norm(tool.xpos - grip.xpos) == pytest.approx(0.024, abs=1e-4)


def test_joint_ranges_are_those_of_dm_control(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> None:
    for name in JACO.arm_joints:
        np.testing.assert_array_equal(ours.joint(name).limited, theirs.joint(name).limited)
        np.testing.assert_allclose(ours.joint(name).range, theirs.joint(name).range)
    for name in JACO.finger_joints:
        np.testing.assert_allclose(ours.joint(name).range, theirs.joint(f"hand_{name}").range)


def test_torque_limits_are_the_makers(ours: mujoco.MjModel) -> None:
    makers = [30.5] * 3 + [6.8] * 3
    assert JACO.joint_torque_limits == tuple(makers)
    np.testing.assert_allclose(ours.actuator_forcerange[:6, 1], makers)
    np.testing.assert_allclose(ours.jnt_actfrcrange[:6, 1], makers)
    np.testing.assert_allclose(np.degrees(JACO.joint_speed_limits), [36] * 3 + [48] * 3)


def test_the_hand_points_down_at_the_home_posture(ours: mujoco.MjModel) -> None:
    data = mujoco.MjData(ours)
    data.qpos[:6] = JACO.home
    mujoco.mj_kinematics(ours, data)
    upright = data.site(JACO.tool_site).xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(upright, (0, 0, 1), atol=2e-3)


def distance_to_capsule(points: np.ndarray, data: mujoco.MjData, geom: int) -> np.ndarray:
    model = data.model
    radius, half = model.geom_size[geom, :2]
    local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    return np.linalg.norm(local, axis=1) - radius


@pytest.mark.parametrize("body", [name for name in BODIES.values() if name != "link_6"])
def test_primitives_cover_the_mesh(ours: mujoco.MjModel, body: str) -> None:
    data = mujoco.MjData(ours)
    data.qpos[:] = (*JACO.home, 0.6, 0.6, 0.6)
    mujoco.mj_kinematics(ours, data)
    primitives = np.flatnonzero(ours.geom_group == COLLISION_GROUP)
    assert (ours.geom_type[primitives] == mujoco.mjtGeom.mjGEOM_CAPSULE).all()
    is_mesh = (ours.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (
        ours.geom_bodyid == ours.body(body).id
    )
    for geom in np.flatnonzero(is_mesh):
        mesh = ours.mesh(ours.geom_dataid[geom])
        vertices = ours.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
        world = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        outside = np.min([distance_to_capsule(world, data, p) for p in primitives], axis=0)
        assert outside.max() < TOLERANCE
