"""The text of the generated documentation: a page an environment, the weights, the results.

Nothing here draws or simulates, so that a test can compare the pages with the code at once.
"""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from saver_advisors.benchmarks.pose_page import pose_page
from saver_advisors.cli import evaluate, runs, wrist_page
from saver_advisors.cli.catalogue import (
    COLUMNS,
    Entry,
    dense_twin,
    entry,
    pixel_ids,
    sparse_ids,
)
from saver_advisors.cli.tables import markdown
from saver_envs.core import ACTION_DURATION, Episodes
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

GENERATED: Final = "Generated from the code by `saver docs`.\n"
BEGIN, END = "<!-- envs:begin -->", "<!-- envs:end -->"

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


def all_pages(output: Path) -> dict[str, str]:
    """Every generated page.

    :param output: the documentation's folder; its ``results/*.json`` are read
    :return: text by path in that folder
    """
    results = read_results(output / "results")
    entries = [entry(name) for name in sparse_ids()]
    pages = {f"environments/{one.env_id}.md": environment_page(one, results) for one in entries}
    pages["environments/index.md"] = environments_page(entries)
    pages["weights.md"] = weights_page()
    pages["results.md"] = results_page(results)
    pose = output / "results" / "pose.json"
    if pose.is_file():
        pages["perception-results.md"] = pose_page(json.loads(pose.read_text(encoding="utf-8")))
    return pages


def environments_table(entries: list[Entry], folder: str) -> str:
    """The table of environments with links to their pages.

    :param entries: its rows
    :param folder: where the pages are, from the reader's page
    :return: Markdown
    """
    rows = [[f"[`{one.env_id}`]({folder}{one.env_id}.md)", *one.cells[1:]] for one in entries]
    return markdown(COLUMNS, rows)


def with_table(readme: str, output: Path) -> str:
    """The README with the table of environments between its markers.

    :param readme: its text
    :param output: the documentation's folder, beside the README
    :return: the new text
    :raises ValueError: where a marker is missing
    """
    before, begin, rest = readme.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the README has no {BEGIN} and {END}")
    entries = [entry(name) for name in sparse_ids()]
    table = environments_table(entries, f"{output.name}/environments/")
    return f"{before}{begin}\n{table}{end}{after}"


def environments_page(entries: list[Entry]) -> str:
    """The page that lists the environments."""
    lines = ["# Environments", "", environments_table(entries, "")]
    twin = dense_twin(entries[0].env_id)
    lines += [f"Each id has a twin with a dense reward, such as `{twin}`.", ""]
    lines += [f"{sentence}\n" for sentence in pixel_ids()]
    lines.append(GENERATED)
    return "\n".join(lines)


