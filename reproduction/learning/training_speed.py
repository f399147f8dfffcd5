"""Where a training run's time goes, and what would make it faster.

Each environment's learner is built as `saver train` builds it and trained for some blocks: an
episode in each environment, then gradient steps. Everything that is compared is measured in turn,
block by block, on one core, in processor time, so that a machine's other work weighs on all alike.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

from reproduction.learning.training_loops import (
    AS_CONFIGURED,
    UPDATE,
    VARIANTS,
    Loop,
    evaluation_seconds,
    our_loop,
    settings_of,
    stock_loop,
)
from saver_advisors.benchmark.machine import cores, median_ratio, progress
from saver_advisors.benchmark.peers.process import PeerError, PeerProcess
from saver_advisors.benchmark.peers.suites import SBX, add_peer_cache, install
from saver_advisors.cli.measured import hand_over, measured_or_read
from saver_advisors.reporting.provenance import load_averages
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from collections.abc import Mapping

EXAMPLES: Final = """\
examples:
  python -m reproduction learning                                    minutes
  python -m reproduction learning --envs JacoPush-v0 --variants      where the time goes, no more
  python -m reproduction learning --sbx --json learning.json         SBX's gradient steps as well
  python -m reproduction learning --from learning.json --table page.md"""

ENVS: Final = ("JacoPush-v0", "DualJacoPush-v0")
STOCK: Final = ("TD3", "DDPG")
SBX_WORKER: Final = Path(__file__).with_name("sbx_worker.py")
#: Blocks before the first that counts: caches fill, compilers compile, replay gets its episodes.
WARM_UP: Final = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_page, at_least, env_id

    names = [variant.name for variant in VARIANTS if variant.name != AS_CONFIGURED]
    parser.add_argument(
        "--envs",
        nargs="+",
        type=env_id,
        default=list(ENVS),
        metavar="ID",
        help=f"environments, whose learner is TD3 (default: {' '.join(ENVS)})",
    )
    parser.add_argument(
        "--variants",
        nargs="*",
        choices=names,
        default=names,
        metavar="NAME",
        help=f"what is changed, one thing at a time: any of {names}; none without a name "
        "(default: all)",
    )
    parser.add_argument(
        "--stock",
        nargs="*",
        choices=STOCK,
        default=list(STOCK),
        metavar="NAME",
        help="SB3's algorithms with its own hindsight replay (default: TD3 DDPG)",
    )
    parser.add_argument(
        "--rounds",
        type=at_least(1),
        default=7,
        metavar="N",
        help="blocks of each; medians are over these (default: 7)",
    )
    parser.add_argument(
        "--sbx",
        action="store_true",
        help="also time gradient steps of SBX, in a virtual environment that is made at the first "
        "use",
    )
    add_peer_cache(parser)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.learning.learning_page import render
    from saver_advisors.reporting.errors import UsageError

    try:
        figures = measured_or_read(args, "learning", lambda: measure(args))
    except (PeerError, OSError) as error:
        raise UsageError(str(error)) from error
    hand_over(render(figures), figures, args.json, args.table)
    return 0


@one_thread_of_algebra()
def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Take every measurement that was asked for.

    :param args: see :func:`add_arguments`
    :return: JSON-able: a row an environment, with its ``parts``, ``variants`` and, where asked for,
        ``sbx``
    """
    load_before = load_averages()
    rows = []
    with cores(1):
        for env_id in args.envs:
            row = {"env": env_id, **settings(env_id), **parts_row(env_id, args.rounds)}
            row["variants"] = variant_rows(env_id, args.variants, args.stock, args.rounds)
            if args.sbx:
                row["sbx"] = sbx_row(env_id, args.rounds, args.peer_cache)
            rows.append(row)
    return {
        "title": "Speed of learning",
        "kind": "learning",
        "rounds": args.rounds,
        "load_before": load_before,
        "load_after": load_averages(),
        "rows": rows,
    }


def settings(env_id: str) -> dict[str, Any]:
    """What the figures depend on: sizes of networks and batches, updates for each block.

    :param env_id: of the environment
    """
    config = settings_of(env_id, VARIANTS[0])
    return {
        "n_envs": config.n_envs,
        "net_arch": list(config.net_arch),
        "batch_size": config.batch_size,
        "gradient_steps": config.gradient_steps,
        "advice": None if config.advice is None else config.advice.strategy,
    }


