"""The text of a page an environment, and of the one that lists them all."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields
from typing import Any, Final

from reproduction.pages.results import results_of
from saver_advisors.cli import wrist_push_facts as wrist_push
from saver_advisors.cli.catalogue import COLUMNS, Entry, dense_twin, pixel_ids
from saver_advisors.reporting.tables import markdown
from saver_envs.episodes import ACTION_DURATION, Episodes
from saver_envs.registration import Options, make_episodes
from saver_envs.tasks.distance import DISTANCE_TOLERANCE, REQUIRED_DISTANCE
from saver_envs.tasks.observation import PARTS, SIZE_PER_ARM
from saver_envs.tasks.regions import Regions
from saver_envs.tasks.sampling import (
    CLEARANCE_WIDTHS,
    HAND_CLEARANCE,
    HAND_TO_OBJECT,
    HAND_TO_OTHER_OBJECT,
    OBJECT_TO_TARGET,
    StartRules,
)

COST_MEANINGS: Final = {
    "collision": (
        "1 on a step with contact between arms, or of an arm with the table or with another arm's "
        "cube"
    ),
    "distance": (
        f"1 on a step on which the cubes are not {REQUIRED_DISTANCE:g} m "
        f"+- {100 * DISTANCE_TOLERANCE:g} cm apart"
    ),
}


def environments_table(entries: list[Entry], folder: str) -> str:
    """The table of environments with links to their pages.

    :param entries: its rows
    :param folder: where the pages are, from the reader's page
    :return: Markdown
    """
    rows = [[f"[`{one.env_id}`]({folder}{one.env_id}.md)", *one.cells[1:]] for one in entries]
    return markdown(COLUMNS, rows)


def environments_page(entries: list[Entry]) -> str:
    """The page that lists the environments.

    :param entries: its rows
    :return: Markdown
    """
    lines = ["# Environments", "", environments_table(entries, "")]
    twin = dense_twin(entries[0].env_id)
    lines += [f"Each id has a twin with a dense reward, such as `{twin}`.", ""]
    lines += [f"{sentence}\n" for sentence in pixel_ids()]
    return "\n".join([*lines, ""])


def environment_page(one: Entry, results: list[dict[str, Any]]) -> str:
    """The page of an id and its dense twin.

    :param one: the sparse id's entry
    :param results: as ``read_result_files`` returns them
    :return: Markdown
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("reproduction.pages"),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        # Markdown, not HTML: nothing is to be escaped, and all of it comes from our own code.
        autoescape=False,
    )
    episodes = make_episodes(one.env_id)
    return templates.get_template("environment.md.j2").render(
        entry=one,
        summary=_summary(episodes),
        twin=dense_twin(one.env_id),
        facts=_facts(one, episodes),
        spaces=_spaces(one),
        observation=_observation(one.arms),
        action=_action(episodes),
        goal=_goal(one, episodes),
        start=_start(episodes),
        reward=_sparse_reward(one, _thing(episodes)),
        dense=_dense_reward(one, _thing(episodes)),
        costs=_costs(one, episodes),
        readings=wrist_push.READINGS if episodes.task.moves_person else "",
        keywords=_keywords(),
        results=results_of(one.env_id, results),
    )


def _summary(episodes: Episodes) -> str:
    """What the task's module says about it."""
    module = inspect.getdoc(inspect.getmodule(type(episodes.task))) or ""
    return _one_line(module)


def _facts(one: Entry, episodes: Episodes) -> list[tuple[str, str]]:
    settings = episodes.settings
    cubes = (
        "cubes",
        f"{100 * settings.objects.size:g} cm, {settings.objects.mass:g} kg, friction "
        f"{settings.objects.friction:g}",
    )
    return [
        ("robot", f"{one.arms} x {one.robot}" if one.arms > 1 else one.robot),
        ("an action lasts", f"{ACTION_DURATION:g} s"),
        ("horizon", f"{one.horizon} actions, {one.horizon * ACTION_DURATION:g} s"),
        ("top speed of a hand", f"{settings.max_speed:g} m/s"),
        wrist_push.facts() if episodes.task.moves_person else cubes,
    ]


def _thing(episodes: Episodes) -> str:
    """What an arm moves."""
    return "wrist" if episodes.task.moves_person else "cube"


def _spaces(one: Entry) -> str:
    goal = ["achieved_goal", f"Box(-inf, inf, ({one.goal_size},), float32)"]
    rows = [
        ["observation", f"Box(-inf, inf, ({one.observation_size},), float32)"],
        goal,
        ["desired_goal", goal[1]],
        ["action", f"Box(-1, 1, ({one.action_size},), float32)"],
    ]
    return markdown(("entry", "space"), [[f"`{name}`", space] for name, space in rows])


def _observation(arms: int) -> str:
    rows, first = [], 0
    for name, size, unit in PARTS:
        rows.append([_indices(first, size, SIZE_PER_ARM, arms), name, unit])
        first += size
    return markdown(("index", "what", "unit"), rows)


def _action(episodes: Episodes) -> str:
    step = f"{1000 * episodes.settings.max_speed * ACTION_DURATION:g} mm"
    size, arms = episodes.action_size_per_arm, episodes.task.n_arms
    held = episodes.task.held_height
    motion = f"displacement of the hand's set-point along x, y, z; 1 is {step}, the longest in all"
    if held is not None:
        motion += f"; z is held at {100 * held:g} cm above the table"
    rows = [[_indices(0, 3, size, arms), motion]]
    if size > 3:
        rows.append([_indices(3, 1, size, arms), "gripper: 1 is open, -1 is closed"])
    return markdown(("index", "what"), rows)


