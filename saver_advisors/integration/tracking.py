"""The filter between perception and policy: missing joints, outliers, velocities, short gaps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, TypeAlias

import numpy as np

from saver_advisors.integration.bench import BenchGeometry
from saver_advisors.integration.casualty import TASK
from saver_advisors.integration.messages import ArmReading, Floats, Person, SpacePose
from saver_advisors.integration.stage import Inputs, LoopStage, StageFault
from saver_envs.people.patient import heading
from saver_envs.perception.skeleton import JOINTS
from saver_envs.validation import NonNegativeFloat, PositiveFloat, check_fields

#: The person's side at each arm: the right arm's base is at negative y, on the right of a person
#: who lies on the back with the head towards -x.
SIDES: Final = ("right", "left")
WRISTS: Final = tuple(JOINTS.index(f"{side}_wrist") for side in SIDES)
"""Indices of the wrists among the skeleton's joints, right and left."""
ELBOWS: Final = tuple(JOINTS.index(f"{side}_elbow") for side in SIDES)
HIPS: Final = tuple(JOINTS.index(f"{side}_hip") for side in SIDES)
"""Indices of the hips among the skeleton's joints, right and left."""
Gain: TypeAlias = Annotated[float, "above 0, at most 1", lambda value: 0 < value <= 1]
#: Least confidence of a joint.
LEAST_SCORE: Final = 0.05
#: Distance from a tool to the arm's elbow along the hand (m).
_FOREARM: Final = 0.32
#: The gate widens for this time after a joint was last seen (s).
_MEMORY: Final = 0.1


@dataclass(frozen=True)
class FilterSettings:
    """Configure the filter.

    :param wrist_gain: fraction of a wrist's error that corrects its position, above 0, at most 1.
    :param wrist_speed_gain: fraction of that error, times the frame rate, that corrects its
        velocity.
    :param hip_gain: fraction of a hip's error that corrects its position.
    :param jump: largest accepted distance of a joint from its expected position, metres.
    :param top_speed: increase of that distance per second since the joint was seen (m/s), up to
        `_MEMORY`.
    :param reacquire: time after which a joint that stays at another position is accepted, seconds.
    :param hold: time for which the last position of a hidden wrist is repeated, seconds.
    :param hold_hidden: the same for a wrist that an arm of the robot occludes, seconds.
    :param hold_hip: the same for a hip, whose position hardly changes, seconds.
    :param arm_radius: distance from an arm's axis within which it occludes a wrist, metres.
    :raises ValueError: for a value out of range.
    """

    wrist_gain: Gain = 0.6
    wrist_speed_gain: NonNegativeFloat = 0.15
    hip_gain: Gain = 0.15
    jump: PositiveFloat = 0.08
    top_speed: PositiveFloat = 0.5
    reacquire: PositiveFloat = 1.0
    hold: NonNegativeFloat = 0.0
    hold_hidden: NonNegativeFloat = 0.0
    hold_hip: NonNegativeFloat = 2.0
    arm_radius: PositiveFloat = 0.10

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass
class Track:
    """Track one joint with an alpha-beta filter and a gate.

    :param gain: alpha.
    :param speed_gain: beta.
    :param settings: of the gate.
    :param position: (3,) latest estimate, metres.
    :param velocity: (3,) metres per second.
    :param seen: time of the last accepted measurement, seconds.
    :param time: time of the last picture, seconds.
    :param lost: why the last picture gave no measurement, empty if it gave one.
    """

    gain: float
    speed_gain: float
    settings: FilterSettings
    position: Floats = field(default_factory=lambda: np.full(3, np.nan))
    velocity: Floats = field(default_factory=lambda: np.zeros(3))
    seen: float = -np.inf
    time: float = -np.inf
    lost: str = "has not been seen"
    _elsewhere: Floats | None = None
    _since: float = np.inf

    @property
    def known(self) -> bool:
        """Whether the joint was ever seen."""
        return bool(np.isfinite(self.seen))

    def update(self, measured: Floats, time: float) -> None:
        """Process one picture.

        :param measured: (3,) position of the joint, metres; NaN if it was not found.
        :param time: of the picture, seconds.
        """
        if not np.isfinite(measured).all():
            self._miss("is hidden")
            self._elsewhere = None
        elif not self.known:
            self._jump_to(measured, time)
        else:
            self._correct(measured, time)
        self.time = time

    def _correct(self, measured: Floats, time: float) -> None:
        step = time - self.time
        expected = self.position + self.velocity * step
        error = measured - expected
        settings = self.settings
        distance = float(np.linalg.norm(error))
        unseen = min(time - self.seen, _MEMORY)
        if distance > settings.jump + settings.top_speed * unseen:
            self._reject(measured, distance, time)
            return
        self.position = expected + self.gain * error
        self.velocity = self.velocity + self.speed_gain * error / max(step, 1e-3)
        self.seen, self.lost, self._elsewhere = time, "", None

    def _reject(self, measured: Floats, distance: float, time: float) -> None:
        """Reject an outlier, unless the joint has stayed there for long enough."""
        settings = self.settings
        if self._elsewhere is None or np.linalg.norm(measured - self._elsewhere) > settings.jump:
            self._since = time
        self._elsewhere = measured
        if time - self._since >= settings.reacquire:
            self._jump_to(measured, time)
        else:
            self._miss(f"has jumped by {distance:.2f} m")

    def _miss(self, reason: str) -> None:
        self.lost = reason
        self.velocity = np.zeros(3)  # a limp limb stays where it is

    def _jump_to(self, measured: Floats, time: float) -> None:
        self.position, self.velocity = measured.copy(), np.zeros(3)
        self.seen, self.lost, self._elsewhere = time, "", None


