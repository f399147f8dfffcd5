"""Parse fields into people: peaks, limbs, people (equations 4.7 to 4.13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from saver_envs.perception.fields import AFFINITY_X, AFFINITY_Y, HEAT, STRIDE
from saver_envs.perception.skeleton import LIMBS, N_JOINTS, joints_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: "A pixel's fraction" that keeps equations 4.10 and 4.11 finite for coincident peaks, cells.
_PIXEL_FRACTION: Final = 0.1
_NEIGHBOURS: Final = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]


@dataclass(frozen=True)
class ParsingOptions:
    """Thresholds for joints, limbs and people.

    There are two thresholds, as in edge detection by hysteresis: a person needs some sure joints,
    and may have less certain joints at the end of limbs that begin at sure joints.

    :param heat_threshold: smallest absolute heat of a joint.
    :param affinity_threshold: smallest score of a limb (eq. 4.7), of at most 1.
    :param samples: number of samples of the integral of equation 4.7.
    :param merge_distance: largest distance, in cells, between the peaks of two limbs for their
        common joint.
    :param sure: smallest heat of a sure joint, and smallest score of a sure limb.
    :param minimum_joints: a person with fewer sure joints is dropped; at most the number of joints
        that the limbs have.
    :param most_peaks: number of the strongest peaks that are kept for each end of a limb.
    """

    heat_threshold: float = 0.04
    affinity_threshold: float = 0.04
    samples: int = 10
    merge_distance: float = 7.0
    sure: float = 0.15
    minimum_joints: int = 3
    most_peaks: int = 30


DEFAULT_PARSING: Final = ParsingOptions()
#: Reports sure joints only.
CAUTIOUS_PARSING: Final = ParsingOptions(
    heat_threshold=0.15, affinity_threshold=0.15, merge_distance=3.0
)


@dataclass(frozen=True)
class Poses:
    """People in a picture, in descending order of confidence.

    :param joints: (people, 14, 2) pixels of the picture; NaN for a joint that was not found.
    :param scores: (people, 14) confidence of each joint in [0, 1]; 0 if it was not found.
    :param person_scores: (people,) mean confidence of the joints of the limbs that are detected.
    """

    joints: Array
    scores: Array
    person_scores: Array

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def found(self) -> NDArray[np.bool_]:
        """Whether a joint was found (people, 14)."""
        return self.scores > 0

    @staticmethod
    def none() -> Poses:
        """Return the poses of a picture without people."""
        return Poses(np.empty((0, N_JOINTS, 2)), np.empty((0, N_JOINTS)), np.empty(0))


@dataclass(frozen=True)
class _Peaks:
    """Peaks of one sign in all heat maps: (peaks,) limb, (peaks, 2) cells, (peaks,) height."""

    limb: Indices
    position: Array
    height: Array


#: Detected limbs: (pairs,) limb, and indices into proximal and distal peaks.
_Pairs = tuple[Indices, Indices, Indices]


def parse(
    fields: NDArray[Any], limbs: Sequence[int], options: ParsingOptions = DEFAULT_PARSING
) -> Poses:
    """Find the people in fields.

    :param fields: (limbs, 3, rows, columns) as :func:`~.fields.encode` draws them.
    :param limbs: indices into :data:`~.skeleton.LIMBS`, ascending.
    :param options: thresholds.
    :return: any number of people; joints that were not found are missing.
    :raises ValueError: for fields of another number of limbs.
    """
    if fields.ndim != 4 or fields.shape[:2] != (len(limbs), 3):
        raise ValueError(
            f"fields of shape {fields.shape}: must be ({len(limbs)}, 3, rows, columns)"
        )
    heat = np.asarray(fields[:, HEAT], dtype=np.float64)
    proximal = _find_peaks(heat, options)
    distal = _find_peaks(-heat, options)
    pairs = _pair(fields, proximal, distal, options)
    people = _assemble(pairs, proximal, distal, limbs, options.merge_distance)
    return _poses(people, len(joints_of(limbs)), options)


def _find_peaks(heat: Array, options: ParsingOptions) -> _Peaks:
    """Return local maxima above the threshold, with subcell positions.

    Around a joint the logarithm of the heat is a parabola (eq. 4.4), whose maximum follows from
    three of its values.
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


def _strongest(kept: Indices, limb: Indices, height: Array, most: int) -> Indices:
    """Return the ``most`` highest entries of each limb, in the order of ``kept``."""
    order = np.lexsort((-height, limb))
    starts = np.searchsorted(limb[order], limb[order])
    return np.sort(kept[order[np.arange(len(order)) - starts < most]])


def _parabola_top(before: Array, centre: Array, after: Array) -> Array:
    """Return the maximum, in [-1/2, 1/2], of the Gaussian through three neighbouring values.

    It is 0 at the picture's border, where a neighbour is missing.
    """
    floor = 1e-3 * centre
    low, middle, high = (np.log(np.maximum(part, floor)) for part in (before, centre, after))
    curvature = 2 * middle - low - high
    shift = np.where(curvature > 1e-9, (high - low) / (2 * np.maximum(curvature, 1e-9)), 0.0)
    whole = np.isfinite(before) & np.isfinite(after)
    return np.where(whole, np.clip(shift, -0.5, 0.5), 0.0)


