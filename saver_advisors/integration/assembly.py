"""A loop from settings: which stages there are, at what rates, with what latencies."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np

from saver_advisors.integration.bench import Bench, Cell
from saver_advisors.integration.control_stages import (
    ENCODER_RATE,
    POLICY_RATE,
    EncoderStage,
    KinematicsStage,
    Policy,
    PolicyStage,
    ServoStage,
    SetPointStage,
    TruePersonStage,
)
from saver_advisors.integration.graph import Graph
from saver_advisors.integration.health import SILENT_PERIODS, Health, allowed_silence
from saver_advisors.integration.perception_stages import (
    BenchFrameStage,
    CameraStage,
    LiftStage,
    PictureCheckStage,
    PoseStage,
    shipped_estimator,
)
from saver_advisors.integration.safety import EmergencyStop, Limits
from saver_advisors.integration.stage import MEASURED, Latency, Stage
from saver_advisors.integration.tracking import FilterSettings, FilterStage
from saver_envs.cameras.rgbd import KINECT_V2
from saver_envs.control import DampedLeastSquares, InverseKinematics
from saver_envs.robots import ROBOTS
from saver_envs.robots.description import Fingers

SEEING: Final = ("camera", "picture check", "pose", "lift", "bench frame", "filter")
ACTING: Final = ("policy", "set-points", "kinematics")
#: Seconds from a stage's input to its result: what the stages take on one core of an ordinary
#: machine, rounded up (docs/wrist-push-results.md has measured ones). Of the camera: exposure
#: and transfer.
LATENCIES: Final[Mapping[str, float]] = {
    "camera": 0.010,
    "picture check": 0.0005,
    "pose": 0.030,
    "lift": 0.001,
    "bench frame": 0.0001,
    "filter": 0.0005,
    "policy": 0.0005,
    "set-points": 0.0003,
    "kinematics": 0.0005,
}
#: The scripted policy of the environment, to tell faults of the loop from those of a learned one.
EXPERT: Final = "expert"
ENV_ID: Final = "WristPush-v0"
#: The robot whose hand the shipped push policies know, and the height of the cubes' centres (m).
TRAINED_ON: Final = "jaco"
CUBE_HEIGHT: Final = 0.028


@dataclass(frozen=True)
class LoopSettings:
    """Everything that makes a loop, apart from its bench.

    :param seeing: camera and pose network, or the true state
    :param learned_kinematics: the shipped learned model, or damped least squares
    :param policy: name of a shipped policy, or a weight file
    :param trained_on: robot whose finger readings the policy knows; None for the bench's own
    :param wrist_height: of wrists and targets as told to the policy (m), see `PolicyStage`
    :param limits: of set-points
    :param filter: of the tracking
    :param latencies: seconds of each stage, or ``"measured"``; what is missing has none
    :param silent_periods: periods after which a stage counts as silent
    :raises ValueError: for an unknown stage or robot
    """

    seeing: bool = True
    learned_kinematics: bool = True
    policy: str = "dual-jaco-push"
    trained_on: str | None = TRAINED_ON
    wrist_height: float | None = CUBE_HEIGHT
    limits: Limits = field(default_factory=Limits)
    filter: FilterSettings = field(default_factory=FilterSettings)
    latencies: Mapping[str, Latency] = field(default_factory=lambda: dict(LATENCIES))
    silent_periods: float = SILENT_PERIODS

    def __post_init__(self) -> None:
        known = (*SEEING, *ACTING, "encoders", "true state")
        for name in self.latencies:
            if name not in known:
                raise ValueError(f"latencies: {name!r} is no stage; there are {', '.join(known)}")
        if self.trained_on is not None and self.trained_on not in ROBOTS:
            raise ValueError(f"trained_on={self.trained_on!r}: must be one of {', '.join(ROBOTS)}")
        if not 1 < self.silent_periods < np.inf:
            raise ValueError(f"silent_periods={self.silent_periods!r}: must be above 1")

    def latency(self, stage: str) -> Latency:
        """Of a stage, 0 where none is given."""
        return self.latencies.get(stage, 0.0)

    def measured(self) -> LoopSettings:
        """The same with every stage as slow as it is on this machine, the camera apart.

        A simulated camera is slow because it draws, which a real one does not.
        """
        slow = dict.fromkeys((*SEEING[1:], *ACTING), MEASURED)
        return replace(self, latencies={**slow, "camera": self.latency("camera")})

    def to_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "latencies": dict(self.latencies)}

    @staticmethod
    def from_mapping(values: Mapping[str, Any]) -> LoopSettings:
        """What :meth:`to_mapping` returned."""
        given = dict(values)
        given["limits"] = Limits(**given["limits"])
        given["filter"] = FilterSettings(**given["filter"])
        return LoopSettings(**given)

    @property
    def order(self) -> tuple[str, ...]:
        """The stages' names, from the sensors to the servos."""
        return ("encoders", *(SEEING if self.seeing else ("true state",)), *ACTING, "servos")

    def silence(self) -> dict[str, float]:
        """Seconds after which each stage counts as silent."""
        allowed = {"encoders": allowed_silence(ENCODER_RATE, 2 * self.silent_periods)}
        slowest = 1 / KINECT_V2.rate
        for name in self.order[1:-1]:
            if name in SEEING:
                latency = self.latency(name)
                own = 0.0 if isinstance(latency, str) or name == "camera" else latency
                slowest = max(slowest, own)
                allowed[name] = slowest * self.silent_periods
            else:
                allowed[name] = allowed_silence(POLICY_RATE, self.silent_periods)
        return allowed


