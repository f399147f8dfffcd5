"""Train an algorithm of yours by the benchmark's protocol, and write its result file.

Seeds from 10,000 make the curve and choose a checkpoint, seeds from 0 report the last policy and
the chosen one; the policy acts alone, without noise. Interrupted, it leaves the file with what it
had shown; run again, it starts from the beginning.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.evaluation.protocol import (
    EVALUATE_EVERY,
    REPORT_EPISODES,
    SELECTION_EPISODES,
)
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.benchmark.recorder import BenchmarkPlan

EXAMPLES: Final = """\
examples:
  saver benchmark run --env JacoPush-v0 --algo docs/examples/td3_her.py:TD3HER \\
      --steps 400000 --seed 0 --output results
  saver benchmark run --env JacoPush-v0 --algo stable_baselines3:SAC --name sac-her \\
      --algo-kwargs replay_buffer_class=import:stable_baselines3:HerReplayBuffer \\
      learning_starts=1000 train_freq=16 gradient_steps=16 \\
      --steps 400000 --seed 0 --output results
  saver benchmark compare results/*.json --baselines docs/results/teachers.json

The class is one of Stable-Baselines3's, or has `learn` and `predict`:
see docs/benchmark-protocol.md."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_count, add_env_kwargs, at_least, env_id

    parser.add_argument("--env", type=env_id, required=True, metavar="ID", help="see `saver envs`")
    parser.add_argument(
        "--algo", required=True, metavar="MODULE:CLASS", help="or FILE.py:CLASS; what trains"
    )
    parser.add_argument(
        "--algo-kwargs",
        nargs="+",
        action="extend",
        metavar="NAME=VALUE",
        help="its keyword arguments, read as YAML; import:MODULE:NAME names a class",
    )
    parser.add_argument("--name", help="what tables call it (default: the class's name)")
    count = at_least(1)
    parser.add_argument(
        "--steps",
        type=count,
        metavar="N",
        help="environment steps in all (default: the environment's, as in `saver train`)",
    )
    parser.add_argument(
        "--seed", type=at_least(0), required=True, metavar="S", help="of everything random"
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="folder of the result file"
    )
    add_count(parser, "--n-envs", 16, "stepped together")
    add_env_kwargs(parser)
    told = parser.add_argument_group(
        "what went before", "steps that no table may leave out, as far as there were any"
    )
    for name, what in (("teacher", "trained its teachers"), ("demonstration", "demonstrated")):
        told.add_argument(
            f"--{name}-steps", type=at_least(0), default=0, metavar="N", help=f"that {what}"
        )
    rules = parser.add_argument_group("evaluations", "their seeds are fixed")
    for argument, default, what in (
        ("--eval-every", EVALUATE_EVERY, "environment steps between evaluations"),
        ("--eval-episodes", SELECTION_EPISODES, "episodes of each"),
        ("--report-episodes", REPORT_EPISODES, "episodes of the one that is reported"),
    ):
        rules.add_argument(
            argument, type=count, default=default, metavar="N", help=f"{what} (default: {default})"
        )


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Train, evaluate, write.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.benchmark.recorder import Recorder
    from saver_advisors.benchmark.third_party import (
        AlgorithmError,
        load_class,
        resolved,
        train,
    )
    from saver_advisors.reporting.errors import UsageError, user_mistakes

    with user_mistakes("argument --algo"):
        algorithm = load_class(args.algo)
    plan = plan_of(args, algorithm)
    with user_mistakes("argument --algo-kwargs"):
        resolved(plan.algo_kwargs)
    recorder = Recorder(plan, args.output, progress=_tell)
    if _is_finished(recorder.path, plan):
        print(f"{recorder.path} is finished: nothing to do")
        return 0
    args.output.mkdir(parents=True, exist_ok=True)
    try:
        record = train(algorithm, recorder)
    except AlgorithmError as error:
        raise UsageError(f"argument --algo: {error}") from error
    _report(record)
    print(f"wrote {recorder.path}")
    return 0


def plan_of(args: argparse.Namespace, algorithm: type[Any]) -> BenchmarkPlan:
    """What the command line asks for.

    :param args: the command line
    :param algorithm: the class that it names
    :return: the plan
    """
    from saver_advisors.benchmark.recorder import BenchmarkPlan
    from saver_advisors.benchmark.third_party import source_sha256
    from saver_advisors.cli.arguments import checked_env_kwargs, settings
    from saver_advisors.evaluation.protocol import training_seed
    from saver_advisors.reporting.errors import UsageError, user_mistakes
    from saver_advisors.training.defaults import default_settings

    with user_mistakes("argument --seed"):
        training_seed(args.seed)
    if args.output.exists() and not args.output.is_dir():
        raise UsageError(f"argument --output: {str(args.output)!r} is a file, no folder")
    row = args.name or getattr(algorithm, "__name__", args.algo.rpartition(":")[2])
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", f"{args.env}-{row}-seed{args.seed}")
    return BenchmarkPlan(
        name=stem,
        row=row,
        env_id=args.env,
        env_kwargs=checked_env_kwargs(args.env, args.env_kwargs),
        algorithm=args.algo,
        algo_kwargs=settings(args.algo_kwargs, "--algo-kwargs"),
        source_sha256=source_sha256(algorithm),
        n_envs=args.n_envs,
        total_steps=args.steps or default_settings(args.env)["total_steps"],
        seed=args.seed,
        eval_every=args.eval_every,
        eval_episodes=args.eval_episodes,
        report_episodes=args.report_episodes,
        teacher_steps=args.teacher_steps,
        demonstration_steps=args.demonstration_steps,
    )


def _is_finished(path: Path, plan: BenchmarkPlan) -> bool:
    """Whether the file holds this very run, finished; one that is not, or is damaged, is redone.

    :raises UsageError: where it holds a finished run of other settings
    """
    from saver_advisors.reporting.errors import UsageError

    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        finished, config = record["finished"], record["config"]
    except FileNotFoundError:
        return False
    except (OSError, ValueError, KeyError, TypeError):
        print(f"{path} is damaged: the run starts again")
        return False
    if not finished:
        print(f"{path} was interrupted: the run starts again")
        return False
    # By way of JSON, so that tuples equal the lists they became.
    wanted = json.loads(json.dumps(plan.config()))
    other = sorted(name for name in wanted if wanted[name] != config.get(name))
    if other:
        raise UsageError(
            f"argument --output: {path} holds a run of other settings ({', '.join(other)}): choose "
            "another folder or --name"
        )
    return True


def _tell(line: dict[str, Any]) -> None:
    print(
        f"{line['steps']:>11,} steps  success {line['success_rate']:.2f}  "
        f"{line['wall_clock_s'] / 60:.1f} min",
        flush=True,
    )


def _report(record: dict[str, Any]) -> None:
    from saver_advisors.cli.evaluate import show

    show({**record["final"], "policy": f"{record['row']}, last policy"})
    if chosen := record["chosen"]:
        show({**chosen, "policy": f"{record['row']}, chosen after {chosen['steps']:,} steps"})
