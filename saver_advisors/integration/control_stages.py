"""The stages from the sensors to the servos: policy, set-points, kinematics, servo gate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.bench import BenchGeometry, RobotBench
from saver_advisors.integration.health import STOPPED, Event, Health
from saver_advisors.integration.messages import (
    Action,
    ArmReading,
    Floats,
    JointTargets,
    Message,
    Person,
    ServoCommand,
    SetPoints,
    Stamp,
)
from saver_advisors.integration.safety import (
    BURST,
    EmergencyStop,
    SafetyLimits,
    TargetLimits,
    kept_clear,
)
from saver_advisors.integration.stage import Inputs, LoopStage, StageFault
from saver_envs.control import InverseKinematics, SetPointRule, bounded
from saver_envs.robots.description import Robot
from saver_envs.simulation import ACTION_DURATION, ObjectState
from saver_envs.tasks.arm_and_object import ARM_AND_OBJECT, object_parts, three_fingers
from saver_envs.tasks.layout import Layout
from saver_envs.wrappers.finger_readings import translated_fingers

#: Rates of the encoders, the policy and the servo gate (Hz). The servos themselves run at 500 Hz.
ENCODER_RATE, POLICY_RATE, GATE_RATE = 100.0, 25.0, 250.0
#: Largest excess over 1 that rounding adds to the outputs of a policy that is bounded by 1.
_ROUNDING: Final = 1e-3


class LoopPolicy(Protocol):
    """The interface of `saver_advisors.pretrained.load_policy` and Stable-Baselines3's models."""

    def predict(self, observation: Any) -> tuple[NDArray[Any], Any]:
        """Return actions for a batch of observations.

        :param observation: name -> (n, size).
        :return: actions (n, size), and a state that the loop ignores.
        """


class PolicyStage(LoopStage):
    """Compute actions with a policy, at 25 Hz.

    :param policy: for as many arms, with 28 numbers of observation each.
    :param geometry: of the bench.
    :param trained_on: robot whose finger readings the policy was trained with; the bench's own if
        None.
    :param wrist_height: height of wrists and targets in the observation (m), for a policy that was
        trained on cubes: wrists then have a cube's height and do not turn. None for true heights.
    """

    def __init__(
        self,
        policy: LoopPolicy,
        geometry: BenchGeometry,
        trained_on: Robot | None = None,
        wrist_height: float | None = None,
    ) -> None:
        super().__init__("policy", "action", ("arms", "person"), POLICY_RATE)
        self._policy = policy
        self._robot = geometry.robot
        self._base = geometry.base_position
        self._trained_on = trained_on or geometry.robot
        self._height = wrist_height
        self._layout = Layout(ARM_AND_OBJECT, len(self._base))

    def process(self, inputs: Inputs, now: float) -> Action | None:
        """Compute one action; None until a person has been seen."""
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
        state = arms.arm_state()
        locked = np.zeros((1, len(self._base), 0))
        hand = {
            "gripper position": state.tool_position,
            "gripper linear velocity": state.tool_velocity,
            "finger positions": three_fingers(locked, self._robot.finger_closed),
            "finger velocities": three_fingers(locked, 0.0),
        }
        observation: NDArray[np.floating] = self._layout.join(
            hand | object_parts(state, objects)
        ).astype(np.float32)
        if self._trained_on is not self._robot:
            observation = translated_fingers(
                observation, self._layout, self._robot, self._trained_on
            )
        goal = (person.targets - self._base).reshape(1, -1).astype(np.float32)
        achieved = objects.position.reshape(1, -1).astype(np.float32)
        action, _ = self._policy.predict(
            {"observation": observation, "achieved_goal": achieved, "desired_goal": goal}
        )
        motion = np.asarray(action, dtype=np.float64).reshape(len(self._base), -1)[:, :3]
        return Action(self.stamp(arms.stamp), motion)


