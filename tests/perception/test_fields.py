from __future__ import annotations

import math

import numpy as np
import pytest

from saver_envs.perception.fields import HEAT, SIGMA, encode, loss_mask
from saver_envs.perception.skeleton import LIMB_NAMES, LIMBS, N_JOINTS

FOREARM = LIMB_NAMES.index("left_forearm")
ELBOW, WRIST = LIMBS[FOREARM].proximal, LIMBS[FOREARM].distal


def forearm(elbow: tuple[float, float], wrist: tuple[float, float]) -> np.ndarray:
    joints = np.zeros((N_JOINTS, 2))
    joints[ELBOW], joints[WRIST] = elbow, wrist
    return joints


def only(*names: int) -> np.ndarray:
    known = np.zeros(N_JOINTS, dtype=bool)
    known[list(names)] = True
    return known


def test_equation_4_4_and_4_5_value_by_value() -> None:
    # Elbow at the centre of cell (column 2, row 3), wrist at that of cell (8, 3).
    joints = forearm((20.0, 28.0), (68.0, 28.0))[None]
    fields = encode(joints, only(ELBOW, WRIST)[None], (64, 96), [FOREARM])
    assert fields.shape == (1, 3, 8, 12)
    heat = fields[0, HEAT]
    assert heat[3, 2] == 1.0
    assert heat[3, 8] == -1.0
    assert heat[4, 3] == pytest.approx(math.exp(-2 / SIGMA**2))
    assert heat[5, 8] == pytest.approx(-math.exp(-4 / SIGMA**2))
    inside = np.zeros((8, 12))
    inside[2:5, 2:9] = 1
    assert np.array_equal(fields[0, 0], inside)
    assert np.array_equal(fields[0, 1], np.zeros((8, 12)))


def test_people_are_joined_by_the_largest_value_and_the_mean_direction() -> None:
    one = forearm((12.0, 28.0), (92.0, 28.0))  # to the right
    two = forearm((52.0, 4.0), (52.0, 60.0))  # downwards, across it
    known = np.stack([only(ELBOW, WRIST)] * 2)
    both = encode(np.stack([one, two]), known, (64, 96), [FOREARM])
    alone = [encode(person[None], known[:1], (64, 96), [FOREARM]) for person in (one, two)]
    heats = np.stack([fields[0, HEAT] for fields in alone])
    largest = np.take_along_axis(heats, np.abs(heats).argmax(0)[None], 0)[0]
    assert np.allclose(both[0, HEAT], largest)
    assert both[0, :2, 3, 6].tolist() == [0.5, 0.5]
    assert both[0, :2, 3, 2].tolist() == [1.0, 0.0]


def test_missing_joints_draw_nothing() -> None:
    joints = forearm((12.0, 28.0), (92.0, 28.0))[None]
    fields = encode(joints, only(ELBOW)[None], (64, 96), [FOREARM])
    assert fields[0, HEAT].max() > 0.9
    assert fields[0, HEAT].min() == 0.0
    assert (fields[0, :2] == 0).all()
    assert (encode(joints[:0], only()[None][:0], (64, 96), [FOREARM]) == 0).all()


def test_joints_beyond_the_border_still_point_there() -> None:
    joints = forearm((52.0, 28.0), (300.0, 28.0))[None]
    fields = encode(joints, only(ELBOW, WRIST)[None], (64, 96), [FOREARM])
    assert fields[0, HEAT].min() == 0.0
    assert (fields[0, 0, 3, 6:] == 1.0).all()


def test_the_loss_does_not_count_where_somebodys_joint_is_unknown() -> None:
    known = np.stack([only(ELBOW, WRIST), only(ELBOW)])
    boxes = np.array([[0, 0, 40, 64], [48, 0, 96, 32]])
    mask = loss_mask(known, boxes, (64, 96), [0, FOREARM])
    expected = np.ones((8, 12))
    expected[:4, 6:] = 0
    assert np.array_equal(mask[1], expected)
    assert mask[0, :, :5].sum() == 0  # nobody's head is known
    assert mask[0, 4:, 6:].all()


def test_sizes_must_fit_the_stride() -> None:
    with pytest.raises(ValueError, match=r"size=\(60, 96\).*multiples of 8"):
        encode(np.zeros((0, 14, 2)), np.zeros((0, 14), bool), (60, 96), [0])
