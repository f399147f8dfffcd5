"""Pick and place: carry each cube to its target on the table or in the air."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from saver_envs.robots.description import Fingers
from saver_envs.tasks.sampling import CONTESTED_SHARE, StartRules
from saver_envs.tasks.table import TableTask

#: Half of the targets are in the air, up to this height (m).
AIR_SHARE, AIR_HEIGHT = 0.5, 0.25
#: Heights at which hands start (m): above the cubes, fingers open.
HAND_HEIGHT = (0.05, 0.20)


@dataclass(frozen=True)
class CarryTask(TableTask):
    """Hands open and close; height is part of the action (chapter 5).

    :param in_hand_probability: that an arm starts with its cube in hand, for training.
    """

    in_hand_probability: float = 0.0

    fingers: ClassVar[Fingers] = Fingers.ACTUATED

    def start_rules(self) -> StartRules:
        """Return the rules of a start: hands above the table, half of the targets in the air."""
        return self.rules(hand_height=HAND_HEIGHT, air_share=AIR_SHARE, air_height=AIR_HEIGHT)


@dataclass(frozen=True)
class PickAndPlace(CarryTask):
    """Cubes to targets on the table or in the air.

    :param contested_share: share of the episodes of several arms in which the ways of two hands
        meet.
    """

    contested_share: float = CONTESTED_SHARE

    name: ClassVar[str] = "pick-and-place"
    expert: ClassVar[str | None] = "saver_envs.experts.pick:expert"
