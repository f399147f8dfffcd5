"""`saver train --zoo`: the same arguments, under RL Zoo."""

from __future__ import annotations

import argparse
from typing import Any

from saver_advisors.cli.arguments import checked_env_kwargs
from saver_advisors.cli.train_settings import apply_advice, apply_set
from saver_advisors.reporting.errors import UsageError, user_mistakes


def run_zoo(args: argparse.Namespace) -> int:
    """Train under RL Zoo, from the same arguments as far as they mean something there.

    :param args: the command line of ``saver train``
    :return: exit status
    """
    from saver_advisors.zoo.arguments import (
        ZooRun,
        algorithm_name,
        check_arguments,
        latest_model,
        read_settings,
        ready_advice,
        settings_path,
        start,
    )

    for name in ("algorithm", "time_limit", "json", "print_config"):
        if getattr(args, name):
            raise UsageError(f"argument --{name.replace('_', '-')}: RL Zoo knows no such thing")
    if args.threads != 1:
        raise UsageError("argument --threads: RL Zoo has --num-threads, which goes after --")
    for name in ("env", "output"):
        if getattr(args, name) is None:
            raise UsageError(f"argument --{name}: --zoo needs it")
    algorithm_name(args.zoo, advised=False)  # is there one of that name?
    check_arguments(args.zoo_arguments)
    config = args.config or settings_path(args.zoo)
    entry, advice = read_settings(config, args.env)
    values: dict[str, Any] = {"advice": advice}
    apply_advice(values, args)
    chosen = dict(entry)
    apply_set(chosen, args)
    env_kwargs = checked_env_kwargs(args.env, args.env_kwargs)
    if values["advice"] is not None:
        with user_mistakes("advice"):
            steps, seed = args.steps or int(chosen["n_timesteps"]), args.seed or 0
            values["advice"] = ready_advice(values["advice"], args.env, env_kwargs, steps, seed)
    algorithm = algorithm_name(args.zoo, advised=values["advice"] is not None)
    trained = latest_model(args.output, algorithm, args.env) if args.resume else None
    start(
        ZooRun(
            algorithm,
            args.env,
            config,
            args.output,
            advice=values["advice"],
            steps=args.steps,
            seed=args.seed or 0,
            overrides={k: v for k, v in chosen.items() if k not in entry or v != entry[k]},
            env_kwargs=env_kwargs,
            trained=trained,
            more=args.zoo_arguments,
        )
    )
    return 0
