"""A replay buffer with a second one beside it that holds demonstrations.

A fixed share of each batch comes from the demonstrations however few they are, as in RLPD (Ball et
al., arXiv 2302.02948: half and half). They are relabelled in hindsight as all others are.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from saver_advisors.learner.replay import GoalReplayBuffer, GoalTransitions

DEMONSTRATIONS_FILE = "demonstrations.npz"


class DemonstrationReplayBuffer(GoalReplayBuffer):
    """Replay that draws a share of each batch from ``demonstrations``.

    ``add`` and ``size`` are about the student's own transitions; demonstrations are added to
    ``demonstrations``. While either is empty, all of a batch comes from the other.

    :param buffer_size: of the student's own transitions
    :param arguments: as for ``GoalReplayBuffer``
    :param demonstration_size: transitions that ``demonstrations`` keeps
    :param demonstration_fraction: of each batch, in [0, 1)
    :raises ValueError: for a share or sizes that do not fit
    """

    def __init__(
        self,
        buffer_size: int,
        *arguments: Any,
        demonstration_size: int,
        demonstration_fraction: float = 0.5,
        **named: Any,
    ) -> None:
        if not 0.0 <= demonstration_fraction < 1.0:
            raise ValueError(f"demonstration_fraction={demonstration_fraction} must lie in [0, 1)")
        super().__init__(buffer_size, *arguments, **named)
        seed = named.pop("seed", None)
        # A stream of its own: what one buffer draws must not shift what the other will draw.
        own = None if seed is None else int(np.random.SeedSequence([seed, 1]).generate_state(1)[0])
        self.demonstrations = GoalReplayBuffer(demonstration_size, *arguments, seed=own, **named)
        self.demonstration_fraction = demonstration_fraction

    def sample_transitions(
        self, batch_size: int, *, relabel_probability: float | None = None
    ) -> GoalTransitions:
        """Draw transitions from both buffers; slots of demonstrations count on from the own ones.

        :param batch_size: transitions to draw, with replacement
        :param relabel_probability: another one than the buffers' own
        :return: the transitions, the student's own first
        :raises ValueError: when both are empty, or there is no reward function
        """
        shown = self._shown(batch_size)
        # May have been set, or replaced, since.
        self.demonstrations.reward_function = self.reward_function
        if shown == 0:
            return super().sample_transitions(batch_size, relabel_probability=relabel_probability)
        demonstrated = self.demonstrations.sample_transitions(
            shown, relabel_probability=relabel_probability
        )
        demonstrated.slot[:] += self.n_slots
        if shown == batch_size:
            return demonstrated
        own = super().sample_transitions(
            batch_size - shown, relabel_probability=relabel_probability
        )
        names = [field.name for field in fields(GoalTransitions)]
        return GoalTransitions(
            **{n: np.concatenate((getattr(own, n), getattr(demonstrated, n))) for n in names}
        )

    def _shown(self, batch_size: int) -> int:
        """How many of a batch are demonstrations."""
        if self.demonstrations.size() == 0:
            return 0
        if self.size() == 0:
            return batch_size
        return round(self.demonstration_fraction * batch_size)

    def end_running_episodes(self) -> None:
        """Cut the running episodes of both buffers short."""
        super().end_running_episodes()
        self.demonstrations.end_running_episodes()

    def save_npz(self, path: str | Path) -> None:
        """Write both buffers, the demonstrations to ``demonstrations.npz`` in the same folder.

        :param path: of the student's own transitions
        :raises OSError: when one cannot be written
        """
        super().save_npz(path)
        self.demonstrations.save_npz(Path(path).with_name(DEMONSTRATIONS_FILE))

    def load_npz(self, path: str | Path) -> None:
        """Take over both buffers written by ``save_npz``.

        :param path: of the student's own transitions
        :raises FileNotFoundError: when one of the files is missing
        :raises ValueError: when one is damaged, foreign, or of another shape
        """
        super().load_npz(path)
        self.demonstrations.load_npz(Path(path).with_name(DEMONSTRATIONS_FILE))
