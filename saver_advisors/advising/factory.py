"""Build an advisor from the names and numbers of a configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from gymnasium import spaces

from saver_advisors.advising.advisor import Advisor, Compare
from saver_advisors.advising.context import AdviceBudget, AdvisingStrategy, RunPlan
from saver_advisors.advising.strategies import make_strategy
from saver_advisors.policies.files import load_teacher
from saver_advisors.policies.mapping import ArmMapping, flat_size
from saver_advisors.policies.scripted import PREFIX, scripted_teachers
from saver_advisors.policies.teacher import Teacher

TeacherLike = str | PathLike[str] | Teacher


def make_advisor(
    strategy: str | AdvisingStrategy,
    teacher: TeacherLike | Sequence[TeacherLike],
    budget: int,
    *,
    n_arms: int | None = None,
    observation_space: spaces.Space[Any] | None = None,
    action_space: spaces.Space[Any] | None = None,
    threshold: float | None = None,
    correcting: str | None = None,
    settings: Mapping[str, Any] | None = None,
    compare: Compare = "noisy",
    twin_minimum: bool = True,
    arms: Sequence[int] | None = None,
    total_steps: int | None = None,
    horizon: int | None = None,
    seed: int = 0,
) -> Advisor:
    """Build an advisor from names, for either a number of arms or a student's spaces.

    :param strategy: a strategy's name, "module:Class" of an unregistered one, or a strategy.
    :param teacher: a shipped policy's name, a weight file, a teacher, or a list of those, one per
        arm; ``scripted:ID`` is the scripted expert of an environment, for each arm.
    :param budget: environment steps that may be advised.
    :param n_arms: arms of the student; may be omitted if the spaces are given.
    :param observation_space: the student's, checked immediately.
    :param action_space: the student's, checked immediately.
    :param threshold: t_I or alpha of a correcting strategy.
    :param correcting: the second half of `early-mc`.
    :param settings: further arguments of a strategy given by name.
    :param compare: "noisy" or "noise-free": the student action that a correcting strategy compares.
    :param twin_minimum: whether Q_tr is the minimum of the teacher's critics, else the first.
    :param arms: indices of the arms that may be advised; every arm if None.
    :param total_steps: environment steps of the run, over which `random` spreads its budget.
    :param horizon: steps of an episode, which `jump-start` divides.
    :param seed: of the run, for strategies that draw random numbers.
    :return: the advisor.
    :raises ValueError: if parts do not match; the message names the sizes.
    """
    if isinstance(strategy, str):
        strategy = make_strategy(strategy, threshold, correcting=correcting, settings=settings)
    elif threshold is not None or correcting is not None or settings:
        raise ValueError(
            "threshold, correcting and settings belong to a strategy given by name: set them on "
            "the object instead"
        )
    teachers = _resolve(teacher)
    first = teachers[0]
    if n_arms is None:
        if observation_space is None or action_space is None:
            raise ValueError("give n_arms, or observation_space and action_space to read it from")
        n_arms = _count_arms(first, action_space)
    mapping = ArmMapping(n_arms, first.observation_size, first.goal_size, first.action_size)
    advisor = Advisor(
        strategy,
        teachers,
        mapping,
        AdviceBudget(budget),
        compare=compare,
        twin_minimum=twin_minimum,
        arms=arms,
        run=RunPlan(total_steps, horizon, seed),
    )
    if observation_space is not None and action_space is not None:
        advisor.check_spaces(observation_space, action_space)
    return advisor


def _resolve(teacher: TeacherLike | Sequence[TeacherLike]) -> list[Teacher]:
    """Load the teachers given by name or path; equal names share one teacher."""
    given = [teacher] if isinstance(teacher, (str, PathLike, Teacher)) else list(teacher)
    if not given:
        raise ValueError("teacher is an empty list: give one teacher for all arms, or one per arm")
    loaded: dict[str, Teacher] = {}
    teachers = []
    for one in given:
        if isinstance(one, Teacher):
            teachers.append(one)
        elif str(one).startswith(PREFIX):
            teachers += scripted_teachers(str(one))
        else:
            teachers.append(loaded.setdefault(str(one), load_teacher(one)))
    return teachers


def _count_arms(teacher: Teacher, action_space: spaces.Space[Any]) -> int:
    size = flat_size("action", action_space)
    n_arms, rest = divmod(size, teacher.action_size)
    if rest or n_arms == 0:
        raise ValueError(
            f"teacher {teacher.name!r} has actions of size {teacher.action_size}, which do not "
            f"divide the student's action of size {size}: choose a teacher of the same task"
        )
    return n_arms
