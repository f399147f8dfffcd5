"""The RGB-D camera over the bench: intrinsics, noise, range, and from pixels to metres and back.

The optical frame has x to the right of the picture, y down, z along the view. Pixels are continuous
coordinates from the top left corner, as in :mod:`saver_envs.perception.fields`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import OffScreenView, camera_index

#: MuJoCo's camera looks along -z with y up.
_OPTICAL_TO_MUJOCO: Final = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class CameraPose:
    """Where a camera is and which way it looks.

    :param position: (3,) metres, bench frame.
    :param rotation: (3, 3) columns are the optical frame's axes in the bench frame.
    """

    position: NDArray[np.float64]
    rotation: NDArray[np.float64]

    @staticmethod
    def looking_at(
        position: NDArray[Any], target: NDArray[Any], upwards: NDArray[Any]
    ) -> CameraPose:
        """Return a camera that looks at a point, with a direction upwards in its picture.

        :param position: (3,) metres.
        :param target: (3,) metres, in the picture's middle.
        :param upwards: (3,) not along the view.
        """
        position = np.asarray(position, dtype=np.float64)
        forward = np.asarray(target) - position
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, upwards)
        right = right / np.linalg.norm(right)
        return CameraPose(position, np.stack([right, np.cross(forward, right), forward], axis=1))

    def quaternion(self) -> NDArray[np.float64]:
        """Return the rotation (4,) of MuJoCo's camera frame."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, (self.rotation @ _OPTICAL_TO_MUJOCO).reshape(9))
        return quaternion


