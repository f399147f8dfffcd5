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
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from reproduction.command_parts import add_choices
from reproduction.page_templates import page
from saver_advisors.benchmark.peers.process import PeerError
from saver_advisors.benchmark.peers.suites import environment
from saver_advisors.cli.arguments import add_page, add_peer_cache
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.reporting.provenance import REPOSITORY, measured_at

EXAMPLES: Final = """\
examples:
  python -m reproduction ecosystem --json docs/results/ecosystem.json --table docs/ecosystem.md
  python -m reproduction ecosystem --only TorchRL skrl"""

SHARED: Final = "beside"
TIME_LIMIT: Final = 600.0
"""Seconds that a program may take."""
TORCH: Final = "torch==2.13.0"
"""Installed first, so that no library brings another build of it."""


#: Folder of the programs, one file per library.
PROGRAMS: Final = "docs/examples/ecosystem"
#: Arguments of RL Zoo's programs that all its rows share.
_ZOO: Final = "--algo tqc --env JacoPush-v0 -f logs"
_SETTINGS: Final = "--gym-packages saver_envs --conf-file {root}/zoo_configs/tqc.yml"


@dataclass(frozen=True)
class Library:
    """A library and the programs that use it.

    :param name: as its users write it.
    :param package: distribution whose version is reported.
    :param programs: arguments of Python, one line each; ``{root}`` is the clone.
    :param requirements: distributions to install beside ours.
    :param unresolved: distributions to install without their dependencies, because a pin of theirs
        excludes versions that we need.
    :param pin: that pin.
    :param extra: extra of ours that is installed with it; nothing but the base package where empty.
    """

    name: str
    package: str
    programs: tuple[str, ...]
    requirements: tuple[str, ...] = ()
    unresolved: tuple[str, ...] = ()
    pin: str = ""
    extra: str = "train"


def _example(file: str) -> tuple[str, ...]:
    return (f"{{root}}/{PROGRAMS}/{file}",)


LIBRARIES: Final = (
    Library("Gymnasium", "gymnasium", _example("gymnasium_wrappers.py")),
    Library("Gymnasium-Robotics", "gymnasium-robotics", _example("gymnasium_robotics_goals.py")),
    Library("PettingZoo", "pettingzoo", _example("pettingzoo_suite.py")),
    Library("sb3-contrib", "sb3-contrib", _example("sb3_contrib_tqc.py")),
    Library(
        "RL Zoo",
        "rl_zoo3",
        (
            f"-m rl_zoo3.train {_ZOO} {_SETTINGS} -n 400 --eval-freq -1",
            f"-m rl_zoo3.enjoy {_ZOO} --gym-packages saver_envs -n 60 --no-render",
            f"-m rl_zoo3.train {_ZOO} {_SETTINGS} -optimize --n-trials 2 -n 400 --n-evaluations 1",
            "-m rl_zoo3.plots.plot_train -a tqc -e JacoPush-v0 -f logs",
        ),
    ),
    Library("SuperSuit", "supersuit", _example("supersuit_ppo.py"), ("supersuit",)),
    Library("SBX", "sbx-rl", _example("sbx_tqc.py"), ("sbx-rl",)),
    Library("TorchRL", "torchrl", _example("torchrl_rollout.py"), ("torchrl",)),
    Library("skrl", "skrl", _example("skrl_ddpg.py"), ("skrl",)),
    Library("Tianshou", "tianshou", _example("tianshou_td3.py"), ("tianshou>=2",)),
    Library("Minari", "minari", _example("minari_dataset.py"), ("minari",)),
    Library("CleanRL (style)", "torch", _example("cleanrl_ddpg.py")),
    Library(
        "d3rlpy",
        "d3rlpy",
        _example("d3rlpy_offline.py"),
        (
            "gym",
            "scikit-learn",
            "structlog",
            "dataclasses-json",
            "typing-extensions",
            "colorama",
            "click",
            "h5py",
            "tqdm",
        ),
        ("d3rlpy",),
        "gymnasium==1.0.0",
    ),
    Library(
        "RLlib",
        "ray",
        _example("rllib_sac.py"),
        ("ray", "dm_tree", "pandas", "pyarrow", "tensorboardX", "pydantic<3", "lz4", "scipy"),
        (),
        "ray[rllib] has gymnasium==1.2.2; its requirements are installed by name",
    ),
    Library(
        "Safety-Gymnasium",
        "safety-gymnasium",
        _example("safety_gymnasium_step.py"),
        ("xmltodict", "pygame"),
        ("safety-gymnasium",),
        "gymnasium==0.28.1, mujoco==2.3.3",
    ),
    Library(
        "OmniSafe",
        "omnisafe",
        _example("omnisafe_cpo.py"),
        ("wandb", "gdown", "moviepy", "tensorboard", "typer", "xmltodict", "pygame", "seaborn"),
        ("omnisafe", "safety-gymnasium"),
        "safety-gymnasium, which has gymnasium==0.28.1",
    ),
    Library(
        "LeRobot",
        "lerobot",
        _example("lerobot_dataset.py"),
        ("lerobot",),
        (),
        "torch<2.11: installs with the base package, without `train`",
        "",
    ),
)


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
    columns = {
        "library": "{library}",
        "version": "{version}",
        "program": "`{program}`",
        "result": "{result}",
        "pin": "{pin}",
    }
    runs = [
        {**row, **run, "version": row["version"] or "-"}
        for row in figures["rows"]
        for run in row["programs"]
    ]
    return page("ecosystem", runs=runs, columns=columns, origin=measured_at(figures), **figures)
