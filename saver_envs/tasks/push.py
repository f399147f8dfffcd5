"""Push: slide each cube across the table to its target with a closed hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from saver_envs.robots.description import Fingers
from saver_envs.tasks.base import Task
from saver_envs.tasks.sampling import StartRules

#: Height of the tool above the table while pushing (m): the fingers meet the cube below its top.
PUSH_HEIGHT = 0.025


@dataclass(frozen=True)
class Push(Task):
    """Both objects on the table, hands closed and held at pushing height (chapter 5)."""

    name: ClassVar[str] = "push"
    fingers: ClassVar[Fingers] = Fingers.LOCKED
    held_height: ClassVar[float | None] = PUSH_HEIGHT

    def start_rules(self, object_rest_height: float) -> StartRules:
        """Return the rules of a start; see :meth:`Task.start_rules`."""
        return StartRules(
            hand_height=(PUSH_HEIGHT, PUSH_HEIGHT),
            air_share=0.0,
            air_height=object_rest_height,
            success_threshold=self.success_threshold,
            pushes=True,
            contested_share=self.contested_share,
        )
