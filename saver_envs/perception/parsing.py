"""From fields to people: peaks, limbs, persons (equations 4.7 to 4.13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from saver_envs.perception.fields import AFFINITY_X, AFFINITY_Y, HEAT, STRIDE
from saver_envs.perception.skeleton import LIMBS, N_JOINTS

Array = NDArray[np.float64]

#: "A pixel's fraction" that keeps equations 4.10 and 4.11 finite where two peaks coincide, cells.
_PIXEL_FRACTION: Final = 0.1
_NEIGHBOURS: Final = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]


@dataclass(frozen=True)
class ParsingOptions:
    """What counts as a joint, a limb and a person.

    Two thresholds, as in edge detection by hysteresis: some joints have to be sure for there to be
    a person, who may then have less certain ones at the end of limbs that begin at sure ones.

    :param heat_threshold: smallest absolute heat of a joint.
    :param affinity_threshold: smallest score of a limb (eq. 4.7), of at most 1.
    :param samples: points at which the integral of equation 4.7 is taken.
    :param merge_distance: how far apart, in cells, the peaks of two limbs for the joint that they
        share may lie.
    :param sure: heat from which a joint, and score from which a limb, is sure.
    :param minimum_joints: a person with fewer sure joints is dropped, where the limbs that are
        looked for have as many joints.
    :param most_peaks: the strongest that are kept of a limb's proximal, and of its distal joints.
    """

    heat_threshold: float = 0.04
    affinity_threshold: float = 0.04
    samples: int = 10
    merge_distance: float = 7.0
    sure: float = 0.15
    minimum_joints: int = 3
    most_peaks: int = 30


DEFAULT_PARSING: Final = ParsingOptions()
#: Gives sure joints alone: what is not certain is missing.
CAUTIOUS_PARSING: Final = ParsingOptions(
    heat_threshold=0.15, affinity_threshold=0.15, merge_distance=3.0
)


@dataclass(frozen=True)
class Poses:
    """People in a picture, the most certain first.

    :param joints: (people, 14, 2) pixels of the picture; NaN where a joint was not found.
    :param scores: (people, 14) confidence of each joint in [0, 1]; 0 where it was not found.
    :param person_scores: (people,) sum of the joints' confidences over the number of joints that
        could have been found.
    """

    joints: Array
    scores: Array
    person_scores: Array

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def found(self) -> NDArray[np.bool_]:
        """(people, 14) which joints were found."""
        return self.scores > 0

    @staticmethod
    def none() -> Poses:
        """Return the result for a picture without people."""
        return Poses(np.empty((0, N_JOINTS, 2)), np.empty((0, N_JOINTS)), np.empty(0))


@dataclass(frozen=True)
class _Peaks:
    """Peaks of one sign in all limbs' heat maps: (peaks,) limb, (peaks, 2) cells, (peaks,) |J|."""

    limb: NDArray[np.intp]
    position: Array
    height: Array


@dataclass(frozen=True)
class _Pairs:
    """Limbs that were found: (pairs,) limb, and indices into proximal and distal peaks."""

    limb: NDArray[np.intp]
    proximal: NDArray[np.intp]
    distal: NDArray[np.intp]


def parse(
    fields: NDArray[Any],
    limbs: Sequence[int],
    options: ParsingOptions = DEFAULT_PARSING,
    stride: int = STRIDE,
) -> Poses:
    """Find the people in fields, however many.

    :param fields: (limbs, 3, rows, columns) as :func:`~.fields.encode` draws them.
    :param limbs: which of the 13 limbs they are, indices into :data:`~.skeleton.LIMBS`, ascending.
    :param options: thresholds.
    :param stride: pixels of the picture per cell.
    :return: the people; an incomplete one has missing joints, not invented ones.
    :raises ValueError: where the fields are not those of so many limbs.
    """
    if fields.ndim != 4 or fields.shape[:2] != (len(limbs), 3):
        raise ValueError(
            f"fields of shape {fields.shape}: must be ({len(limbs)}, 3, rows, columns)"
        )
    heat = np.asarray(fields[:, HEAT], dtype=np.float64)
    proximal = _find_peaks(heat, options)
    distal = _find_peaks(-heat, options)
    pairs = _pair(fields, proximal, distal, options)
    if len(pairs.limb) == 0:
        return Poses.none()
    people = _assemble(pairs, proximal, distal, limbs, options)
    return _poses(people, limbs, options, stride)


