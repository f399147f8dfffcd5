"""Train a policy, alone or with the advice of a single-arm teacher.

The default settings are the environment's entry of zoo_configs/saver.yml. Ctrl-C lets the current
block finish and writes a checkpoint.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

from saver_advisors.cli import arguments
from saver_advisors.cli.train_settings import configuration
from saver_advisors.cli.train_zoo import run_zoo
from saver_advisors.reporting.errors import UsageError, user_mistakes

EXAMPLES = """\
examples:
  saver train --env JacoPush-v0 --output runs/push                   one arm
  saver train --output runs/push --resume                            continue after Ctrl-C
  saver train --env DualJacoPush-v0 --output runs/dual               two arms
  saver train --env JacoPush-v0 --output runs/tb --tensorboard       and: tensorboard --logdir runs
  saver train --env DualJacoPush-v0 --output runs/three --env-kwargs n_arms=3
  saver train --env DualJacoPush-v0 --output runs/mcq --advice mc-q --teacher jaco-push \\
      --budget 100000 --threshold 0.1
  saver train --env MicoPush-v0 --output runs/mico --algorithm sac --set learning_rate=5e-4
  saver train --env JacoPush-v0 --print-config > mine.yml            then --config mine.yml
  saver train --zoo sac --env DualJacoPush-v0 --output logs          under RL Zoo, with advice
  saver train --zoo td3 --env JacoPush-v0 --output logs -- --save-freq 100000 --progress"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    arguments.add_env(parser)
    arguments.add_folder(parser, "--output", "the run's folder")
    arguments.add_flag(parser, "--resume", "continue from its checkpoint")
    arguments.add_count(parser, "--steps", None, "total environment steps")
    arguments.add_count(parser, "--seed", None, "seed of all random numbers", least=0, metavar="S")
    arguments.add(parser, "--algorithm", "ddpg, td3, sac or tqc", metavar="NAME")
    text = "settings in YAML or JSON that replace the environment's defaults"
    arguments.add_path(parser, "--config", text)
    text = "any setting, such as batch_size=512 or net_arch=[64,64]; see --print-config"
    arguments.add_settings(parser, "--set", text)
    arguments.add_env_kwargs(parser)
    arguments.add_seconds(parser, "--time-limit", "stop with a checkpoint after this time")
    arguments.add_threads(parser)
    arguments.add_flag(parser, "--print-config", "show the settings as YAML and stop")
    advice = parser.add_argument_group("advice")
    text = "early, mc-q, MODULE:CLASS or none; replaces the settings' use of the teacher"
    arguments.add(advice, "--advice", text, metavar="STRATEGY")
    text = "a shipped policy, weight file, run's folder, SB3 zip or MODULE:FUNCTION"
    arguments.add(advice, "--teacher", text, type=arguments.teacher, metavar="NAME")
    arguments.add_count(advice, "--budget", None, "environment steps that may be advised", least=0)
    arguments.add(advice, "--threshold", "for correcting strategies", type=float, metavar="T")
    zoo = parser.add_argument_group("RL Zoo")
    text = "run under RL Zoo: ddpg, td3, sac, tqc, a goal learner such as goal_td3, or cpo, "
    arguments.add(zoo, "--zoo", f"{text}trpolag, ppolag", metavar="ALGO")
    arguments.add(
        zoo, "zoo_arguments", "RL Zoo's own arguments, after --", nargs="*", metavar="ARG"
    )
    arguments.add_json(parser)
    arguments.add_flag(parser, "--tensorboard", "write the curve to DIR/tensorboard as well")
    text = "send the curve to Weights & Biases (default project: saver)"
    arguments.add(parser, "--wandb", text, nargs="?", const="saver", metavar="PROJECT")
    arguments.add_flag(parser, "--no-progress", "show no progress bar")


