"""Small graphs: stages that count, a plant without physics, and the loop on the dual push scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from saver_advisors.integration.bench import EpisodesBench
from saver_advisors.integration.control_stages import (
    ENCODER_RATE,
    POLICY_RATE,
    KinematicsStage,
    LoopPolicy,
    PolicyStage,
    ServoStage,
    SetPointStage,
)
from saver_advisors.integration.graph import Graph
from saver_advisors.integration.health import Health
from saver_advisors.integration.messages import JointTargets, Message, Stamp
from saver_advisors.integration.safety import EmergencyStop, SafetyLimits
from saver_advisors.integration.stage import Inputs, LoopStage, SensorStage
from saver_envs.control import DampedLeastSquares
from saver_envs.registration import make_episodes
from saver_envs.robots import JACO

Act = Callable[[Message, float], None]


@dataclass
class Clock:
    """A plant that only tells the time."""

    time: float = 0.0

    def advance_to(self, time: float) -> None:
        assert time >= self.time - 1e-9
        self.time = time


class Source(LoopStage):
    """Says 1, 2, 3 ..."""

    def reset(self) -> None:
        self.count = 0

    def process(self, inputs: Inputs, now: float) -> Message:
        self.count += 1
        return JointTargets(Stamp(now, self.count, self.name), np.full((1, 1), float(self.count)))


class Relay(LoopStage):
    """Passes on what it gets, unless `act` does something else."""

    def __init__(
        self,
        *arguments: object,
        act: Callable[[Message, float], None] | None = None,
        **more: object,
    ) -> None:
        super().__init__(*arguments, **more)  # type: ignore[arg-type]
        self.act = act
        self.got: list[tuple[float, int]] = []

    def process(self, inputs: Inputs, now: float) -> Message:
        message = inputs.latest(self.inputs[0], JointTargets)
        self.got.append((now, message.stamp.sequence))
        if self.act is not None:
            self.act(message, now)
        return JointTargets(self.stamp(message.stamp), message.joints)


@dataclass
class SmallLoop:
    """The loop with the true state on a scene of cubes."""

    bench: EpisodesBench
    graph: Graph
    health: Health
    stop: EmergencyStop = field(default_factory=EmergencyStop)


class Push:
    """A policy that pushes everything along one direction."""

    def __init__(self, motion: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self.motion = np.array(motion)

    def predict(self, observation: object) -> tuple[np.ndarray, None]:
        return np.tile(self.motion, 2)[None], None


def build_loop(policy: LoopPolicy, limits: SafetyLimits | None = None) -> SmallLoop:
    """The loop with the true state round a policy, at the start of trial 0."""
    bench = EpisodesBench(make_episodes("DualMicoPush-v0"))
    names = ("encoders", "true state", "policy", "set-points", "kinematics", "servos")
    health = Health(names, {"encoders": 0.03, "true state": 0.06, "policy": 0.06})
    stop = EmergencyStop()
    limits = limits or SafetyLimits(max_speed=0.5, hand_force=1e6, clearance=0.0)
    stages = [
        SensorStage("encoders", "arms", rate=ENCODER_RATE, measure=bench.reading),
        SensorStage("true state", "person", rate=POLICY_RATE, measure=bench.truth),
        PolicyStage(policy, bench.geometry, JACO),
        SetPointStage(bench.geometry, limits, health),
        KinematicsStage(DampedLeastSquares(bench.geometry.robot)),
        ServoStage(bench, health, stop, limits),
    ]
    graph = Graph(stages, health)
    bench.reset(0)
    graph.reset()
    return SmallLoop(bench, graph, health, stop)
