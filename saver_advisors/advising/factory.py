"""Build an advisor from the names and numbers of a configuration."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from gymnasium import spaces

from saver_advisors.advising.advisor import Advisor, Compare
from saver_advisors.advising.context import AdviceBudget, AdvisingStrategy, RunPlan
from saver_advisors.advising.strategies import import_object, make_strategy
from saver_advisors.policies.files import load_teacher
from saver_advisors.policies.mapping import ArmMapping, flat_size
from saver_advisors.policies.scripted import PREFIX, scripted_teachers
from saver_advisors.policies.teacher import FunctionTeacher, Teacher, TeacherFunction

TeacherLike = str | PathLike[str] | Teacher | TeacherFunction


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
    :param teacher: a shipped policy's name; a weight file; the folder of a run; the zip file of an
        SB3 model; a teacher; a function of one arm's observation and goal, or its name
        "module:function" (see ``FunctionTeacher``); or a list of those, one per arm.
        ``scripted:ID`` is the scripted expert of an environment, for each arm.
    :param budget: environment steps that may be advised.
    :param n_arms: arms of the student; may be omitted if the spaces are given, except for a
        function, whose sizes follow from both.
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
    spendable = AdviceBudget(budget)
    late = isinstance(strategy, str) and ":" in strategy
    if isinstance(strategy, str) and not late:
        strategy = make_strategy(strategy, threshold, correcting=correcting, settings=settings)
    elif not late and (threshold is not None or correcting is not None or settings):
        raise ValueError(
            "threshold, correcting and settings belong to a strategy given by name: set them on "
            "the object instead"
        )
    teachers = _resolve(teacher, n_arms, observation_space, action_space)
    first = teachers[0]
    if n_arms is None:
        if observation_space is None or action_space is None:
            raise ValueError("give n_arms, or observation_space and action_space to read it from")
        n_arms = _count_arms(first, action_space)
    mapping = ArmMapping(n_arms, first.observation_size, first.goal_size, first.action_size)
    if isinstance(strategy, str):
        # The name of code: it is imported once everything else is accepted.
        strategy = make_strategy(strategy, threshold, correcting=correcting, settings=settings)
    advisor = Advisor(
        strategy,
        teachers,
        mapping,
        spendable,
        compare=compare,
        twin_minimum=twin_minimum,
        arms=arms,
        run=RunPlan(total_steps, horizon, seed),
    )
    if observation_space is not None and action_space is not None:
        advisor.check_spaces(observation_space, action_space)
    return advisor


def names_code(teacher: TeacherLike) -> bool:
    """Return whether a teacher is "module:function", the name of code to import."""
    word = str(teacher) if isinstance(teacher, (str, PathLike)) else ""
    return ":" in word and not word.startswith(PREFIX) and not os.path.exists(word)


def _resolve(
    teacher: TeacherLike | Sequence[TeacherLike],
    n_arms: int | None,
    observation_space: spaces.Space[Any] | None,
    action_space: spaces.Space[Any] | None,
) -> list[Teacher]:
    """Load the teachers given by name or path; equal names share one teacher."""
    one = isinstance(teacher, (str, PathLike, Teacher)) or callable(teacher)
    given: list[Any] = [teacher] if one else list(teacher)  # type: ignore[arg-type]
    if not given:
        raise ValueError("teacher is an empty list: give one teacher for all arms, or one per arm")
    loaded: dict[Any, list[Teacher]] = {}
    for each in sorted(dict.fromkeys(given), key=names_code):
        if isinstance(each, Teacher):
            loaded[each] = [each]
        elif callable(each) or names_code(each):
            loaded[each] = [_of_function(each, n_arms, observation_space, action_space)]
        elif str(each).startswith(PREFIX):
            loaded[each] = list(scripted_teachers(str(each)))
        else:
            loaded[each] = [load_teacher(each)]
    return [member for each in given for member in loaded[each]]


def _of_function(
    function: str | TeacherFunction,
    n_arms: int | None,
    observation_space: spaces.Space[Any] | None,
    action_space: spaces.Space[Any] | None,
) -> FunctionTeacher:
    """Return the teacher that a function is for one arm of a student."""
    if n_arms is None or not isinstance(observation_space, spaces.Dict):
        raise ValueError(
            f"teacher={function!r} is a function: give n_arms, observation_space and action_space, "
            "from which its sizes follow"
        )
    given = {**observation_space.spaces, "action": action_space}
    names = ("observation", "desired_goal", "action")
    observation, goal, action = (flat_size(name, given.get(name)) // n_arms for name in names)
    found = import_object("teacher", function) if isinstance(function, str) else function
    if not callable(found):
        raise TypeError(f"teacher={function!r} must be a function of observation and goal")
    return FunctionTeacher(found, (observation, goal, action), str(function))


def _count_arms(teacher: Teacher, action_space: spaces.Space[Any]) -> int:
    size = flat_size("action", action_space)
    n_arms, rest = divmod(size, teacher.action_size)
    if rest or n_arms == 0:
        raise ValueError(
            f"teacher {teacher.name!r} has actions of size {teacher.action_size}, which do not "
            f"divide the student's action of size {size}: choose a teacher of the same task"
        )
    return n_arms
