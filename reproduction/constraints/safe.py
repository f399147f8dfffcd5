"""CPO and the Lagrangians on a constrained problem whose optimum is known.

Each learns with several seeds; its mean action is then judged over fresh episodes by the return,
as a share of the best that any policy can have, and by the cost beside the limit.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import mean
from typing import Any, Final

from saver_advisors.benchmark.machine import progress
from saver_advisors.cli.measured import measured_or_read
from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.training.threads import one_thread_of_algebra

EXAMPLES: Final = """\
examples:
  python -m reproduction safe                                        three seeds each, minutes
  python -m reproduction safe --processes 2                          two runs at a time
  python -m reproduction safe --algorithms cpo --seeds 0             one run
  python -m reproduction safe --from safe.json --table page.md       an earlier one as a table"""

NAMES: Final = ("cpo", "trpolag", "ppolag")
SEEDS: Final = (9, 10, 11)
"""That had no part in finding the settings below, which was done on seeds 0 to 8."""
N_ENVS: Final = 100
EPISODES: Final = 2000
EVALUATION_SEED: Final = 1_000_000
MARGIN: Final = 0.03
"""Share of the limit that is left as a margin when learning: a rollout of 200 episodes tells the
cost to a few per cent, and the limit is to hold, not to be met on average.
"""
WITHIN: Final = 0.05
"""The return may fall short of the optimum by this share."""
COMMON: Final[dict[str, Any]] = {
    # Two episodes of each environment: by one, the cost that the price answers to is noise.
    "n_steps": 40,
    "batch_size": 500,
    "gamma": 1.0,
    "cost_gamma": 1.0,
    # As exploration dies down, an action's effect is small beside what a critic gets wrong.
    "n_cost_critic_updates": 20,
}
PRICED: Final[dict[str, Any]] = {
    # The advantages keep the unit of the rewards, so that lambda is what a unit of cost is worth
    # in reward: R* / (2 d), 0.67. Standardised, that price grows as exploration dies down.
    "normalize_advantage": False,
    # Integral control: the price must move more slowly than the policy that answers it.
    "multiplier_lr": 0.002,
    # On top of that, what the cost exceeds the limit by now: without it price and cost swing.
    "multiplier_gain": 0.3,
}
SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "cpo": {"n_critic_updates": 20},
    "trpolag": {
        **PRICED,
        "multiplier_init": 0.65,
        "n_critic_updates": 20,
        # A step of the usual 0.01 changes the cost by more than the margin.
        "target_kl": 0.005,
    },
    "ppolag": {
        **PRICED,
        "multiplier_init": 0.65,
        "n_epochs": 20,
        # Its steps have no trust region: unless they shrink, the cost of its last one is chance.
        "learning_rate": lambda remaining: 5e-5 + 2e-3 * remaining,
    },
}
"""Beside the classes' defaults."""
STEPS: Final[dict[str, int]] = {"cpo": 240_000, "trpolag": 320_000, "ppolag": 480_000}

