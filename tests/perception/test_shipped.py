"""The weights that ship find the person on the bench."""

from __future__ import annotations

import mujoco
import numpy as np

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, RgbdCamera
from saver_envs.people.manikin import add_manikin, joint_centres
from saver_envs.people.stretcher import add_stretcher
from saver_envs.perception.estimator import PoseEstimator
from saver_envs.perception.lifting import lift
from saver_envs.perception.skeleton import JOINTS, limb_indices
from saver_envs.perception.weights import SHIPPED

#: In the picture of the camera over the bench.
SEEN = [JOINTS.index(name) for name in ("neck", "head", "right_shoulder", "left_shoulder")]
SEEN += [JOINTS.index(name) for name in ("right_hip", "left_hip", "right_elbow", "left_elbow")]


def test_a_person_on_the_bench_is_found_in_picture_and_space() -> None:
    assert SHIPPED.stat().st_size < 5_000_000
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient = (0.4, 0.4, 0.4)
    spec.worldbody.add_light(pos=(0.3, 0.5, 2.5), dir=(0, -0.15, -1), diffuse=(0.5, 0.5, 0.5))
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(3, 3, 0.1), rgba=(0.7, 0.7, 0.7, 1)
    )
    add_manikin(spec, position=(0.35, 0.0, 0.0))
    add_stretcher(spec, position=(0.35, 0.0, 0.0))
    KINECT_V2.add_to(spec, "kinect", BENCH_POSE)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 800)
    mujoco.mj_forward(model, data)
    camera = RgbdCamera(model, "kinect")
    rgb, depth = camera.capture(data, np.random.default_rng(0))
    camera.close()
    estimator = PoseEstimator.shipped(turn=2)
    poses = estimator(rgb)
    truth = joint_centres(model, data)
    pixels, _ = KINECT_V2.project(truth, BENCH_POSE)
    error = np.linalg.norm(poses.joints[0] - pixels, axis=-1)[SEEN]
    assert np.median(error) < 12.0
    assert error.max() < 40.0
    space = lift(poses, depth, KINECT_V2, BENCH_POSE)
    apart = np.linalg.norm(space.positions[0] - truth, axis=-1)[SEEN]
    assert np.median(apart) < 0.05
    # Its arms alone: the same joints, and no others.
    arms = ["left_upper_arm", "left_forearm"]
    part = PoseEstimator.shipped(arms, turn=2)(rgb)
    assert part.found.any(axis=0).sum() <= 3
    elbow = JOINTS.index("left_elbow")
    assert np.linalg.norm(part.joints[0, elbow] - pixels[elbow]) < 40.0
    assert len(limb_indices(arms)) == 2
