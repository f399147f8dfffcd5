"""Compare estimated poses with true poses: PCK, detection rate, error in pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import JOINTS, NECK, Visibility

HIPS: Final = (JOINTS.index("right_hip"), JOINTS.index("left_hip"))
#: PCK's threshold as a fraction of the torso, the distance from the neck to the hips' middle.
PCK_SHARE: Final = 0.2


@dataclass(frozen=True)
class JointErrors:
    """Errors of the visible joints of the people in one picture.

    :param joint: (entries,) index of the joint, 0 to 13.
    :param pixels: (entries,) distance to the true joint; one torso for an undetected joint.
    :param torso: (entries,) length of the person's torso in the picture, pixels.
    :param found: (entries,) whether the joint was detected.
    :param estimate: (true people,) index of the matched estimated person, -1 for none.
    """

    joint: NDArray[np.intp]
    pixels: NDArray[np.float64]
    torso: NDArray[np.float64]
    found: NDArray[np.bool_]
    estimate: NDArray[np.intp]

    @property
    def correct(self) -> NDArray[np.bool_]:
        """(entries,) whether the joint is detected within a fifth of the torso."""
        return self.found & (self.pixels <= PCK_SHARE * self.torso)


def joint_errors(
    poses: Poses, truth: NDArray[np.floating], visibility: NDArray[np.integer]
) -> JointErrors:
    """Compare the people in a picture with the true people.

    Each true person is matched with at most one estimated person so that the sum of errors is
    least. An undetected joint has an error of one torso.

    :param poses: estimated people.
    :param truth: (people, 14, 2) true joints, pixels.
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
    rows = np.flatnonzero(estimate >= 0)
    found[rows] = ~missed[rows, estimate[rows]]
    errors[rows] = np.where(found[rows], apart[rows, estimate[rows]], torso[rows, None])
    person, joint = np.nonzero(seen)
    return JointErrors(joint, errors[seen], torso[person], found[seen], estimate)


@dataclass(frozen=True)
class PoseAccuracy:
    """Accuracy over many pictures.

    :param pck: fraction of the visible joints that are within a fifth of the torso.
    :param mean_pixels: mean error of the visible joints.
    :param detected: fraction of the visible joints that were detected.
    :param pck_by_joint: (14,) PCK of each joint; NaN for a joint that was never visible.
    :param joints: number of visible joints.
    """

    pck: float
    mean_pixels: float
    detected: float
    pck_by_joint: NDArray[np.float64]
    joints: int


def summarise(errors: list[JointErrors], scale: float = 1.0) -> PoseAccuracy:
    """Combine the errors of many pictures.

    :param errors: of each picture.
    :param scale: factor for the errors in pixels, which converts them to another picture size.
    """
    joint, correct, pixels, found = (
        np.concatenate([getattr(one, name) for one in errors])
        for name in ("joint", "correct", "pixels", "found")
    )
    counts = np.bincount(joint, minlength=len(JOINTS))
    right = np.bincount(joint, weights=correct, minlength=len(JOINTS))
    by_joint = np.where(counts > 0, right / np.maximum(counts, 1), np.nan)
    means = (float(values.mean()) if len(joint) else np.nan for values in (correct, pixels, found))
    pck, mean_pixels, detected = means
    return PoseAccuracy(pck, mean_pixels * scale, detected, by_joint, len(joint))
