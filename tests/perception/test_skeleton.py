from __future__ import annotations

import numpy as np
import pytest

from saver_envs.perception.skeleton import (
    COCO_JOINTS,
    JOINTS,
    LIMB_NAMES,
    LIMBS,
    MIRRORED_JOINTS,
    MIRRORED_LIMBS,
    NECK,
    Visibility,
    from_coco,
    joints_of,
    limb_indices,
    to_coco,
)


def test_thirteen_limbs_are_a_tree_with_five_limbs_at_the_neck() -> None:
    assert (len(JOINTS), len(LIMBS)) == (14, 13)
    reached = {NECK}
    for limb in LIMBS:
        assert limb.proximal in reached
        assert limb.distal not in reached
        reached.add(limb.distal)
    assert reached == set(range(14))
    assert sum(limb.proximal == NECK for limb in LIMBS) == 5


def test_mirroring_twice_changes_nothing_and_limbs_follow_joints() -> None:
    assert (MIRRORED_JOINTS[MIRRORED_JOINTS] == np.arange(14)).all()
    for limb, other in zip(LIMBS, MIRRORED_LIMBS, strict=True):
        assert MIRRORED_JOINTS[limb.proximal] == LIMBS[other].proximal
        assert MIRRORED_JOINTS[limb.distal] == LIMBS[other].distal


def test_coco_there_and_back() -> None:
    random = np.random.default_rng(0)
    keypoints = np.concatenate([random.uniform(0, 200, (3, 17, 2)), np.full((3, 17, 1), 2)], -1)
    keypoints[1, COCO_JOINTS.index("left_shoulder"), 2] = Visibility.OCCLUDED
    keypoints[2, COCO_JOINTS.index("right_shoulder"), 2] = Visibility.MISSING
    joints = from_coco(keypoints)
    left, right = (keypoints[:, COCO_JOINTS.index(f"{s}_shoulder")] for s in ("left", "right"))
    assert np.allclose(joints[:2, NECK, :2], (left[:2, :2] + right[:2, :2]) / 2)
    assert joints[:, NECK, 2].tolist() == [2, 1, 0]
    assert (joints[2, NECK] == 0).all()
    back = to_coco(joints[..., :2], joints[..., 2])
    unseen = [
        COCO_JOINTS.index(f"{side}_{part}") for side in ("left", "right") for part in ("eye", "ear")
    ]
    expected = keypoints.copy()
    expected[:, unseen] = 0
    expected[expected[..., 2] == 0] = 0
    assert np.allclose(back, expected)


def test_a_joint_that_was_not_found_is_not_handed_on() -> None:
    joints = np.full((14, 2), np.nan)
    joints[NECK + 1] = (3.0, 4.0)
    scores = np.zeros(14)
    scores[NECK + 1] = 0.7
    keypoints = to_coco(joints, scores)
    assert keypoints[0].tolist() == [3.0, 4.0, 0.7]
    assert (keypoints[1:] == 0).all()


def test_limbs_by_name() -> None:
    assert limb_indices(None) == tuple(range(13))
    assert limb_indices(["left_forearm", "left_upper_arm", "left_forearm"]) == (5, 6)
    assert [JOINTS[joint] for joint in joints_of((5, 6))] == [
        "left_shoulder",
        "left_elbow",
        "left_wrist",
    ]
    with pytest.raises(ValueError, match=r"'tail' is none of head, right_collar"):
        limb_indices(["head", "tail"])
    for nothing in ([], "head"):
        with pytest.raises(ValueError, match="give a list of names"):
            limb_indices(nothing)
    assert len(set(LIMB_NAMES)) == 13


def test_key_points_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(17, 3\)"):
        from_coco(np.zeros((14, 3)))
