"""One person who is handled by several care tasks in turn, each with robots and bed of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from saver_envs.people.limp_people import PEOPLE
from saver_envs.people.lying import LyingPosture
from saver_envs.simulation import Simulation
from saver_envs.tasks.care import CareTask
from saver_envs.tasks.care_starts import alone
from saver_envs.tasks.contract import NoStart

#: So many postures are tried until one comes to rest as it should.
_TRIES: Final = 20


@dataclass(frozen=True)
class PersonOnBed:
    """A person at rest, wherever the bed is.

    :param who: which of :data:`saver_envs.people.limp_people.PEOPLE`.
    :param pose: (35,) as :meth:`saver_envs.tasks.care.CareTask.pose_of` returns it.
    :param stiffness: factor of the person's joints.
    :param friction: sliding friction of clothes and skin.
    """

    who: int
    pose: tuple[float, ...]
    stiffness: float
    friction: float


def drawn_person(tasks: Sequence[CareTask], generator: np.random.Generator) -> PersonOnBed:
    """Draw a person for a procedure, at rest on the bed of its first task.

    Each task says how the limbs lie that it handles.

    :param tasks: in the order of the procedure.
    :param generator: source of randomness.
    :raises NoStart: where no posture comes to rest as the first task wants it, or nobody can be
        handled by all tasks.
    """
    first = tasks[0]
    people = sorted(set(first.people).intersection(*(task.people for task in tasks[1:])))
    if not people:
        raise NoStart(f"nobody is handled by all of {', '.join(task.name for task in tasks)}")
    who = int(generator.choice(people))
    stiffness, friction = (
        float(generator.uniform(*first.ranges[f"person_{name}"]))
        for name in ("stiffness", "friction")
    )
    world = alone(who, first.bed)
    for _ in range(_TRIES):
        index = int(generator.integers(first.postures))
        posture = _posture(tasks, index, generator)
        pose = world.laid(posture, first.bed.centre[:2], first.facing)
        if pose is not None and first.keeps(world, index):
            return PersonOnBed(who, first.unplaced(pose), stiffness, friction)
    raise NoStart(f"{_TRIES} postures of {PEOPLE[who]} in a row did not come to rest")


def _posture(tasks: Sequence[CareTask], index: int, generator: np.random.Generator) -> LyingPosture:
    """Draw a posture of the first task, with limbs as the other ones would find them."""
    posture = tasks[0].posture(index, generator)
    for task in tasks[1:]:
        other = task.posture(int(generator.integers(task.postures)), generator)
        posture = replace(posture, **{name: getattr(other, name) for name in task.handles})
    return posture


def with_person(task: CareTask, person: PersonOnBed) -> CareTask:
    """Return a task whose episodes start with a person."""
    return replace(
        task,
        person_body=person.who,
        person_pose=person.pose,
        person_stiffness=person.stiffness,
        person_friction=person.friction,
    )


def left_behind(
    task: CareTask, person: PersonOnBed, simulation: Simulation, row: int
) -> PersonOnBed:
    """Return a person as the episode of ``row`` left them.

    :param task: of the episode.
    :param person: at its start.
    :param simulation: in which it was played.
    :param row: which episode.
    """
    return replace(person, pose=task.pose_of(simulation, row))
