"""Safety functions: limits of every set-point, and a latching emergency stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from saver_advisors.integration.bench import BenchGeometry
from saver_advisors.integration.casualty import TASK
from saver_advisors.integration.messages import ArmReading, Floats
from saver_envs.control import LEAD_LIMIT, bounded
from saver_envs.episodes import RATED_SPEED
from saver_envs.simulation import ACTION_DURATION
from saver_envs.validation import NonNegativeFloat, PositiveFloat, check_fields

#: Limit of the contact force at a hand of the robot (N), less than half of the quasi-static limit
#: of ISO/TS 15066 for a person's lower arm, which is 160 N.
HAND_FORCE: Final = 70.0
#: Limit of the contact force at the torso (N), at which set-points are back at the tools. Servos
#: keep pressing for a tenth of a second after that: half of the harmful force keeps peaks below it.
TORSO_FORCE: Final = TASK.torso_force_limit / 2
#: Fraction of a force limit at which the set-point lead limit starts to shrink.
YIELDING: Final = 0.5
#: Lateral distance of the set-points from the hip joints (m): the target's distance and half of a
#: finger's thickness, so that the hand's inner side keeps the distance of SPEC 5.5.
CLEARANCE: Final = TASK.standoff + 0.02
#: Limit of a joint's speed, as a multiple of the rated one: a folded MICO needs 2.5 times that of
#: its third joint for the rated tool speed.
JOINT_EXCESS: Final = 3.0
#: What a tool that has rested may move at once, as a multiple of one action at top speed: the
#: kinematics' errors let a tool catch up.
BURST: Final = 1.4
#: Force, as a multiple of its limit, at which the arms hold still instead of yielding.
FORCE_EXCESS: Final = 2.0
#: Allowed error of the tool positions that are predicted from joint targets (m).
_PREDICTION_ERROR: Final = 0.001


@dataclass(frozen=True)
class SafetyLimits:
    """Limit set-points, whatever the policy's action.

    :param max_speed: top speed of a set-point, m/s.
    :param torso_force: contact force at the torso, newtons.
    :param hand_force: contact force at a hand, newtons.
    :param clearance: lateral distance of a set-point from the hip joint on its side, metres; 0 for
        no limit.
    :raises ValueError: for an invalid limit.
    """

    max_speed: PositiveFloat = RATED_SPEED
    torso_force: PositiveFloat = TORSO_FORCE
    hand_force: PositiveFloat = HAND_FORCE
    clearance: NonNegativeFloat = CLEARANCE

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def longest(self) -> float:
        """The longest displacement of a set-point in one action, metres."""
        return self.max_speed * ACTION_DURATION

    def freedom(self, hand_force: Floats, torso_force: float) -> Floats:
        """Return the factor by which forces scale the set-point lead limit.

        A servo's force grows with the distance to its target, so the lead bounds contact forces.

        :param hand_force: (arms,) newtons.
        :param torso_force: newtons, of all arms together.
        :return: (arms,) from 1, far from the limits, to 0 at a limit.
        """
        used = np.maximum(hand_force / self.hand_force, torso_force / self.torso_force)
        return np.clip((1 - used) / (1 - YIELDING), 0.0, 1.0)


def kept_clear(
    position: Floats, hips: Floats, base_position: Floats, clearance: float
) -> tuple[Floats, bool]:
    """Keep set-points on the outer side of a person's hips.

    :param position: (arms, 3) metres, base frames without yaw.
    :param hips: (arms, 3) metres, bench frame, one on the side of each arm.
    :param base_position: (arms, 3) metres.
    :param clearance: lateral distance, metres.
    :return: (arms, 3), and whether any set-point has changed.
    """
    lateral = position[:, 1]
    side = np.sign(hips[:, 1] - hips[:, 1].mean())
    wall = hips[:, 1] + side * clearance - base_position[:, 1]
    kept = np.where(side > 0, np.maximum(lateral, wall), lateral)
    kept = np.where(side < 0, np.minimum(kept, wall), kept)
    result = position.copy()
    result[:, 1] = kept
    return result, bool((kept != lateral).any())


class TargetLimits:
    """Check joint targets and the arms' motion against the limits, whoever computed the targets.

    :param geometry: of the bench.
    :param limits: of speed, force and clearance.
    """

    def __init__(self, geometry: BenchGeometry, limits: SafetyLimits) -> None:
        self._geometry, self._limits = geometry, limits
        # Joints may exceed their rated speed by the same factor as the tool.
        factor = JOINT_EXCESS * limits.max_speed / RATED_SPEED
        #: What each joint may turn in one action at most, (dof,) radians.
        self._travel = np.asarray(geometry.robot.joint_speed_limits) * ACTION_DURATION * factor
        self._shape = len(geometry.base_position), len(self._travel)

    def broken(self, targets: Floats, arms: ArmReading, hips: Floats | None) -> str:
        """Return why joint targets must not reach the servos, empty if they may.

        The Jacobian predicts where they lead the tools; that must be a set-point within the limits.

        :param targets: (arms, dof) radians.
        :param arms: newest reading.
        :param hips: (arms, 3) hip joints of the person, metres, or None without a person.
        """
        robot, limits = self._geometry.robot, self._limits
        if targets.shape != self._shape or not np.isfinite(targets).all():
            return f"joint targets of shape {targets.shape}: must be {self._shape}, all finite"
        if ((targets < robot.joint_lower) | (targets > robot.joint_upper)).any():
            return "a joint target is beyond the joint limits"
        step = targets - arms.joint_position
        if self.too_far(targets, arms.joint_position):
            return (
                f"a joint target is {np.abs(step).max():.2f} rad away, out of reach of one action"
            )
        tool = arms.tool_position
        point = tool + (arms.jacobian[:, :3] @ step[..., None])[..., 0]
        start = self._allowed(tool, hips)
        strayed = np.linalg.norm(self._allowed(point, hips) - point, axis=-1)
        if (strayed > _PREDICTION_ERROR + np.linalg.norm(start - tool, axis=-1)).any():
            return "the joint targets lead a tool out of its workspace or too near to the hips"
        # At a held height, the set-point rule limits the level part of the lead alone.
        axes = slice(3 if self._geometry.held_height is None else 2)
        lead = np.linalg.norm((point - start)[:, axes], axis=-1)
        free = limits.freedom(arms.hand_force, arms.torso_force)
        if (lead > LEAD_LIMIT * limits.longest * free + _PREDICTION_ERROR).any():
            return f"the joint targets lead a tool by {lead.max():.3f} m, too far for its force"
        return ""

    def too_far(self, targets: Floats, present: Floats) -> bool:
        """Return whether a target (arms, dof) leads its joint by more than the lead limit."""
        return not (np.abs(targets - present) <= LEAD_LIMIT * self._travel).all()

    def pressed(self, arms: ArmReading) -> str:
        """Return which force is so high that yielding does not suffice, empty for none."""
        limits = self._limits
        if arms.torso_force > FORCE_EXCESS * limits.torso_force:
            return f"the trunk is pressed with {arms.torso_force:.0f} N"
        if (arms.hand_force > FORCE_EXCESS * limits.hand_force).any():
            return f"a hand presses with {arms.hand_force.max():.0f} N"
        return ""

    def slowed(
        self, targets: Floats, present: Floats, last: Floats, jacobian: Floats, left: Floats
    ) -> tuple[Floats, Floats]:
        """Return the part of the way to joint targets that the speed limits allow.

        Only a motion beyond the last command counts, since moving a target back to its joint slows
        the arm down.

        :param targets: (arms, dof) radians.
        :param present: (arms, dof) joint positions.
        :param last: (arms, dof) the last command.
        :param jacobian: (arms, 6, dof) of the tools.
        :param left: (arms,) what the arms may move, as a multiple of one action at top speed.
        :return: the command, and the multiple (arms,) that it uses.
        """
        kept = bounded(targets, np.minimum(present, last), np.maximum(present, last))
        beyond = targets - kept
        tool = np.linalg.norm((jacobian[:, :3] @ beyond[..., None])[..., 0], axis=-1)
        turned = (np.abs(beyond) / self._travel).max(axis=-1)
        needed = np.maximum(tool / self._limits.longest, turned)
        share = np.minimum(1.0, left / np.maximum(needed, 1e-12))[:, None]
        return np.where(share < 1, kept + share * beyond, targets), np.minimum(needed, left)

    def _allowed(self, points: Floats, hips: Floats | None) -> Floats:
        """Return the nearest allowed set-points to points (arms, 3), metres."""
        geometry = self._geometry
        if self._limits.clearance and hips is not None:
            points, _ = kept_clear(points, hips, geometry.base_position, self._limits.clearance)
        return geometry.workspace.clip(points)


@dataclass
class EmergencyStop:
    """A stop button that latches until it is released.

    :param reason: why it is pressed, empty while it is not.
    """

    reason: str = ""

    @property
    def pressed(self) -> bool:
        """Whether the button is pressed."""
        return bool(self.reason)

    def press(self, reason: str = "pressed") -> None:
        """Stop the arms until :meth:`release`; the first reason is kept.

        :param reason: why, for the log.
        :raises ValueError: for an empty reason.
        """
        if not reason:
            raise ValueError("reason='': must not be empty")
        self.reason = self.reason or reason

    def release(self) -> None:
        """Let the arms move again."""
        self.reason = ""
