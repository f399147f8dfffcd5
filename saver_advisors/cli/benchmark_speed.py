"""Measure environment steps per second over n_envs and threads, and against bare MuJoCo and peers.

Compared rows are measured alternately, round by round, and results are medians over the rounds, so
that other load on the machine and changes of its clock affect all rows alike.
"""

from __future__ import annotations

import argparse
from typing import Any, Final

from saver_advisors.benchmark.machine import progress
from saver_advisors.benchmark.peers.process import PeerError
from saver_advisors.benchmark.peers.suites import PEERS
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.reporting.provenance import load_averages
from saver_envs.registration import TIMED_IDS

EXAMPLES: Final = """\
examples:
  saver benchmark speed                                  every row, a few minutes
  saver benchmark speed --envs JacoPush-v0 --n-envs 64   one row
  saver benchmark speed --peers --json speed.json        also FetchPush, twice, and TwoArmLift"""

N_ENVS: Final = (1, 4, 16, 64, 256, 1024)
THREADS: Final = (1, 2)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli import arguments

    arguments.add_several(
        parser, "--envs", arguments.env_id, TIMED_IDS, "environments", metavar="ID"
    )
    count = arguments.at_least(1)
    arguments.add_several(parser, "--n-envs", count, N_ENVS, "environments stepped in parallel")
    arguments.add_several(
        parser, "--threads", count, THREADS, "native threads, each on its own core"
    )
    arguments.add_count(parser, "--rounds", 9, "rounds of each median")
    arguments.add_seconds(parser, "--seconds", "shortest measurement", 0.25, metavar="S")
    peers = ", ".join(peer.name for peer in PEERS)
    text = f"also time {peers}, each in a virtual environment created at first use"
    arguments.add_flag(parser, "--peers", text)
    arguments.add_peer_cache(parser)
    arguments.add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the tables, and write the given files.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    import stable_baselines3  # noqa: F401  (needed after some of the work: say so before it)

    from saver_advisors.benchmark.speed.speed_page import render
    from saver_advisors.reporting.errors import UsageError

    try:
        return measure_and_render(args, "speed", lambda: measure(args), render)
    except (PeerError, OSError) as error:
        raise UsageError(str(error)) from error


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Take all measurements.

    :param args: see :func:`add_arguments`
    :return: ``rows``, ``randomized``, ``resets``, ``replay``, ``advice`` and, with ``--peers``,
        ``peers``
    """
    from saver_advisors.benchmark.speed.learner_parts import ADVICE, advice_row, replay_row
    from saver_advisors.benchmark.speed.randomized_steps import N_ENVS as MOST_VARIED
    from saver_advisors.benchmark.speed.randomized_steps import randomized_row
    from saver_advisors.benchmark.speed.steps import memory_per_env, reset_row, step_rows
    from saver_advisors.benchmark.speed.versus import peer_rows

    load_before = load_averages()
    memory = {env_id: memory_per_env(env_id, args.n_envs) for env_id in args.envs}
    rows = []
    with progress("steps", len(args.envs) * len(args.n_envs) * args.rounds) as advance:
        for env_id in args.envs:
            for n_envs in args.n_envs:
                found = step_rows(env_id, n_envs, args.threads, args.rounds, args.seconds, advance)
                for row in found:
                    rows.append({**row, "memory_per_env_mb": memory[env_id].get(n_envs)})
    varied = min(MOST_VARIED, max(args.n_envs))
    with progress("worlds that vary", len(args.envs) * args.rounds) as advance:
        randomized = [randomized_row(one, varied, args.rounds, advance) for one in args.envs]
    figures: dict[str, Any] = {
        "title": "Speed",
        "kind": "speed",
        "rounds": args.rounds,
        "rows": rows,
        "randomized": randomized,
        "resets": [reset_row(env_id, args.rounds) for env_id in args.envs],
        "replay": replay_row(args.rounds),
        "advice": [advice_row(strategy, args.rounds, args.seconds) for strategy in ADVICE],
    }
    if args.peers:
        figures["peers"] = peer_rows(args.peer_cache, args.rounds, args.seconds)
    return {**figures, "load_average": {"before": load_before, "after": load_averages()}}
