"""An extraction: the care tasks of the procedure in turn, with the same person."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Predict
from saver_envs.episodes import Episodes
from saver_envs.people.contact_forces import FORCE_COSTS, FORCE_LIMITS
from saver_envs.people.limp_people import PEOPLE
from saver_envs.registration import make_episodes, task_and_settings
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.procedure import drawn_person, left_behind, with_person
from saver_envs.wrappers.seen_person import SeenPeople

#: Called at the start of a step of the procedure and after each action.
Look = Callable[[str, Episodes], None]
#: Separates the persons of an extraction from the starts of the same seeds.
_PEOPLE_STREAM: Final = 0xCA5E


@dataclass(frozen=True)
class ExtractionStep:
    """How one care task of an extraction ended.

    :param env_id: of the task.
    :param success: ``is_success`` at the end.
    :param reached: whether the goal was reached at the end, whatever the costs.
    :param seconds: until the goal was reached and stayed so; the horizon where it was not.
    :param forces: part of the body -> greatest force on it, N.
    :param exceeded: names of the hard costs that arose, without ``cost_``.
    """

    env_id: str
    success: bool
    reached: bool
    seconds: float
    forces: Mapping[str, float]
    exceeded: tuple[str, ...]


@dataclass(frozen=True)
class Extraction:
    """An extraction of one person, up to the task that failed.

    :param seed: of the person and of the starts.
    :param person: who it is.
    :param steps: of the procedure that were played.
    """

    seed: int
    person: str
    steps: tuple[ExtractionStep, ...]

    @property
    def completed(self) -> bool:
        """Whether all tasks succeeded."""
        return self.steps[-1].success

    @property
    def outcome(self) -> str:
        """How the extraction ended, in words."""
        last = self.steps[-1]
        if self.completed:
            return "completed"
        why = ", ".join(last.exceeded) if last.exceeded else "the goal was not reached"
        return f"{last.env_id} failed: {why}"

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {**asdict(self), "completed": self.completed, "outcome": self.outcome}


def extract(
    policies: Mapping[str, Predict],
    seeds: Sequence[int],
    look: Look | None = None,
    *,
    seeing: bool = False,
) -> list[Extraction]:
    """Extract people: play the tasks in turn, each until its horizon.

    A person lies on the bed of a task as the one before left them. The bed is placed under them
    as accurately as in the task's own starts.

    :param policies: id of a care task -> batched observation to actions, in the order of the
        procedure.
    :param seeds: one a person; they are played together.
    :param look: sees the episodes; gets a step's id and its episodes.
    :param seeing: a camera and the pose network find the person, instead of the true state.
    """
    tasks: list[Any] = [task_and_settings(env_id, {})[0] for env_id in policies]
    people = {
        seed: drawn_person(tasks, np.random.default_rng([seed, _PEOPLE_STREAM])) for seed in seeds
    }
    steps: dict[int, list[ExtractionStep]] = {seed: [] for seed in seeds}
    left = seeds
    for number, (env_id, predict) in enumerate(policies.items()):
        episodes = make_episodes(env_id, len(left))
        for row, seed in enumerate(left):
            episodes.worlds.tasks[row] = with_person(tasks[number], people[seed])
            episodes.set_generator(row, np.random.default_rng([seed, number]))
        with ExitStack() as stack:
            eye = stack.enter_context(closing(SeenPeople(episodes))) if seeing else None
            ended = play_step(env_id, episodes, predict, look, eye)
        for row, (seed, step) in enumerate(zip(left, ended, strict=True)):
            steps[seed].append(step)
            people[seed] = left_behind(tasks[number], people[seed], episodes.simulation, row)
        left = [seed for seed in left if steps[seed][-1].success]
        if not left:
            break
    return [
        Extraction(seed, PEOPLE[people[seed].who].described, tuple(ended))
        for seed, ended in steps.items()
    ]


def play_step(
    env_id: str,
    episodes: Episodes,
    predict: Predict,
    look: Look | None = None,
    eye: SeenPeople | None = None,
) -> list[ExtractionStep]:
    """Play the episodes of a care task up to their horizon.

    :param env_id: of the task.
    :param episodes: not yet reset.
    :param predict: batched observation -> actions.
    :param look: sees the episodes.
    :param eye: sees the person for the policy; arms wait until it has.
    :return: how each ended.
    """
    outcome = episodes.reset()
    if eye is not None:
        eye.begin()
    n, hard = episodes.n, episodes.task.hard
    forces = {name: np.zeros(n) for name in FORCE_COSTS}
    over = {name: np.zeros(n, dtype=bool) for name in hard}
    since = np.zeros(n)
    while True:
        if look is not None:
            look(env_id, episodes)
        if outcome.truncated.all():
            break
        outcome = episodes.step(_actions(episodes, predict, eye))
        since[~outcome.reached] = episodes.elapsed[~outcome.reached]
        for name, greatest in forces.items():
            np.maximum(greatest, outcome.measured[name], out=greatest)
        for name, arose in over.items():
            arose |= outcome.measured[f"cost_{name}"] > 0
    return [
        ExtractionStep(
            env_id,
            bool(outcome.success[row]),
            bool(outcome.reached[row]),
            float(since[row] * ACTION_DURATION),
            dict(zip(FORCE_LIMITS, (float(one[row]) for one in forces.values()), strict=True)),
            tuple(name for name, arose in over.items() if arose[row]),
        )
        for row in range(n)
    ]


def _actions(episodes: Episodes, predict: Predict, eye: SeenPeople | None) -> NDArray[Any]:
    if eye is None:
        return predict(episodes.observation().as_dict())
    actions = predict(eye.observed())
    actions[~eye.ready] = 0.0
    eye.advance()
    return actions


def task_rows(
    extractions: Sequence[Extraction], policies: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return how the tasks of a procedure went, a row each.

    :param extractions: of all people.
    :param policies: id -> the policy that played it, in the order of the procedure.
    """
    rows = []
    for number, (env_id, policy) in enumerate(policies.items()):
        steps = [one.steps[number] for one in extractions if number < len(one.steps)]
        forces = greatest_forces(steps)
        part = max(forces, key=lambda part: forces[part] / FORCE_LIMITS[part])
        rows.append(
            {
                "task": env_id,
                "policy": policy,
                "people who began it": len(steps),
                "succeeded": sum(step.success for step in steps),
                "a limit was exceeded": sum(bool(step.exceeded) for step in steps),
                "strongest force": f"{part.replace('_', ' ')}: {forces[part]:.0f} N",
                "limit of lasting contacts": f"{FORCE_LIMITS[part]:.0f} N",
            }
        )
    return rows


def greatest_forces(steps: Sequence[ExtractionStep]) -> dict[str, float]:
    """Return part of the body -> greatest force on it in some steps, N."""
    return {part: max((one.forces[part] for one in steps), default=0.0) for part in FORCE_LIMITS}
