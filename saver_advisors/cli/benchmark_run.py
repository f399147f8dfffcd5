"""Train your own algorithm by the benchmark protocol, and write a result file.

Evaluations with seeds from 10,000 make the curve and select a checkpoint; seeds from 0 report the
last policy and the selected one. The policy acts without advice and without noise. The same command
does the seeds that are not finished; an interrupted seed, whose result file holds the curve so far,
starts again.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.arguments import (
    add,
    add_count,
    add_env,
    add_env_kwargs,
    add_folder,
    add_settings,
    checked_env_kwargs,
    settings,
)
from saver_advisors.cli.evaluate import show
from saver_advisors.cli.experiments import execute
from saver_advisors.evaluation import protocol
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.experiments.recorder import BenchmarkPlan

EXAMPLES: Final = """\
examples:
  saver benchmark run --env JacoPush-v0 --algo docs/examples/td3_her.py:TD3HER \\
      --steps 400000 --seeds 0-4 --processes 2 --output results
  saver benchmark run --env JacoPush-v0 --algo stable_baselines3:SAC --name sac-her \\
      --algo-kwargs replay_buffer_class=import:stable_baselines3:HerReplayBuffer \\
      learning_starts=1000 train_freq=16 gradient_steps=16 \\
      --steps 400000 --seed 0 --output results
  saver benchmark compare results/*.json --baselines docs/results/teachers.json

The class is from Stable-Baselines3, or has `learn` and `predict`
(see docs/benchmark-protocol.md)."""


RUNS_FOLDER: Final = "runs"
"""Folder with the logs of the runs, in that of the results."""


def seed_range(text: str) -> list[int]:
    """Parse seeds for argparse.

    :param text: such as ``0-4`` or ``0,3,7``
    :return: the seeds, each once, ascending
    """
    seeds: set[int] = set()
    for part in text.split(","):
        found = re.fullmatch(r"(\d+)(?:-(\d+))?", part.strip())
        if found is None:
            raise argparse.ArgumentTypeError(f"{text!r} must be such as 0-4 or 0,3,7")
        seeds.update(range(int(found[1]), int(found[2] or found[1]) + 1))
    if not seeds:
        raise argparse.ArgumentTypeError(f"{text!r} holds no seed: the first must be the smaller")
    return sorted(seeds)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_env(parser, required=True)
    add(parser, "--algo", "the algorithm; or FILE.py:CLASS", required=True, metavar="MODULE:CLASS")
    text = "its keyword arguments as YAML; import:MODULE:NAME refers to a class"
    add_settings(parser, "--algo-kwargs", text)
    add(parser, "--name", "its name in tables (default: the class's name)")
    text = "total environment steps (default: the environment's, as in `saver train`)"
    add_count(parser, "--steps", None, text)
    which = parser.add_mutually_exclusive_group(required=True)
    text = "seed of all random numbers of one run"
    add_count(which, "--seed", None, text, least=0, metavar="S")
    add(which, "--seeds", "seeds of several runs: 0-4, or 0,3,7", type=seed_range, metavar="A-B")
    add_count(parser, "--processes", 1, "runs in parallel, with --seeds")
    add_folder(parser, "--output", "folder of the result file", required=True)
    add_count(parser, "--n-envs", 16, "environments stepped in parallel")
    add_env_kwargs(parser)
    text = "further ones for training only, such as easier starts: in_hand_probability=0.4"
    add_settings(parser, "--train-env-kwargs", text)
    earlier = parser.add_argument_group("earlier steps", "tables add them to the run's own steps")
    add_count(earlier, "--teacher-steps", 0, "steps that trained its teachers", least=0)
    add_count(earlier, "--demonstration-steps", 0, "steps of demonstrations", least=0)
    rules = parser.add_argument_group("evaluations", "their seeds are fixed")
    add_count(
        rules, "--eval-every", protocol.EVALUATE_EVERY, "environment steps between evaluations"
    )
    add_count(rules, "--eval-episodes", protocol.SELECTION_EPISODES, "episodes per evaluation")
    add_count(
        rules, "--report-episodes", protocol.REPORT_EPISODES, "episodes of the reported evaluation"
    )


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Train, evaluate, and write the result file.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.experiments.third_party import load_class, resolved

    with user_mistakes("argument --algo"):
        algorithm = load_class(args.algo)
    plans = [plan_of(args, algorithm, seed) for seed in args.seeds or [args.seed]]
    with user_mistakes("argument --algo-kwargs"):
        resolved(plans[0].algo_kwargs)
    left = [plan for plan in plans if not _is_finished(args.output / f"{plan.name}.json", plan)]
    if not left:
        return 0
    args.output.mkdir(parents=True, exist_ok=True)
    return _run_seeds(args, plans) if args.seeds else _run_seed(args, algorithm, left[0])


def _run_seed(args: argparse.Namespace, algorithm: type[Any], plan: BenchmarkPlan) -> int:
    """Do one run in this process."""
    from tqdm import tqdm

    from saver_advisors.experiments.recorder import Recorder
    from saver_advisors.experiments.third_party import AlgorithmError, train

    with tqdm(total=plan.total_steps, unit="step", dynamic_ncols=True) as bar:
        recorder = Recorder(
            plan, args.output, progress=_tell, stepped=lambda steps: bar.update(steps - bar.n)
        )
        try:
            record = train(algorithm, recorder)
        except AlgorithmError as error:
            raise UsageError(f"argument --algo: {error}") from error
    _report(record)
    print(f"wrote {recorder.path}")
    return 0


def _run_seeds(args: argparse.Namespace, plans: Sequence[BenchmarkPlan]) -> int:
    """Do several runs in processes, like those of a grid."""
    from saver_advisors.experiments.grid import ExperimentRun, Grid
    from saver_advisors.experiments.results import is_done, read_result
    from saver_advisors.experiments.scheduler import LocalProcesses, Places

    runs = [ExperimentRun(one.name, "", one.row, one, one.report_episodes) for one in plans]
    places = Places(args.output / RUNS_FOLDER, args.output)
    backend = LocalProcesses(places, args.processes)
    status = execute(Grid(plans[0].row, tuple(runs)), places, backend)
    for run in runs:
        if is_done(places.result(run), run):
            _report(read_result(places.result(run)))
    return status


def plan_of(args: argparse.Namespace, algorithm: type[Any], seed: int) -> BenchmarkPlan:
    """Make the plan of the run from the command line.

    :param args: the command line
    :param algorithm: the class that ``--algo`` names
    :param seed: of the run
    """
    from saver_advisors.experiments.grid import THIRD_PARTY_KEYS, third_party_plan

    with user_mistakes("argument --seeds" if args.seeds else "argument --seed"):
        protocol.training_seed(seed)
    name = args.name or getattr(algorithm, "__name__", args.algo.rpartition(":")[2])
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", f"{args.env}-{name}-seed{seed}")
    shared = {key: getattr(args, key) for key in ("n_envs", "eval_every", "eval_episodes")}
    for argument in ("--env-kwargs", "--train-env-kwargs"):
        key = argument[2:].replace("-", "_")
        shared[key] = checked_env_kwargs(args.env, getattr(args, key), argument)
    if args.steps is not None:
        shared["total_steps"] = args.steps
    row = {key: getattr(args, key, None) for key in THIRD_PARTY_KEYS}
    row |= {"algorithm": args.algo, "algo_kwargs": settings(args.algo_kwargs, "--algo-kwargs")}
    group = {"env_id": args.env, "settings": shared}
    labels = {"name": stem, "row": name}
    with user_mistakes():
        return third_party_plan(group, row, seed, args.report_episodes, labels)


def _is_finished(path: Path, plan: BenchmarkPlan) -> bool:
    """Return whether the file holds this run, finished; unfinished and damaged files are redone.

    :raises UsageError: if the file holds a finished run with other settings
    """
    from saver_advisors.experiments.results import changed_settings

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
    other = changed_settings(plan, config)
    if other:
        raise UsageError(
            f"argument --output: {path} holds a run with other settings ({', '.join(other)}): "
            "choose another folder or --name"
        )
    print(f"{path} is already finished")
    return True


def _tell(line: dict[str, Any]) -> None:
    from tqdm import tqdm

    tqdm.write(
        f"{line['steps']:>11,} steps  success {line['success_rate']:.2f}  "
        f"{line['wall_clock_s'] / 60:.1f} min"
    )


def _report(record: dict[str, Any]) -> None:
    show({**record["final"], "policy": f"{record['row']}, last policy"})
    if chosen := record["chosen"]:
        show({**chosen, "policy": f"{record['row']}, chosen after {chosen['steps']:,} steps"})
