"""Try third-party libraries with our environments, each by a program in `docs/examples/ecosystem`.

Libraries that install with ours share a virtual environment; one whose pins exclude our versions
gets its own and is installed without its dependencies. Environments are kept in the cache folder.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices, measure_and_render, measured_at
from reproduction.ecosystem.libraries import LIBRARIES, Library
from saver_advisors.benchmark.peers.process import PeerError
from saver_advisors.benchmark.peers.suites import add_peer_cache, environment
from saver_advisors.cli.arguments import add_page
from saver_advisors.reporting.provenance import REPOSITORY

EXAMPLES: Final = """\
examples:
  python -m reproduction ecosystem --json docs/results/ecosystem.json --table docs/ecosystem.md
  python -m reproduction ecosystem --only TorchRL skrl"""

SHARED: Final = "beside"
TIME_LIMIT: Final = 600.0
"""Seconds that a program may take."""
TORCH: Final = "torch==2.13.0"
"""Installed first, so that no library brings another build of it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_choices(parser, "--only", [one.name for one in LIBRARIES], "libraries to try")
    add_peer_cache(parser)
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Install and try the libraries, print the page, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """
    chosen = [one for one in LIBRARIES if one.name in args.only]

    def figures() -> dict[str, Any]:
        from tqdm import tqdm

        rows = [tried(one, args.peer_cache) for one in tqdm(chosen, unit="library")]
        return {"title": "Third-party libraries", "kind": "ecosystem", "rows": rows}

    return measure_and_render(args, "ecosystem", figures, render)


def tried(library: Library, cache: Path) -> dict[str, Any]:
    """Install a library and run its programs.

    :param library: which one.
    :param cache: folder of the virtual environments.
    :return: ``library``, ``version``, ``pin``, and ``programs`` with the ``result`` of each: ``ok``
        or the last line of its output.
    """
    row = {"library": library.name, "version": None, "pin": library.pin}
    try:
        python = installed(library, cache)
    except PeerError as error:
        runs = [{"program": line, "result": str(error)} for line in library.programs]
        return {**row, "programs": runs}
    with tempfile.TemporaryDirectory() as folder:
        runs = [_run(python, line, Path(folder)) for line in library.programs]
    version = f"from importlib.metadata import version; print(version({library.package!r}))"
    found = subprocess.run([python, "-c", version], capture_output=True, text=True, check=True)
    return {**row, "version": found.stdout.strip(), "programs": runs}


def installed(library: Library, cache: Path) -> Path:
    """Install a library with ours, unless its environment has it already.

    :param library: which one.
    :param cache: folder of the virtual environments.
    :return: Python of the environment.
    :raises PeerError: if a distribution cannot be installed.
    """
    name = library.package if library.pin else SHARED
    ours = ["-e", f"{REPOSITORY}[{library.extra}]" if library.extra else str(REPOSITORY)]
    together = [one for each in LIBRARIES if not each.pin for one in each.requirements]
    theirs = library.requirements if library.pin else together
    constraints = ["-c", str(REPOSITORY / "constraints.txt")]
    # Theirs come last and unconstrained: the pins are of our tests, not of our requirements.
    steps = [[TORCH], [*constraints, *ours], list(theirs)] if library.extra else [[*ours, *theirs]]
    if library.unresolved:
        steps.append(["--no-deps", *library.unresolved])
    return environment(cache / f"ecosystem-{name}", steps, library.name)


def _run(python: Path, line: str, folder: Path) -> dict[str, Any]:
    """Run a program in a folder of its own."""
    words = shlex.split(line.format(root=REPOSITORY))
    start = time.perf_counter()
    try:
        done = subprocess.run(
            [python, "-W", "ignore", *words],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
        )
        output = (done.stderr or done.stdout).strip().splitlines()
        result = "ok" if done.returncode == 0 else (output or ["no output"])[-1]
    except subprocess.TimeoutExpired:
        result = f"not done after {TIME_LIMIT:g} s"
    program = line.replace("{root}/", "")
    return {"program": program, "result": result, "seconds": time.perf_counter() - start}


def render(figures: Mapping[str, Any]) -> str:
    """Render the results as a page.

    :param figures: what was measured, or the content of its JSON file.
    :return: Markdown.
    """
    from saver_advisors.reporting.tables import markdown

    rows = [
        [one["library"], one["version"] or "-", f"`{run['program']}`", run["result"], one["pin"]]
        for one in figures["rows"]
        for run in one["programs"]
    ]
    return "\n".join(
        [
            f"# {figures['title']}\n",
            "Each program ran as it is in this repository, with our environments. *Pin* is a "
            "requirement of the library that excludes versions we need: such a library is "
            "installed without its dependencies.\n",
            markdown(["library", "version", "program", "result", "pin"], rows),
            measured_at(figures) + "\n",
        ]
    )
