"""From encoders and person to the servos: policy, set-points, inverse kinematics, servo gate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.bench import Bench
from saver_advisors.integration.health import Cause, Health
from saver_advisors.integration.messages import (
    Action,
    ArmReading,
    Floats,
    JointTargets,
    Person,
    ServoCommand,
    SetPoints,
    Stamp,
)
from saver_advisors.integration.safety import (
    EmergencyStop,
    Limits,
    kept_clear,
    limited_set_point,
)
from saver_advisors.integration.stage import Inputs, Latency, Stage, StageFault
from saver_envs.control import LARGEST_JOINT_STEP, InverseKinematics, Workspace
from saver_envs.robots.description import Robot
from saver_envs.simulation import ObjectState
from saver_envs.tasks.observation import observe
from saver_envs.wrappers.finger_readings import translated_fingers

#: Rates (Hz): encoders, policy, and the gate before the servos, which work at 500 Hz themselves.
ENCODER_RATE, POLICY_RATE, GATE_RATE = 100.0, 25.0, 250.0
#: A policy whose outputs are bounded by 1 asks for no more than rounding beyond it.
_ROUNDING: Final = 1e-3
#: Kind of the log's line that tells that the arms are held.
STOPPED: Final = "stopped"


class Policy(Protocol):
    """What `saver_advisors.pretrained.load_policy` and Stable-Baselines3's models are."""

    def predict(self, observation: Any) -> tuple[NDArray[Any], Any]:
        """Return actions (n, size) for a mapping of observations (n, size), and a state that is
        not used.
        """


class EncoderStage(Stage):
    """Reads joint encoders and force sensors.

    :param bench: whose
    :param rate: Hz
    :param latency: see `Stage`
    """

    def __init__(self, bench: Bench, rate: float = ENCODER_RATE, latency: Latency = 0.0) -> None:
        super().__init__("encoders", "arms", rate=rate, latency=latency)
        self._bench = bench
        self._sequence = 0

    def reset(self) -> None:
        """Count from 0."""
        self._sequence = 0

    def process(self, inputs: Inputs, now: float) -> ArmReading:
        """Read once."""
        self._sequence += 1
        return self._bench.reading(Stamp(now, self._sequence, self.name))


class TruePersonStage(Stage):
    """Tells where wrists and hips truly are: the rows of the table without a camera.

    :param bench: whose
    :param rate: Hz
    :param latency: see `Stage`
    """

    def __init__(self, bench: Bench, rate: float = POLICY_RATE, latency: Latency = 0.0) -> None:
        super().__init__("true state", "person", rate=rate, latency=latency)
        self._bench = bench
        self._sequence = 0

    def reset(self) -> None:
        """Count from 0."""
        self._sequence = 0

    def process(self, inputs: Inputs, now: float) -> Person:
        """Look once."""
        self._sequence += 1
        truth = self._bench.truth()
        return Person(
            stamp=Stamp(now, self._sequence, self.name),
            wrists=truth.wrists,
            wrist_velocity=truth.wrist_velocity,
            wrist_quaternion=truth.wrist_quaternion,
            wrist_angular_velocity=truth.wrist_angular_velocity,
            hips=truth.hips,
            targets=truth.targets,
            held=np.zeros(len(truth.wrists), dtype=bool),
        )


