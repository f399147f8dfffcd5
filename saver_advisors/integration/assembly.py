"""Build a loop from settings: its stages, their rates and latencies."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np

from saver_advisors.integration import EXPERT, casualty
from saver_advisors.integration import control_stages as control
from saver_advisors.integration import perception_stages as perception
from saver_advisors.integration.bench import BenchGeometry, RobotBench
from saver_advisors.integration.graph import Graph
from saver_advisors.integration.health import SILENT_PERIODS, Health
from saver_advisors.integration.messages import Picture
from saver_advisors.integration.safety import EmergencyStop, SafetyLimits
from saver_advisors.integration.stage import (
    MEASURED,
    Change,
    Latency,
    LoopStage,
    SensorStage,
    check_latency,
)
from saver_advisors.integration.tracking import FilterSettings, FilterStage
from saver_envs.cameras.rgbd import KINECT_V2
from saver_envs.control import DampedLeastSquares, InverseKinematics
from saver_envs.robots import ROBOTS
from saver_envs.robots.description import Fingers
from saver_envs.validation import require

#: Output topic of a stage, and the seconds from its input to its result: the duration of a call on
#: one core of an ordinary machine, rounded up (docs/wrist-push-results.md has measured ones); for
#: the camera, exposure and transfer.
_STAGES: Final[Mapping[str, tuple[str, float]]] = {
    "camera": ("frame", 0.010),
    "picture check": ("picture", 0.0005),
    "pose": ("pixel_pose", 0.030),
    "lift": ("camera_pose", 0.001),
    "bench frame": ("bench_pose", 0.0001),
    "filter": ("person", 0.0005),
    "policy": ("action", 0.0005),
    "set-points": ("set_points", 0.0003),
    "kinematics": ("joint_targets", 0.0005),
}
SEEING, ACTING = tuple(_STAGES)[:6], tuple(_STAGES)[6:]
LATENCIES: Final[Mapping[str, float]] = {name: one[1] for name, one in _STAGES.items()}
#: Output topics of the stages that can run in other processes.
OUTPUTS: Final = {name: one[0] for name, one in _STAGES.items() if name != "camera"}


@dataclass(frozen=True)
class LoopSettings:
    """Configure a loop, apart from its bench.

    :param seeing: use the camera and the pose network, instead of the true state.
    :param learned_kinematics: use the shipped learned model, instead of damped least squares.
    :param policy: name of a shipped policy, a weight file, or ``expert``.
    :param trained_on: robot whose finger readings the policy was trained with; the bench's if None.
    :param wrist_height: of wrists and targets in the observation (m), see `PolicyStage`.
    :param limits: of set-points.
    :param filter: of the tracking.
    :param latencies: stage -> seconds, or ``"measured"``; 0 for stages without an entry.
    :param silent_periods: periods after which a stage counts as silent.
    :raises ValueError: for an unknown stage or robot.
    """

    seeing: bool = True
    learned_kinematics: bool = True
    policy: str = "dual-jaco-push"
    trained_on: str | None = casualty.TRAINED_ON
    wrist_height: float | None = casualty.CUBE_HEIGHT
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    filter: FilterSettings = field(default_factory=FilterSettings)
    latencies: Mapping[str, Latency] = field(default_factory=lambda: dict(LATENCIES))
    silent_periods: float = SILENT_PERIODS

    def __post_init__(self) -> None:
        known = (*SEEING, *ACTING, "encoders", "true state")
        for name, latency in self.latencies.items():
            if name not in known:
                raise ValueError(f"latencies: {name!r} is no stage; there are {', '.join(known)}")
            check_latency(name, latency)
        known_robot = self.trained_on is None or self.trained_on in ROBOTS
        require("trained_on", self.trained_on, known_robot, f"one of {', '.join(ROBOTS)}")
        require("silent_periods", self.silent_periods, 1 < self.silent_periods < np.inf, "above 1")

    def measured(self) -> LoopSettings:
        """Return a copy in which the latency of each stage is the duration of its call.

        The camera keeps its latency: the simulated one is slow because it renders.
        """
        slow = dict.fromkeys((*SEEING[1:], *ACTING), MEASURED)
        return replace(self, latencies={**slow, "camera": self.latencies.get("camera", 0.0)})

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return asdict(self)

    @staticmethod
    def from_mapping(values: Mapping[str, Any]) -> LoopSettings:
        """Restore what :meth:`to_mapping` returned."""
        limits, filters = SafetyLimits(**values["limits"]), FilterSettings(**values["filter"])
        return LoopSettings(**{**values, "limits": limits, "filter": filters})

    @property
    def order(self) -> tuple[str, ...]:
        """The names of the stages, from the sensors to the servos."""
        return ("encoders", *(SEEING if self.seeing else ("true state",)), *ACTING, "servos")

    def silence(self, camera_rate: float = KINECT_V2.rate) -> dict[str, float]:
        """Return the seconds after which each stage counts as silent.

        :param camera_rate: pictures per second.
        """
        allowed = {"encoders": 2 * self.silent_periods / control.ENCODER_RATE}
        slowest = 1 / camera_rate
        for name in self.order[1:-1]:
            if name not in SEEING:
                allowed[name] = self.silent_periods / control.POLICY_RATE
                continue
            latency = self.latencies.get(name, 0.0)
            if name != "camera" and not isinstance(latency, str):
                slowest = max(slowest, latency)
            allowed[name] = slowest * self.silent_periods
        return allowed


def settings_for(policy: str) -> LoopSettings:
    """Return the settings that fit a policy: its robot, and whether it was trained on cubes.

    :param policy: name of a shipped policy, a weight file, or ``expert`` for the scripted policy.
    :raises ValueError: for an unknown policy, or one that does not drive two arms by displacements.
    """
    from saver_advisors.pretrained import load_policy
    from saver_envs.registration import row_of

    if policy == EXPERT:
        return LoopSettings(policy=policy, trained_on=None, wrist_height=None)
    card = load_policy(policy).card
    row = row_of(card.env_id)
    if row.n_arms != 2 or row.task.fingers is not Fingers.LOCKED:
        raise ValueError(f"policy={policy!r} is of {card.env_id}: must push with two arms")
    height = None if issubclass(row.task, casualty.TASK) else casualty.CUBE_HEIGHT
    return LoopSettings(policy=policy, trained_on=row.robot, wrist_height=height)


@dataclass
class ControlLoop:
    """Connect a graph of stages to a bench.

    :param bench: sensors and servos.
    :param graph: the stages.
    :param health: of the stages, and the log.
    :param stop: the emergency stop.
    :param settings: that the loop was built from.
    """

    bench: RobotBench
    graph: Graph
    health: Health
    stop: EmergencyStop
    settings: LoopSettings

    def reset(self, seed: int) -> None:
        """Begin a trial, drawn from a seed; the emergency stop keeps its state."""
        self.bench.reset(seed)
        self.graph.reset()


def build_loop(
    settings: LoopSettings,
    bench: RobotBench,
    change: Change | None = None,
    elsewhere: Collection[str] = (),
) -> ControlLoop:
    """Build a loop.

    :param settings: of the loop.
    :param bench: sensors and servos.
    :param change: replaces stages, such as ``lambda stages: [...]``.
    :param elsewhere: names of the stages that run in other processes.
    """
    health = Health(settings.order, settings.silence(bench.geometry.camera.rate))
    stop = EmergencyStop()
    here = [name for name in settings.order if name not in elsewhere]
    stages = [_bench_stage(name, settings, bench, health, stop) for name in here]
    if change is not None:
        stages = change(stages)
    external = {OUTPUTS[name] for name in elsewhere}
    return ControlLoop(bench, Graph(stages, health, external), health, stop, settings)


def _bench_stage(
    name: str, settings: LoopSettings, bench: RobotBench, health: Health, stop: EmergencyStop
) -> LoopStage:
    """Build any stage, with the bench for those that need it."""
    sensor = partial(SensorStage, name, latency=settings.latencies.get(name, 0.0))
    camera_rate = bench.geometry.camera.rate
    builders: dict[str, Callable[[], LoopStage]] = {
        "encoders": lambda: sensor("arms", rate=control.ENCODER_RATE, measure=bench.reading),
        "true state": lambda: sensor("person", rate=control.POLICY_RATE, measure=bench.truth),
        "camera": lambda: sensor(
            "frame", rate=camera_rate, measure=lambda stamp: Picture(stamp, *bench.picture())
        ),
        "servos": lambda: control.ServoStage(bench, health, stop, settings.limits),
    }
    if name in builders:
        return builders[name]()
    return build_stage(name, settings, bench.geometry, health)


def build_stage(
    name: str, settings: LoopSettings, geometry: BenchGeometry, health: Health
) -> LoopStage:
    """Build a stage that does not need the bench, so that it can run in any process.

    :param name: one of `OUTPUTS`.
    :param settings: of the loop.
    :param geometry: of the bench.
    :param health: logs which limits set in.
    :raises ValueError: for another name.
    """
    trained_on = None if settings.trained_on is None else ROBOTS[settings.trained_on]
    height = settings.wrist_height
    builders: dict[str, Callable[[], LoopStage]] = {
        "picture check": perception.PictureCheckStage,
        "pose": lambda: perception.PoseStage(perception.shipped_estimator()),
        "lift": lambda: perception.LiftStage(geometry.camera),
        "bench frame": lambda: perception.BenchFrameStage(geometry.camera_pose),
        "filter": lambda: FilterStage(geometry, settings.filter),
        "policy": lambda: control.PolicyStage(_policy(settings), geometry, trained_on, height),
        "set-points": lambda: control.SetPointStage(geometry, settings.limits, health),
        "kinematics": lambda: control.KinematicsStage(_kinematics(settings, geometry)),
    }
    if name not in builders:
        raise ValueError(f"stage {name!r} is unknown; there are {', '.join(builders)}")
    stage = builders[name]()
    stage.latency = settings.latencies.get(name, 0.0)
    return stage


def _policy(settings: LoopSettings) -> control.LoopPolicy:
    if settings.policy == EXPERT:
        from saver_envs.experts import make_expert

        return make_expert(casualty.ENV_ID, max_speed=settings.limits.max_speed)
    from saver_advisors.pretrained import load_policy

    return load_policy(settings.policy)


def _kinematics(settings: LoopSettings, geometry: BenchGeometry) -> InverseKinematics:
    if not settings.learned_kinematics:
        return DampedLeastSquares(geometry.robot)
    from saver_envs.modelling.kinematics import LearnedInverseKinematics

    return LearnedInverseKinematics(geometry.robot)
