"""Play the trials of a policy under a condition, and find the causes of their failures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from reproduction.transfer.conditions import TRAINED_ON, Condition
from reproduction.transfer.failures import Failure, pick_failure, push_failure
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
class Entrant:
    """A policy to try.

    :param label: its name in tables.
    :param policy: a policy as in ``saver evaluate``.
    """

    label: str
    policy: str


@dataclass(frozen=True)
class Attempt:
    """One policy under one condition.

    :param task: ``push`` or ``pick``.
    :param condition: the condition.
    :param entrant: the policy.
    """

    task: str
    condition: Condition
    entrant: Entrant

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
        predict = resolve(self.entrant.policy, self.env_id, condition.options, seed)
        # The expert works with the hand of any robot.
        known = condition.translated and self.entrant.policy != EXPERT
        return run_trials(
            predict,
            self.env_id,
            trials,
            seed=seed,
            env_kwargs=condition.options,
            noise=condition.noise,
            hand=ROBOTS[TRAINED_ON] if known else None,
            frame_callback=frame_callback,
        )

    def failure(self, trial: TrialTrajectory) -> Failure | None:
        """Return why a trial failed, None if it succeeded."""
        return (push_failure if self.task == "push" else pick_failure)(trial)


def by_kind(
    found: Sequence[tuple[Attempt, Sequence[TrialTrajectory], Sequence[Failure | None]]],
) -> Iterator[tuple[str, int, int]]:
    """Find the first successful trial of each task, and the first of each cause of failure.

    Conditions with more differences come first, since the table is about them, and the policies of
    a condition in their order. The scripted expert is left out.

    :param found: attempts with their trials and failures.
    :return: ``success`` or a cause, the attempt's index in ``found``, and the trial's index.
    """
    conditions = list(dict.fromkeys((one.task, one.condition.name) for one, _, _ in found))
    seen = set()
    # Sorting is stable: the policies of a condition keep their order.
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
