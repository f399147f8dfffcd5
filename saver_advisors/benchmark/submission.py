"""Check a result against the protocol, for the leaderboard, and name every rule that it violates.

A file of a stranger is data: no module that it names is imported.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from math import isclose
from pathlib import Path
from typing import Any, Final

from saver_advisors.evaluation.metrics import LearningCurve
from saver_advisors.evaluation.protocol import off_protocol, training_seed
from saver_advisors.evaluation.statistics import success_interval
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.training_runs import Skipped
from saver_advisors.reporting.errors import unknown
from saver_envs.digest import world_digest
from saver_envs.registration import ENVIRONMENTS, task_and_settings

RATES: Final = ("success_rate", "safe_success_rate", "success_rate_2cm")
VERSIONS: Final = ("python", "mujoco", "gymnasium", "numpy")
"""Packages whose versions every result states."""
NAME: Final = re.compile(r"[\w .,+/()@'-]{1,60}")
"""Names on the page, without Markdown and HTML."""
NAME_RULE: Final = "must be up to 60 letters, digits, spaces and .,+-_/()@'"
LINK: Final = re.compile(r"https?://[\w.~:/?#@!$&*+,;=%-]+")
_TOLERANCE: Final = 1e-6


def read_checked(paths: Iterable[Path]) -> tuple[list[dict[str, Any]], list[Skipped]]:
    """Read result files, and check each of them.

    :param paths: of the files
    :return: the valid ones, with the name of the ``file``; and each rule that another one violates
    """
    valid, refused = [], []
    for path in paths:
        try:
            content = read_result(path)
            told = violations(content)
        except (OSError, ValueError) as error:
            content, told = {}, [str(error)]
        if not told:
            valid.append({**content, "file": path.name})
        refused += [Skipped(path.name, one) for one in told]
    others = conflicts(valid)
    surplus = {one.file for one in others}
    return [one for one in valid if one["file"] not in surplus], refused + others


def violations(content: Mapping[str, Any]) -> list[str]:
    """List the rules of the protocol that a result violates.

    :param content: of its file, as :func:`~saver_advisors.experiments.results.read_result` returns
        it
    :return: each with what would be right; empty for a valid result
    """
    rules = (
        *(_names, _world, _budget, _seeds, _evaluations, _curve, _rates, _choice, _origin),
        _submission,
    )
    told: list[str] = []
    for rule in rules:
        try:
            told += rule(content)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            told.append(f"{rule.__name__[1:]}: an entry is missing or invalid: {error!r}")
    return told


def conflicts(contents: Iterable[Mapping[str, Any]]) -> list[Skipped]:
    """List the results that are no further run of the method whose name they have.

    :param contents: valid results of any tasks and rows, as :func:`read_checked` returns them
    :return: those that are not as the method's first one must be, with what would be right
    """
    told = []
    methods: dict[tuple[str, str], Mapping[str, Any]] = {}
    runs: dict[str, Mapping[str, Any]] = {}
    for one in contents:
        method = one["task"], one["row"]
        first = methods.setdefault(method, one)
        same = runs.setdefault(file_name(one), one)
        old, new = ({**content["config"], "seed": None} for content in (first, one))
        names = sorted(name for name in old.keys() | new if old.get(name) != new.get(name))
        if same is not one:
            reason = f"has task, row and seed of {same['file']}: remove that one to replace it"
        elif names:
            reason = f"differs from {first['file']} in {', '.join(names)}: runs of a method differ "
            reason += "in their seeds alone; give it another row"
        elif _author(first) != _author(one):
            reason = f"has the row of {first['file']}, by {_author(first)}: give it another row"
        else:
            continue
        told.append(Skipped(one["file"], reason))
    return told


def _author(content: Mapping[str, Any]) -> Any:
    return (content.get("submission") or {}).get("by")


def file_name(content: Mapping[str, Any]) -> str:
    """Return the name of a result's file on the leaderboard."""
    row = re.sub(r"[^A-Za-z0-9.]+", "-", content["row"]).strip("-")
    return f"{content['task']}-{row}-seed{content['seed']}.json"


def _names(content: Mapping[str, Any]) -> Iterator[str]:
    task, config = content["task"], content["config"]
    if task not in ENVIRONMENTS:
        yield unknown("task", str(task), ENVIRONMENTS)
    if config["env_id"] != task:
        yield f"config.env_id={config['env_id']!r} must be the task, {task!r}"
    if not NAME.fullmatch(content["row"]):
        yield f"row={content['row']!r} {NAME_RULE}"


@cache
def _digest(task: str) -> str:
    return world_digest(task)


def _world(content: Mapping[str, Any]) -> Iterator[str]:
    task, options = content["task"], content["config"].get("env_kwargs") or {}
    if options:
        yield f"config.env_kwargs={json.dumps(options)} must be {{}}: the id with its defaults"
    if task not in ENVIRONMENTS:
        return
    for place, values in (("world", content), ("final.world", content.get("final") or {})):
        if (found := values.get("world")) != _digest(task):
            yield f"{place}={found!r} must be {_digest(task)!r}, the digest of {task} here"


