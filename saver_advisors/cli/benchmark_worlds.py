"""Evaluate policies in worlds that vary: under presets and under held-out ranges.

Every policy plays the same seeds in every world. A world without a held-out range of a policy's
environment is left out for that policy.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from saver_advisors.cli.measured import measure_and_render, read_measurement
from saver_advisors.reporting.errors import UsageError

EXAMPLES: Final = """\
examples:
  saver benchmark worlds --json worlds.json         every shipped policy in every world; goes on
                                                    with what an interrupted one has measured
  saver benchmark worlds --policies jaco-push --worlds none wide --episodes 50
  saver benchmark worlds --policies runs/push expert --env JacoPush-v0 --json worlds.json"""

HEAD: Final = {"kind": "worlds", "title": "Worlds that policies were not trained in"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add, add_count, add_env, add_page

    text = "policies as in `saver evaluate` (default: every shipped one)"
    add(parser, "--policies", text, nargs="+", metavar="POLICY")
    text = "environment of policies that do not ship; a shipped one has its own"
    add_env(parser, text)
    text = "values of randomization (default: none, mild, wide, every held-out range, all of them)"
    add(parser, "--worlds", text, nargs="+", metavar="NAME")
    add_count(parser, "--episodes", 200, "episodes of each policy in each world")
    add_count(parser, "--seed", 0, "seed of episode 0", least=0)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the table, and write the given files.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    return measure_and_render(args, "worlds", lambda: measure(args), render)


def entrants(names: Sequence[str] | None, env: str | None) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the environment and its keyword arguments of each policy.

    :param names: of policies; every shipped one by default
    :param env: id for those that do not ship
    :raises UsageError: for a policy without an environment
    """
    from saver_advisors.pretrained import load_policy, shipped_policies

    shipped, found = shipped_policies(), {}
    for name in shipped if names is None else names:
        if name in shipped:
            card = load_policy(name).card
            found[name] = card.env_id, dict(card.env_kwargs)
        elif env is not None:
            found[name] = env, {}
        else:
            raise UsageError(f"argument --policies: {name!r} does not ship: say where with --env")
    return found


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate every policy in every world.

    :param args: see :func:`add_arguments`
    :return: JSON-able: ``rows`` with an evaluation each
    """
    from saver_advisors.cli import evaluate
    from saver_advisors.cli.policies import resolve
    from saver_advisors.policies.files import weights_digest
    from saver_advisors.reporting.provenance import provenance, write_json_atomic
    from saver_envs.digest import world_digest

    todo = [
        (policy, env, {**kwargs, "randomization": world})
        for policy, (env, kwargs) in entrants(args.policies, args.env).items()
        for world in worlds_of(env, kwargs, args.worlds)
    ]
    for policy, env, kwargs in todo:  # report policies that do not fit before the first episode
        resolve(policy, env, kwargs)
    keys = [
        (policy, weights_digest(policy), kwargs["randomization"], world_digest(env, kwargs))
        for policy, env, kwargs in todo
    ]
    origin = provenance()  # before the file is written, perhaps in the checkout
    rows = earlier_rows(args.json, args.episodes, args.seed)
    for key, (policy, env, kwargs) in zip(keys, todo, strict=True):
        if key in rows:
            continue
        row = evaluate.measure(policy, env, args.episodes, args.seed, kwargs)
        rows[key] = {"under": kwargs["randomization"], "weights": key[1], **row}
        if args.json is not None:
            so_far = [rows[one] for one in keys if one in rows]
            write_json_atomic(args.json, {**HEAD, "rows": so_far, "provenance": origin})
    return {**HEAD, "rows": [rows[key] for key in keys]}


def earlier_rows(
    path: Path | None, episodes: int, seed: int
) -> dict[tuple[str, str | None, str, str], dict[str, Any]]:
    """Return the rows that an earlier command left in its file.

    :param path: of the JSON file, if there is one
    :param episodes: of every row
    :param seed: of every row
    :return: rows by policy, digest of its weights, name of the randomization, and digest of the
        world
    """
    if path is None or not path.exists():
        return {}
    return {
        (one["policy"], one.get("weights"), one["under"], one["world"]): one
        for one in read_measurement(path, HEAD["kind"])["rows"]
        if (one["episodes"], one["seed"]) == (episodes, seed)
    }


def worlds_of(env: str, kwargs: Mapping[str, Any], names: Sequence[str] | None) -> list[str]:
    """Return the names of worlds that an environment has.

    :param env: id
    :param kwargs: its keyword arguments
    :param names: wanted ones; all by default
    :raises UsageError: for a name that no environment has
    """
    from saver_envs.randomization.presets import ALL, HELD_OUT, PRESETS
    from saver_envs.registration import parameters_of, task_and_settings

    known = parameters_of(task_and_settings(env, kwargs)[0])
    held_out = [f"{HELD_OUT}{one.name}" for one in known if one.held_out is not None]
    every = [*PRESETS, *held_out, f"{HELD_OUT}{ALL}"]
    if names is None:
        return every
    for name in names:
        if name not in every and not name.startswith(HELD_OUT):
            raise UsageError(f"argument --worlds: {name!r} is none of {', '.join(every)}")
    return [name for name in names if name in every]


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file
    :return: Markdown
    """
    from saver_advisors.reporting.provenance import measured_at
    from saver_advisors.reporting.tables import markdown
    from saver_advisors.reporting.templates import rendered

    rows = figures["rows"]
    policies = list(dict.fromkeys((one["policy"], one["env"]) for one in rows))
    cells = {(one["policy"], one["under"]): one for one in rows}
    table = []
    for world in dict.fromkeys(one["under"] for one in rows):
        measured = [cells.get((policy, world)) for policy, _ in policies]
        table.append([f"`{world}`", *(_cell(one) for one in measured)])
    return rendered(
        "saver_advisors.benchmark",
        "varied_worlds.md.j2",
        title=figures["title"],
        table=markdown(["world", *(f"`{policy}`" for policy, _ in policies)], table),
        episodes=rows[0]["episodes"],
        seed=rows[0]["seed"],
        measured=measured_at(figures),
    )


def _cell(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return "-"
    return f"{row['success_rate']:.2f} / {row['safe_success_rate']:.2f}"