BEGIN, END = "<!-- measured:begin -->", "<!-- measured:end -->"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_json, at_least

    parser.add_argument(
        "--algorithms",
        nargs="+",
        choices=NAMES,
        default=list(NAMES),
        help=f"which (default: {' '.join(NAMES)})",
    )
    parser.add_argument(
        "--seeds",
        nargs="+",
        type=at_least(0),
        default=list(SEEDS),
        metavar="N",
        help="one run each (default: 9 10 11)",
    )
    parser.add_argument(
        "--steps",
        type=at_least(1),
        metavar="N",
        help="environment steps of a run (default: "
        + ", ".join(f"{name} {steps:,}" for name, steps in STEPS.items())
        + ")",
    )
    parser.add_argument(
        "--processes",
        type=at_least(1),
        default=1,
        metavar="N",
        help="runs at a time, a core each (default: 1)",
    )
    parser.add_argument(
        "--table",
        type=Path,
        metavar="FILE",
        help=f"write the figures there as Markdown; in a page with {BEGIN} and {END}, between them",
    )
    parser.add_argument(
        "--from",
        dest="from_json",
        type=Path,
        metavar="FILE",
        help="show an earlier measurement's JSON file instead of measuring",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status: 0 where every run meets limit and optimum, else 1
    """
    from saver_advisors.reporting.errors import UsageError
    from saver_advisors.reporting.provenance import write_json_atomic

    try:
        figures = measured_or_read(args, "safe", lambda: measure(args))
        page = render(figures)
        print(page)
        if args.json is not None:
            write_json_atomic(args.json, figures)
            print(f"wrote {args.json}")
        if args.table is not None:
            args.table.write_text(placed(args.table, page), encoding="utf-8")
            print(f"wrote {args.table}")
    except OSError as error:
        raise UsageError(str(error)) from error
    return 0 if all(one["limit_met"] and one["near_optimum"] for one in figures["rows"]) else 1


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Do every run that was asked for.

    :param args: see :func:`add_arguments`
    :return: JSON-able: the problem's ``cost_limit`` and ``best_return``, and ``rows``, one a run
    """
    from reproduction.constraints.known_problem import COST_LIMIT, HORIZON, best_return

    runs = [
        (name, seed, args.steps or STEPS[name]) for name in args.algorithms for seed in args.seeds
    ]
    rows = []
    # Fresh processes: a forked one would share torch's threads and generators with this one.
    with (
        ProcessPoolExecutor(args.processes, get_context("spawn")) as pool,
        progress("safe", len(runs)) as advance,
    ):
        for row in pool.map(one_run, *zip(*runs, strict=True)):
            rows.append(row)
            advance()
    return {
        "title": "Safe baselines on a problem with a known optimum",
        "kind": "safe",
        "horizon": HORIZON,
        "cost_limit": COST_LIMIT,
        "margin": MARGIN,
        "within": WITHIN,
        "best_return": best_return(),
        "episodes": EPISODES,
        "rows": rows,
    }


@one_thread_of_algebra()
def one_run(name: str, seed: int, steps: int) -> dict[str, Any]:
    """Learn once, and judge what was learned.

    :param name: of the algorithm
    :param seed: of everything random
    :param steps: environment steps
    :return: JSON-able figures
    """
    from reproduction.constraints.known_problem import (
        COST_LIMIT,
        EffortCartVecEnv,
        best_return,
    )
    from saver_advisors.safe_baselines import ALGORITHMS

    began = time.process_time()
    settings = {**COMMON, **SETTINGS[name], "cost_limit": (1 - MARGIN) * COST_LIMIT}
    env = EffortCartVecEnv(N_ENVS, seed=seed)
    model: Any = ALGORITHMS[name]("MlpPolicy", env, seed=seed, device="cpu", **settings)
    model.learn(steps, log_interval=None)
    seconds = time.process_time() - began
    returned, cost = judge(model, deterministic=True)
    exploring_return, exploring_cost = judge(model, deterministic=False)
    share = returned / best_return()
    return {
        "algorithm": type(model).__name__,
        "seed": seed,
        "steps": model.num_timesteps,
        "return": returned,
        "share_of_optimum": share,
        "cost": cost,
        "limit_met": cost <= COST_LIMIT,
        "near_optimum": share >= 1 - WITHIN,
        "exploring_return": exploring_return,
        "exploring_cost": exploring_cost,
        "cpu_seconds": round(seconds, 1),
    }


def judge(model: Any, deterministic: bool) -> tuple[float, float]:
    """Mean return and mean cost of fresh episodes.

    :param model: what has SB3's ``predict``
    :param deterministic: whether the mean action is taken, or one drawn as in learning
    """
    from reproduction.constraints.known_problem import EffortCartVecEnv

    env = EffortCartVecEnv(EPISODES, seed=EVALUATION_SEED)
    observation: Any = env.reset()
    returned = cost = 0.0
    for _ in range(env.horizon):
        action, _ = model.predict(observation, deterministic=deterministic)
        observation, rewards, _, infos = env.step(action)
        returned += float(rewards.mean())
        cost += mean(info["cost"] for info in infos)
    return returned, cost


COLUMNS: Final = (
    "algorithm",
    "seed",
    "steps",
    "return",
    "of the optimum",
    "cost",
    "limit met",
    "cost while exploring",
    "CPU s",
)


def render(figures: Mapping[str, Any]) -> str:
    """The figures as Markdown.

    :param figures: what the command measured, or its JSON file's content
    """
    from saver_advisors.reporting.tables import markdown

    cells = [
        [
            one["algorithm"],
            str(one["seed"]),
            f"{one['steps']:,}",
            f"{one['return']:.3f}",
            f"{one['share_of_optimum']:.1%}",
            f"{one['cost']:.3f}",
            "yes" if one["limit_met"] else "no",
            f"{one['exploring_cost']:.3f}",
            f"{one['cpu_seconds']:.0f}",
        ]
        for one in figures["rows"]
    ]
    text = (
        f"The limit is a mean cost of {figures['cost_limit']:g} an episode; the best mean return "
        f"under it is {figures['best_return']:.3f}. The algorithms were given "
        f"{(1 - figures['margin']) * figures['cost_limit']:g}. Return and cost of the mean action, "
        f"over {figures['episodes']:,} fresh episodes.\n"
    )
    return "\n".join([text, markdown(COLUMNS, cells), _origin(figures)])


def _origin(figures: Mapping[str, Any]) -> str:
    origin = figures.get("provenance")
    if not origin:
        return ""
    versions = origin["versions"]
    return (
        f"Measured {origin['time']} at commit `{origin['commit']}` with `{origin['command']}` on "
        f"{machine_in_words(origin['machine'])}, PyTorch {versions['torch']}, "
        f"Stable-Baselines3 {versions['sb3']}.\n"
    )


def placed(path: Path, text: str) -> str:
    """What a file should read: the text, or its old content with the text between its markers.

    :param path: of the file, which need not exist
    :param text: the figures as Markdown
    """
    from saver_advisors.reporting.tables import between_markers

    old = path.read_text(encoding="utf-8") if path.is_file() else ""
    try:
        return between_markers(old, BEGIN, END, text)
    except ValueError:
        return text
