"""Pick and place: carry each cube to its target on the table or in the air."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from saver_envs.robots.description import Fingers
from saver_envs.tasks.base import Task
from saver_envs.tasks.sampling import StartRules

#: Half of the targets are in the air, up to this height (m).
AIR_SHARE, AIR_HEIGHT = 0.5, 0.25
#: Heights at which hands start (m): above the cubes, fingers open.
HAND_HEIGHT = (0.05, 0.20)


@dataclass(frozen=True)
class PickAndPlace(Task):
    """Hands open and close; height is part of the action (chapter 5)."""

    name: ClassVar[str] = "pick-and-place"
    fingers: ClassVar[Fingers] = Fingers.ACTUATED

    def start_rules(self, object_rest_height: float) -> StartRules:
        """Return the rules of a start; see :meth:`Task.start_rules`."""
        return StartRules(
            hand_height=HAND_HEIGHT,
            air_share=AIR_SHARE,
            air_height=AIR_HEIGHT,
            success_threshold=self.success_threshold,
            pushes=False,
            contested_share=self.contested_share,
        )
