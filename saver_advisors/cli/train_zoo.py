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
    words = _zoo_words(args)
    from saver_advisors.zoo.manager import train

    train([*words, *args.zoo_arguments])
    return 0


def _zoo_words(args: argparse.Namespace) -> list[str]:
    """Return RL Zoo's command line.

    RL Zoo 2.9 does not pass the file's `env_kwargs`, which make starts easier, to its evaluations.
    The command line does not rely on that: it resets each of them to its default there, except for
    `randomization`, which the evaluations share.
    """
    from saver_advisors.zoo import arguments as zoo
    from saver_envs.registration import default_options

    zoo.algorithm_name(args.zoo, advised=False)  # rejects an unknown name before the file is read
    for word in args.zoo_arguments:
        name = word.split("=")[0]
        if name in zoo.OURS:
            own = zoo.OURS[name]
            raise UsageError(f"argument {name}: use {own} of `saver train`, before the --")
    config = args.config or zoo.settings_path(args.zoo)
    entry, advice = zoo.read_settings(config, args.env)
    values: dict[str, Any] = {"advice": advice}
    apply_advice(values, args)
    chosen = dict(entry)
    apply_set(chosen, args)
    hyperparameters = {k: v for k, v in chosen.items() if k not in entry or v != entry[k]}
    env_kwargs = checked_env_kwargs(args.env, args.env_kwargs)
    easier = entry.get("env_kwargs") or {}
    usual = default_options(args.env)
    kept = ("randomization",)
    measured = {name: value if name in kept else usual[name] for name, value in easier.items()}
    seed = args.seed or 0
    algorithm = zoo.algorithm_name(args.zoo, advised=values["advice"] is not None)
    if values["advice"] is not None:
        with user_mistakes("advice"):
            steps = args.steps or int(chosen["n_timesteps"])
            hyperparameters["advisor"] = zoo.ready_advice(
                values["advice"], args.env, env_kwargs, steps, seed
            )
    words = ["--algo", algorithm, "--env", args.env, "--conf-file", str(config)]
    words += ["--log-folder", str(args.output), "--seed", str(seed), "--num-threads", "1"]
    words += zoo.EVALUATION
    if args.steps is not None:
        words += ["--n-timesteps", str(args.steps)]
    if args.resume:
        words += ["--trained-agent", str(zoo.latest_model(args.output, algorithm, args.env))]
    for name, given in (
        ("--hyperparams", hyperparameters),
        ("--env-kwargs", {**easier, **env_kwargs}),
        ("--eval-env-kwargs", {**measured, **env_kwargs}),
    ):
        if given:
            # RL Zoo evaluates what follows the colon as Python.
            words += [name, *(f"{key}:{value!r}" for key, value in given.items())]
    return words
