"""From the camera to joints in the bench frame: camera, picture check, pose, lift, bench frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.messages import Picture, PixelPose, SpacePose, Stamp
from saver_advisors.integration.stage import Inputs, Latency, Stage, StageFault
from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, Camera, CameraPose
from saver_envs.perception.lifting import lift
from saver_envs.perception.parsing import CAUTIOUS_PARSING, Poses

#: A picture is looked at in every so many pixels to tell whether it is black or frozen.
_COARSE: Final = 8
#: Mean brightness below which a picture is black, of 255.
_BLACK: Final = 4.0
#: The camera's own frame, seen from itself.
_AT_HOME: Final = CameraPose(np.zeros(3), np.eye(3))

#: Limbs that wrists and hips belong to: nothing else is looked for.
LIMBS: Final = (
    "right_collar",
    "right_upper_arm",
    "right_forearm",
    "left_collar",
    "left_upper_arm",
    "left_forearm",
    "right_trunk",
    "left_trunk",
)
Estimator = Callable[[NDArray[np.uint8]], Poses]


class SeenBench(Protocol):
    """A bench with a camera."""

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Take a picture: colour (height, width, 3), and depth (height, width) in metres."""


class CameraStage(Stage):
    """Takes pictures.

    :param bench: with a camera
    :param rate: Hz
    :param latency: exposure and transfer, see `Stage`
    """

    def __init__(
        self, bench: SeenBench, rate: float = KINECT_V2.rate, latency: Latency = 0.0
    ) -> None:
        super().__init__("camera", "frame", rate=rate, latency=latency)
        self._bench = bench
        self._sequence = 0

    def reset(self) -> None:
        """Count from 0."""
        self._sequence = 0

    def process(self, inputs: Inputs, now: float) -> Picture:
        """Take one."""
        self._sequence += 1
        rgb, depth = self._bench.picture()
        return Picture(Stamp(now, self._sequence, self.name), rgb, depth)


class PictureCheckStage(Stage):
    """Passes pictures on that show something, and something new.

    A sensor's noise differs from frame to frame: two equal depth images are one image twice.

    :param latency: see `Stage`
    """

    def __init__(self, latency: Latency = 0.0) -> None:
        super().__init__("picture check", "picture", ("frame",), None, latency)
        self.reset()

    def reset(self) -> None:
        """Compare the next picture with none."""
        self._before: NDArray[np.float32] | None = None

    def process(self, inputs: Inputs, now: float) -> Picture:
        """Check one."""
        frame = inputs.latest("frame", Picture)
        before, self._before = self._before, frame.depth[::_COARSE, ::_COARSE].copy()
        if frame.rgb[::_COARSE, ::_COARSE].mean() < _BLACK:
            raise StageFault("the picture is black")
        if not self._before.any():
            raise StageFault("the picture has no depth")
        if before is not None and np.array_equal(before, self._before):
            raise StageFault("the picture is frozen")
        return Picture(self.stamp(frame.stamp), frame.rgb, frame.depth)


class PoseStage(Stage):
    """Finds the person in a picture.

    :param estimator: from a picture to people, the surest first
    :param latency: see `Stage`
    """

    def __init__(self, estimator: Estimator, latency: Latency = 0.0) -> None:
        super().__init__("pose", "pixel_pose", ("picture",), None, latency)
        self._estimator = estimator

    def process(self, inputs: Inputs, now: float) -> PixelPose:
        """Look at one."""
        picture = inputs.latest("picture", Picture)
        poses = self._estimator(picture.rgb)
        if len(poses) == 0:
            raise StageFault("no person found")
        return PixelPose(self.stamp(picture.stamp), poses.joints[0], poses.scores[0])


class LiftStage(Stage):
    """Finds joints in space, in the camera's frame, from the depth at them.

    :param camera: intrinsics
    :param latency: see `Stage`
    """

    def __init__(self, camera: Camera = KINECT_V2, latency: Latency = 0.0) -> None:
        super().__init__("lift", "camera_pose", ("pixel_pose", "picture"), None, latency)
        self._camera = camera

    def process(self, inputs: Inputs, now: float) -> SpacePose:
        """Lift one person."""
        pose = inputs.latest("pixel_pose", PixelPose)
        picture = inputs.matching("picture", Picture, pose.stamp.sequence)
        people = Poses(pose.joints[None], pose.scores[None], np.ones(1))
        joints = lift(people, picture.depth, self._camera, _AT_HOME)
        return SpacePose(self.stamp(pose.stamp), joints.positions[0], joints.scores[0])


class BenchFrameStage(Stage):
    """Turns positions from the camera's frame into the bench's.

    :param pose: of the camera, as calibrated
    :param latency: see `Stage`
    """

    def __init__(self, pose: CameraPose = BENCH_POSE, latency: Latency = 0.0) -> None:
        super().__init__("bench frame", "bench_pose", ("camera_pose",), None, latency)
        self._pose = pose

    def process(self, inputs: Inputs, now: float) -> SpacePose:
        """Turn one person."""
        seen = inputs.latest("camera_pose", SpacePose)
        positions = seen.positions @ self._pose.rotation.T + self._pose.position
        return SpacePose(self.stamp(seen.stamp), positions, seen.scores)


def shipped_estimator(**options: Any) -> Estimator:
    """The pose network that comes along, for the camera over the bench; imports torch.

    It gives sure joints alone: for arms that touch a person, a joint that is missing is better than
    a wrong one.

    :param options: of `saver_envs.perception.estimator.PoseEstimator`
    """
    from saver_envs.perception.estimator import PoseEstimator

    options = {"options": CAUTIOUS_PARSING, **options}
    return PoseEstimator.shipped(limbs=list(LIMBS), turn=2, **options)
