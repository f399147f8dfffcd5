"""Safety functions: limits of every set-point, and a latching emergency stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from saver_advisors.integration.casualty import TASK
from saver_advisors.integration.messages import Floats
from saver_envs.control import SetPointRule, Workspace
from saver_envs.episodes import ACTION_DURATION, RATED_SPEED

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

    max_speed: float = RATED_SPEED
    torso_force: float = TORSO_FORCE
    hand_force: float = HAND_FORCE
    clearance: float = CLEARANCE

    def __post_init__(self) -> None:
        for name in ("max_speed", "torso_force", "hand_force"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(f"{name}={value!r}: must be above 0")
        if not 0 <= self.clearance < np.inf:
            raise ValueError(f"clearance={self.clearance!r}: must be 0 m or more")

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
        free: Floats = np.clip((1 - used) / (1 - YIELDING), 0.0, 1.0)
        return free


def limited_set_point(
    previous: Floats,
    motion: Floats,
    tool: Floats,
    limits: SafetyLimits,
    workspace: Workspace,
    held_height: float | None,
    freedom: Floats,
) -> tuple[Floats, set[str]]:
    """Move set-points by an action, within the limits.

    Without contact forces this equals the environments' rule.

    :param previous: (arms, 3) last set-points, metres, base frames.
    :param motion: (arms, 3) displacement as a fraction of the longest.
    :param tool: (arms, 3) positions of the tools, metres.
    :param limits: gives the longest displacement.
    :param workspace: region of the set-points.
    :param held_height: constant height of the set-points (m), or None.
    :param freedom: (arms,) factor of the set-point lead limit.
    :return: (arms, 3) new set-points, and the names of the limits that changed them.
    """
    rule = SetPointRule(workspace, limits.longest, held_height)
    moved = rule.unclipped(previous, motion, tool, freedom[:, None])
    inside = workspace.clip(moved)
    applied = {
        "force": bool((freedom < 1).any()),
        "workspace": bool((np.abs(inside - moved) > 1e-9).any()),
    }
    return inside, {name for name, changed in applied.items() if changed}


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