def as_cubes(person: Person, height: float) -> Person:
    """Return the person with wrists that have a cube's height and slide without turning.

    :param person: as tracked.
    :param height: of wrists and targets, metres.
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


class SetPointStage(LoopStage):
    """Turn actions into set-points within the limits.

    An action that is not finite or exceeds the longest displacement is a fault of the policy, and
    the arms hold still.

    :param geometry: of the bench.
    :param limits: of speed, force and clearance.
    :param health: logs which limits set in.
    """

    def __init__(self, geometry: BenchGeometry, limits: SafetyLimits, health: Health) -> None:
        super().__init__("set-points", "set_points", ("action", "arms", "person"))
        self._geometry = geometry
        self._limits = limits
        self._rule = SetPointRule(geometry.workspace, limits.longest, geometry.held_height)
        self._health = health
        self.reset()

    def reset(self) -> None:
        """Start from the tools' positions."""
        self._previous: Floats | None = None
        self._by: set[str] = set()

    def process(self, inputs: Inputs, now: float) -> SetPoints:
        """Apply one action."""
        action = inputs.latest("action", Action)
        arms = inputs.latest("arms", ArmReading)
        person = inputs.find("person", Person)
        limits, geometry = self._limits, self._geometry
        tool, free = arms.tool_position, limits.freedom(arms.hand_force, arms.torso_force)
        previous = tool if self._previous is None else self._previous
        # Without contact forces this equals the environments' rule.
        moved = self._rule.unclipped(previous, self._checked(action.motion), tool, free[:, None])
        position = geometry.workspace.clip(moved)
        by = {"force"} if (free < 1).any() else set()
        if limits.clearance and person is not None:
            clear, changed = kept_clear(
                position, person.hips, geometry.base_position, limits.clearance
            )
            if changed:
                # The workspace has priority where both limits conflict.
                position = geometry.workspace.clip(clear)
                by.add("clearance")
        # Every policy reaches the workspace's walls now and then, so that is not logged.
        for name in sorted(by - self._by):
            self._health.note(now, "limited", self.name, name)
        self._by = by
        self._previous = position
        return SetPoints(self.stamp(action.stamp), position)

    def _checked(self, motion: Floats) -> Floats:
        """Return a valid motion, clipped to [-1, 1].

        :raises StageFault: for an invalid one.
        """
        if not np.isfinite(motion).all():
            raise StageFault("the policy's action is not finite")
        largest = float(np.abs(motion).max())
        if largest > 1 + _ROUNDING:
            away = largest * self._limits.longest
            raise StageFault(
                f"the policy's action leads to a point {away:.2f} m away, out of reach of one "
                f"action ({self._limits.longest:.3f} m)"
            )
        return bounded(motion, -1.0, 1.0)


class KinematicsStage(LoopStage):
    """Turn set-points into joint targets.

    :param solver: damped least squares or a learned model.
    """

    def __init__(self, solver: InverseKinematics) -> None:
        super().__init__("kinematics", "joint_targets", ("set_points", "arms"))
        self._solver = solver

    def process(self, inputs: Inputs, now: float) -> JointTargets:
        """Solve once."""
        points = inputs.latest("set_points", SetPoints)
        arms = inputs.latest("arms", ArmReading)
        joints = self._solver(arms.arm_state(), points.positions[None])[0]
        if not np.isfinite(joints).all():
            raise StageFault("the solution is not finite")
        return JointTargets(self.stamp(points.stamp), joints)


