"""The filter between seeing and acting: missing joints, outliers, velocities, hold-last."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.messages import ArmReading, Floats, Person, SpacePose
from saver_advisors.integration.stage import Inputs, Latency, Stage, StageFault
from saver_envs.cameras.rgbd import BENCH_POSE
from saver_envs.people.patient import heading
from saver_envs.perception.skeleton import JOINTS
from saver_envs.tasks.wrist_push import STANDOFF

#: Wrist and hip on the side of each arm: the right arm's base is at negative y, where a person on
#: the back with the head towards -x has the right side.
SIDES: Final = ("right", "left")
WRISTS: Final = tuple(JOINTS.index(f"{side}_wrist") for side in SIDES)
ELBOWS: Final = tuple(JOINTS.index(f"{side}_elbow") for side in SIDES)
HIPS: Final = tuple(JOINTS.index(f"{side}_hip") for side in SIDES)
#: A joint needs this confidence.
LEAST_SCORE: Final = 0.05
#: For so long (s) a joint that is not seen may have moved on; after that it must be found anew.
_MEMORY: Final = 0.1


@dataclass(frozen=True)
class FilterSettings:
    """How the filter judges.

    :param wrist_gain: share of a wrist's error that its position takes over, 0 to 1
    :param wrist_speed_gain: the same of its velocity, times the frame rate
    :param hip_gain: share of a hip's error
    :param jump: metres that a joint may be away from where it is expected ...
    :param top_speed: ... and metres more for each second since it was seen, up to `_MEMORY`
    :param reacquire: seconds after which a joint that stays away is believed
    :param hold: seconds for which a wrist is held that nothing is known to hide
    :param hold_hidden: seconds for which a wrist is held that an arm of the robot hides
    :param hold_hip: seconds for which a hip is held; a trunk that is not pushed stays
    :param arm_radius: metres from an arm's axis that it hides, flesh of the wrist included
    """

    wrist_gain: float = 0.6
    wrist_speed_gain: float = 0.15
    hip_gain: float = 0.15
    jump: float = 0.08
    top_speed: float = 0.5
    reacquire: float = 1.0
    hold: float = 0.0
    hold_hidden: float = 0.0
    hold_hip: float = 2.0
    arm_radius: float = 0.10

    def __post_init__(self) -> None:
        for name in ("wrist_gain", "hip_gain"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name}={getattr(self, name)!r}: must be above 0, at most 1")
        for name in ("jump", "top_speed", "reacquire", "arm_radius"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name}={getattr(self, name)!r}: must be above 0")
        for name in ("wrist_speed_gain", "hold", "hold_hidden", "hold_hip"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name}={getattr(self, name)!r}: must be 0 or more")


@dataclass
class Track:
    """One joint through time: an alpha-beta filter with a gate.

    :param gain: alpha
    :param speed_gain: beta
    :param settings: the gate's
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
        """Whether it was ever seen."""
        return bool(np.isfinite(self.seen))

    def update(self, measured: Floats, time: float) -> None:
        """Take in a measurement (3,), metres; NaN where there is none; ``lost`` says why not.

        :param measured: the joint's place
        :param time: of the picture, seconds
        """
        if not np.isfinite(measured).all():
            self._miss("is hidden", time)
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
            self._doubt(measured, distance, time)
            return
        self.position = expected + self.gain * error
        self.velocity = self.velocity + self.speed_gain * error / max(step, 1e-3)
        self.seen, self.lost, self._elsewhere = time, "", None

    def _doubt(self, measured: Floats, distance: float, time: float) -> None:
        """Disbelieve a jump, unless the joint stays there."""
        settings = self.settings
        if self._elsewhere is None or np.linalg.norm(measured - self._elsewhere) > settings.jump:
            self._since = time
        self._elsewhere = measured
        if time - self._since >= settings.reacquire:
            self._jump_to(measured, time)
        else:
            self._miss(f"has jumped by {distance:.2f} m", time)

    def _miss(self, reason: str, time: float) -> None:
        self.lost = reason
        self.velocity = np.zeros(3)  # it stays where it was, as limp limbs do

    def _jump_to(self, measured: Floats, time: float) -> None:
        self.position, self.velocity = measured.copy(), np.zeros(3)
        self.seen, self.time, self.lost, self._elsewhere = time, time, "", None


