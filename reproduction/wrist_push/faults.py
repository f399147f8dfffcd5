"""Fault injection: wrap a stage so that its results are wrong for a while."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from saver_advisors.integration.messages import Action, Message, Picture, PixelPose
from saver_advisors.integration.stage import Change, Inputs, LoopStage
from saver_advisors.integration.tracking import WRISTS
from saver_envs.cameras.rgbd import KINECT_V2

#: Displacement of a jumping wrist in the picture (pixels): 0.2 m on the stretcher.
JUMP: Final = 70.0
#: Length of an unreachable action, as a multiple of the longest displacement.
TOO_FAR: Final = 50.0


#: Turns a result and the last result before the fault into the message that is passed on.
Spoil = Callable[[Any, Any], Message | None]


@dataclass(frozen=True)
class Fault:
    """Describe a fault.

    :param name: in the table of results.
    :param stage: whose results are wrong.
    :param spoil: replaces a result; returns None for no message.
    :param words: description for the table.
    :param detected_by: the stage that detects the fault, if it is not the faulty one: pictures are
        checked by the stages that read them, actions by the stage that applies them.
    """

    name: str
    stage: str
    spoil: Spoil
    words: str
    detected_by: str = ""


#: Name -> fault, in the order of the table.
FAULTS: Final[dict[str, Fault]] = {}


def _fault(name: str, stage: str, words: str, detected_by: str = "") -> Callable[[Spoil], Spoil]:
    """Return a decorator that registers a function as a fault, see `Fault`."""

    def register(spoil: Spoil) -> Spoil:
        FAULTS[name] = Fault(name, stage, spoil, words, detected_by)
        return spoil

    return register


@_fault("frames lost", "camera", "the camera delivers nothing")
def _lost(message: Message, before: Message | None) -> None:
    return None


@_fault("frames frozen", "camera", "the camera delivers its last picture again", "picture check")
def _frozen(picture: Picture, before: Picture | None) -> Picture:
    old = picture if before is None else before
    return replace(picture, rgb=old.rgb, depth=old.depth)


@_fault("frames black", "camera", "the picture is black", "picture check")
def _black(picture: Picture, before: Picture | None) -> Picture:
    return replace(picture, rgb=np.zeros_like(picture.rgb))


@_fault("no person", "camera", "there is nobody in the picture", "pose")
def _nobody(picture: Picture, before: Picture | None) -> Picture:
    """Return a uniform grey picture with unchanged depth: there is light but no person."""
    return replace(picture, rgb=np.full_like(picture.rgb, 120))


@_fault("wrist hidden", "pose", "the right wrist is not found", "filter")
def _hidden(pose: PixelPose, before: PixelPose | None) -> PixelPose:
    joints, scores = pose.joints.copy(), pose.scores.copy()
    joints[WRISTS[0]], scores[WRISTS[0]] = np.nan, 0.0
    return replace(pose, joints=joints, scores=scores)


@_fault("pose jumps", "pose", "the right wrist is found 0.2 m away", "filter")
def _jumped(pose: PixelPose, before: PixelPose | None) -> PixelPose:
    joints = pose.joints.copy()
    joints[WRISTS[0], 1] += JUMP if joints[WRISTS[0], 1] < KINECT_V2.height / 2 else -JUMP
    return replace(pose, joints=joints)


@_fault("unreachable point", "policy", "the policy asks for a point 1 m away", "set-points")
def _unreachable(action: Action, before: Action | None) -> Action:
    length = max(float(np.abs(action.motion).max()), 0.1)
    return replace(action, motion=action.motion / length * TOO_FAR)


@_fault("not a number", "policy", "the policy asks for NaN", "set-points")
def _not_finite(action: Action, before: Action | None) -> Action:
    return replace(action, motion=np.full_like(action.motion, math.nan))


@_fault("stage crashes", "pose", "the pose stage raises an exception at every call")
def _crash(pose: PixelPose, before: PixelPose | None) -> None:
    raise RuntimeError("injected")


_fault("policy silent", "policy", "the policy does not answer")(_lost)


class FaultyStage(LoopStage):
    """Inject a fault into a stage during given periods.

    :param inner: the stage.
    :param fault: that is injected.
    :param windows: (begin, end) of each period, seconds of the trial.
    """

    def __init__(self, inner: LoopStage, fault: Fault, windows: list[tuple[float, float]]) -> None:
        super().__init__(inner.name, inner.output, inner.inputs, inner.rate, inner.latency)
        self._inner = inner
        self._fault = fault
        self._windows = windows
        self._before: Message | None = None

    def reset(self) -> None:
        """Reset the stage, and forget its last result."""
        self._inner.reset()
        self._before = None

    def process(self, inputs: Inputs, now: float) -> Message | None:
        """Run the stage; spoil its result during the fault."""
        message = self._inner.process(inputs, now)
        if message is None:
            return None
        if any(begin <= now < end for begin, end in self._windows):
            return self._fault.spoil(message, self._before)
        self._before = message
        return message


def with_fault(fault: Fault, windows: list[tuple[float, float]]) -> Change:
    """Return the argument ``change`` of `saver_advisors.integration.assembly.build_loop`.

    :param fault: that is injected.
    :param windows: (begin, end) of each period, seconds of the trial.
    :raises ValueError: when called for a loop without the fault's stage.
    """

    def change(stages: list[LoopStage]) -> list[LoopStage]:
        if fault.stage not in [stage.name for stage in stages]:
            raise ValueError(f"fault {fault.name!r}: this loop has no stage {fault.stage!r}")
        return [
            FaultyStage(stage, fault, windows) if stage.name == fault.stage else stage
            for stage in stages
        ]

    return change