def settings_for(policy: str) -> LoopSettings:
    """The settings that fit a policy: what its hand was, and whether it has only pushed cubes.

    :param policy: name of a shipped one, a weight file, or ``expert``: the scripted one
    :raises ValueError: for an unknown one, or one that does not drive two arms by displacements
    """
    from saver_advisors.pretrained import load_policy
    from saver_envs.registration import row_of

    if policy == EXPERT:
        return LoopSettings(policy=policy, trained_on=None, wrist_height=None)
    card = load_policy(policy).card
    row = row_of(card.env_id)
    if row.n_arms != 2 or row.task.fingers is not Fingers.LOCKED:
        raise ValueError(f"policy={policy!r} is of {card.env_id}: must push with two arms")
    knows_people = row.task.moves_person
    return LoopSettings(
        policy=policy,
        trained_on=row.robot,
        wrist_height=None if knows_people else CUBE_HEIGHT,
    )


@dataclass
class Loop:
    """A graph round a bench.

    :param bench: what it runs on
    :param graph: the stages
    :param health: who is well, and the log
    :param stop: the emergency stop
    :param settings: what it was built from
    """

    bench: Bench
    graph: Graph
    health: Health
    stop: EmergencyStop
    settings: LoopSettings


Change = Callable[[list[Stage]], list[Stage]]


def build_loop(
    settings: LoopSettings,
    bench: Bench,
    change: Change | None = None,
    elsewhere: Collection[str] = (),
) -> Loop:
    """Build a loop.

    :param settings: what it is made of
    :param bench: what it runs on
    :param change: replaces stages, such as ``lambda stages: [...]``
    :param elsewhere: names of stages that other processes run
    """
    health, stop = Health(settings.order, settings.silence()), EmergencyStop()
    here = [name for name in settings.order if name not in elsewhere]
    stages = [_own_stage(name, settings, bench, health, stop) for name in here]
    if change is not None:
        stages = change(stages)
    external = {OUTPUTS[name] for name in elsewhere}
    return Loop(bench, Graph(stages, health, external), health, stop, settings)


#: The topic that each stage writes.
OUTPUTS: Final = {
    "picture check": "picture",
    "pose": "pixel_pose",
    "lift": "camera_pose",
    "bench frame": "bench_pose",
    "filter": "person",
    "policy": "action",
    "set-points": "set_points",
    "kinematics": "joint_targets",
}


def _own_stage(
    name: str, settings: LoopSettings, bench: Bench, health: Health, stop: EmergencyStop
) -> Stage:
    """A stage that needs the bench itself, or any other."""
    latency = settings.latency(name)
    if name == "encoders":
        return EncoderStage(bench, latency=latency)
    if name == "true state":
        return TruePersonStage(bench, latency=latency)
    if name == "camera":
        return CameraStage(bench, latency=latency)
    if name == "servos":
        return ServoStage(bench, health, stop)
    return build_stage(name, settings, bench.cell, health)


def build_stage(name: str, settings: LoopSettings, cell: Cell, health: Health) -> Stage:
    """Build a stage that needs no bench, so that it may run anywhere.

    :param name: one of `OUTPUTS`
    :param settings: of the loop
    :param cell: what is fixed about the bench
    :param health: gets lines about limits
    :raises ValueError: for another name
    """
    latency = settings.latency(name)
    builders: dict[str, Callable[[], Stage]] = {
        "picture check": lambda: PictureCheckStage(latency),
        "pose": lambda: PoseStage(shipped_estimator(), latency),
        "lift": lambda: LiftStage(latency=latency),
        "bench frame": lambda: BenchFrameStage(latency=latency),
        "filter": lambda: FilterStage(
            cell.base_position, settings=settings.filter, latency=latency
        ),
        "policy": lambda: _policy_stage(settings, cell, latency),
        "set-points": lambda: SetPointStage(
            cell.workspace, cell.base_position, settings.limits, cell.held_height, health, latency
        ),
        "kinematics": lambda: KinematicsStage(_kinematics(settings, cell), latency),
    }
    if name not in builders:
        raise ValueError(f"stage {name!r} is unknown; there are {', '.join(builders)}")
    return builders[name]()


def _policy_stage(settings: LoopSettings, cell: Cell, latency: Latency) -> PolicyStage:
    trained_on = None if settings.trained_on is None else ROBOTS[settings.trained_on]
    policy = _policy(settings)
    return PolicyStage(
        policy,
        cell.robot,
        cell.base_position,
        trained_on,
        settings.wrist_height,
        latency=latency,
    )


def _policy(settings: LoopSettings) -> Policy:
    if settings.policy == EXPERT:
        from saver_envs.experts import make_expert

        return make_expert(ENV_ID, max_speed=settings.limits.max_speed)
    from saver_advisors.pretrained import load_policy

    return load_policy(settings.policy)


def _kinematics(settings: LoopSettings, cell: Cell) -> InverseKinematics:
    if not settings.learned_kinematics:
        return DampedLeastSquares(cell.robot)
    from saver_envs.modelling.kinematics import LearnedInverseKinematics

    return LearnedInverseKinematics(cell.robot)
