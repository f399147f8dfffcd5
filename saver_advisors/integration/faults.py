"""Faults to inject: wrappers round a stage that do something wrong for a while."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from saver_advisors.integration.messages import Action, Message, Picture, PixelPose
from saver_advisors.integration.stage import Inputs, Stage
from saver_advisors.integration.tracking import WRISTS
from saver_envs.cameras.rgbd import KINECT_V2

#: How far a jumping wrist jumps (pixels): 0.2 m on the stretcher.
JUMP: Final = 70.0
#: What an unreachable point is asked for with: so many times the longest displacement.
TOO_FAR: Final = 50.0


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    :param name: in the table
    :param stage: whose results it spoils
    :param spoil: from a result, and the last one before the fault, to what is passed on instead:
        a message, or None for nothing
    :param words: what happens, for the table
    """

    name: str
    stage: str
    spoil: Callable[[Any, Any], Message | None]
    words: str


def _lost(message: Message, before: Message | None) -> None:
    return None


def _frozen(picture: Picture, before: Picture | None) -> Picture:
    old = picture if before is None else before
    return replace(picture, rgb=old.rgb, depth=old.depth)


def _black(picture: Picture, before: Picture | None) -> Picture:
    return replace(picture, rgb=np.zeros_like(picture.rgb))


def _nobody(picture: Picture, before: Picture | None) -> Picture:
    """An even grey, with the depth's noise: there is light, and nobody."""
    return replace(picture, rgb=np.full_like(picture.rgb, 120))


def _hidden(pose: PixelPose, before: PixelPose | None) -> PixelPose:
    joints, scores = pose.joints.copy(), pose.scores.copy()
    joints[WRISTS[0]], scores[WRISTS[0]] = np.nan, 0.0
    return replace(pose, joints=joints, scores=scores)


def _jumped(pose: PixelPose, before: PixelPose | None) -> PixelPose:
    joints = pose.joints.copy()
    joints[WRISTS[0], 1] += JUMP if joints[WRISTS[0], 1] < KINECT_V2.height / 2 else -JUMP
    return replace(pose, joints=joints)


def _unreachable(action: Action, before: Action | None) -> Action:
    length = max(float(np.abs(action.motion).max()), 0.1)
    return replace(action, motion=action.motion / length * TOO_FAR)


def _not_finite(action: Action, before: Action | None) -> Action:
    return replace(action, motion=np.full_like(action.motion, math.nan))


def _crash(message: Message, before: Message | None) -> None:
    raise RuntimeError("injected")


FAULTS: Final = {
    fault.name: fault
    for fault in (
        Fault("frames lost", "camera", _lost, "the camera delivers nothing"),
        Fault("frames frozen", "camera", _frozen, "the camera delivers its last picture again"),
        Fault("frames black", "camera", _black, "the picture is black"),
        Fault("no person", "camera", _nobody, "there is nobody in the picture"),
        Fault("wrist hidden", "pose", _hidden, "the right wrist is not found"),
        Fault("pose jumps", "pose", _jumped, "the right wrist is found 0.2 m away"),
        Fault("unreachable point", "policy", _unreachable, "the policy asks for a point 1 m away"),
        Fault("not a number", "policy", _not_finite, "the policy asks for NaN"),
        Fault("stage crashes", "pose", _crash, "the pose stage raises an exception at every call"),
        Fault("policy silent", "policy", _lost, "the policy does not answer"),
    )
}


class FaultyStage(Stage):
    """A stage that does something wrong from a time to another, as often as told.

    :param inner: the stage
    :param fault: what goes wrong
    :param windows: (begin, end) of each time it does, seconds of the trial
    :raises ValueError: for another stage than the fault's
    """

    def __init__(self, inner: Stage, fault: Fault, windows: list[tuple[float, float]]) -> None:
        if inner.name != fault.stage:
            raise ValueError(f"fault {fault.name!r} is one of {fault.stage!r}, not {inner.name!r}")
        super().__init__(inner.name, inner.output, inner.inputs, inner.rate, inner.latency)
        self._inner = inner
        self._fault = fault
        self._windows = windows
        self._before: Message | None = None

    def reset(self) -> None:
        """Let the stage forget, and the last good result with it."""
        self._inner.reset()
        self._before = None

    def process(self, inputs: Inputs, now: float) -> Message | None:
        """Let the stage work; spoil the result when it is time."""
        message = self._inner.process(inputs, now)
        if message is None:
            return None
        if any(begin <= now < end for begin, end in self._windows):
            return self._fault.spoil(message, self._before)
        self._before = message
        return message


def with_fault(
    fault: Fault, windows: list[tuple[float, float]]
) -> Callable[[list[Stage]], list[Stage]]:
    """What `saver_advisors.integration.assembly.build_loop` takes as ``change``.

    :param fault: what goes wrong
    :param windows: when
    :raises ValueError: where the loop has no such stage
    """

    def change(stages: list[Stage]) -> list[Stage]:
        if fault.stage not in [stage.name for stage in stages]:
            raise ValueError(f"fault {fault.name!r}: this loop has no stage {fault.stage!r}")
        return [
            FaultyStage(stage, fault, windows) if stage.name == fault.stage else stage
            for stage in stages
        ]

    return change