class FilterStage(LoopStage):
    """Turn joints of single pictures into a person with velocities.

    A joint that is missing or jumps keeps its last position for a limited time; after that the
    stage is faulty and the arms hold still. For wrists this time is 0 by default, and a wrist that
    an arm of the robot occludes can have a time of its own.

    :param geometry: of the bench.
    :param settings: of the filter.
    """

    def __init__(self, geometry: BenchGeometry, settings: FilterSettings) -> None:
        super().__init__("filter", "person", ("bench_pose", "arms"))
        self._base, self._camera = geometry.base_position, geometry.camera_pose.position
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget all joints."""
        settings = self._settings
        gains = settings.wrist_gain, settings.wrist_speed_gain
        self._wrists = [Track(*gains, settings) for _ in SIDES]
        self._elbows = [Track(*gains, settings) for _ in SIDES]
        self._hips = [Track(settings.hip_gain, 0.0, settings) for _ in SIDES]

    def process(self, inputs: Inputs, now: float) -> Person:
        """Process the joints of one picture."""
        pose = inputs.latest("bench_pose", SpacePose)
        arms = inputs.find("arms", ArmReading)
        known = pose.scores >= LEAST_SCORE
        positions = np.where(known[:, None], pose.positions, np.nan)
        tracks = (*self._wrists, *self._elbows, *self._hips)
        for joint, track in zip((*WRISTS, *ELBOWS, *HIPS), tracks, strict=True):
            track.update(positions[joint], pose.stamp.time)
        self._check(pose.stamp.time, arms)
        return self._person(pose)

    def _check(self, time: float, arms: ArmReading | None) -> None:
        """Check the age of all positions.

        :raises StageFault: for a position that is too old; states which joint, and why.
        """
        settings = self._settings
        for side, wrist, hip in zip(SIDES, self._wrists, self._hips, strict=True):
            hidden = wrist.known and arms is not None and self._occluded(wrist.position, arms)
            # A wrist that jumped was seen, so nothing occludes it.
            hold = settings.hold_hidden if hidden and "hidden" in wrist.lost else settings.hold
            for name, track, limit in (("wrist", wrist, hold), ("hip", hip, settings.hold_hip)):
                if track.lost and time - track.seen > limit:
                    raise StageFault(f"the {side} {name} {track.lost}")

    def _occluded(self, place: Floats, arms: ArmReading) -> bool:
        """Return whether an arm of the robot is between the camera and a position (3,)."""
        begin = arms.tool_position + self._base
        end = begin + _FOREARM * arms.tool_rotation[..., 2]
        towards, radius = self._camera - place, self._settings.arm_radius
        return any(
            segment_distance(place, towards, *ends) < radius
            for ends in zip(begin, end, strict=True)
        )

    def _person(self, pose: SpacePose) -> Person:
        wrists = np.stack([track.position for track in self._wrists])
        hips = np.stack([track.position for track in self._hips])
        # Targets are at the height of the wrists, which lie on the stretcher.
        targets = np.concatenate([hips[:, :2], wrists[:, 2:]], axis=1)
        targets[:, 1] += np.where(self._base[:, 1] < 0, -TASK.standoff, TASK.standoff)
        velocity = np.stack([track.velocity for track in self._wrists])
        quaternion, angular = self._forearms(wrists, velocity)
        held = np.array([bool(track.lost) for track in self._wrists])
        stamp = self.stamp(pose.stamp)
        return Person(stamp, wrists, velocity, quaternion, angular, hips, targets, held)

    def _forearms(self, wrists: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Compute the forearms' orientation and angular velocity.

        The definition is that of `saver_envs.people.patient.Patient.wrists`. The wrist of an elbow
        that was never seen has the identity. A hidden elbow keeps its position, since forearms turn
        slowly.
        """
        quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (len(wrists), 1))
        angular = np.zeros_like(wrists)
        for arm, elbow in enumerate(self._elbows):
            if elbow.known:
                along = wrists[arm] - elbow.position
                quaternion[arm] = heading(along)
                swing = np.cross(along, velocity[arm] - elbow.velocity)
                angular[arm] = swing / max(float(along @ along), 1e-4)
        return quaternion, angular


def segment_distance(start: Floats, direction: Floats, begin: Floats, end: Floats) -> float:
    """Return the least distance between two segments, metres.

    :param start: (3,) start of the first segment, metres.
    :param direction: (3,) from its start to its end, metres.
    :param begin: (3,) start of the second segment, metres.
    :param end: (3,) its end, metres.
    """
    along, offset = end - begin, start - begin
    a, b, c = float(direction @ direction), float(direction @ along), float(along @ along)
    d, e = float(direction @ offset), float(along @ offset)
    denominator = a * c - b * b
    s = 0.0 if denominator < 1e-12 else min(max((b * e - c * d) / denominator, 0.0), 1.0)
    t = min(max((b * s + e) / max(c, 1e-12), 0.0), 1.0)
    s = min(max((b * t - d) / max(a, 1e-12), 0.0), 1.0)
    return float(np.linalg.norm(start + s * direction - begin - t * along))
