"""From joints in the picture and the depth at them to joints in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import Camera, CameraPose
from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import JOINTS

#: How far behind the visible surface a joint's centre lies along the view (m): medians over
#: rendered pictures of other people than the test's (``saver benchmark pose`` measures them anew).
_DEPTH_TO_CENTRE: Final = {
    "neck": 0.097,
    "head": 0.005,
    "shoulder": 0.069,
    "elbow": 0.044,
    "wrist": 0.024,
    "hip": 0.116,
    "knee": 0.057,
    "ankle": 0.044,
}
DEPTH_TO_CENTRE: Final = np.array(
    [_DEPTH_TO_CENTRE[name.removeprefix("left_").removeprefix("right_")] for name in JOINTS]
)
#: Half the side of the window in which the depth is read, in pixels of a 512 x 424 picture.
_WINDOW: Final = 2


@dataclass(frozen=True)
class Joints3D:
    """Joints of people in space.

    :param positions: (people, 14, 3) metres, bench frame; NaN where unknown.
    :param scores: (people, 14) confidences; 0 where unknown, be it that the joint was not found or
        that there is no depth at it.
    """

    positions: NDArray[np.float64]
    scores: NDArray[np.float64]


def lift(poses: Poses, depth: NDArray[np.floating], camera: Camera, pose: CameraPose) -> Joints3D:
    """Find joints in space.

    :param poses: pixels of ``camera``'s picture.
    :param depth: (height, width) metres, 0 where there is no measurement.
    :param camera: intrinsics.
    :param pose: of the camera.
    :return: the joints' centres: the visible surface, moved on along the view by a length for each
        joint.
    """
    surface = depth_at(depth, poses.joints)
    known = poses.found & (surface > 0)
    distance = np.where(known, surface + DEPTH_TO_CENTRE, np.nan)
    positions = camera.back_project(poses.joints, distance, pose)
    return Joints3D(positions, np.where(known, poses.scores, 0.0))


def depth_at(depth: NDArray[np.floating], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of the depths around pixels (..., 2), 0 where there are none.

    :param depth: (height, width) metres, 0 where there is no measurement.
    :param pixels: may be NaN or outside of the picture, which gives 0.
    """
    height, width = depth.shape
    inside = np.isfinite(pixels).all(axis=-1)
    inside &= (pixels >= 0).all(axis=-1) & (pixels < (width, height)).all(axis=-1)
    column = np.where(inside, np.nan_to_num(pixels[..., 0]), 0).astype(np.intp)
    row = np.where(inside, np.nan_to_num(pixels[..., 1]), 0).astype(np.intp)
    step = np.arange(-_WINDOW, _WINDOW + 1)
    rows = np.clip(row[..., None, None] + step[:, None], 0, height - 1)
    columns = np.clip(column[..., None, None] + step, 0, width - 1)
    window = depth[rows, columns].reshape(*row.shape, len(step) ** 2).astype(np.float64)
    measured = np.where(window > 0, window, np.nan)
    some = inside & np.isfinite(measured).any(axis=-1)
    measured[~some] = 0.0
    median: NDArray[np.float64] = np.nanmedian(measured, axis=-1)
    return median
