"""Settings of `saver train`: an environment's or a file's, changed by the command line."""

from __future__ import annotations

import argparse
from typing import Any

from saver_advisors.cli.arguments import settings
from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes


def configuration(args: argparse.Namespace) -> dict[str, Any]:
    """Read the settings of a file or an environment, and apply the command line to them.

    :param args: the command line.
    :return: fields of ``RunConfig``.
    :raises UsageError: for a file that cannot be read, or arguments that do not fit together.
    """
    values = _starting_point(args)
    given = {"total_steps": args.steps, "seed": args.seed, "algorithm": args.algorithm}
    values |= {name: value for name, value in given.items() if value is not None}
    env_kwargs = settings(args.env_kwargs, "--env-kwargs")
    values["env_kwargs"] = {**values.get("env_kwargs", {}), **env_kwargs}
    apply_advice(values, args)
    apply_set(values, args)
    return values


def apply_set(values: dict[str, Any], args: argparse.Namespace) -> None:
    """Apply ``--set``; ``outer.inner=value`` sets an entry of a nested setting.

    :param values: the settings, changed in place.
    :param args: the command line.
    :raises UsageError: for an entry of a setting that has none.
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
    from saver_advisors.training.run_folder import RECORD_FILE, read_record

    if args.config is not None:
        with user_mistakes("argument --config"):
            return read_settings(args.config, args.env)
    if args.resume and args.output is not None and (args.output / RECORD_FILE).is_file():
        with user_mistakes("argument --output"):
            saved = read_record(args.output)["config"]
        return {**saved, **({} if args.env is None else {"env_id": args.env})}
    if args.env is None:
        raise UsageError("argument --env: say what to train in; `saver envs` lists the ids")
    return default_settings(args.env)


def apply_advice(values: dict[str, Any], args: argparse.Namespace) -> None:
    """Apply the arguments about advice.

    :param values: the settings, whose ``advice`` is changed in place.
    :param args: the command line.
    :raises UsageError: for an unknown strategy, or arguments that do not fit together.
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
        # Another strategy: the other settings of advice belonged to the previous one.
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
