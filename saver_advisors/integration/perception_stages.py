"""The stages from the camera to joints in the bench frame: picture check, pose, lift, frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.messages import Picture, PixelPose, SpacePose
from saver_advisors.integration.stage import Inputs, LoopStage, StageFault
from saver_advisors.integration.tracking import SIDES
from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, Camera, CameraPose
from saver_envs.perception.lifting import lift
from saver_envs.perception.parsing import CAUTIOUS_PARSING, Poses

#: Stride of the pixels (in each direction) that tell whether a picture is black or frozen.
_COARSE: Final = 8
#: Mean brightness below which a picture is black, of 255.
_BLACK: Final = 4.0
#: The pose of the camera in its own frame.
_CAMERA_FRAME: Final = CameraPose(np.zeros(3), np.eye(3))

#: The limbs that the pose network looks for: those that connect wrists and hips to the body.
LIMBS: Final = (
    *(f"{side}_{limb}" for side in SIDES for limb in ("collar", "upper_arm", "forearm")),
    *(f"{side}_trunk" for side in SIDES),
)
Estimator = Callable[[NDArray[np.uint8]], Poses]


class PictureCheckStage(LoopStage):
    """Forward pictures that are neither black nor frozen.

    A sensor's noise differs from frame to frame: equal depth images are the same frame.
    """

    def __init__(self) -> None:
        super().__init__("picture check", "picture", ("frame",))
        self.reset()

    def reset(self) -> None:
        """Forget the last picture."""
        self._before: NDArray[np.float32] | None = None

    def process(self, inputs: Inputs, now: float) -> Picture:
        """Check one picture."""
        frame = inputs.latest("frame", Picture)
        before, self._before = self._before, frame.depth[::_COARSE, ::_COARSE].copy()
        if frame.rgb[::_COARSE, ::_COARSE].mean() < _BLACK:
            raise StageFault("the picture is black")
        if not self._before.any():
            raise StageFault("the picture has no depth")
        if before is not None and np.array_equal(before, self._before):
            raise StageFault("the picture is frozen")
        return Picture(self.stamp(frame.stamp), frame.rgb, frame.depth)


class PoseStage(LoopStage):
    """Find the person in a picture.

    :param estimator: returns people in a picture, the one with the highest confidence first.
    """

    def __init__(self, estimator: Estimator) -> None:
        super().__init__("pose", "pixel_pose", ("picture",))
        self._estimator = estimator

    def process(self, inputs: Inputs, now: float) -> PixelPose:
        """Process one picture."""
        picture = inputs.latest("picture", Picture)
        poses = self._estimator(picture.rgb)
        if len(poses) == 0:
            raise StageFault("no person found")
        return PixelPose(self.stamp(picture.stamp), poses.joints[0], poses.scores[0])


class LiftStage(LoopStage):
    """Compute joint positions in the camera's frame from the depth image.

    :param camera: intrinsics.
    """

    def __init__(self, camera: Camera = KINECT_V2) -> None:
        self._camera = camera
        super().__init__("lift", "camera_pose", ("pixel_pose", "picture"))

    def process(self, inputs: Inputs, now: float) -> SpacePose:
        """Lift one person."""
        pose = inputs.latest("pixel_pose", PixelPose)
        picture = inputs.matching("picture", Picture, pose.stamp.sequence)
        people = Poses(pose.joints[None], pose.scores[None], np.ones(1))
        joints = lift(people, picture.depth, self._camera, _CAMERA_FRAME)
        return SpacePose(self.stamp(pose.stamp), joints.positions[0], joints.scores[0])


class BenchFrameStage(LoopStage):
    """Transform positions from the camera's frame to the bench's.

    :param pose: of the camera, as calibrated.
    """

    def __init__(self, pose: CameraPose = BENCH_POSE) -> None:
        self._pose = pose
        super().__init__("bench frame", "bench_pose", ("camera_pose",))

    def process(self, inputs: Inputs, now: float) -> SpacePose:
        """Transform one person."""
        seen = inputs.latest("camera_pose", SpacePose)
        positions = seen.positions @ self._pose.rotation.T + self._pose.position
        return SpacePose(self.stamp(seen.stamp), positions, seen.scores)


def shipped_estimator() -> Estimator:
    """Load the shipped pose network for the camera over the bench; imports torch.

    It returns joints of high confidence only: for arms that touch a person, a missing joint is
    better than a wrong one.
    """
    from saver_envs.perception.estimator import PoseEstimator

    return PoseEstimator.shipped(limbs=list(LIMBS), turn=2, options=CAUTIOUS_PARSING)
