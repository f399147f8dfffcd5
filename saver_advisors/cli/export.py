"""Export a training run as a weight file with a card.

The command exports the better of the best and the latest policy. It selects on other seeds than
the card reports. A weight file instead of a run is measured again, which renews its card.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from saver_advisors.cli.arguments import add, add_count, add_file, add_json, add_path, write_json
from saver_advisors.cli.curves import read_run
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.training.threads import one_thread_of_algebra

EXAMPLES = """\
examples:
  saver export runs/push --path push.safetensors
  saver export runs/push --name jaco-push          from a clone: among the shipped policies
  saver export push.safetensors --path push.safetensors   measure it again"""


EPISODES = 200
"""Default number of episodes per evaluation of a run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    text = "a folder of `saver train`, or a weight file"
    add_path(parser, "run_dir", text, metavar="RUN_DIR")
    where = parser.add_mutually_exclusive_group(required=True)
    text = "add it to the shipped policies under this name; only in a clone of the repository"
    add(where, "--name", text)
    add_file(where, "--path", "write the weights to this file", ".safetensors")
    text = "episodes per evaluation (default: 200, or as on the card of a weight file)"
    add_count(parser, "--episodes", None, text)
    add(parser, "--task", "description of the task, for the card", metavar="TEXT")
    add_json(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Choose the policy, measure it, and write weights and card."""
    from saver_advisors.reporting.evaluation_table import EVALUATION_COLUMNS
    from saver_advisors.reporting.tables import show_rows
    from saver_advisors.training.release import release_run, remeasure

    path = args.path or shipped_path(args.name)
    figures: dict[str, Any] = {"kind": "export", "policy": path.stem}
    if args.run_dir.suffix == ".safetensors":
        with user_mistakes("argument RUN_DIR"):
            figures["summary"] = remeasure(args.run_dir, path, args.episodes)
        shown, chosen = {**figures, **figures["summary"]}, ""
    else:
        episodes = EPISODES if args.episodes is None else args.episodes
        config = read_run(args.run_dir, "").config
        env, env_kwargs = config["env_id"], config.get("env_kwargs", {})
        print(f"evaluating {args.run_dir}: up to three times {episodes} episodes")
        task = args.task or _task(env, env_kwargs)
        with user_mistakes("argument RUN_DIR"):
            released = release_run(args.run_dir, path, task=task, episodes=episodes)
        figures |= {"env_kwargs": env_kwargs, **released, **released["summary"]}
        shown, chosen = figures, f"took the {released['chosen']} policy; "
    show_rows([shown], EVALUATION_COLUMNS)
    print(f"{chosen}wrote {path} and {path.with_suffix('.md')}")
    write_json(args.json, figures)
    return 0


def shipped_path(name: str) -> Path:
    """Return the path of a shipped policy's weights.

    :param name: name of the policy
    :raises UsageError: outside a clone of the repository, or for an invalid name
    """
    from saver_advisors.policies.files import WEIGHTS_DIR
    from saver_advisors.reporting.provenance import REPOSITORY

    if not (REPOSITORY / "pyproject.toml").is_file():
        raise UsageError("argument --name: only for a clone of the repository; use --path")
    if not name or not all(letter.isalnum() or letter in "-_" for letter in name):
        raise UsageError(f"argument --name: {name!r} may only contain letters, digits, - and _")
    return WEIGHTS_DIR / f"{name}.safetensors"


def _task(env_id: str, env_kwargs: Mapping[str, Any]) -> str:
    from saver_envs.registration import row_of

    row = row_of(env_id)
    n_arms = env_kwargs.get("n_arms", row.n_arms)
    arms = ("one arm", "two arms", "three arms", "four arms")[n_arms - 1]
    return f"{row.task.name}, {arms}"