def _pair(
    fields: NDArray[Any], proximal: _Peaks, distal: _Peaks, options: ParsingOptions
) -> _Pairs:
    """Match the peaks of each limb one to one (eq. 4.7 to 4.9): first sure pairs, then the others.

    In a joint matching, two faint pairs could outweigh the sure pair whose ends they use.
    """
    begins, ends = (peaks.height >= options.sure for peaks in (proximal, distal))
    same_limb = proximal.limb[:, None] == distal.limb
    first, second = np.nonzero(same_limb & (begins[:, None] | ends))
    limb = proximal.limb[first]
    begin, end = proximal.position[first], distal.position[second]
    score = _line_integral(fields, limb, begin, end, options.samples)
    both = begins[first] & ends[second] & (score > options.sure)
    sure = _match_each_limb(np.flatnonzero(both), limb, first, second, score)
    free = ~np.isin(first, first[sure]) & ~np.isin(second, second[sure])
    left = np.flatnonzero(free & (score > options.affinity_threshold))
    faint = _match_each_limb(left, limb, first, second, score)
    kept = np.concatenate([sure, faint])
    return limb[kept], first[kept], second[kept]


def _match_each_limb(
    entries: Indices, limb: Indices, first: Indices, second: Indices, score: Array
) -> Indices:
    """Return the entries out of ``entries`` that :func:`_match` chooses for each limb."""
    chosen = [entries[:0]]
    for one in np.unique(limb[entries]):
        rows = entries[limb[entries] == one]
        if len(rows) > 1:
            rows = rows[_match(first[rows], second[rows], score[rows])]
        chosen.append(rows)
    return np.concatenate(chosen)


def _line_integral(
    fields: NDArray[Any], limb: Indices, begin: Array, end: Array, samples: int
) -> Array:
    """Integrate the affinity along the lines from ``begin`` to ``end`` (eq. 4.7, 4.8)."""
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


def _match(first: Indices, second: Indices, score: Array) -> Indices:
    """Choose entries with the largest sum of scores that use no end twice.

    :param first: (entries,) one end.
    :param second: (entries,) the other end.
    :param score: (entries,) above 0.
    :return: indices of the chosen entries.
    """
    ends, row = np.unique(first, return_inverse=True)
    others, column = np.unique(second, return_inverse=True)
    table = np.zeros((len(ends), len(others)))
    entry = np.full(table.shape, -1)
    table[row, column], entry[row, column] = score, np.arange(len(score))
    matched = entry[linear_sum_assignment(table, maximize=True)]
    return matched[matched >= 0]


class _People:
    """People that grow limb by limb; a joint is the mean of its peaks weighted by height (4.13)."""

    def __init__(self, capacity: int) -> None:
        self.count = 0
        self.weight = np.zeros((capacity, N_JOINTS))
        self.peaks = np.zeros((capacity, N_JOINTS))
        self.moment = np.zeros((capacity, N_JOINTS, 2))

    def add(self, people: Indices, joint: int, position: Array, height: Array) -> None:
        """Add one peak of a joint to each of several people."""
        self.weight[people, joint] += height
        self.peaks[people, joint] += 1
        self.moment[people, joint] += height[:, None] * position

    def new(self, number: int) -> Indices:
        """Return ``number`` people without joints."""
        self.count += number
        return np.arange(self.count - number, self.count)

    def confidences(self) -> Array:
        """Return the mean height of the peaks (people, 14) of each joint, 0 without peaks."""
        return self.weight[: self.count] / np.maximum(self.peaks[: self.count], 1)

    def positions(self) -> Array:
        """Return the joints (people, 14, 2) in cells, NaN without peaks."""
        weight = self.weight[: self.count, :, None]
        return self.moment[: self.count] / np.where(weight > 0, weight, np.nan)


def _assemble(
    pairs: _Pairs, proximal: _Peaks, distal: _Peaks, limbs: Sequence[int], farthest: float
) -> _People:
    """Join limbs into people, from the neck outwards (eq. 4.10 to 4.13).

    At every joint the matching of limbs to people is optimal (4.12). The five limbs at a neck are
    added one after the other: no fast algorithm matches all five at once.
    """
    of_limb, begins, ends = pairs
    people = _People(len(of_limb))
    for row, limb in enumerate(limbs):
        rows = np.flatnonzero(of_limb == row)
        near, far = begins[rows], ends[rows]
        position, height = proximal.position[near], proximal.height[near]
        owner = _owners(people, LIMBS[limb].proximal, position, height, farthest)
        lone = owner < 0
        owner[lone] = people.new(int(lone.sum()))
        people.add(owner, LIMBS[limb].proximal, position, height)
        people.add(owner, LIMBS[limb].distal, distal.position[far], distal.height[far])
    return people


def _owners(
    people: _People, joint: int, position: Array, height: Array, farthest: float
) -> Indices:
    """Return the person of each limb that begins at a joint, -1 for a new one (eq. 4.10, 4.11)."""
    owner = np.full(len(position), -1)
    apart = position[:, None] - people.positions()[:, joint]
    distance = np.hypot(apart[..., 0], apart[..., 1])
    confidence = people.confidences()[:, joint]
    score = height[:, None] * confidence / (distance + _PIXEL_FRACTION)
    limb, person = np.nonzero(distance <= farthest)
    if len(limb):
        chosen = _match(limb, person, score[limb, person])
        owner[limb[chosen]] = person[chosen]
    return owner


def _poses(people: _People, possible: int, options: ParsingOptions) -> Poses:
    """Convert cells into pixels, drop people with too few sure joints, sort by confidence.

    :param people: in cells.
    :param possible: number of joints that could be found.
    :param options: thresholds.
    """
    scores = people.confidences()
    joints = (people.positions() + 0.5) * STRIDE
    enough = (scores >= options.sure).sum(axis=1) >= min(options.minimum_joints, possible)
    person_scores = scores.sum(axis=1) / possible
    order = np.argsort(-person_scores, kind="stable")
    order = order[enough[order]]
    return Poses(joints[order], scores[order], person_scores[order])