def _goal(one: Entry, episodes: Episodes) -> str:
    what = f"centre of the {_thing(episodes)} (achieved), its target (desired)"
    rows = [[_indices(0, 3, 3, one.arms), what, "m"]]
    if one.goal_size > 3 * one.arms:
        rows.append([str(3 * one.arms), "distance between the cubes, and the required one", "m"])
    return markdown(("index", "what", "unit"), rows)


def _indices(first: int, size: int, block: int, arms: int) -> str:
    """``3 to 5``, or ``28k + 3 to 28k + 5`` where each arm has a block of its own."""
    ends = [first] if size == 1 else [first, first + size - 1]
    offset = f"{block}k + " if arms > 1 else ""
    return " to ".join(f"{offset}{end}" for end in ends)


def _start(episodes: Episodes) -> list[str]:
    """What the sampler guarantees, each with its figure."""
    task, scene = episodes.task, episodes.scene
    if task.moves_person:
        return wrist_push.start()
    rules = task.start_rules(scene.object_rest_height)
    lines = [
        f"A cube {_span(HAND_TO_OBJECT)} from its hand, its target {_span(OBJECT_TO_TARGET)} from "
        "the cube.",
        *_boxes(episodes.regions),
        _hands(rules),
        _targets(rules),
    ]
    if rules.pushes:
        lines.append("Behind each cube there is room for the hand that is to push it.")
    if task.n_arms > 1:
        lines += _several_arms(rules)
    lines.append("Hands, cubes and targets can be reached: the sampler looks each of them up.")
    return lines


def _boxes(region: Regions) -> list[str]:
    """A line an arm; one for all where they are alike."""
    boxes = []
    for lower, upper in zip(region.object_lower, region.object_upper, strict=True):
        boxes.append(f"x {lower[0]:g} to {upper[0]:g} m, y {lower[1]:g} to {upper[1]:g} m")
    reach = f"at most {region.reach:g} m from the base"
    if len(set(boxes)) == 1:
        return [f"Cubes and targets in {boxes[0]}, {reach}."]
    return [f"Arm {arm}: cube and target in {box}, {reach}." for arm, box in enumerate(boxes)]


def _hands(rules: StartRules) -> str:
    low, high = rules.hand_height
    if low == high:
        return f"Hands closed, {100 * low:g} cm above the table."
    return f"Hands open, {100 * low:g} to {100 * high:g} cm above the table."


def _targets(rules: StartRules) -> str:
    if rules.air_share == 0:
        return "Targets on the table."
    return (
        f"{rules.air_share:.0%} of the targets in the air, up to {100 * rules.air_height:g} cm; "
        "the others on the table."
    )


def _several_arms(rules: StartRules) -> list[str]:
    lines = [
        f"Cubes and targets of different arms are at least {CLEARANCE_WIDTHS:g} cube widths apart, "
        f"hands {100 * HAND_CLEARANCE:g} cm from one another and "
        f"{100 * HAND_TO_OTHER_OBJECT:g} cm from other arms' cubes."
    ]
    if rules.separation is not None:
        low, high = rules.separation
        lines.append(f"Both cubes, and both targets, {low:g} to {high:g} m apart.")
    elif rules.contested_share > 0:
        lines.append(
            f"In {rules.contested_share:.0%} of the episodes the ways of two cubes cross, so that "
            "the arms must give way; in the others they cross by chance."
        )
    return lines


def _span(span: tuple[float, float]) -> str:
    return f"{100 * span[0]:g} to {100 * span[1]:g} cm"


def _sparse_reward(one: Entry, thing: str) -> str:
    reached = f"0 where every {thing} is within the threshold of its target, else -1."
    if one.task != "distance":
        return reached
    return (
        "0 where every cube is within the threshold of its target and the cubes keep their "
        'distance, else -1; with `reward_stage="goal"` the distance does not count, and with '
        '`reward_combination="linear"` goal and distance are summed, -1 for each that is missed.'
    )


def _dense_reward(one: Entry, thing: str) -> str:
    text = f"minus the sum of the {thing}s' distances to their targets, in metres"
    if one.task == "distance":
        text += ", and minus how far the cubes are from the required distance"
    return text + "."


def _costs(one: Entry, episodes: Episodes) -> str:
    meanings = wrist_push.COST_MEANINGS if episodes.task.moves_person else COST_MEANINGS
    rows = [
        [f"`cost_{name}`", meanings[name], "yes" if name in one.summed_costs else "no"]
        for name in one.costs
    ]
    return markdown(("cost", "what", 'part of `info["cost"]`'), rows)


def _keywords() -> str:
    """The keyword arguments of every id, from the class that reads them."""
    meanings = parameters(inspect.getdoc(Options) or "")
    rows = [
        [f"`{one.name}`", f"`{one.default!r}`", meanings[one.name].replace("``", "`")]
        for one in fields(Options)
    ]
    return markdown(("name", "default", "meaning"), rows)


def parameters(docstring: str) -> dict[str, str]:
    """What a docstring says about parameters.

    :param docstring: with ``:param name: text`` entries, which may go on over several lines
    :return: the texts by name
    """
    entries = re.findall(r":param (\w+): (.*?)(?=\n:|\n\n|\Z)", docstring, flags=re.DOTALL)
    return {name: _one_line(text) for name, text in entries}


def _one_line(text: str) -> str:
    return " ".join(text.split())
