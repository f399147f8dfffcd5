"""Scenes of one to four arms: names, addresses, who collides with whom, and cameras."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from saver_envs.robots import ROBOTS
from saver_envs.robots.description import COLLISION_GROUP, Fingers
from saver_envs.scenes import (
    BASE_SPACING,
    RING_RADIUS,
    Arms,
    Bases,
    Scene,
    base_poses,
    compose,
    free_bodies,
)
from saver_envs.tasks.cubes import CubeTask
from saver_envs.world import FRAMED_HEIGHT, TABLE_BIT


def with_cubes(
    name: str, n: int, fingers: Fingers = Fingers.ACTUATED, bases: Bases = "row"
) -> Scene:
    """Compose a scene with a cube for each arm."""
    return compose(Arms(ROBOTS[name], n, fingers, bases), CubeTask(n))


CASES = [
    pytest.param(name, n_arms, layout, id=f"{name}-{n_arms}-{layout}")
    for name, n_arms, layout in itertools.product(ROBOTS, range(1, 5), ("row", "ring"))
]


@pytest.mark.parametrize(("name", "n_arms", "layout"), CASES)
def test_addresses_lead_to_the_right_names(name: str, n_arms: int, layout: Bases) -> None:
    robot = ROBOTS[name]
    scene = with_cubes(name, n_arms, Fingers.ACTUATED, layout)
    model = scene.model
    assert scene.n_arms == n_arms
    dof, fingers = len(robot.arm_joints), len(robot.finger_joints)
    assert model.nv == n_arms * (dof + fingers + 6)
    assert model.nu == n_arms * (dof + fingers)
    for arm in range(n_arms):
        joints = [model.joint(index).name for index in scene.joint_id[arm]]
        assert joints == [f"arm{arm}_{joint}" for joint in robot.arm_joints]
        servos = [model.actuator(index).name for index in scene.arm_ctrl[arm]]
        assert servos == [f"arm{arm}_{servo}" for servo in robot.arm_actuators]
        servos = [model.actuator(index).name for index in scene.finger_ctrl[arm]]
        assert servos == [f"arm{arm}_{servo}" for servo in robot.finger_actuators]
        assert model.site(scene.tool_site[arm]).name == f"arm{arm}_{robot.tool_site}"
        assert model.site(scene.target_site[arm]).name == f"target{arm}"
        for addresses, names in (
            (scene.joint_qpos, robot.arm_joints),
            (scene.finger_qpos, robot.finger_joints),
        ):
            expected = [model.joint(f"arm{arm}_{joint}").qposadr[0] for joint in names]
            assert addresses[arm].tolist() == expected
        first = model.joint(f"object{arm}_joint").qposadr[0]
        cube = free_bodies(scene, (f"object{arm}",))
        assert cube.qpos[0].tolist() == list(range(first, first + 7))


@pytest.mark.parametrize(("name", "n_arms", "layout"), CASES)
def test_arms_stand_where_the_layout_says(name: str, n_arms: int, layout: Bases) -> None:
    scene = with_cubes(name, n_arms, Fingers.LOCKED, layout)
    data = mujoco.MjData(scene.model)
    mujoco.mj_kinematics(scene.model, data)
    for arm in range(n_arms):
        base = data.body(f"arm{arm}_{ROBOTS[name].base_body}")
        np.testing.assert_allclose(base.xpos, scene.base_position[arm], atol=1e-12)
        np.testing.assert_allclose(base.xmat.reshape(3, 3), scene.base_rotation[arm], atol=1e-12)


def test_row_and_ring() -> None:
    row, yaws = base_poses(4, "row")
    np.testing.assert_allclose(np.diff(row[:, 1]), BASE_SPACING)
    assert not yaws.any()
    np.testing.assert_allclose(base_poses(2, "row")[0][:, 1], (-0.36, 0.36))  # Table 8.1
    ring, yaws = base_poses(4, "ring")
    centre = np.array([RING_RADIUS, 0, 0])
    np.testing.assert_allclose(np.linalg.norm(ring - centre, axis=1), RING_RADIUS)
    ahead = np.stack([np.cos(yaws), np.sin(yaws), np.zeros(4)], axis=-1)
    np.testing.assert_allclose(ring + RING_RADIUS * ahead, np.tile(centre, (4, 1)), atol=1e-12)


@pytest.mark.parametrize("n_arms", [0, 5])
def test_too_few_or_too_many_arms(n_arms: int) -> None:
    with pytest.raises(ValueError, match="1 to 4"):
        base_poses(n_arms, "row")


def test_unknown_layout() -> None:
    with pytest.raises(ValueError, match="'row' or 'ring' or 'bedside'"):
        base_poses(2, "circle")  # type: ignore[arg-type]


def may_touch(model: mujoco.MjModel, first: str, second: str) -> bool:
    a, b = model.geom(first), model.geom(second)
    return bool((a.contype[0] & b.conaffinity[0]) or (b.contype[0] & a.conaffinity[0]))


@pytest.mark.parametrize("name", ROBOTS)
def test_who_may_touch_whom(name: str) -> None:
    model = with_cubes(name, 2).model
    palm, pad = ("palm", "distal_1") if ROBOTS[name].finger_joints else ("stem", "bar")
    assert may_touch(model, f"arm0_{palm}", f"arm1_{palm}")
    assert may_touch(model, f"arm0_{palm}", "table")
    assert may_touch(model, f"arm0_{pad}", "object0")
    assert may_touch(model, f"arm0_{pad}", "object1")
    assert may_touch(model, "object0", "object1")
    assert may_touch(model, "object0", "table")
    assert not may_touch(model, f"arm0_{palm}", "arm0_forearm")
    assert not may_touch(model, "arm0_base", "table")


def framed(scene: Scene, camera: str, points: np.ndarray, aspect: float) -> np.ndarray:
    """Say which points, world frame, a picture of that aspect shows."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    seen = (points - data.camera(camera).xpos) @ data.camera(camera).xmat.reshape(3, 3)
    tangent = np.tan(np.radians(scene.model.camera(camera).fovy[0]) / 2)
    height = -seen[:, 2] * tangent
    return (np.abs(seen[:, 0]) < aspect * height) & (np.abs(seen[:, 1]) < height)