class PolicyStage(Stage):
    """Asks a policy, at 25 Hz.

    :param policy: of as many arms, with 28 numbers of observation each
    :param robot: the arms
    :param base_position: (arms, 3) of the bases, metres, which face along x
    :param trained_on: robot whose finger readings the policy knows; the arms' own where None
    :param wrist_height: what wrists and targets are told to lie at (m), for a policy that has only
        pushed cubes: then they have a cube's place, and do not turn; None tells what is so
    :param rate: Hz
    :param latency: see `Stage`
    """

    def __init__(
        self,
        policy: Policy,
        robot: Robot,
        base_position: NDArray[np.float64],
        trained_on: Robot | None = None,
        wrist_height: float | None = None,
        rate: float = POLICY_RATE,
        latency: Latency = 0.0,
    ) -> None:
        super().__init__("policy", "action", ("arms", "person"), rate, latency)
        self._policy = policy
        self._robot = robot
        self._base = base_position
        self._trained_on = trained_on or robot
        self._height = wrist_height
        self._fingers = np.zeros((1, len(base_position), 0))

    def process(self, inputs: Inputs, now: float) -> Action | None:
        """Ask once; nothing before a person has been seen."""
        arms = inputs.latest("arms", ArmReading)
        person = inputs.find("person", Person)
        if person is None:
            return None
        if self._height is not None:
            person = as_cubes(person, self._height)
        objects = ObjectState(
            position=(person.wrists - self._base)[None],
            quaternion=person.wrist_quaternion[None],
            linear_velocity=person.wrist_velocity[None],
            angular_velocity=person.wrist_angular_velocity[None],
            world_position=person.wrists[None],
        )
        closed = self._robot.finger_closed
        observation: NDArray[np.floating] = observe(
            arms.arm_state(), objects, self._fingers, self._fingers, closed
        ).astype(np.float32)
        if self._trained_on is not self._robot:
            observation = translated_fingers(observation, self._robot, self._trained_on)
        goal = (person.targets - self._base).reshape(1, -1).astype(np.float32)
        achieved = objects.position.reshape(1, -1).astype(np.float32)
        action, _ = self._policy.predict(
            {"observation": observation, "achieved_goal": achieved, "desired_goal": goal}
        )
        motion = np.asarray(action, dtype=np.float64).reshape(len(self._base), -1)[:, :3]
        return Action(self.stamp(arms.stamp), motion)


def as_cubes(person: Person, height: float) -> Person:
    """The same person with wrists that lie and slide as cubes do.

    :param person: as tracked
    :param height: of wrists and targets, metres
    """
    level = np.array([1.0, 1.0, 0.0])
    at = np.array([0.0, 0.0, height])
    return replace(
        person,
        wrists=person.wrists * level + at,
        wrist_velocity=person.wrist_velocity * level,
        wrist_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (len(person.wrists), 1)),
        wrist_angular_velocity=np.zeros_like(person.wrist_angular_velocity),
        targets=person.targets * level + at,
    )


class SetPointStage(Stage):
    """Turns actions into set-points, within the limits.

    What cannot be meant, a value that is not finite or a point farther away than an action can
    reach, is a fault of the policy's, and the arms hold still.

    :param workspace: where set-points may be
    :param base_position: (arms, 3) metres
    :param limits: of speed, force and clearance
    :param held_height: of all set-points, or None
    :param health: gets a line when a force begins to limit
    :param latency: see `Stage`
    """

    def __init__(
        self,
        workspace: Workspace,
        base_position: NDArray[np.float64],
        limits: Limits,
        held_height: float | None,
        health: Health,
        latency: Latency = 0.0,
    ) -> None:
        super().__init__("set-points", "set_points", ("action", "arms", "person"), None, latency)
        self._workspace = workspace
        self._base = base_position
        self._limits = limits
        self._height = held_height
        self._health = health
        self.reset()

    def reset(self) -> None:
        """Begin from where the tools are."""
        self._previous: Floats | None = None
        self._by: frozenset[str] = frozenset()

    def process(self, inputs: Inputs, now: float) -> SetPoints:
        """Apply one action."""
        action = inputs.latest("action", Action)
        arms = inputs.latest("arms", ArmReading)
        motion = self._checked(action.motion)
        limits = self._limits
        previous = arms.tool_position if self._previous is None else self._previous
        result = limited_set_point(
            previous,
            motion,
            arms.tool_position,
            limits,
            self._workspace,
            self._height,
            limits.freedom(arms.hand_force, arms.torso_force),
        )
        position, by = result.position, set(result.by)
        person = inputs.find("person", Person)
        if limits.clearance and person is not None:
            clear, changed = kept_clear(position, person.hips, self._base, limits.clearance)
            if changed:
                # Back into the box, should the person lie so that both cannot be kept.
                position = self._workspace.clip(clear)
                by.add("clearance")
        self._tell(by, now)
        self._previous = position
        return SetPoints(self.stamp(action.stamp), position)

    def _checked(self, motion: Floats) -> Floats:
        """Return a motion that can be meant, within [-1, 1].

        :raises StageFault: for one that cannot
        """
        if not np.isfinite(motion).all():
            raise StageFault("the policy asks for values that are not finite")
        largest = float(np.abs(motion).max())
        if largest > 1 + _ROUNDING:
            away = largest * self._limits.longest
            raise StageFault(
                f"the policy asks for a point {away:.2f} m away, out of reach of one action "
                f"({self._limits.longest:.3f} m)"
            )
        clipped: Floats = np.clip(motion, -1.0, 1.0)
        return clipped

    def _tell(self, by: set[str], now: float) -> None:
        for name in sorted(by - self._by):
            if name != "workspace":  # every policy leans on the walls now and then
                self._health.note(now, "limited", self.name, name)
        self._by = frozenset(by)


