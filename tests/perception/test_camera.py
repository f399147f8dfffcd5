"""Projection against what is drawn, back-projection against where things are."""

from __future__ import annotations

import gc
import math

import mujoco
import numpy as np
import pytest

from saver_envs.cameras.off_screen import OffScreenView
from saver_envs.cameras.rgbd import (
    BENCH_POSE,
    KINECT_V2,
    Camera,
    CameraPose,
    RgbdCamera,
    measured_depth,
    pose_of,
)
from saver_envs.people.manikin import add_manikin, joint_centres
from saver_envs.perception.lifting import depth_at


def bench(*balls: tuple[float, float, float]) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.visual.quality.offsamples = 0
    spec.worldbody.add_light(pos=(0, 0, 3))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(5, 5, 0.1))
    for ball in balls:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.02, 0, 0), pos=ball)
    KINECT_V2.add_to(spec, "kinect", BENCH_POSE)
    return spec


def test_field_of_view_is_the_kinects() -> None:
    for focal, size, degrees in zip(KINECT_V2.focal, (512, 424), (70.6, 60), strict=True):
        assert math.degrees(2 * math.atan(size / 2 / focal)) == pytest.approx(degrees)


def test_drawn_balls_are_where_projection_says() -> None:
    balls = [(0.06, 0.03, 0.1), (0.5, 0.3, 0.0), (-0.4, -0.5, 0.2), (0.55, -0.6, 0.05)]
    model = bench(*balls).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = RgbdCamera(model, "kinect")
    drawn = camera.draw(data, "segmentation", shadows=False)
    pixels, depth = KINECT_V2.project(np.array(balls), pose_of(data, "kinect"))
    _, measured = camera.capture(data)
    for ball in range(len(balls)):
        rows, columns = np.nonzero(drawn[..., 0] == ball + 1)
        centre = np.array([columns.mean(), rows.mean()]) + 0.5
        assert np.abs(centre - pixels[ball]).max() < 0.4
        seen = measured[rows, columns].min()
        assert seen == pytest.approx(depth[ball] - 0.02, abs=2e-3)
    camera.close()


def test_a_camera_forgotten_unclosed_takes_nothing_from_another() -> None:
    model = bench((0.06, 0.03, 0.1)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    kept, forgotten = (OffScreenView(model, "kinect", 512, 424) for _ in range(2))
    forgotten.draw_both(data)
    rgb, depth = kept.draw_both(data)
    # A cycle, so that the collector and not the last reference ends it, contexts in any order.
    forgotten.itself = forgotten  # type: ignore[attr-defined]
    del forgotten
    gc.collect()
    rgb_after, depth_after = kept.draw_both(data)
    np.testing.assert_array_equal(rgb_after, rgb)
    np.testing.assert_array_equal(depth_after, depth)
    kept.close()


def test_back_projection_undoes_projection_within_a_millimetre() -> None:
    spec = bench()
    add_manikin(spec, position=(0.35, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    joints = joint_centres(model, data)
    pose = pose_of(data, "kinect")
    assert np.allclose(pose.rotation, BENCH_POSE.rotation)
    pixels, depth = KINECT_V2.project(joints, pose)
    back = KINECT_V2.back_project(pixels, depth, pose)
    assert np.abs(back - joints).max() < 1e-9
    # The top of the picture is towards +x, the feet; its right is towards -y.
    assert pixels[1, 1] > pixels[8, 1]
    assert pixels[2, 0] > pixels[5, 0]  # right shoulder, left shoulder


def test_depth_of_a_slope_is_right_to_a_millimetre() -> None:
    """Back-projected pixels of the floor lie in the floor, all over the picture."""
    model = bench().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pose = CameraPose.looking_at(np.array([1.0, 0.5, 1.5]), np.zeros(3), np.array([0, 0, 1.0]))
    model.cam_pos[0], model.cam_quat[0] = pose.position, pose.quaternion()
    mujoco.mj_forward(model, data)
    camera = RgbdCamera(model, "kinect")
    _, depth = camera.capture(data)
    rows, columns = np.indices(depth.shape)
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    points = KINECT_V2.back_project(pixels, depth, pose_of(data, "kinect"))[depth > 0]
    assert len(points) > 100_000
    assert np.abs(points[:, 2]).max() < 2e-3
    assert np.abs(points[:, 2]).mean() < 1e-3
    camera.close()


def test_noise_is_the_published_one_and_range_is_masked() -> None:
    random = np.random.default_rng(0)
    for z, expected in ((1.0, 1.3e-3), (1.75, 1.544e-3), (4.0, 4.3e-3)):
        measured = measured_depth(np.full((424, 512), z), KINECT_V2, random)
        assert measured.std() == pytest.approx(expected, rel=0.02)
        assert measured.mean() == pytest.approx(z, abs=1e-4)
    exact = np.tile([0.3, 0.49, 0.51, 4.49, 4.51, 100.0], (4, 1))
    assert (measured_depth(exact, KINECT_V2, None)[0] > 0).tolist() == [0, 0, 1, 1, 0, 0]


def test_points_behind_the_camera_have_no_pixel() -> None:
    pixels, depth = KINECT_V2.project(np.array([[0.0, 0.0, 2.0], [0.06, 0.03, 0.2]]), BENCH_POSE)
    assert np.isnan(pixels[0]).all()
    assert pixels[1] == pytest.approx([256, 212])
    assert depth == pytest.approx([-0.8, 1.0])


def test_half_the_size_is_half_the_pixels() -> None:
    point = np.array([0.3, -0.2, 0.1])
    whole, _ = KINECT_V2.project(point, BENCH_POSE)
    half, _ = KINECT_V2.scaled(0.5).project(point, BENCH_POSE)
    assert np.allclose(half, whole / 2)
    assert (KINECT_V2.scaled(0.5).width, KINECT_V2.scaled(0.5).height) == (256, 212)


def test_depth_is_read_around_a_pixel_and_zero_means_none() -> None:
    depth = np.zeros((40, 60), dtype=np.float32)
    depth[10:13, 20:23] = [[1.0, 1.1, 0], [1.2, 0, 1.3], [1.1, 1.1, 9.0]]
    pixels = np.array([[21.5, 11.5], [50.0, 30.0], [np.nan, np.nan], [-3.0, 5.0], [1e9, 0.0]])
    assert depth_at(depth, pixels) == pytest.approx([1.1, 0, 0, 0, 0])


def test_an_unknown_camera_is_named() -> None:
    with pytest.raises(ValueError, match="the model has the cameras kinect"):
        RgbdCamera(bench().compile(), "webcam", Camera(4, 4, (1, 1), (2, 2)))