def _find_peaks(heat: Array, options: ParsingOptions) -> _Peaks:
    """Return local maxima above the threshold, to a fraction of a cell.

    Around a joint the logarithm of the heat is a parabola (eq. 4.4), whose top follows from three
    of its values.
    """
    limb, row, column = np.nonzero(heat > options.heat_threshold)
    padded = np.pad(heat, ((0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
    centre = heat[limb, row, column]
    around = np.stack([padded[limb, row + 1 + dy, column + 1 + dx] for dy, dx in _NEIGHBOURS])
    # Of two equal neighbours the first one, in reading order, is the peak.
    top = (centre > around[:4]).all(axis=0) & (centre >= around[4:]).all(axis=0)
    kept = np.flatnonzero(top)
    kept = _strongest(kept, limb[kept], centre[kept], options.most_peaks)
    limb, row, column, centre = limb[kept], row[kept], column[kept], centre[kept]
    around = around[:, kept]
    shift_y = _parabola_top(around[1], centre, around[6])
    shift_x = _parabola_top(around[3], centre, around[4])
    position = np.stack([column + shift_x, row + shift_y], axis=-1)
    return _Peaks(limb, position, np.minimum(centre, 1.0))


def _strongest(
    kept: NDArray[np.intp], limb: NDArray[np.intp], height: Array, most: int
) -> NDArray[np.intp]:
    """Return the ``most`` highest entries of each limb, in the order of ``kept``."""
    if len(kept) <= most:
        return kept
    order = np.lexsort((-height, limb))
    starts = np.searchsorted(limb[order], limb[order])
    return np.sort(kept[order[np.arange(len(order)) - starts < most]])


def _parabola_top(before: Array, centre: Array, after: Array) -> Array:
    """Return where, in [-1/2, 1/2], the Gaussian through three neighbouring values is highest.

    It is 0 at the picture's border, where a neighbour is missing.
    """
    floor = 1e-3 * centre
    low, middle, high = (np.log(np.maximum(part, floor)) for part in (before, centre, after))
    curvature = 2 * middle - low - high
    shift = np.where(curvature > 1e-9, (high - low) / (2 * np.maximum(curvature, 1e-9)), 0.0)
    whole = np.isfinite(before) & np.isfinite(after)
    top: Array = np.where(whole, np.clip(shift, -0.5, 0.5), 0.0)
    return top


def _pair(
    fields: NDArray[Any], proximal: _Peaks, distal: _Peaks, options: ParsingOptions
) -> _Pairs:
    """Match a limb's peaks one to one (eq. 4.7 to 4.9): sure ones first, then the others to them.

    Taken together, two faint pairs could outweigh the sure one whose ends they share.
    """
    first, second = _of_one_limb(proximal.limb, distal.limb)
    begins, ends = proximal.height >= options.sure, distal.height >= options.sure
    both = begins[first] & ends[second]
    certain = _matched(fields, proximal, distal, (first[both], second[both]), options, options.sure)
    begin_free, end_free = np.ones(len(begins), dtype=bool), np.ones(len(ends), dtype=bool)
    begin_free[certain.proximal] = end_free[certain.distal] = False
    left = (begins[first] | ends[second]) & begin_free[first] & end_free[second]
    faint = _matched(
        fields,
        proximal,
        distal,
        (first[left], second[left]),
        options,
        options.affinity_threshold,
    )
    return _Pairs(
        np.concatenate([certain.limb, faint.limb]),
        np.concatenate([certain.proximal, faint.proximal]),
        np.concatenate([certain.distal, faint.distal]),
    )


def _of_one_limb(
    proximal: NDArray[np.intp], distal: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all pairs of indices at which two ascending arrays of limbs are the same."""
    begin = np.searchsorted(distal, proximal, side="left")
    count = np.searchsorted(distal, proximal, side="right") - begin
    first = np.repeat(np.arange(len(proximal)), count)
    within = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    return first, begin[first] + within


def _matched(
    fields: NDArray[Any],
    proximal: _Peaks,
    distal: _Peaks,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
    options: ParsingOptions,
    threshold: float,
) -> _Pairs:
    """Score pairs of peaks (proximal, distal) and match them one to one."""
    first, second = pairs
    limb = proximal.limb[first]
    score = _line_integral(
        fields, limb, proximal.position[first], distal.position[second], options.samples
    )
    good = score > threshold
    first, second, limb, score = first[good], second[good], limb[good], score[good]
    chosen = []
    for one in np.unique(limb):
        rows = np.flatnonzero(limb == one)
        if len(rows) > 1:
            rows = rows[_match(first[rows], second[rows], score[rows])]
        chosen.append(rows)
    kept = np.concatenate(chosen) if chosen else np.empty(0, dtype=np.intp)
    return _Pairs(limb[kept], first[kept], second[kept])


def _line_integral(
    fields: NDArray[Any], limb: NDArray[np.intp], begin: Array, end: Array, samples: int
) -> Array:
    """Integrate the affinity's part along the line from ``begin`` to ``end`` (eq. 4.7, 4.8)."""
    along = end - begin
    direction = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    u = (np.arange(samples) + 0.5) / samples
    points = begin[:, None] + u[:, None] * along[:, None]
    rows, columns = fields.shape[2:]
    x = np.clip(np.rint(points[..., 0]).astype(np.intp), 0, columns - 1)
    y = np.clip(np.rint(points[..., 1]).astype(np.intp), 0, rows - 1)
    along_x = fields[limb[:, None], AFFINITY_X, y, x].mean(axis=1) * direction[:, 0]
    along_y = fields[limb[:, None], AFFINITY_Y, y, x].mean(axis=1) * direction[:, 1]
    return np.nan_to_num(along_x + along_y)


def _match(first: NDArray[np.intp], second: NDArray[np.intp], score: Array) -> NDArray[np.intp]:
    """Choose entries so that the sum of scores is greatest and no end is used twice.

    :param first: (entries,) one end.
    :param second: (entries,) the other.
    :param score: (entries,) above 0; pairs that are not listed may not be chosen.
    :return: the entries chosen.
    """
    ends, row = np.unique(first, return_inverse=True)
    others, column = np.unique(second, return_inverse=True)
    table = np.zeros((len(ends), len(others)))
    entry = np.full(table.shape, -1)
    table[row, column], entry[row, column] = score, np.arange(len(score))
    matched = entry[linear_sum_assignment(table, maximize=True)]
    chosen: NDArray[np.intp] = matched[matched >= 0]
    return chosen


class _People:
    """Persons that grow limb by limb; a joint is the mean of its peaks weighted by |J| (4.13)."""

    def __init__(self, capacity: int) -> None:
        self.count = 0
        self.weight = np.zeros((capacity, N_JOINTS))
        self.peaks = np.zeros((capacity, N_JOINTS))
        self.moment = np.zeros((capacity, N_JOINTS, 2))

    def add(self, people: NDArray[np.intp], joint: int, position: Array, height: Array) -> None:
        """Add one peak of a joint to each of several people."""
        self.weight[people, joint] += height
        self.peaks[people, joint] += 1
        self.moment[people, joint] += height[:, None] * position

    def new(self, number: int) -> NDArray[np.intp]:
        """Return ``number`` people without joints."""
        self.count += number
        return np.arange(self.count - number, self.count)

    def having(self, joint: int) -> NDArray[np.intp]:
        """Return who has a joint."""
        return np.flatnonzero(self.weight[: self.count, joint] > 0)

    def position(self, people: NDArray[np.intp], joint: int) -> Array:
        """(people, 2) where a joint of theirs is, cells."""
        position: Array = self.moment[people, joint] / self.weight[people, joint][:, None]
        return position

    def confidence(self, people: NDArray[np.intp], joint: int) -> Array:
        """(people,) mean height of the joint's peaks."""
        confidence: Array = self.weight[people, joint] / self.peaks[people, joint]
        return confidence


def _assemble(
    pairs: _Pairs,
    proximal: _Peaks,
    distal: _Peaks,
    limbs: Sequence[int],
    options: ParsingOptions,
) -> _People:
    """Join limbs into people, from the neck outwards (eq. 4.10 to 4.13).

    At every joint the matching of limbs to people is the best one (4.12). The five limbs at a neck
    are taken in one after the other: matching all five at once is a problem without fast solution.
    """
    people = _People(len(pairs.limb))
    for place, limb in enumerate(limbs):
        rows = np.flatnonzero(pairs.limb == place)
        near, far = pairs.proximal[rows], pairs.distal[rows]
        joint = LIMBS[limb].proximal
        position, height = proximal.position[near], proximal.height[near]
        owner = _owners(people, joint, position, height, options.merge_distance)
        lone = owner < 0
        owner[lone] = people.new(int(lone.sum()))
        people.add(owner, joint, position, height)
        people.add(owner, LIMBS[limb].distal, distal.position[far], distal.height[far])
    return people


def _owners(
    people: _People, joint: int, position: Array, height: Array, farthest: float
) -> NDArray[np.intp]:
    """Return to whom limbs that begin at a joint belong, -1 where to nobody (eq. 4.10, 4.11)."""
    owner = np.full(len(position), -1)
    there = people.having(joint)
    if len(there) == 0 or len(position) == 0:
        return owner
    apart = position[:, None] - people.position(there, joint)
    distance = np.hypot(apart[..., 0], apart[..., 1])
    score = height[:, None] * people.confidence(there, joint) / (distance + _PIXEL_FRACTION)
    limb, person = np.nonzero(distance <= farthest)
    if len(limb) == 0:
        return owner
    chosen = _match(limb, person, score[limb, person])
    owner[limb[chosen]] = there[person[chosen]]
    return owner


def _poses(people: _People, limbs: Sequence[int], options: ParsingOptions, stride: int) -> Poses:
    """Turn cells into pixels, drop those with too few sure joints, sort by confidence."""
    possible = len(
        {joint for limb in limbs for joint in (LIMBS[limb].proximal, LIMBS[limb].distal)}
    )
    weight, peaks = people.weight[: people.count], people.peaks[: people.count]
    found = weight > 0
    scores = np.where(found, weight / np.maximum(peaks, 1), 0.0)
    enough = (scores >= options.sure).sum(axis=1) >= min(options.minimum_joints, possible)
    mean = people.moment[: people.count] / np.where(found, weight, 1.0)[..., None]
    joints = np.where(found[..., None], (mean + 0.5) * stride, np.nan)
    person_scores = scores.sum(axis=1) / possible
    order = np.argsort(-person_scores, kind="stable")
    order = order[enough[order]]
    return Poses(joints[order], scores[order], person_scores[order])