class KinematicsStage(Stage):
    """Turns set-points into joint targets.

    :param solver: damped least squares or a learned model
    :param latency: see `Stage`
    """

    def __init__(self, solver: InverseKinematics, latency: Latency = 0.0) -> None:
        super().__init__("kinematics", "joint_targets", ("set_points", "arms"), None, latency)
        self._solver = solver

    def process(self, inputs: Inputs, now: float) -> JointTargets:
        """Solve once."""
        points = inputs.latest("set_points", SetPoints)
        arms = inputs.latest("arms", ArmReading)
        joints = self._solver(arms.arm_state(), points.positions[None])[0]
        if not np.isfinite(joints).all():
            raise StageFault("the solution is not finite")
        return JointTargets(self.stamp(points.stamp), joints)


class ServoStage(Stage):
    """The gate before the servos: passes joint targets on, or holds the arms where they are.

    It holds while a stage is faulty or silent and while the emergency stop is pressed, and goes
    on when all are well again and a new target has come.

    :param bench: whose servos
    :param health: says who is not well
    :param stop: the emergency stop
    :param rate: how often it looks, Hz
    """

    def __init__(
        self, bench: Bench, health: Health, stop: EmergencyStop, rate: float = GATE_RATE
    ) -> None:
        super().__init__("servos", "servo", (), rate)
        self._bench = bench
        self._health = health
        self._emergency = stop
        self._lower = np.asarray(bench.cell.robot.joint_lower)
        self._upper = np.asarray(bench.cell.robot.joint_upper)
        self.reset()

    def reset(self) -> None:
        """Hold until there is something to do."""
        self._held: Floats | None = None
        self._moving = np.zeros(1)
        self._cause: Cause | None = None
        self._stopped = -1.0
        self._sequence = 0

    def process(self, inputs: Inputs, now: float) -> ServoCommand | None:
        """Look once."""
        self._sequence += 1
        stamp = Stamp(now, self._sequence, self.name)
        cause = self._why(now)
        if cause is not None:
            self._stopped = now
            return self._hold(stamp, cause)
        targets = inputs.find("joint_targets", JointTargets)
        if self._cause is not None and (targets is None or targets.stamp.time <= self._stopped):
            return self._hold(stamp, self._cause)
        if targets is None:
            return None
        if self._cause is not None:
            self._health.note(now, "resumed", self._cause.stage, "well again")
            self._cause, self._held = None, None
        joints = self._bounded(targets.joints)
        self._bench.command(joints)
        return ServoCommand(stamp, joints, False, "")

    def _bounded(self, targets: Floats) -> Floats:
        """Return targets that are within the joint limits and not far from the joints."""
        present = self._bench.joint_position()
        lower = np.maximum(self._lower, present - LARGEST_JOINT_STEP)
        upper = np.minimum(self._upper, present + LARGEST_JOINT_STEP)
        return np.minimum(np.maximum(targets, lower), upper)

    def _braked(self, held: Floats | None) -> Floats:
        """Where to hold the joints.

        First where they are, not where they were to go: they brake at once, and overshoot a little.
        Then each where it has turned round, since to come back would take twice as long.
        """
        position, velocity = self._bench.joint_position(), self._bench.joint_velocity()
        if held is None:
            self._moving = velocity
            return position
        turned = velocity * self._moving < 0
        self._moving = np.where(turned, 0.0, self._moving)
        return np.where(turned, position, held)

    def _why(self, now: float) -> Cause | None:
        if self._emergency.pressed:
            return Cause("emergency stop", self._emergency.reason)
        return self._health.cause(now)

    def _hold(self, stamp: Stamp, cause: Cause) -> ServoCommand:
        self._held = self._braked(self._held)
        if self._cause is None or self._cause.stage != cause.stage:
            self._health.note(stamp.time, STOPPED, cause.stage, cause.reason)
        self._cause = cause
        self._bench.command(self._held)
        return ServoCommand(stamp, self._held, True, str(cause))