@pytest.mark.parametrize("camera", ["front", "three_quarter", "side", "overhead"])
@pytest.mark.parametrize(("name", "n_arms", "layout"), CASES)
def test_cameras_frame_every_arm(name: str, n_arms: int, layout: Bases, camera: str) -> None:
    scene = with_cubes(name, n_arms, Fingers.LOCKED, layout)
    local = np.array(
        [(x, y, z) for x in (0, 0.55) for y in (-0.25, 0.25) for z in (0, FRAMED_HEIGHT)]
    )
    for arm in range(n_arms):
        points = local @ scene.base_rotation[arm].T + scene.base_position[arm]
        assert framed(scene, camera, points, 4 / 3).all()


def test_a_pushed_cube_slides_and_stops_as_friction_says() -> None:
    cube = CubeTask(1)
    scene = with_cubes("jaco", 1, Fingers.LOCKED)
    address = free_bodies(scene, ("object0",))
    data = mujoco.MjData(scene.model)
    data.qpos[scene.joint_qpos[0]] = data.ctrl[scene.arm_ctrl[0]] = ROBOTS["jaco"].home
    data.qpos[address.qpos[0]] = (0.2, 0.5, cube.object_size / 2, 1, 0, 0, 0)
    speed = 0.5
    data.qvel[address.dof[0, 0]] = speed
    mujoco.mj_step(scene.model, data, 500)
    travelled = data.qpos[address.qpos[0, 0]] - 0.2
    assert travelled == pytest.approx(speed**2 / (2 * cube.object_friction * 9.81), rel=0.1)
    assert np.abs(data.qvel[address.dof[0]]).max() < 1e-3


def test_the_table_is_the_only_geom_of_its_bit() -> None:
    model = with_cubes("jaco", 1).model
    tables = [model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] == TABLE_BIT]
    assert tables == ["table"]
    assert model.geom("table").group[0] == COLLISION_GROUP