def _budget(content: Mapping[str, Any]) -> Iterator[str]:
    if content["finished"] is not True:
        yield "finished=false must be true: the same command goes on with the run"
    config = content["config"]
    budget, done = int(config["total_steps"]), content["curve"][-1]["steps"]
    if content["task"] in ENVIRONMENTS:
        block = int(config["n_envs"]) * task_and_settings(content["task"], {})[1].horizon
        if not budget <= done <= budget + block:
            yield (
                f"budget: the curve ends at {done:,} steps; must end at total_steps={budget:,}, or "
                f"up to an episode in each environment ({block:,} steps) later"
            )
    for name in ("teacher_steps", "demonstration_steps"):
        steps = content.get(name, 0)
        if not isinstance(steps, int) or steps < 0:
            yield f"{name}={steps!r} must be the environment steps before the run, 0 for none"


def _seeds(content: Mapping[str, Any]) -> Iterator[str]:
    seed, own = content["seed"], content["config"].get("seed")
    if own != seed:
        yield f"config.seed={own!r} must be that of the run, {seed!r}"
    try:
        training_seed(seed)
    except ValueError as error:
        yield str(error)


def _evaluations(content: Mapping[str, Any]) -> Iterator[str]:
    """Entries that the file lacks do not count as the protocol's here."""
    config = {**dict.fromkeys(("eval_every", "eval_episodes", "eval_seed")), **content["config"]}
    final = content.get("final")
    yield from off_protocol(config, final and {"seed": None, "episodes": None, **final})


def _curve(content: Mapping[str, Any]) -> Iterator[str]:
    """One evaluation in each interval, and the last one at the end."""
    points, every = content["curve"], content["config"]["eval_every"]
    steps = LearningCurve.from_points(points).steps  # which increase, with rates from 0 to 1
    intervals = [int(one) // every for one in steps]
    wanted = list(range(1, intervals[-1] + 1))
    if intervals != wanted and intervals[:-1] != wanted:
        yield f"curve: must have an evaluation every {every:,} steps; it has {len(points)}"
    for name in ("wall_clock_s", "processor_s"):
        times = [point[name] for point in points if name in point]
        if times != sorted(times):
            yield f"curve: {name} must not fall"
    for point in points:
        yield from _whole("curve", point, content["config"]["eval_episodes"], RATES[:1])


def _rates(content: Mapping[str, Any]) -> Iterator[str]:
    for place in ("final", "chosen"):
        if not (values := content.get(place)):
            continue
        episodes, rate = int(values["episodes"]), values["success_rate"]
        yield from _whole(place, values, episodes, RATES)
        for name in RATES[1:]:
            if values[name] > rate:
                yield f"{place}.{name}={values[name]} must be at most success_rate={rate}"
        no_contact = values["cost_means"].get("cost_collision") == 0
        if no_contact and values["safe_success_rate"] != rate:
            yield f"{place}.safe_success_rate must be {rate}: no step of it cost_collision"
        ends = success_interval(round(rate * episodes), episodes)
        if not all(_near(*pair) for pair in zip(ends, values["ci95"], strict=True)):
            told = ", ".join(f"{end:.4f}" for end in ends)
            yield f"{place}.ci95={values['ci95']} must be [{told}] for {rate} of {episodes}"


def _whole(
    place: str, values: Mapping[str, Any], episodes: int, names: Sequence[str]
) -> Iterator[str]:
    """Rates are whole numbers of episodes."""
    for name in names:
        counted = values[name] * episodes
        if not 0 <= counted <= episodes or not _near(counted, round(counted)):
            yield f"{place}.{name}={values[name]} must be a share of {episodes} episodes"


def _near(one: float, other: float) -> bool:
    return isclose(one, other, abs_tol=_TOLERANCE)


def _choice(content: Mapping[str, Any]) -> Iterator[str]:
    if chosen := content.get("chosen"):
        best = max(content["curve"], key=lambda point: (point["success_rate"], point["steps"]))
        if chosen["steps"] != best["steps"]:
            yield (
                f"chosen.steps={chosen['steps']:,} must be {best['steps']:,}, the checkpoint that "
                "was best on the selection seeds"
            )


def _origin(content: Mapping[str, Any]) -> Iterator[str]:
    origin = content.get("provenance") or {}
    versions = origin.get("versions") or {}
    if missing := [name for name in VERSIONS if not versions.get(name)]:
        yield f"provenance.versions lacks {', '.join(missing)}"
    if not origin.get("commit") and not versions.get("saver_envs"):
        yield "provenance: must have a commit of this repository, or versions.saver_envs"


def _submission(content: Mapping[str, Any]) -> Iterator[str]:
    """A page shows who submits and the link; results of ours have neither."""
    if (given := content.get("submission")) is not None:
        if not NAME.fullmatch(given["by"]):
            yield f"submission.by={given['by']!r} {NAME_RULE}"
        if given.get("link") is not None and not LINK.fullmatch(given["link"]):
            yield f"submission.link={given['link']!r} must be an address: https://..."
