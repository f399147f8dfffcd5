"""Define the conditions of the trials, and play the trials of a policy under one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

from reproduction.transfer.failures import Failure
from reproduction.transfer.trajectories import FrameCallback, TrialTrajectory, run_trials
from saver_advisors.cli.policies import options_that_fit, resolve
from saver_advisors.evaluation.episodes import Predict
from saver_envs.robots import ROBOTS

ENVIRONMENTS: Final = {
    ("push", "jaco"): "DualJacoPush-v0",
    ("push", "mico"): "DualMicoPush-v0",
    ("pick", "jaco"): "DualJacoPickAndPlace-v0",
    ("pick", "mico"): "DualMicoPickAndPlace-v0",
}
TITLES: Final = {"push": "Push", "pick": "Pick and place"}
EXPERT: Final = "expert"


OBJECT_SIZE: Final = 0.09
"""Edge of the cube in the dissertation's physical push runs (m); 5.6 cm in training."""
FRICTION: Final = 0.35
"""Friction of a smooth box on a smooth table; 0.5 in training. With less, objects slide further."""
MASS: Final = 0.4
"""Kilograms, twice that of training: a filled box instead of an empty one."""
DAMPING: Final = 1.0
"""N s/m; 0 in training. At the hand's top speed of 0.5 m/s the drag is half the friction of a
training cube, and a third of that of a cube with the two figures above.
"""

TRAINED_ON: Final = "jaco"
"""The robot that the policies were trained with."""


@dataclass(frozen=True)
class Condition:
    """One condition in which policies are tried.

    :param name: its name in tables and on the command line.
    :param words: the differences in words.
    :param robot: name of the arm.
    :param randomization: value of each parameter that differs from training.
    :param translated: whether finger readings are translated to those of the trained hand.
    :param expert: whether to try the scripted expert, which is slow, as well.
    """

    name: str
    words: str
    robot: str = "mico"
    randomization: dict[str, float] = field(default_factory=dict)
    translated: bool = True
    expert: bool = False


CHANGES: Final[Mapping[str, tuple[str, dict[str, float]]]] = {
    "size": (f"{100 * OBJECT_SIZE:g} cm cubes", {"object_size": OBJECT_SIZE}),
    "friction": (f"friction {FRICTION:g}", {"object_friction": FRICTION}),
    "mass": (f"mass {MASS:g} kg", {"object_mass": MASS}),
    "damping": (f"damping {DAMPING:g} N s/m", {"object_damping": DAMPING}),
    "noise": ("sensor noise", {"sensor_noise": 1.0}),
}
"""Differences from training by name, in words and as values of parameters."""


def conditions(task: str) -> tuple[Condition, ...]:
    """List the conditions of a task, from those of training to all differences together.

    :param task: ``push`` or ``pick``.
    :return: the conditions; the last one is compared with the dissertation's table.
    """
    but_size = [name for name in CHANGES if name != "size"]
    if task == "push":
        changed = [("all-but-size", but_size), ("all", list(CHANGES))]
    else:
        changed = [("all", but_size)]
    return (
        Condition("home", "two Jacos, as trained", robot=TRAINED_ON),
        Condition("raw", "two MICOs, finger readings untranslated", translated=False),
        Condition("mico", "two MICOs", expert=True),
        *(_changed(name, [name]) for name in changed[-1][1]),
        *(_changed(name, names, expert=True) for name, names in changed),
    )


def _changed(name: str, changes: Sequence[str], expert: bool = False) -> Condition:
    words = ", ".join(CHANGES[one][0] for one in changes)
    randomization = {key: value for one in changes for key, value in CHANGES[one][1].items()}
    return Condition(name, words, randomization=randomization, expert=expert)


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

    def predict(self, seed: int = 0) -> Predict:
        """Resolve the policy anew, since an expert keeps the plans of past episodes.

        :param seed: of a random policy.
        :return: batched observation (n, size) -> actions (n, action_size).
        :raises UsageError: for an unknown policy, or one that does not fit the environment.
        """
        return resolve(self.policy, self.env_id, self.options, seed)

    @cached_property
    def options(self) -> dict[str, Any]:
        """Keyword arguments of the environment, with what the policy observes."""
        world = {"randomization": self.condition.randomization}
        return options_that_fit(self.policy, self.env_id, world)

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
        # The expert works with the hand of any robot.
        known = condition.translated and self.policy != EXPERT
        return run_trials(
            self.predict(seed),
            self.env_id,
            trials,
            seed=seed,
            env_kwargs=self.options,
            hand=ROBOTS[TRAINED_ON] if known else None,
            frame_callback=frame_callback,
        )


Played = tuple[Attempt, Sequence[TrialTrajectory], Sequence[Failure | None]]
"""An attempt with its trials, and why each failed (None: it succeeded)."""


def by_kind(found: Sequence[Played]) -> list[tuple[str, int, int]]:
    """Find the first successful trial of each task, and the first of each cause of failure.

    Conditions with more differences come first, since the table is about them, and the policies of
    a condition in their order. The scripted expert is left out.

    :param found: attempts with their trials and failures.
    :return: ``success`` or a cause, the attempt's index in ``found``, and the trial's index.
    """
    names = [(one.task, one.condition.name) for one, _, _ in found]
    conditions = list(dict.fromkeys(names))
    first: dict[tuple[str, str], tuple[int, int]] = {}
    # Sorting is stable: the policies of a condition keep their order.
    for place in sorted(range(len(found)), key=lambda place: -conditions.index(names[place])):
        attempt, _, failures = found[place]
        if attempt.policy == EXPERT:
            continue
        for number, failure in enumerate(failures):
            kind = "success" if failure is None else failure.cause
            first.setdefault((attempt.task, kind), (place, number))
    return [(kind, *found_at) for (_, kind), found_at in first.items()]
