"""A policy under a condition: what it plays, and why its trials fail."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from reproduction.transfer.conditions import TRAINED_ON, Condition
from reproduction.transfer.failures import Failure, pick_failure, push_failure
from reproduction.transfer.trajectories import FrameCallback, Trajectory, run_trials
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
class Entrant:
    """A policy to try.

    :param label: what tables call it
    :param policy: a word that ``saver evaluate`` takes
    """

    label: str
    policy: str


@dataclass(frozen=True)
class Attempt:
    """One policy under one condition.

    :param task: ``push`` or ``pick``
    :param condition: the condition
    :param entrant: the policy
    """

    task: str
    condition: Condition
    entrant: Entrant

    @property
    def env_id(self) -> str:
        """Where it takes place."""
        return ENVIRONMENTS[self.task, self.condition.robot]

    def play(
        self, trials: int, seed: int, frame_callback: FrameCallback | None = None
    ) -> list[Trajectory]:
        """Play it; the same arguments play the same trials."""
        condition = self.condition
        # Anew each time: an expert keeps the plans of the episodes that it has seen.
        policy = resolve(self.entrant.policy, self.env_id, condition.options, seed)
        # The expert was written for whatever hand it finds.
        known = condition.translated and self.entrant.policy != EXPERT
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

    def failure(self, trial: Trajectory) -> Failure | None:
        """Why a trial failed, None where it succeeded."""
        return (push_failure if self.task == "push" else pick_failure)(trial)


def by_kind(
    found: Sequence[tuple[Attempt, Sequence[Trajectory], Sequence[Failure | None]]],
) -> Iterator[tuple[str, int, int]]:
    """The first trial of each task that succeeded, and the first of each cause.

    Conditions in which more differs are looked at first, since the table is about them, and the
    policies of a condition in their order; the scripted expert is left out.

    :param found: attempts with their trials and failures
    :return: ``success`` or a cause, the attempt's place in ``found``, and the trial's number
    """
    conditions = list(dict.fromkeys((one.task, one.condition.name) for one, _, _ in found))
    seen = set()
    # Sorting is stable: within a condition policies stay in order.
    places = sorted(
        range(len(found)),
        key=lambda place: -conditions.index((found[place][0].task, found[place][0].condition.name)),
    )
    for place in places:
        attempt, _, failures = found[place]
        if attempt.entrant.policy == EXPERT:
            continue
        for number, failure in enumerate(failures):
            kind = "success" if failure is None else failure.cause
            if (attempt.task, kind) not in seen:
                seen.add((attempt.task, kind))
                yield kind, place, number
