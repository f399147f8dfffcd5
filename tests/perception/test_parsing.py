"""Encoding, then parsing, gives the joints back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from people import person

from saver_envs.perception.fields import HEAT, encode
from saver_envs.perception.parsing import CAUTIOUS_PARSING, ParsingOptions, Poses, parse
from saver_envs.perception.skeleton import LIMB_NAMES, LIMBS, N_JOINTS, joints_of, limb_indices

ALL = tuple(range(13))
SIZE = (368, 368)


def picture(seed: int, people: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """People side by side: (people, 14, 2)."""
    random = np.random.default_rng(seed)
    width = size[1] / people
    torso = min(0.27 * size[0], 0.4 * width) * random.uniform(0.85, 1.0)
    necks = [(width * (k + 0.5), size[0] * 0.25) for k in range(people)]
    return np.stack([person(random, neck, torso) for neck in necks])


def readable(joints: np.ndarray, size: tuple[int, int]) -> bool:
    """Whether all joints lie in the picture and no two peaks of one channel meet."""
    inside = (joints > 8) & (joints < np.array(size[::-1]) - 8)
    if not inside.all():
        return False
    for limb in LIMBS:
        ends = joints[:, [limb.proximal, limb.distal]].reshape(-1, 2)
        apart = np.linalg.norm(ends[:, None] - ends, axis=-1) + 1e9 * np.eye(len(ends))
        if apart.min() < 4 * 8:
            return False
    return True


def matched(found: Poses, joints: np.ndarray) -> np.ndarray:
    """Indices into ``found`` of the people in ``joints``, by their nearest joints."""
    gaps = np.nanmean(np.linalg.norm(found.joints[None] - joints[:, None], axis=-1), axis=-1)
    return gaps.argmin(axis=1)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), people=st.integers(1, 2))
def test_round_trip(seed: int, people: int) -> None:
    joints = picture(seed, people)
    assume(readable(joints, SIZE))
    found = parse(encode(joints, np.ones((people, 14), bool), SIZE, ALL), ALL)
    assert len(found) == people
    order = matched(found, joints)
    assert sorted(order) == list(range(people))
    assert found.found.all()
    assert np.abs(found.joints[order] - joints).max() < 1.5  # of 8 pixels a cell
    assert (found.scores > 0.5).all()
    assert (found.scores <= 1).all()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), missing=st.sets(st.integers(0, 13), min_size=1, max_size=4))
def test_missing_joints_stay_missing_and_nothing_is_made_up(seed: int, missing: set[int]) -> None:
    joints = picture(seed, 1)
    assume(readable(joints, SIZE))
    known = np.ones((1, N_JOINTS), dtype=bool)
    known[0, list(missing)] = False
    found = parse(encode(joints, known, SIZE, ALL), ALL, ParsingOptions(minimum_joints=2))
    # A joint is found where a limb of it is whole, though perhaps in another piece of the person.
    whole = [k for k, limb in enumerate(LIMBS) if known[0, limb.proximal] and known[0, limb.distal]]
    expected = np.zeros(N_JOINTS, dtype=bool)
    expected[list(joints_of(whole))] = True
    assert np.array_equal(found.found.any(axis=0), expected)
    error = np.abs(found.joints - joints)
    assert np.nanmax(error) < 1.5


@pytest.mark.parametrize("names", [["left_forearm"], ["left_upper_arm", "left_forearm", "head"]])
def test_some_limbs_alone(names: list[str]) -> None:
    limbs = limb_indices(names)
    joints = picture(3, 1)
    found = parse(encode(joints, np.ones((1, 14), bool), SIZE, limbs), limbs)
    assert found.found.any(axis=0).nonzero()[0].tolist() == (
        list(joints_of(limbs)) if len(names) == 1 else list(joints_of(limbs[1:]))
    )  # two joints of a head alone are no person where five joints could be found
    assert np.nanmax(np.abs(found.joints - joints)) < 1.5


def test_ten_people() -> None:
    size = (368, 1840)
    joints = picture(1, 10, size)
    found = parse(encode(joints, np.ones((10, 14), bool), size, ALL), ALL)
    assert len(found) == 10
    assert np.abs(found.joints[matched(found, joints)] - joints).max() < 2.5


def test_crossing_forearms_are_told_apart_by_their_affinities() -> None:
    limb = LIMB_NAMES.index("left_forearm")
    joints = np.zeros((2, N_JOINTS, 2))
    elbow, wrist = LIMBS[limb].proximal, LIMBS[limb].distal
    joints[0, [elbow, wrist]] = (60, 60), (220, 220)
    joints[1, [elbow, wrist]] = (60, 220), (220, 60)
    known = np.zeros((2, N_JOINTS), dtype=bool)
    known[:, [elbow, wrist]] = True
    found = parse(encode(joints, known, SIZE, [limb]), [limb])
    rights = {tuple(np.rint(p[[elbow, wrist]]).ravel().astype(int)) for p in found.joints}
    assert rights == {(60, 60, 220, 220), (60, 220, 220, 60)}


def test_joints_are_the_mean_weighted_by_confidence() -> None:
    """Equation 4.13: the elbow of an upper arm and of a forearm, one seen four times as well."""
    upper, fore = limb_indices(["left_upper_arm", "left_forearm"])
    known = np.ones((1, N_JOINTS), dtype=bool)
    joints = np.zeros((1, N_JOINTS, 2))
    shoulder, elbow, wrist = LIMBS[upper].proximal, LIMBS[upper].distal, LIMBS[fore].distal
    joints[0, [shoulder, elbow, wrist]] = (60, 60), (60, 164), (60, 268)
    fields = encode(joints, known, SIZE, (upper, fore))
    shifted = joints.copy()
    shifted[0, elbow] += (8, 0)
    fields[1] = encode(shifted, known, SIZE, (fore,))[0] * 0.25
    found = parse(fields, (upper, fore), ParsingOptions(affinity_threshold=0.1))
    assert found.joints[0, elbow] == pytest.approx([60 + 8 * 0.2, 164], abs=0.3)


def test_ends_without_an_affinity_between_them_are_no_limb() -> None:
    limb = limb_indices(["left_forearm"])[0]
    joints = np.zeros((1, N_JOINTS, 2))
    joints[0, [LIMBS[limb].proximal, LIMBS[limb].distal]] = (100, 180), (260, 180)
    fields = encode(joints, np.ones((1, N_JOINTS), dtype=bool), SIZE, [limb])
    assert len(parse(fields, [limb])) == 1
    fields[:, [k for k in range(3) if k != HEAT]] = 0
    assert len(parse(fields, [limb])) == 0
    turned = encode(joints[..., ::-1].copy(), np.ones((1, N_JOINTS), dtype=bool), SIZE, [limb])
    fields[:, [k for k in range(3) if k != HEAT]] = turned[:, [k for k in range(3) if k != HEAT]]
    assert len(parse(fields, [limb])) == 0


@pytest.mark.parametrize(("x", "y"), [(4, 180), (364, 180), (180, 4), (180, 364)])
def test_joints_at_the_border_are_found(x: int, y: int) -> None:
    limb = limb_indices(["left_forearm"])[0]
    joints = np.zeros((1, N_JOINTS, 2))
    elbow, wrist = LIMBS[limb].proximal, LIMBS[limb].distal
    joints[0, [elbow, wrist]] = (184, 184), (x, y)
    known = np.zeros((1, N_JOINTS), dtype=bool)
    known[:, [elbow, wrist]] = True
    found = parse(encode(joints, known, SIZE, [limb]), [limb])
    assert len(found) == 1
    assert np.abs(found.joints[0, wrist] - (x, y)).max() < 4


def test_who_is_sure_may_have_faint_joints_and_faint_joints_alone_are_nobody() -> None:
    joints = picture(3, 1)
    fields = encode(joints, np.ones((1, 14), bool), SIZE, ALL)
    wrist = LIMB_NAMES.index("left_forearm")
    heat = fields[wrist, HEAT]
    heat[heat < 0] *= 0.1  # the distal end's
    found = parse(fields, ALL)
    assert len(found) == 1
    assert found.found.all()
    assert found.scores[0, LIMBS[wrist].distal] == pytest.approx(0.1, abs=0.03)
    sure = parse(fields, ALL, CAUTIOUS_PARSING)
    assert not sure.found[0, LIMBS[wrist].distal]
    assert len(parse(0.1 * encode(joints, np.ones((1, 14), bool), SIZE, ALL), ALL)) == 0


@pytest.mark.parametrize("people", [1, 2, 10])
def test_noise_between_the_thresholds_adds_nobody(people: int) -> None:
    """Though one faint pair at each end of a sure one would outweigh it."""
    size = (368, 184 * max(people, 2))
    joints = picture(1, people, size)
    fields = encode(joints, np.ones((people, 14), bool), size, ALL)
    noisy = fields + np.random.default_rng(0).normal(0, 0.03, fields.shape)
    found = parse(noisy, ALL)
    assert len(found) == people
    assert np.abs(found.joints[matched(found, joints)] - joints).max() < 4


@pytest.mark.parametrize("value", [0.0, np.nan, 5.0])
def test_empty_and_broken_fields_give_nobody(value: float) -> None:
    nobody = parse(np.full((13, 3, 27, 32), value), ALL)
    assert len(nobody) == 0
    assert (nobody.joints.shape, nobody.scores.shape) == ((0, N_JOINTS, 2), (0, N_JOINTS))
    assert nobody.person_scores.shape == (0,)


def test_noise_gives_no_exception_and_joints_inside_the_picture() -> None:
    random = np.random.default_rng(0)
    for _ in range(5):
        found = parse(random.normal(0, 1, (13, 3, 27, 32)), ALL)
        assert (found.joints[found.found] >= 0).all()
        assert (found.joints[found.found] <= [256, 216]).all()


@pytest.mark.parametrize("shape", [(2, 3, 8, 8), (1, 2, 8, 8), (1, 4, 8, 8), (3, 8, 8)])
def test_fields_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"must be \(1, 3, rows, columns\)"):
        parse(np.zeros(shape), [0])


def test_fields_of_other_limbs_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must be \(13, 3, rows, columns\)"):
        parse(np.zeros((2, 3, 8, 8)), ALL)
