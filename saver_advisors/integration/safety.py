"""Safety below the policy: limits on every set-point, and the stop that latches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from saver_advisors.integration.messages import Floats
from saver_envs.control import Workspace
from saver_envs.episodes import ACTION_DURATION, LEASH, RATED_SPEED, shortened
from saver_envs.tasks.wrist_push import FORCE_LIMIT, STANDOFF

#: What may press against a hand of the robot (N): the quasi-static limit of ISO/TS 15066 for a
#: person's lower arm is 160 N, of which we take less than half.
HAND_FORCE: Final = 70.0
#: What may press on the trunk (N), at which set-points have come back to the tools. Servos press on
#: for a tenth of a second after that: with half of what counts as harm, peaks stay below it.
TORSO_FORCE: Final = FORCE_LIMIT / 2
#: From this share of a limit on, set-points are drawn nearer to the tools.
YIELDING: Final = 0.5
#: Lateral distance of the set-points from the hip joints (m): motion stops 15 cm from the body
#: (SPEC 5.5), and half of a finger's thickness more, so that this holds for the hand's inner side.
CLEARANCE: Final = STANDOFF + 0.02


@dataclass(frozen=True)
class Limits:
    """What set-points keep to, whatever the policy asks for.

    :param max_speed: of a set-point, m/s
    :param torso_force: newtons
    :param hand_force: newtons
    :param clearance: lateral distance of a set-point from the hip joint of its side, metres;
        0 for none
    :raises ValueError: for a limit that cannot be
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
        """The longest way of a set-point in one action, metres."""
        return self.max_speed * ACTION_DURATION

    def freedom(self, hand_force: Floats, torso_force: float) -> Floats:
        """The share of the leash that forces leave.

        A servo presses the harder the further its target is ahead, so this is what bounds forces.

        :param hand_force: (arms,) newtons
        :param torso_force: newtons, of all arms together
        :return: (arms,) from 1, far from the limits, to 0 at a limit
        """
        used = np.maximum(hand_force / self.hand_force, torso_force / self.torso_force)
        free: Floats = np.clip((1 - used) / (1 - YIELDING), 0.0, 1.0)
        return free


@dataclass(frozen=True)
class Limited:
    """A set-point and what has changed it.

    :param position: (arms, 3) metres, base frames
    :param by: names of the limits that mattered
    """

    position: Floats
    by: tuple[str, ...]


def limited_set_point(
    previous: Floats,
    motion: Floats,
    tool: Floats,
    limits: Limits,
    workspace: Workspace,
    held_height: float | None,
    freedom: Floats,
) -> Limited:
    """Move set-points as an action asks, as far as limits allow.

    Away from forces this is what the environments do with an action.

    :param previous: (arms, 3) set-points so far, metres, base frames
    :param motion: (arms, 3) displacement in shares of the longest
    :param tool: (arms, 3) where the tools are
    :param limits: of speed
    :param workspace: where set-points may be
    :param held_height: of all set-points, or None
    :param freedom: (arms,) share of the leash
    :return: the new set-points
    """
    longest = limits.longest
    wanted = previous + shortened(motion * longest, longest)
    leash = LEASH * longest * freedom
    ahead = wanted - tool
    length = np.sqrt((ahead * ahead).sum(axis=-1, keepdims=True))
    moved = tool + ahead * np.minimum(1.0, leash[:, None] / np.maximum(length, 1e-12))
    if held_height is not None:
        moved[..., 2] = held_height
    inside = workspace.clip(moved)
    by = (
        *(("force",) if (freedom < 1).any() else ()),
        *(("workspace",) if (np.abs(inside - moved) > 1e-9).any() else ()),
    )
    return Limited(inside, by)


def kept_clear(
    position: Floats, hips: Floats, base_position: Floats, clearance: float
) -> tuple[Floats, bool]:
    """Keep set-points on the outer side of a person's hips.

    :param position: (arms, 3) metres, base frames without yaw
    :param hips: (arms, 3) metres, bench frame, one on the side of each arm
    :param base_position: (arms, 3) metres
    :param clearance: lateral distance, metres
    :return: (arms, 3), and whether anything has changed
    """
    middle = hips[:, 1].mean()
    side = np.sign(hips[:, 1] - middle)
    wall = hips[:, 1] + side * clearance - base_position[:, 1]
    lateral = np.where(side > 0, np.maximum(position[:, 1], wall), position[:, 1])
    lateral = np.where(side < 0, np.minimum(lateral, wall), lateral)
    changed = bool((lateral != position[:, 1]).any())
    result = position.copy()
    result[:, 1] = lateral
    return result, changed


class EmergencyStop:
    """A button that stays pressed until it is released."""

    def __init__(self) -> None:
        self._reason = ""

    @property
    def pressed(self) -> bool:
        """Whether it is."""
        return bool(self._reason)

    @property
    def reason(self) -> str:
        """Why, empty where it is not pressed."""
        return self._reason

    def press(self, reason: str = "pressed") -> None:
        """Stop the arms until :meth:`release`; the first reason stays.

        :raises ValueError: for an empty reason
        """
        if not reason:
            raise ValueError("reason='': must say why")
        self._reason = self._reason or reason

    def release(self) -> None:
        """Let the arms go on."""
        self._reason = ""
