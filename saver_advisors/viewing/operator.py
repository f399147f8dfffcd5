"""What an operator commands: the target of a hand, moved by keys or dragged, becomes actions."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saver_envs.control import shortened
from saver_envs.episodes import Episodes
from saver_envs.validation import require

KEYS: Final = {
    "arrowup": (-1.0, 0.0, 0.0),
    "arrowdown": (1.0, 0.0, 0.0),
    "arrowleft": (0.0, -1.0, 0.0),
    "arrowright": (0.0, 1.0, 0.0),
    "pageup": (0.0, 0.0, 1.0),
    "pagedown": (0.0, 0.0, -1.0),
}
"""Directions of keys in the world frame, as the camera in front of the arms shows them."""

ARRIVED: Final = 1e-4
"""A hand whose set-point is this close to its target (m) is there."""
GRIPPER_ACTIONS: Final = 12
"""Actions for which time runs after a gripper command, until the fingers have moved."""


class Operator:
    """Moves the hand of one arm to a target, at most at top speed.

    :param episodes: one episode, with Cartesian control
    :param arm: which arm
    :raises ValueError: for an arm that there is not, or control of joints
    """

    def __init__(self, episodes: Episodes, arm: int = 0) -> None:
        control = episodes.settings.control
        require("control", control, control == "cartesian", "'cartesian': a hand is moved")
        self._episodes = episodes
        self.arm = arm
        self.begin()

    @property
    def arm(self) -> int:
        """Which arm; another one starts with its target where its hand is."""
        return self._arm

    @arm.setter
    def arm(self, arm: int) -> None:
        arms = self._episodes.task.n_arms
        require("arm", arm, 0 <= arm < arms, f"0 to {arms - 1}")
        self._arm = arm
        self._target = self._set_point()

    def begin(self) -> None:
        """Start an episode: the target is where the hand is, and the gripper stays open."""
        self._target = self._set_point()
        self._open = True
        self._waited_for = 0
        self.finishing = False

    @property
    def target(self) -> NDArray[np.float64]:
        """Where the hand is to go (3,), world frame, metres."""
        points = self._episodes.set_point.copy()
        points[0, self.arm] = self._target
        return np.asarray(self._episodes.scene.to_world(points)[0, self.arm])

    def drag(self, target: ArrayLike) -> None:
        """Set the target; it stays within the workspace.

        :param target: (3,), world frame, metres
        """
        scene, rule = self._episodes.scene, self._episodes.worlds.set_points
        points = scene.to_world(self._episodes.set_point)
        points[0, self.arm] = target
        points = scene.to_bases(points)
        if rule.held_height is not None:
            points[..., 2] = rule.held_height
        self._target = rule.workspace.clip(points)[0, self.arm]

    def press(self, key: str) -> None:
        """Move the target as far as one action moves the hand.

        :param key: one of :data:`KEYS`
        """
        self.drag(self.target + self._longest() * np.array(KEYS[key]))

    def grip(self, is_open: bool) -> None:
        """Open or close the gripper, if there is one."""
        if not self.grips:
            return
        self._open = is_open
        self._waited_for = GRIPPER_ACTIONS

    @property
    def acts(self) -> bool:
        """Whether there is something to do; otherwise time may stand still."""
        away = np.abs(self._target - self._set_point()).max() > ARRIVED
        return bool(away) or self._waited_for > 0 or self.finishing

    def replace(self, actions: NDArray[np.float32]) -> NDArray[np.float32]:
        """Replace the arm's part of an action by the operator's.

        :param actions: (1, action size)
        :return: a copy with the motion to the target, and the gripper command if there is one
        """
        self._waited_for = max(0, self._waited_for - 1)
        motion = (self._target - self._set_point()) / self._longest()
        command = [*shortened(motion, 1.0), *([1.0 if self._open else -1.0] * int(self.grips))]
        blocks = actions.reshape(self._episodes.task.n_arms, -1).copy()
        blocks[self.arm] = command
        return blocks.reshape(actions.shape)

    @property
    def grips(self) -> bool:
        """Whether the arm has a gripper to command."""
        return self._episodes.action_size_per_arm > 3

    def _set_point(self) -> NDArray[np.float64]:
        return self._episodes.set_point[0, self.arm].copy()

    def _longest(self) -> float:
        """Return how far an action moves the hand, metres."""
        return float(np.ravel(self._episodes.worlds.set_points.longest)[0])
