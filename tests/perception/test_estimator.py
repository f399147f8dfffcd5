"""Pictures in, people out: sizes, turns, bad pictures; lifting; metrics."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from people import person

from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2
from saver_envs.perception.backbones import DEVIATION, MEAN
from saver_envs.perception.drawing import draw_poses
from saver_envs.perception.estimator import PoseEstimator, checked, normalised
from saver_envs.perception.fields import AFFINITY_X, encode
from saver_envs.perception.lifting import DEPTH_TO_CENTRE, lift
from saver_envs.perception.metrics import joint_errors, summarise
from saver_envs.perception.network import LIGHT, PoseNetwork
from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import JOINTS, MIRRORED_LIMBS, N_JOINTS, Visibility

SIZE = (216, 256)


@pytest.fixture(scope="module")
def network() -> PoseNetwork:
    torch.manual_seed(0)
    return PoseNetwork(LIGHT)


def someone(height: int, width: int) -> np.ndarray:
    """Joints (14, 2) of a person in the middle of a picture."""
    return person(np.random.default_rng(5), (width / 2, 0.25 * height), 0.26 * height)


def drawn(joints: np.ndarray, turn: int, shape: tuple[int, int]):
    """What a perfect network says about a picture of that shape, turned and fitted."""
    height, width = shape
    corners = {
        0: joints,
        1: np.stack([joints[:, 1], width - joints[:, 0]], -1),
        2: np.array([width, height]) - joints,
        3: np.stack([height - joints[:, 1], joints[:, 0]], -1),
    }[turn]
    if turn % 2:
        height, width = width, height
    scale = min(SIZE[0] / height, SIZE[1] / width)
    margin = (np.array(SIZE[::-1]) - np.array([width, height]) * scale) / 2
    fields = encode((corners * scale + margin)[None], np.ones((1, 14), bool), SIZE, range(13))
    return lambda _: fields[None]


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
@pytest.mark.parametrize("shape", [(424, 512), (216, 256), (300, 200)])
def test_joints_come_back_in_the_pictures_own_pixels(
    network: PoseNetwork, turn: int, shape: tuple[int, int]
) -> None:
    joints = someone(*shape)
    estimator = PoseEstimator(network, SIZE, turn, run=drawn(joints, turn, shape))
    poses = estimator(np.zeros((*shape, 3), dtype=np.uint8))
    assert len(poses) == 1
    assert np.nanmax(np.abs(poses.joints[0] - joints)) < 2.5 * max(
        shape[0] / SIZE[0], shape[1] / SIZE[1], 1
    )


def test_with_mirror_images_a_mirrored_picture_has_mirrored_fields(network: PoseNetwork) -> None:
    """Which the network alone, untrained, is far from."""
    picture = np.random.default_rng(0).normal(size=(3, *SIZE)).astype(np.float32)
    flipped = np.ascontiguousarray(picture[:, :, ::-1])

    def mirrored(fields: np.ndarray) -> np.ndarray:
        back = fields[MIRRORED_LIMBS, :, :, ::-1].copy()
        back[:, AFFINITY_X] *= -1
        return back

    both = PoseEstimator(network, SIZE, mirror=True)
    np.testing.assert_allclose(both.fields(flipped), mirrored(both.fields(picture)), atol=1e-5)
    alone = PoseEstimator(network, SIZE)
    assert np.abs(alone.fields(flipped) - mirrored(alone.fields(picture))).max() > 1e-2


def test_mirror_images_need_both_sides() -> None:
    one_side = PoseNetwork(LIGHT, ["head", "left_forearm"])
    with pytest.raises(ValueError, match="needs the limbs right_forearm as well"):
        PoseEstimator(one_side, mirror=True)


@pytest.mark.parametrize("value", [0, 255])
@pytest.mark.parametrize("shape", [(424, 512), (1, 1), (7, 900), (1080, 1920)])
def test_any_picture_gives_a_result(
    network: PoseNetwork, value: int, shape: tuple[int, int]
) -> None:
    poses = PoseEstimator(network)(np.full((*shape, 3), value, dtype=np.uint8))
    assert poses.joints.shape == (len(poses), N_JOINTS, 2)
    assert (np.isnan(poses.joints).any(axis=-1) == (poses.scores == 0)).all()


def test_floats_count_as_shares_and_other_types_are_named(network: PoseNetwork) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    assert np.array_equal(checked(pixels / 255.0), pixels)
    assert checked(np.array([[[np.nan, np.inf, -1.0]]])).tolist() == [[[0, 255, 0]]]
    with pytest.raises(ValueError, match="type int64: must be uint8"):
        checked(pixels.astype(np.int64))
    for shape in ((20, 30), (20, 30, 4), (0, 30, 3)):
        with pytest.raises(ValueError, match=r"must be \(height, width, 3\)"):
            checked(np.zeros(shape, dtype=np.uint8))
    for size in ((200, 250), (250, 200)):
        with pytest.raises(ValueError, match=r"size=\(2.0, 2.0\).*multiples of 8"):
            PoseEstimator(network, size)


def test_pictures_are_fitted_into_the_middle() -> None:
    canvas, scale, offset = normalised(np.full((50, 200, 3), 255, np.uint8), SIZE)
    assert (scale, offset.tolist()) == (1.28, [0, 76])
    assert (canvas[:, :76] == 0).all()
    white = (1 - np.array(MEAN)) / np.array(DEVIATION)
    np.testing.assert_allclose(canvas[:, 76:140].mean(axis=(1, 2)), white, rtol=1e-5)


def test_lifting_gives_centres_and_zero_depth_gives_none() -> None:
    joints = np.full((1, N_JOINTS, 3), np.nan)
    joints[0, :, 0], joints[0, :, 1] = np.linspace(-0.3, 0.4, 14), np.linspace(-0.4, 0.4, 14)
    joints[0, :, 2] = 0.1
    pixels, distance = KINECT_V2.project(joints, BENCH_POSE)
    depth = np.full((424, 512), 2.0, dtype=np.float32)
    for (x, y), far, behind in zip(
        pixels[0].astype(int), distance[0], DEPTH_TO_CENTRE, strict=True
    ):
        depth[y - 3 : y + 4, x - 3 : x + 4] = far - behind
    x, y = pixels[0, 4].astype(int)
    depth[y - 3 : y + 4, x - 3 : x + 4] = 0.0
    scores = np.full((1, N_JOINTS), 0.8)
    scores[0, 7], pixels[0, 7] = 0.0, np.nan
    space = lift(Poses(pixels, scores, np.ones(1)), depth, KINECT_V2, BENCH_POSE)
    unknown = np.isnan(space.positions[0]).any(axis=-1)
    assert np.flatnonzero(unknown).tolist() == [4, 7]
    assert (space.scores[0] == 0).tolist() == unknown.tolist()
    assert np.abs(space.positions - joints)[0][~unknown].max() < 1e-3


def test_lifting_nobody_gives_nobody() -> None:
    space = lift(Poses.none(), np.ones((424, 512), np.float32), KINECT_V2, BENCH_POSE)
    assert space.positions.shape == (0, N_JOINTS, 3)


def test_metrics_count_a_missing_joint_as_a_torso() -> None:
    truth = someone(424, 512)[None]
    torso = np.linalg.norm(truth[0, 0] - truth[0, [8, 11]].mean(axis=0))
    seen = np.full((1, 14), Visibility.VISIBLE)
    seen[0, JOINTS.index("left_ankle")] = Visibility.OCCLUDED
    guess = truth.copy()
    guess[0, 4] += (3.0, 4.0)
    guess[0, 7] += (0.5 * torso, 0.0)
    guess[0, 10] = np.nan
    guess[0, 13] += 1000.0  # hidden: does not count
    scores = np.where(np.isnan(guess[..., 0]), 0.0, 0.9)
    summary = summarise([joint_errors(Poses(guess, scores, np.ones(1)), truth, seen)], scale=2.0)
    assert summary.joints == 13
    assert summary.pck == pytest.approx(11 / 13)
    assert summary.mean_pixels == pytest.approx(2 * (5 + 0.5 * torso + torso) / 13)
    assert summary.detected == pytest.approx(12 / 13)
    assert np.isnan(summary.pck_by_joint[13])
    nobody = summarise([joint_errors(Poses.none(), truth, seen)])
    assert (nobody.pck, nobody.detected) == (0.0, 0.0)
    assert nobody.mean_pixels == pytest.approx(torso)


def test_every_true_person_gets_an_estimate_of_their_own() -> None:
    one = someone(424, 512)
    truth = np.stack([one, one + np.array([120.0, 10.0])])
    poses = Poses(truth[::-1].copy(), np.ones((2, 14)), np.ones(2))
    errors = joint_errors(poses, truth, np.full((2, 14), Visibility.VISIBLE))
    assert errors.estimate.tolist() == [1, 0]
    assert errors.pixels.max() == 0.0


def test_drawing_leaves_the_picture_alone() -> None:
    image = np.zeros((424, 512, 3), dtype=np.uint8)
    poses = Poses(someone(424, 512)[None], np.ones((1, 14)), np.ones(1))
    assert draw_poses(image, poses).any()
    assert not image.any()
    assert np.array_equal(draw_poses(image, Poses.none()), image)
