"""Push: slide each cube across the table to its target with a closed hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from saver_envs.robots.description import Fingers
from saver_envs.tasks.sampling import CONTESTED_SHARE, StartRules
from saver_envs.tasks.table import TableTask

#: Height of the tool above the table while pushing (m): the fingers meet the cube below its top.
PUSH_HEIGHT = 0.025


@dataclass(frozen=True)
class Push(TableTask):
    """Cubes on the table, hands closed and held at pushing height (chapter 5).

    :param contested_share: share of the episodes of several arms in which the ways of two hands
        meet.
    """

    contested_share: float = CONTESTED_SHARE

    name: ClassVar[str] = "push"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    held_height: ClassVar[float | None] = PUSH_HEIGHT
    expert: ClassVar[str | None] = "saver_envs.experts.push:expert"

    def start_rules(self) -> StartRules:
        """Return the rules of a start: hands low, targets on the table, room to push."""
        height = (PUSH_HEIGHT, PUSH_HEIGHT)
        return self.rules(hand_height=height, air_height=self.object_size / 2, pushes=True)
