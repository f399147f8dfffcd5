"""Lift joints from the picture into space with the depth at them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import Camera, CameraPose
from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import JOINTS

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
#: Distance (14,) of a joint's centre behind the visible surface, along the view (m): medians over
#: rendered pictures of people outside the test set (``saver benchmark pose`` measures them).
DEPTH_TO_CENTRE: Final = np.array([_DEPTH_TO_CENTRE[name.split("_")[-1]] for name in JOINTS])
#: Half the side of the window in which the depth is read, in pixels of a 512 x 424 picture.
_WINDOW: Final = 2


@dataclass(frozen=True)
class Joints3D:
    """Joints of people in space.

    :param positions: (people, 14, 3) metres, bench frame; NaN where unknown.
    :param scores: (people, 14) confidences; 0 where the joint was not found or has no depth.
    """

    positions: NDArray[np.float64]
    scores: NDArray[np.float64]


def lift(poses: Poses, depth: NDArray[np.floating], camera: Camera, pose: CameraPose) -> Joints3D:
    """Compute the positions of joints in space.

    :param poses: pixels of the picture of ``camera``.
    :param depth: (height, width) metres, 0 where there is no measurement.
    :param camera: intrinsics.
    :param pose: pose of the camera.
    :return: the centres of the joints: the visible surface, moved along the view by a fixed
        distance for each joint.
    """
    surface = depth_at(depth, poses.joints)
    known = poses.found & (surface > 0)
    distance = np.where(known, surface + DEPTH_TO_CENTRE, np.nan)
    positions = camera.back_project(poses.joints, distance, pose)
    return Joints3D(positions, np.where(known, poses.scores, 0.0))


def depth_at(depth: NDArray[np.floating], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of the measured depths around pixels (..., 2), 0 where there are none.

    :param depth: (height, width) metres, 0 where there is no measurement.
    :param pixels: (..., 2); the depth of NaN and of pixels outside the picture is 0.
    """
    inside, rows, columns = pixel_windows(pixels, depth.shape, _WINDOW)
    side = 2 * _WINDOW + 1
    window = depth[rows, columns].reshape(*inside.shape, side**2).astype(np.float64)
    measured = np.where(window > 0, window, np.nan)
    some = inside & np.isfinite(measured).any(axis=-1)
    measured[~some] = 0.0
    return np.nanmedian(measured, axis=-1)


def pixel_windows(
    pixels: NDArray[np.float64], shape: tuple[int, ...], radius: int
) -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
    """Return indices of square windows around points of a picture.

    :param pixels: (..., 2) x and y.
    :param shape: height and width of the picture.
    :param radius: pixels from the middle of a window to its edge.
    :return: (...) which points are inside the picture, and the windows' rows (..., side, 1) and
        columns (..., 1, side), clipped to the picture. Points outside get a window at (0, 0).
    """
    height, width = shape
    within = (pixels >= 0) & (pixels < (width, height))
    inside: NDArray[np.bool_] = np.asarray(within.all(axis=-1))
    corner = np.where(inside[..., None], pixels, 0).astype(np.intp)[..., None, None, :]
    step = np.arange(-radius, radius + 1)
    rows = np.clip(corner[..., 1] + step[:, None], 0, height - 1)
    return inside, rows, np.clip(corner[..., 0] + step, 0, width - 1)
