"""How good estimated poses are: PCK, error in pixels, error in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import JOINTS, NECK, Visibility

HIPS: Final = (JOINTS.index("right_hip"), JOINTS.index("left_hip"))
#: PCK's threshold as a share of the torso, which reaches from the neck to between the hips.
PCK_SHARE: Final = 0.2


@dataclass(frozen=True)
class Errors:
    """Errors of the visible joints of the people in one picture.

    :param joint: (entries,) which of the 14 joints.
    :param pixels: (entries,) distance to the true one; of an undetected joint, one torso.
    :param torso: (entries,) length of that person's torso in the picture, pixels.
    :param found: (entries,) whether it was detected.
    :param person: (entries,) which true person it belongs to.
    :param estimate: (true people,) which estimated person was taken for them, -1 for none.
    """

    joint: NDArray[np.intp]
    pixels: NDArray[np.float64]
    torso: NDArray[np.float64]
    found: NDArray[np.bool_]
    person: NDArray[np.intp]
    estimate: NDArray[np.intp]

    @property
    def correct(self) -> NDArray[np.bool_]:
        """(entries,) whether the joint is detected within a fifth of the torso."""
        return self.found & (self.pixels <= PCK_SHARE * self.torso)


def joint_errors(
    poses: Poses, truth: NDArray[np.floating], visibility: NDArray[np.integer]
) -> Errors:
    """Compare people in a picture with the true ones.

    Every true person gets at most one estimated person, so that the sum of their joints' errors is
    least; a joint that was not found counts as an error of one torso.

    :param poses: estimated.
    :param truth: (people, 14, 2) pixels.
    :param visibility: (people, 14); only visible joints count.
    """
    torso = np.linalg.norm(truth[:, NECK] - truth[:, HIPS].mean(axis=1), axis=-1)
    apart = np.linalg.norm(poses.joints[None] - truth[:, None], axis=-1)
    seen = visibility == Visibility.VISIBLE
    missed = np.isnan(apart)
    cost = np.where(missed, torso[:, None, None], np.minimum(apart, torso[:, None, None]))
    cost = (cost * seen[:, None]).sum(axis=-1)
    estimate = np.full(len(truth), -1)
    if len(poses):
        rows, columns = linear_sum_assignment(cost)
        useful = cost[rows, columns] < (torso * seen.sum(axis=1))[rows]
        estimate[rows[useful]] = columns[useful]
    errors = np.tile(torso[:, None], (1, len(JOINTS)))
    found = np.zeros_like(seen)
    for row, match in enumerate(estimate):
        if match >= 0:
            found[row] = ~missed[row, match]
            errors[row] = np.where(found[row], apart[row, match], torso[row])
    person, joint = np.nonzero(seen)
    return Errors(joint, errors[seen], torso[person], found[seen], person, estimate)


@dataclass(frozen=True)
class Summary:
    """Over many pictures.

    :param pck: share of visible joints within a fifth of the torso.
    :param mean_pixels: mean error of visible joints.
    :param detected: share of visible joints that were found.
    :param pck_by_joint: (14,) NaN for a joint that was never visible.
    :param joints: number of visible joints.
    """

    pck: float
    mean_pixels: float
    detected: float
    pck_by_joint: NDArray[np.float64]
    joints: int


def summarise(errors: list[Errors], scale: float = 1.0) -> Summary:
    """Put the errors of many pictures together.

    :param errors: of each.
    :param scale: pixels are multiplied with it, to tell them at another size of the picture.
    """
    joint = np.concatenate([one.joint for one in errors])
    correct = np.concatenate([one.correct for one in errors])
    pixels = np.concatenate([one.pixels for one in errors])
    found = np.concatenate([one.found for one in errors])
    counts = np.bincount(joint, minlength=len(JOINTS))
    right = np.bincount(joint, weights=correct, minlength=len(JOINTS))
    by_joint = np.where(counts > 0, right / np.maximum(counts, 1), np.nan)
    some = len(joint) > 0
    return Summary(
        pck=float(correct.mean()) if some else float("nan"),
        mean_pixels=float(pixels.mean() * scale) if some else float("nan"),
        detected=float(found.mean()) if some else float("nan"),
        pck_by_joint=by_joint,
        joints=len(joint),
    )
