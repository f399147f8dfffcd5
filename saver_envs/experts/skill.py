"""What an arm's skill offers to the coordination of several arms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from saver_envs.episodes import DEFAULT_SPEED, Settings
from saver_envs.experts.blocks import ArmView
from saver_envs.experts.geometry import FloatArray
from saver_envs.simulation import ACTION_DURATION


@dataclass(frozen=True)
class Skill:
    """What one arm can do by itself; leading dimensions (n, arms).

    :param step: longest displacement of an action, metres.
    """

    #: Whether a free arm that serves all cubes serves its own last; its target may be in the air,
    #: where it must be held.
    own_last: ClassVar[bool] = False
    #: Whether hands pass beside cubes; else they pass over them.
    low: ClassVar[bool] = False

    step: float = DEFAULT_SPEED * ACTION_DURATION

    def fitted(self, settings: Settings) -> Self:
        """Return the skill of an arm with these settings."""
        return replace(self, step=settings.max_speed * ACTION_DURATION)

    def ring(self, size: FloatArray) -> FloatArray:
        """Return the radii around cubes of edges ``size`` on which a low hand touches none, m."""
        raise NotImplementedError

    def actions(
        self, view: ArmView, side: FloatArray | None = None, others: FloatArray | None = None
    ) -> FloatArray:
        """Return the actions of arms that ignore one another."""
        raise NotImplementedError

    def imagine(self, view: ArmView, actions: FloatArray, base: FloatArray) -> ArmView:
        """Predict what the arms see after these actions."""
        raise NotImplementedError

    def finished(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which arms are done."""
        raise NotImplementedError

    def keeps(self, view: ArmView) -> NDArray[np.bool_]:
        """Return which arms that were done can take their object back to its target."""
        return np.zeros(view.tool.shape[:-1], dtype=bool)

    def places(self, view: ArmView) -> tuple[FloatArray, ...]:
        """Return places (n, arms, 2 or 3) that the hands still have to visit, base frames."""
        return view.object, view.target

    def give_way(self, view: ArmView, action: FloatArray, turned: NDArray[np.bool_]) -> FloatArray:
        """Return actions of which those of arms (n, arms) that are ``turned`` away are adapted.

        By default none are: a low closed hand needs no adaptation.
        """
        return action