def parts_row(env_id: str, rounds: int) -> dict[str, Any]:
    """Time every part of the loop.

    :param env_id: of the environment
    :param rounds: medians are over so many blocks
    :return: ``parts``, milliseconds a 1,000 environment steps by name, and their ``total``
    """
    loop = our_loop(env_id, VARIANTS[0], by_part=True)
    blocks = []
    with progress(f"{env_id}, parts", WARM_UP + rounds) as advance:
        for _ in range(WARM_UP + rounds):
            blocks.append(loop.block())
            advance()
    per_block = 1e6 / loop.steps
    counted = blocks[WARM_UP:]
    parts = {
        name: per_block * median(block[name] for block in counted)
        for name in counted[0]
        if name != "total"
    }
    seconds, every = evaluation_seconds(env_id)
    parts["evaluations"] = 1e6 * seconds / every
    return {"parts": parts, "total": sum(parts.values())}


def variant_rows(
    env_id: str, variants: list[str], stock: list[str], rounds: int
) -> list[dict[str, Any]]:
    """Time whole loops in turn: as configured, with each change, and stock SB3's.

    :param env_id: of the environment
    :param variants: names of what is changed
    :param stock: algorithms of SB3's
    :param rounds: medians are over so many blocks of each
    :return: a row each: ``name``, ``update_ms``, ``steps_per_second`` and the ratios to the first,
        ``times_as_fast_an_update`` and ``times_as_fast``
    """
    loops = {
        variant.name: our_loop(env_id, variant, by_part=False)
        for variant in VARIANTS
        if variant.name in (AS_CONFIGURED, *variants)
    }
    for name in stock:
        loops[f"SB3's {name} + HER"] = stock_loop(env_id, name)
    blocks: dict[str, list[dict[str, float]]] = {name: [] for name in loops}
    with progress(f"{env_id}, variants", WARM_UP + rounds) as advance:
        for _ in range(WARM_UP + rounds):
            for name, loop in loops.items():
                blocks[name].append(loop.block())
            advance()
    counted = {name: found[WARM_UP:] for name, found in blocks.items()}
    return [
        _compared(name, loop, counted[name], loops[AS_CONFIGURED], counted[AS_CONFIGURED])
        for name, loop in loops.items()
    ]


def _compared(
    name: str,
    loop: Loop,
    blocks: list[dict[str, float]],
    base: Loop,
    base_blocks: list[dict[str, float]],
) -> dict[str, Any]:
    def updates(of: Loop, found: list[dict[str, float]]) -> list[float]:
        return [block[UPDATE] / of.updates for block in found]

    def whole(of: Loop, found: list[dict[str, float]]) -> list[float]:
        return [block["total"] / of.steps for block in found]

    return {
        "name": name,
        "update_ms": 1e3 * median(updates(loop, blocks)),
        "steps_per_second": 1.0 / median(whole(loop, blocks)),
        "times_as_fast_an_update": median_ratio(updates(base, base_blocks), updates(loop, blocks)),
        "times_as_fast": median_ratio(whole(base, base_blocks), whole(loop, blocks)),
    }


def sbx_row(env_id: str, rounds: int, cache: Path) -> dict[str, Any]:
    """Time SBX's gradient steps with networks and batches of the same sizes, beside ours.

    :param env_id: of the environment
    :param rounds: medians are over so many
    :param cache: folder of the virtual environments
    :return: ``update_ms`` of SBX, ``times_as_fast_an_update`` beside ours, and ``versions``
    :raises PeerError: where it cannot be installed or does not run
    """
    config = settings_of(env_id, VARIANTS[0])
    loop = our_loop(env_id, VARIANTS[0], by_part=False)
    for _ in range(WARM_UP):
        loop.block()
    model = loop.model
    sizes = (model.policy.shared_features.features_dim, model.action_space.shape[0])
    arguments = [str(size) for size in (*sizes, config.batch_size, *config.net_arch)]
    theirs, ours = [], []
    with PeerProcess("SBX", install(SBX, cache), SBX_WORKER, *arguments) as peer:
        versions: Mapping[str, str] = peer.read()["versions"]
        for turn in range(WARM_UP + rounds):
            seconds = float(peer.ask(str(config.gradient_steps))["seconds"])
            model.train(config.gradient_steps, config.batch_size)
            own = loop.watch.take()[UPDATE]
            if turn >= WARM_UP:
                theirs.append(seconds)
                ours.append(own)
    return {
        "update_ms": 1e3 * median(theirs) / config.gradient_steps,
        "times_as_fast_an_update": median_ratio(ours, theirs),
        "versions": dict(versions),
    }