class ServoStage(LoopStage):
    """Gate the servos: forward joint targets, or hold the arms where they are.

    It holds while a stage is faulty or silent, while the emergency stop is pressed, and while joint
    targets or the arms break a limit, whoever computed the targets. It resumes with the first valid
    target that is measured after that.

    :param bench: gives the servos.
    :param health: gives the cause of a stop.
    :param stop: the emergency stop.
    :param limits: of speed, force and clearance.
    """

    def __init__(
        self, bench: RobotBench, health: Health, stop: EmergencyStop, limits: SafetyLimits
    ) -> None:
        super().__init__("servos", "servo", (), GATE_RATE)
        self._bench = bench
        self._health = health
        self._emergency = stop
        self._limits = TargetLimits(bench.geometry, limits)
        self.reset()

    def reset(self) -> None:
        """Clear targets and causes."""
        self._held: Floats | None = None
        self._moving = np.zeros(1)
        self._cause: Event | None = None
        self._stopped = -1.0
        self._sequence = 0
        self._accepted: Message | None = None
        self._last = self._bench.joint_position()
        #: What each arm may move now, as a multiple of one action at top speed.
        self._left = np.full(len(self._last), BURST)

    def process(self, inputs: Inputs, now: float) -> ServoCommand | None:
        """Send one command; None until there is a target."""
        self._sequence += 1
        stamp = Stamp(now, self._sequence, self.name)
        targets = inputs.boxes["joint_targets"].latest
        cause = self._health.cause(now)
        if self._emergency.pressed:
            cause = Event(now, STOPPED, "emergency stop", self._emergency.reason)
        if cause is None:
            if targets is None or targets.stamp.time <= self._stopped:
                return None if self._cause is None else self._hold(stamp, self._cause)
            if reason := self._refusal(targets, inputs, now):
                cause = Event(now, STOPPED, targets.stamp.source, reason)
        if cause is not None:
            self._stopped = now
            return self._hold(stamp, cause)
        assert isinstance(targets, JointTargets)  # others are refused
        if self._cause is not None:
            self._health.note(now, "resumed", self._cause.stage, "well again")
            self._cause, self._held = None, None
        return self._commanded(targets.joints, stamp, inputs.latest("arms", ArmReading))

    def _commanded(self, joints: Floats, stamp: Stamp, arms: ArmReading) -> ServoCommand:
        """Move the servos towards joint targets, within the speed limits."""
        present = self._bench.joint_position()
        self._last, used = self._limits.slowed(
            joints, present, self._last, arms.jacobian, self._left
        )
        self._left = np.minimum(BURST, self._left - used + 1 / (GATE_RATE * ACTION_DURATION))
        self._bench.command(self._last)
        return ServoCommand(stamp, self._last, False, "")

    def _refusal(self, targets: Message, inputs: Inputs, now: float) -> str:
        """Return why the arms must not move to targets, empty if they may."""
        if not isinstance(targets, JointTargets):
            return f"a {type(targets).__name__} in place of joint targets"
        if not targets.stamp.time <= now:
            return f"joint targets of a measurement at {targets.stamp.time:.3f} s, in the future"
        arms, person = inputs.latest("arms", ArmReading), inputs.find("person", Person)
        if targets is not self._accepted:
            hips = None if person is None else person.hips
            if reason := self._limits.broken(targets.joints, arms, hips):
                return reason
            self._accepted = targets
        if self._limits.too_far(targets.joints, self._bench.joint_position()):
            return "the joints are too far from their targets"
        return self._limits.pressed(arms)

    def _braked(self, held: Floats | None) -> Floats:
        """Return the joint positions to hold.

        The first are the present ones, not the last targets, so that the joints brake at once and
        overshoot a little. Then each joint is held where it turns round, since moving back would
        take twice as long.
        """
        position, velocity = self._bench.joint_position(), self._bench.joint_velocity()
        if held is None:
            self._moving = velocity
            return position
        turned = velocity * self._moving < 0
        self._moving = np.where(turned, 0.0, self._moving)
        return np.where(turned, position, held)

    def _hold(self, stamp: Stamp, cause: Event) -> ServoCommand:
        self._held = self._braked(self._held)
        if self._cause is None or self._cause.stage != cause.stage:
            self._health.note(stamp.time, cause.kind, cause.stage, cause.reason)
        self._cause = cause
        self._bench.command(self._held)
        self._last = self._held
        return ServoCommand(stamp, self._held, True, f"{cause.stage}: {cause.reason}")
