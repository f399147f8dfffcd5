"""`saver train --zoo`: the same arguments, under RL Zoo."""

from __future__ import annotations

import argparse
from typing import Any

from saver_advisors.cli.arguments import checked_env_kwargs
from saver_advisors.cli.train_settings import apply_advice, apply_set
from saver_advisors.reporting.errors import UsageError, user_mistakes


def run_zoo(args: argparse.Namespace) -> int:
    """Train under RL Zoo, from those arguments of ``saver train`` that have a meaning there.

    :param args: the command line of ``saver train``.
    :return: exit status.
    :raises UsageError: for arguments that do not fit.
    """
    from saver_advisors.zoo import arguments as zoo

    for name in ("algorithm", "time_limit", "json", "print_config"):
        if getattr(args, name):
            raise UsageError(f"argument --{name.replace('_', '-')}: not available with --zoo")
    for name, unset, own in (
        ("threads", 1, "--num-threads"),
        ("tensorboard", False, "--tensorboard-log DIR"),
        ("wandb", None, "--track"),
    ):
        if getattr(args, name) != unset:
            raise UsageError(f"argument --{name}: RL Zoo has {own}, which goes after --")
    for name in ("env", "output"):
        if getattr(args, name) is None:
            raise UsageError(f"argument --{name}: --zoo needs it")
    zoo.algorithm_name(args.zoo, advised=False)  # rejects an unknown name before the file is read
    zoo.check_arguments(args.zoo_arguments)
    config = args.config or zoo.settings_path(args.zoo)
    entry, advice = zoo.read_settings(config, args.env)
    values: dict[str, Any] = {"advice": advice}
    apply_advice(values, args)
    chosen = dict(entry)
    apply_set(chosen, args)
    hyperparameters = {k: v for k, v in chosen.items() if k not in entry or v != entry[k]}
    env_kwargs = checked_env_kwargs(args.env, args.env_kwargs)
    seed = args.seed or 0
    algorithm = zoo.algorithm_name(args.zoo, advised=values["advice"] is not None)
    if values["advice"] is not None:
        with user_mistakes("advice"):
            steps = args.steps or int(chosen["n_timesteps"])
            hyperparameters["advisor"] = zoo.ready_advice(
                values["advice"], args.env, env_kwargs, steps, seed
            )
    words = zoo.zoo_arguments(
        algorithm,
        args.env,
        config,
        args.output,
        hyperparameters=hyperparameters,
        env_kwargs=env_kwargs,
        seed=seed,
        steps=args.steps,
        trained=zoo.latest_model(args.output, algorithm, args.env) if args.resume else None,
    )
    from saver_advisors.zoo.manager import train

    train([*words, *args.zoo_arguments])
    return 0
