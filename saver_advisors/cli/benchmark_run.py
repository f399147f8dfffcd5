"""Train your own algorithm by the benchmark protocol, and write a result file.

Evaluations with seeds from 10,000 make the curve and select a checkpoint; seeds from 0 report the
last policy and the selected one. The policy acts without advice and without noise. An interrupted
run leaves a result file with the curve so far; the same command then starts from the beginning.
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

The class is from Stable-Baselines3, or has `learn` and `predict`
(see docs/benchmark-protocol.md)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_count, add_env_kwargs, at_least, env_id, new_folder

    parser.add_argument("--env", type=env_id, required=True, metavar="ID", help="see `saver envs`")
    parser.add_argument(
        "--algo", required=True, metavar="MODULE:CLASS", help="the algorithm; or FILE.py:CLASS"
    )
    parser.add_argument(
        "--algo-kwargs",
        nargs="+",
        action="extend",
        metavar="NAME=VALUE",
        help="its keyword arguments as YAML; import:MODULE:NAME refers to a class",
    )
    parser.add_argument("--name", help="its name in tables (default: the class's name)")
    parser.add_argument(
        "--steps",
        type=at_least(1),
        metavar="N",
        help="total environment steps (default: the environment's, as in `saver train`)",
    )
    parser.add_argument(
        "--seed", type=at_least(0), required=True, metavar="S", help="seed of all random numbers"
    )
    parser.add_argument(
        "--output", type=new_folder, required=True, metavar="DIR", help="folder of the result file"
    )
    add_count(parser, "--n-envs", 16, "environments stepped in parallel")
    add_env_kwargs(parser)
    earlier = parser.add_argument_group("earlier steps", "tables add them to the run's own steps")
    add_count(earlier, "--teacher-steps", 0, "steps that trained its teachers", least=0)
    add_count(earlier, "--demonstration-steps", 0, "steps of demonstrations", least=0)
    rules = parser.add_argument_group("evaluations", "their seeds are fixed")
    add_count(rules, "--eval-every", EVALUATE_EVERY, "environment steps between evaluations")
    add_count(rules, "--eval-episodes", SELECTION_EPISODES, "episodes per evaluation")
    add_count(rules, "--report-episodes", REPORT_EPISODES, "episodes of the reported evaluation")


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Train, evaluate, and write the result file.

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
        print(f"{recorder.path} is already finished")
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
    """Make the plan of the run from the command line.

    :param args: the command line
    :param algorithm: the class that ``--algo`` names
    """
    from saver_advisors.benchmark.recorder import BenchmarkPlan
    from saver_advisors.benchmark.third_party import source_sha256
    from saver_advisors.cli.arguments import checked_env_kwargs, settings
    from saver_advisors.evaluation.protocol import training_seed
    from saver_advisors.reporting.errors import user_mistakes
    from saver_advisors.training.defaults import default_settings

    with user_mistakes("argument --seed"):
        training_seed(args.seed)
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
    """Return whether the file holds this run, finished; unfinished and damaged files are redone.

    :raises UsageError: if the file holds a finished run with other settings
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
    # Through JSON, so that tuples compare equal to lists.
    wanted = json.loads(json.dumps(plan.config()))
    other = sorted(name for name in wanted if wanted[name] != config.get(name))
    if other:
        raise UsageError(
            f"argument --output: {path} holds a run with other settings ({', '.join(other)}): "
            "choose another folder or --name"
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
