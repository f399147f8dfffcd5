"""The settings of `saver train`: an environment's or a file's, and what the command line says."""

from __future__ import annotations

import argparse
import json
from typing import Any

from saver_advisors.cli.arguments import settings
from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes


def configuration(args: argparse.Namespace) -> dict[str, Any]:
    """The settings: the file's or the environment's, then what the command line says otherwise.

    :param args: the command line
    :return: fields of ``RunConfig``
    """
    values = _starting_point(args)
    for name, given in (
        ("total_steps", args.steps),
        ("seed", args.seed),
        ("algorithm", args.algorithm),
    ):
        if given is not None:
            values[name] = given
    env_kwargs = settings(args.env_kwargs, "--env-kwargs")
    values["env_kwargs"] = {**values.get("env_kwargs", {}), **env_kwargs}
    apply_advice(values, args)
    apply_set(values, args)
    return values


def apply_set(values: dict[str, Any], args: argparse.Namespace) -> None:
    """Change settings as ``--set`` says; ``outer.inner=value`` sets a part of one.

    :param values: the settings
    :param args: the command line
    """
    for name, value in settings(args.set, "--set").items():
        outer, _, inner = name.partition(".")
        if not inner:
            values[name] = value
        elif isinstance(values.get(outer) or {}, dict):
            values[outer] = {**(values.get(outer) or {}), inner: value}
        else:
            raise UsageError(f"argument --set: {name!r}: {outer!r} has no parts")


def _starting_point(args: argparse.Namespace) -> dict[str, Any]:
    from saver_advisors.training.defaults import default_settings, read_settings

    if args.config is not None:
        with user_mistakes("argument --config"):
            return read_settings(args.config, args.env)
    record = None if args.output is None else args.output / "run.json"
    if args.resume and record is not None and record.is_file():
        with user_mistakes(f"argument --output: {record}"):
            saved: dict[str, Any] = json.loads(record.read_text(encoding="utf-8"))["config"]
        return {**saved, "env_id": args.env or saved["env_id"]}
    if args.env is None:
        raise UsageError("argument --env: say what to train in; `saver envs` lists the ids")
    return default_settings(args.env)


def apply_advice(values: dict[str, Any], args: argparse.Namespace) -> None:
    """Change settings as the command line says about advice.

    :param values: the settings; ``advice`` is changed
    :param args: the command line
    """
    from saver_advisors.advising import STRATEGIES

    given = {
        "strategy": args.advice,
        "teacher": args.teacher,
        "budget": args.budget,
        "threshold": args.threshold,
    }
    given = {name: value for name, value in given.items() if value is not None}
    if not given:
        return
    own = args.advice is not None and ":" in args.advice
    if args.advice is not None and not own and args.advice not in STRATEGIES:
        raise UsageError(f"argument --advice: {unknown('strategy', args.advice, STRATEGIES)}")
    if args.advice == "none":
        values["advice"] = None
        return
    kept = values.get("advice") or {}
    if args.advice is not None:
        # Another use of the teacher: nothing that belonged to the settings' own belongs to it.
        kept = {name: kept[name] for name in ("teacher", "arms") if name in kept}
    elif kept.get("strategy") == "none" and not given.keys() <= {"teacher"}:
        argument = "budget" if args.budget is not None else "threshold"
        raise UsageError(
            f"argument --{argument}: the settings use the teacher without advice; say which by "
            "--advice STRATEGY as well"
        )
    advice = {**kept, **given}
    for name, argument in (("strategy", "advice"), ("teacher", "teacher"), ("budget", "budget")):
        if name not in advice:
            raise UsageError(f"argument --{argument}: advice needs it as well")
    values["advice"] = advice