class FilterStage(Stage):
    """From the joints of single pictures to a person with velocities.

    A joint that is missing, or jumps, keeps its last place for a limited time. After that the arms
    are to hold still. There is none for a wrist by default, since 100 ms are soon over; a time of
    its own can be given for one that an arm of the robot hides.

    :param base_position: (arms, 3) of the arms' bases, metres
    :param camera_position: (3,) metres, bench frame
    :param settings: see there
    :param forearm: from a tool to the arm's elbow along the hand, metres
    :param latency: see `Stage`
    """

    def __init__(
        self,
        base_position: NDArray[np.float64],
        camera_position: NDArray[np.float64] = BENCH_POSE.position,
        settings: FilterSettings = FilterSettings(),
        forearm: float = 0.32,
        latency: Latency = 0.0,
    ) -> None:
        super().__init__("filter", "person", ("bench_pose", "arms"), None, latency)
        self._base = base_position
        self._camera = camera_position
        self._settings = settings
        self._forearm = forearm
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        settings = self._settings
        self._wrists = [
            Track(settings.wrist_gain, settings.wrist_speed_gain, settings) for _ in SIDES
        ]
        self._elbows = [
            Track(settings.wrist_gain, settings.wrist_speed_gain, settings) for _ in SIDES
        ]
        self._hips = [Track(settings.hip_gain, 0.0, settings) for _ in SIDES]

    def process(self, inputs: Inputs, now: float) -> Person:
        """Take in one picture's joints."""
        pose = inputs.latest("bench_pose", SpacePose)
        arms = inputs.find("arms", ArmReading)
        known = pose.scores >= LEAST_SCORE
        positions = np.where(known[:, None], pose.positions, np.nan)
        time = pose.stamp.time
        every = ((WRISTS, self._wrists), (ELBOWS, self._elbows), (HIPS, self._hips))
        for places, tracks in every:
            for place, track in zip(places, tracks, strict=True):
                track.update(positions[place], time)
        self._check(time, arms)
        return self._person(pose)

    def _check(self, time: float, arms: ArmReading | None) -> None:
        """Refuse to go on with places that are too old.

        :raises StageFault: which joint, and why
        """
        settings = self._settings
        for side, wrist, hip in zip(SIDES, self._wrists, self._hips, strict=True):
            hidden = wrist.known and arms is not None and self._hidden(wrist.position, arms)
            # A jump has been seen, whatever may hide the wrist.
            hold = settings.hold_hidden if hidden and "hidden" in wrist.lost else settings.hold
            for name, track, limit in (("wrist", wrist, hold), ("hip", hip, settings.hold_hip)):
                if track.lost and time - track.seen > limit:
                    raise StageFault(f"the {side} {name} {track.lost}")

    def _hidden(self, place: Floats, arms: ArmReading) -> bool:
        """Whether an arm of the robot is between the camera and a place (3,)."""
        towards = self._camera - place
        for tool, rotation, base in zip(
            arms.tool_position, arms.tool_rotation, self._base, strict=True
        ):
            begin = tool + base
            end = begin + self._forearm * rotation[:, 2]
            if segment_distance(place, towards, begin, end) < self._settings.arm_radius:
                return True
        return False

    def _person(self, pose: SpacePose) -> Person:
        wrists = np.stack([track.position for track in self._wrists])
        hips = np.stack([track.position for track in self._hips])
        # Targets lie where wrists lie, on the stretcher.
        targets = np.concatenate([hips[:, :2], wrists[:, 2:]], axis=1)
        targets[:, 1] += np.where(self._base[:, 1] < 0, -STANDOFF, STANDOFF)
        velocity = np.stack([track.velocity for track in self._wrists])
        quaternion, angular = self._forearms(wrists, velocity)
        return Person(
            stamp=self.stamp(pose.stamp),
            wrists=wrists,
            wrist_velocity=velocity,
            wrist_quaternion=quaternion,
            wrist_angular_velocity=angular,
            hips=hips,
            targets=targets,
            held=np.array([bool(track.lost) for track in self._wrists]),
        )

    def _forearms(self, wrists: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """How the forearms lie and turn, as `saver_envs.people.patient.Patient.wrists` has it.

        An elbow that was never seen leaves its wrist unturned; one that is not seen now keeps its
        place, since forearms turn slowly.
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
    """The least distance between two segments (3,), metres: from ``start`` along ``direction``,
    and from ``begin`` to ``end``.
    """
    along, offset = end - begin, start - begin
    a, b, c = (
        float(x @ y) for x, y in ((direction, direction), (direction, along), (along, along))
    )
    d, e = float(direction @ offset), float(along @ offset)
    denominator = a * c - b * b
    s = 0.0 if denominator < 1e-12 else min(max((b * e - c * d) / denominator, 0.0), 1.0)
    t = min(max((b * s + e) / max(c, 1e-12), 0.0), 1.0)
    s = min(max((b * t - d) / max(a, 1e-12), 0.0), 1.0)
    return float(np.linalg.norm(start + s * direction - begin - t * along))