@dataclass(frozen=True)
class Camera:
    """A calibrated RGB-D camera without lens distortion.

    :param width: pixels.
    :param height: pixels.
    :param focal: along x and along y, pixels.
    :param centre: principal point, pixels.
    :param nearest: metres; nothing nearer has a depth.
    :param farthest: metres.
    :param rate: pictures per second.
    """

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    nearest: float = 0.5
    farthest: float = 4.5
    rate: float = 30.0

    def scaled(self, factor: float) -> Camera:
        """Return the camera whose pictures are ``factor`` times as wide and high."""
        return replace(
            self,
            width=round(self.width * factor),
            height=round(self.height * factor),
            focal=(self.focal[0] * factor, self.focal[1] * factor),
            centre=(self.centre[0] * factor, self.centre[1] * factor),
        )

    def project(
        self, points: NDArray[Any], pose: CameraPose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where points appear.

        :param points: (..., 3) metres, bench frame.
        :param pose: of the camera.
        :return: (..., 2) pixels, NaN for points that are not in front of the camera, and (...)
            depths along the view in metres.
        """
        seen = (np.asarray(points, dtype=np.float64) - pose.position) @ pose.rotation
        depth = seen[..., 2]
        ahead = np.where(depth > 1e-6, depth, np.nan)[..., None]
        return seen[..., :2] / ahead * self.focal + self.centre, depth

    def back_project(
        self, pixels: NDArray[Any], depth: NDArray[Any], pose: CameraPose
    ) -> NDArray[np.float64]:
        """Return the points (..., 3), metres, bench frame, at pixels (..., 2) and depths (...)."""
        aside = (np.asarray(pixels, dtype=np.float64) - self.centre) / self.focal
        distance = np.asarray(depth, dtype=np.float64)[..., None]
        seen = np.concatenate([aside * distance, distance], axis=-1)
        return seen @ pose.rotation.T + pose.position

    def add_to(self, spec: mujoco.MjSpec, name: str, pose: CameraPose) -> None:
        """Add the camera to a specification, with these intrinsics."""
        camera = spec.worldbody.add_camera(name=name, pos=pose.position, quat=pose.quaternion())
        camera.resolution = (self.width, self.height)
        # In pixels of unit size: only its ratio to the focal length matters.
        camera.sensor_size = (self.width, self.height)
        camera.focal_pixel = self.focal
        camera.principal_pixel = (
            self.centre[0] - self.width / 2,
            self.centre[1] - self.height / 2,
        )


def camera_of(model: mujoco.MjModel, name: str, width: int, height: int) -> Camera:
    """Return the intrinsics with which MuJoCo draws a camera of a model.

    :param model: that has the camera.
    :param name: of the camera.
    :param width: of the pictures, pixels.
    :param height: of the pictures, pixels.
    :raises ValueError: for an unknown name; the message lists the model's cameras.
    """
    index = camera_index(model, name)
    sensor = model.cam_sensorsize[index]
    if sensor.all():
        x, y, centre_x, centre_y = model.cam_intrinsic[index]
        per_x, per_y = width / sensor[0], height / sensor[1]
        focal = (float(x * per_x), float(y * per_y))
        middle = (width / 2 + float(centre_x * per_x), height / 2 + float(centre_y * per_y))
        return Camera(width, height, focal, middle)
    # Square pixels: the vertical field of view is all there is.
    length = height / 2 / math.tan(math.radians(float(model.cam_fovy[index])) / 2)
    return Camera(width, height, (length, length), (width / 2, height / 2))


#: Depth camera of the Kinect v2: 512 x 424 pixels, 70.6 x 60 degrees (SPEC 5.4). Colour is taken to
#: be registered to it, as the maker's library does.
KINECT_V2: Final = Camera(
    width=512,
    height=424,
    focal=(256 / math.tan(math.radians(70.6 / 2)), 212 / math.tan(math.radians(60 / 2))),
    centre=(256.0, 212.0),
)
#: Table 8.1: over the bench, looking down; the picture's top is towards +x.
BENCH_POSE: Final = CameraPose(
    np.array([0.06, 0.03, 1.20]),
    np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
)


def pose_of(data: mujoco.MjData, name: str) -> CameraPose:
    """Return where a camera is in the present state."""
    camera = data.camera(name)
    rotation = camera.xmat.reshape(3, 3) @ _OPTICAL_TO_MUJOCO
    return CameraPose(camera.xpos.copy(), rotation)


class RgbdCamera(OffScreenView):
    """Takes pictures of a model; the first one opens the graphics context.

    :param model: with a camera of that name, see :meth:`Camera.add_to`.
    :param name: of the camera.
    :param camera: its intrinsics; pictures are of its size.
    :raises ValueError: for a camera that the model does not have; the message lists those it has.
    """

    def __init__(self, model: mujoco.MjModel, name: str, camera: Camera = KINECT_V2) -> None:
        super().__init__(model, name, camera.width, camera.height)
        self.camera = camera

    def capture(
        self,
        data: mujoco.MjData,
        random: np.random.Generator | None = None,
        shadows: bool = True,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Take a picture.

        :param data: with kinematics up to date.
        :param random: source of the depth's noise; ``None`` for none.
        :param shadows: whether lights cast shadows; without is faster.
        :return: colour (height, width, 3), and depth (height, width) along the view, metres; 0
            where there is no measurement.
        """
        rgb = self.draw(data, "rgb", shadows)
        exact = self.draw(data, "depth", shadows)
        return rgb, measured_depth(exact, self.camera, random)


def measured_depth(
    exact: NDArray[Any], camera: Camera, random: np.random.Generator | None
) -> NDArray[np.float32]:
    """Add the sensor's noise, and blank what is out of range.

    The noise is Fankhauser et al., "Kinect v2 for mobile robot navigation" (ICAR 2015): along the
    view sigma = 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 th^2 / (pi/2 - th)^2 mm at z metres and th
    radians between view and surface normal; across it 1.6 mm.

    :param exact: (height, width) metres.
    :param camera: of the picture.
    :param random: ``None`` for no noise.
    :return: (height, width) metres, 0 where there is no measurement.
    """
    # Single precision (0.1 micrometres here) is twice as fast, and this runs 30 times a second.
    exact = exact.astype(np.float32, copy=False)
    depth = exact
    if random is not None:
        depth = _displaced(depth, camera, random)
        depth += random.standard_normal(depth.shape, np.float32) * _axial_noise(exact, camera)
    seen = (exact >= camera.nearest) & (exact <= camera.farthest)
    return np.where(seen, depth, np.float32(0))


#: Standard deviation across the view (m).
LATERAL_NOISE: Final = 1.6e-3
#: Largest angle of the noise model (rad); at more grazing angles the sensor sees next to nothing.
_STEEPEST: Final = math.radians(80)


def _displaced(
    depth: NDArray[np.float32], camera: Camera, random: np.random.Generator
) -> NDArray[np.float32]:
    """Return depths read at slightly displaced pixels."""
    height, width = depth.shape
    spread = LATERAL_NOISE / np.maximum(depth, np.float32(camera.nearest))
    aside = random.standard_normal((2, height, width), np.float32) * spread
    row, column = aside
    row *= camera.focal[1]
    column *= camera.focal[0]
    row += np.arange(height, dtype=np.float32)[:, None]
    column += np.arange(width, dtype=np.float32)
    np.rint(aside, out=aside)
    np.clip(row, 0, height - 1, out=row)
    np.clip(column, 0, width - 1, out=column)
    row *= width
    row += column
    return depth.ravel()[row.astype(np.intp)]


def _axial_noise(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Return the standard deviation (height, width), metres."""
    z = np.clip(depth, camera.nearest, camera.farthest)
    per_row, per_column = np.gradient(z)
    # A surface that rises by dz over a pixel, which is z / focal wide there.
    slope = np.hypot(per_row * camera.focal[1], per_column * camera.focal[0]) / z
    angle = np.minimum(np.arctan(slope), np.float32(_STEEPEST))
    tilt = np.square(angle / (np.float32(np.pi / 2) - angle))
    return 1e-3 * (1.5 - 0.5 * z + 0.3 * z * z + 0.1 * z * np.sqrt(z) * tilt)