def run(args: argparse.Namespace) -> int:
    """Train until the steps are done, the time is over, or Ctrl-C is pressed."""
    from saver_advisors.training.settings import RunConfig

    if args.zoo is not None:
        return run_zoo(args)
    if args.zoo_arguments:
        raise UsageError(f"argument {args.zoo_arguments[0]}: only --zoo takes further arguments")
    values = configuration(args)
    with user_mistakes():
        config = RunConfig.from_mapping(values)
    if args.print_config:
        import yaml

        print(yaml.safe_dump(config.to_mapping(), sort_keys=False), end="")
        return 0
    _check_output(args, config)
    result = _train(args, config)
    _report(args, config, result)
    figures = {**asdict(result), "output_dir": str(result.output_dir)}
    arguments.write_json(args.json, {"kind": "training", "config": config.to_mapping(), **figures})
    # A requested time limit is a normal end, Ctrl-C is not.
    return 0 if result.finished or args.time_limit is not None else 130


def _check_output(args: argparse.Namespace, config: Any) -> None:
    """Check the folder and the environment's id before anything is built."""
    if args.output is None:
        raise UsageError("argument --output: say which folder the run goes to")
    if not args.resume and (args.output / "run.json").exists():
        raise UsageError(
            f"argument --output: {str(args.output)!r} holds a run already: go on with it by "
            "--resume, or choose another folder"
        )
    from saver_advisors.training.run import find_own_checkpoint

    with user_mistakes("argument --output"):
        # Before the settings are built: those of a file may name code, which is then imported.
        find_own_checkpoint(args.output, config, args.resume)
    try:
        arguments.env_id(config.env_id)
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"argument --config: {error}") from error


def _train(args: argparse.Namespace, config: Any) -> Any:
    from saver_advisors.reporting.curve_logging import curve_logs
    from saver_advisors.training.launch import open_run

    with contextlib.ExitStack() as stack:
        log = stack.enter_context(curve_logs(_destinations(args, config)))
        with user_mistakes():
            run = stack.enter_context(open_run(config, args.output, args.threads))

        def update(*_: object) -> bool:
            """Send new points, after every step."""
            log(run.curve)
            return True

        try:
            # The settings fit. What fails now is the folder, such as a damaged checkpoint.
            with user_mistakes("argument --output"):
                result = run.train(
                    args.resume,
                    not args.no_progress,
                    callback=update,
                    time_limit=args.time_limit,
                )
        except KeyboardInterrupt:
            print(f"stopped at once; from the last checkpoint: {_resume_command(args.output)}")
            raise
        log(run.curve)
        return result


def _destinations(args: argparse.Namespace, config: Any) -> list[Any]:
    """Return the contexts of the curve's destinations, whose packages are installed."""
    from saver_advisors.reporting.curve_logging import tensorboard_log, wandb_log

    destinations: list[Any] = []
    if args.tensorboard:
        importlib.import_module("tensorboard")
        destinations.append(tensorboard_log(args.output))
    if args.wandb is not None:
        importlib.import_module("wandb")
        destinations.append(wandb_log(args.output, args.wandb, config.to_mapping()))
    return destinations


def _report(args: argparse.Namespace, config: Any, result: Any) -> None:
    from saver_advisors.reporting import tables

    rates = (result.success_rate, result.best_success_rate)
    success = ["-" if rate is None else f"{rate:.3f}" for rate in rates]
    columns = ("run", "steps", "gradient steps", "seconds", "success", "best success")
    work = (f"{result.steps:,}", f"{result.updates:,}", f"{result.wall_clock_s:,.0f}")
    tables.show(columns, [[str(result.output_dir), *work, *success]])
    folder = shlex.quote(str(args.output))
    if result.finished:
        print(f"evaluate it:  saver evaluate --env {config.env_id} --policy {folder}")
        print(f"ship it:      saver export {folder} --path policy.safetensors")
    else:
        print(f"not finished, nothing is lost; go on with:  {_resume_command(args.output)}")


def _resume_command(output: Path) -> str:
    return f"saver train --output {shlex.quote(str(output))} --resume"
