"""Play the trials of a policy under a condition, and find the causes of their failures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from reproduction.transfer.conditions import TRAINED_ON, Condition
from reproduction.transfer.failures import Failure
from reproduction.transfer.trajectories import FrameCallback, TrialTrajectory, run_trials
from saver_advisors.cli.policies import resolve
from saver_envs.robots import ROBOTS

ENVIRONMENTS: Final = {
    ("push", "jaco"): "DualJacoPush-v0",
    ("push", "mico"): "DualMicoPush-v0",
    ("pick", "jaco"): "DualJacoPickAndPlace-v0",
    ("pick", "mico"): "DualMicoPickAndPlace-v0",
}
STUDENTS: Final = {
    "push": "dual-jaco-push-advised",
    "pick": "dual-jaco-pick-and-place-advised",
}
TEACHERS: Final = {"push": "jaco-push", "pick": "jaco-pick-and-place"}
TITLES: Final = {"push": "Push", "pick": "Pick and place"}
EXPERT: Final = "expert"


@dataclass(frozen=True)
class Attempt:
    """One policy under one condition.

    :param task: ``push`` or ``pick``.
    :param condition: the condition.
    :param label: the policy's name in tables.
    :param policy: a policy as in ``saver evaluate``.
    """

    task: str
    condition: Condition
    label: str
    policy: str

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        return ENVIRONMENTS[self.task, self.condition.robot]

    def play(
        self, trials: int, seed: int, frame_callback: FrameCallback | None = None
    ) -> list[TrialTrajectory]:
        """Play trials; the same arguments play the same trials.

        :param trials: number of trials.
        :param seed: seed of trial 0.
        :param frame_callback: see `FrameCallback`.
        :return: one trajectory per trial.
        """
        condition = self.condition
        # A new policy each time, since an expert keeps the plans of past episodes.
        policy = resolve(self.policy, self.env_id, condition.options, seed)
        # The expert works with the hand of any robot.
        known = condition.translated and self.policy != EXPERT
        return run_trials(
            policy.predict,
            self.env_id,
            trials,
            seed=seed,
            env_kwargs=condition.options,
            noise=condition.noise,
            hand=ROBOTS[TRAINED_ON] if known else None,
            frame_callback=frame_callback,
        )


Played = tuple[Attempt, Sequence[TrialTrajectory], Sequence[Failure | None]]
"""An attempt with its trials, and why each failed (None: it succeeded)."""


def by_kind(found: Sequence[Played]) -> Iterator[tuple[str, int, int]]:
    """Find the first successful trial of each task, and the first of each cause of failure.

    Conditions with more differences come first, since the table is about them, and the policies of
    a condition in their order. The scripted expert is left out.

    :param found: attempts with their trials and failures.
    :return: ``success`` or a cause, the attempt's index in ``found``, and the trial's index.
    """
    names = [(one.task, one.condition.name) for one, _, _ in found]
    conditions = list(dict.fromkeys(names))
    seen = set()
    # Sorting is stable: the policies of a condition keep their order.
    for place in sorted(range(len(found)), key=lambda place: -conditions.index(names[place])):
        attempt, _, failures = found[place]
        if attempt.policy == EXPERT:
            continue
        for number, failure in enumerate(failures):
            kind = "success" if failure is None else failure.cause
            if (attempt.task, kind) not in seen:
                seen.add((attempt.task, kind))
                yield kind, place, number