def environment_page(one: Entry, results: list[dict[str, Any]]) -> str:
    """The page of an id and its dense twin.

    :param one: the sparse id's entry
    :param results: as ``read_results`` returns them
    :return: Markdown
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("saver_advisors.cli"),
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
        readings=wrist_page.READINGS if episodes.task.moves_person else "",
        keywords=_keywords(),
        results=_results_of(one.env_id, results),
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
        wrist_page.facts() if episodes.task.moves_person else cubes,
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
        return wrist_page.start()
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
    meanings = wrist_page.COST_MEANINGS if episodes.task.moves_person else COST_MEANINGS
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


# Weights ------------------------------------------------------------------------------------------


def weights_page() -> str:
    """The cards of the shipped policies."""
    from saver_advisors.pretrained import WEIGHTS_DIR, read_networks, shipped_policies

    cards = {
        name: read_networks(WEIGHTS_DIR / f"{name}.safetensors")[1] for name in shipped_policies()
    }
    rows = [
        [
            f"`{name}`",
            f"[`{card.environment}`](environments/{card.env_id}.md)",
            card.algorithm,
            f"{card.steps:,}",
            f"{card.wall_clock_s / 60:.0f}",
            f"{card.success:.3f} of {card.success_episodes}",
        ]
        for name, card in cards.items()
    ]
    columns = ("name", "environment", "algorithm", "steps", "minutes", "success, episodes")
    lines = ["# Weights", "", markdown(columns, rows)]
    lines += [
        "Each has a card of its own beside it, with its command, seed, commit and settings:",
        '`saver_advisors.pretrained.load_policy("' + (next(iter(cards), "NAME")) + '").card`.',
        "The success in a card is measured on seeds from 0, in episodes that had no part in",
        "choosing the checkpoint.",
        "",
    ]
    for name, card in cards.items():
        lines += [f"## {name}", "", "```", card.command, "```", ""]
    return "\n".join([*lines, GENERATED])


# Results ------------------------------------------------------------------------------------------


def read_results(folder: Path) -> list[dict[str, Any]]:
    """The results that programs left.

    :param folder: of JSON files
    :return: their contents, with ``file``, in the order of their names
    """
    return [
        {"file": path.name, **json.loads(path.read_text(encoding="utf-8"))}
        for path in sorted(folder.glob("*.json"))
    ]


def _evaluations(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [one for one in results if "success_rate" in one and "ci95" in one]


def _results_of(env_id: str, results: list[dict[str, Any]]) -> str:
    found = [one for one in _evaluations(results) if one["env"] == env_id]
    return _evaluation_table(found) if found else ""


def _evaluation_table(found: list[dict[str, Any]]) -> str:
    columns = (*evaluate.COLUMNS, "collisions per episode")
    rows = []
    for one in found:
        collisions = one.get("cost_means", {}).get("cost_collision")
        rows.append([*evaluate.cells(one), "-" if collisions is None else f"{collisions:.2f}"])
    return markdown(columns, rows)


PAGES: Final = {
    "advising": "advising-results.md",
    "constraints": "constraints-results.md",
    "kinematics": "modelling-in-use.md",
    "learning": "learning-speed.md",
    "modelling-time": "modelling-time.md",
    "pose": "perception-results.md",
    "safe": "safe-baselines.md",
    "speed": "speed.md",
    "tracking": "modelling-tracking.md",
    "transfer": "transfer.md",
}
"""Of results by their kind, where they are told in full."""

PAGES_OF_FILES: Final = {"mico-ik-little-data": "modelling-little-data.md"}
"""The same by the file's name, where several files are of a kind."""


def results_page(results: list[dict[str, Any]]) -> str:
    """Every result as a table.

    :param results: as ``read_results`` returns them
    :return: Markdown
    """
    lines = ["# Results", ""]
    if evaluations := _evaluations(results):
        lines += ["## Success", "", _evaluation_table(evaluations)]
    for one in results:
        if one in evaluations:
            continue
        stem = Path(one["file"]).stem
        lines += [f"## {one.get('title', stem.replace('-', ' '))}", ""]
        if one.get("kind") == "curves":
            lines += [f"![learning curves](results/{stem}.png)", ""]
            lines.append(markdown(runs.COLUMNS, [runs.cells(run) for run in one["runs"]]))
        elif page := PAGES_OF_FILES.get(stem) or PAGES.get(str(one.get("kind"))):
            lines += [f"On [a page of its own]({page}).", ""]
        elif one.get("kind") == "modelling-search":
            lines.append(_plain_table([_trial(trial) for trial in one["trials"]]))
        elif isinstance(one.get("rows"), list):
            lines.append(_plain_table(one["rows"]))
        lines += [_origin(one), ""]
    lines += [f"Rendered from the files in `docs/results`. {GENERATED}"]
    return "\n".join(lines)


def _trial(trial: dict[str, Any]) -> dict[str, Any]:
    """A trial of a search for settings, flat."""
    return {**trial["settings"], "validation_rmse": trial["validation_rmse"]}


def _plain_table(rows: list[dict[str, Any]]) -> str:
    """A table of whatever a program measured: a column a key."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    return markdown([name.replace("_", " ") for name in columns], cells)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)


def _origin(one: dict[str, Any]) -> str:
    """Where a result comes from, as far as it says so."""
    source = one.get("provenance", one)
    parts = [f"`{source['command']}`"] if source.get("command") else []
    if source.get("commit"):
        parts.append(f"commit `{source['commit'][:12]}`")
    if machine := source.get("machine"):
        parts.append(f"{machine['cpu']}, {machine['cores']} cores")
    return "; ".join(parts) + ("." if parts else "")
