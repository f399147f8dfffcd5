"""Measure the time of a training run by part, and the effect of single changes on it.

Each environment's learner is built as `saver train` builds it and trained for some blocks: an
episode in each environment, then gradient steps. Compared loops are measured alternately, block by
block, on one core and in processor time, so that other work on the machine affects all alike.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

from reproduction.command_parts import add_choices
from reproduction.learning.training_loops import (
    AS_CONFIGURED,
    UPDATE,
    VARIANTS,
    TimedLoop,
    evaluation_seconds,
    our_loop,
    settings_of,
    stock_loop,
)
from reproduction.page_templates import page
from saver_advisors.benchmark.machine import cores, median_ratio
from saver_advisors.benchmark.peers.process import PeerError, PeerProcess
from saver_advisors.benchmark.peers.suites import Peer, install
from saver_advisors.cli.arguments import (
    add_count,
    add_flag,
    add_page,
    add_peer_cache,
    add_several,
    env_id,
)
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.provenance import load_averages, measured_at

EXAMPLES: Final = """\
examples:
  python -m reproduction learning                                    minutes
  python -m reproduction learning --envs JacoPush-v0 --variants      only the parts
  python -m reproduction learning --sbx --json learning.json         also SBX's gradient steps
  python -m reproduction learning --from learning.json --table page.md"""

ENVS: Final = ("JacoPush-v0", "DualJacoPush-v0")
STOCK: Final = ("TD3", "DDPG")
#: Stable-Baselines3 in JAX, whose gradient steps are timed; it has no environment.
SBX: Final = Peer("", "sbx", 1, ("sbx-rl==0.28.0", "jax==0.10.2", "torch==2.13.0"))
SBX_WORKER: Final = Path(__file__).with_name("sbx_worker.py")
#: Warm-up blocks, which fill caches and replay and run the compilers.
WARM_UP: Final = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    names = [variant.name for variant in VARIANTS if variant.name != AS_CONFIGURED]
    add_several(parser, "--envs", env_id, ENVS, "environments, trained with TD3", "ID")
    add_choices(parser, "--variants", names, "single changes to measure", nargs="*")
    add_choices(parser, "--stock", STOCK, "SB3's algorithms, with its hindsight replay", nargs="*")
    add_count(parser, "--rounds", 7, "measured blocks of each loop")
    text = "also time gradient steps of SBX, in a virtual environment created at the first use"
    add_flag(parser, "--sbx", text)
    add_peer_cache(parser)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: if SBX cannot be installed or run, or if a file cannot be written.
    """
    try:
        return measure_and_render(args, "learning", lambda: measure(args), render)
    except (PeerError, OSError) as error:
        raise UsageError(str(error)) from error


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """Take every measurement that was asked for.

    :param args: see :func:`add_arguments`.
    :return: JSON-able: one row per environment, with its ``parts``, ``variants`` and, if asked for,
        ``sbx``.
    """
    load_before = load_averages()
    rows = []
    with cores(1):
        for env_id in args.envs:
            config = settings_of(env_id, VARIANTS[0])
            row = {
                "env": env_id,
                "n_envs": config.n_envs,
                "net_arch": list(config.net_arch),
                "batch_size": config.batch_size,
                "gradient_steps": config.gradient_steps,
                "advice": None if config.advice is None else config.advice.strategy,
                **parts_row(env_id, args.rounds),
            }
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


def parts_row(env_id: str, rounds: int) -> dict[str, Any]:
    """Time every part of the loop.

    :param env_id: id of the environment.
    :param rounds: number of measured blocks.
    :return: ``parts``, median milliseconds per 1,000 environment steps by name, and their
        ``total``.
    """
    loop = our_loop(env_id, VARIANTS[0], by_part=True)
    [counted] = _measured_blocks(f"{env_id}, parts", [loop], rounds)
    per_block = 1e6 / loop.steps
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
    """Time whole loops alternately: as configured, with each change, and SB3's own.

    :param env_id: id of the environment.
    :param variants: names of the changes.
    :param stock: names of SB3's algorithms.
    :param rounds: number of measured blocks of each loop.
    :return: one row per loop: ``name``, ``update_ms``, ``steps_per_second`` and the ratios to the
        first, ``times_as_fast_an_update`` and ``times_as_fast``.
    """
    loops = {
        variant.name: our_loop(env_id, variant, by_part=False)
        for variant in VARIANTS
        if variant.name in (AS_CONFIGURED, *variants)
    }
    for name in stock:
        loops[f"SB3's {name} + HER"] = stock_loop(env_id, name)
    blocks = _measured_blocks(f"{env_id}, variants", list(loops.values()), rounds)
    updates, steps = [], []
    for loop, found in zip(loops.values(), blocks, strict=True):
        updates.append([block[UPDATE] / loop.updates for block in found])
        steps.append([block["total"] / loop.steps for block in found])
    return [
        {
            "name": name,
            "update_ms": 1e3 * median(updates[index]),
            "steps_per_second": 1.0 / median(steps[index]),
            "times_as_fast_an_update": median_ratio(updates[0], updates[index]),
            "times_as_fast": median_ratio(steps[0], steps[index]),
        }
        for index, name in enumerate(loops)
    ]


def _measured_blocks(
    title: str, loops: Sequence[TimedLoop], rounds: int
) -> list[list[dict[str, float]]]:
    """Run loops alternately, and return the blocks of each after the warm-up."""
    from tqdm import trange

    turns = trange(WARM_UP + rounds, desc=title, unit="round", dynamic_ncols=True)
    blocks = [[loop.block() for loop in loops] for _ in turns]
    return [list(found) for found in zip(*blocks[WARM_UP:], strict=True)]


def sbx_row(env_id: str, rounds: int, cache: Path) -> dict[str, Any]:
    """Time SBX's gradient steps and ours, with networks and batches of the same sizes.

    :param env_id: id of the environment.
    :param rounds: number of measured blocks.
    :param cache: folder of the virtual environments.
    :return: ``update_ms`` of SBX, its speed-up ``times_as_fast_an_update``, and ``versions``.
    :raises PeerError: if SBX cannot be installed or does not run.
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


VARIANT_COLUMNS: Final = {
    "learner": "{name}",
    "ms per update": "{update_ms:.1f}",
    "speed-up per update": "{times_as_fast_an_update:.2f}x",
    "steps per second": "{steps_per_second:,.0f}",
    "speed-up in all": "{times_as_fast:.2f}x",
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    loads = [one[0] for one in (figures["load_before"], figures["load_after"]) if one]
    origin = measured_at(figures)
    return page("learning", columns=VARIANT_COLUMNS, loads=loads, origin=origin, **figures)
