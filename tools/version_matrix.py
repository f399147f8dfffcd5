"""Try the wheel on each Python, with the lowest and the newest versions of its dependencies:

    python tools/version_matrix.py base train --pythons 3.11 3.12 3.13 --json versions.json

*lowest* are the lower bounds of `pyproject.toml`, *newest* is what pip finds within its upper
bounds. The wheel is built from the sdist. A Python that is not on PATH as `python3.X` is skipped,
with a line that says so. Only the installation needs a network.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import fresh_install
from fresh_install import ENVIRONMENTS, ROOT, RUN, ZOO

PYTHONS = ("3.11", "3.12", "3.13")
VERSIONS = ("lowest", "newest")
#: A requirement of pyproject.toml: name, extras, lower bound, and the rest.
REQUIREMENT = re.compile(r"([\w-]+)(?:\[[\w,]+\])?>=([\d.]+)(?:,<[\d.]+)?$")

#: A step of every id with a sparse reward, the checkers of Gymnasium and PettingZoo, and 60 steps
#: of a vector.
ROLLOUTS = """
import sys
import gymnasium
import numpy as np
import pettingzoo
import saver_envs
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

assert saver_envs.__file__.startswith(sys.prefix), saver_envs.__file__
ids = [id for id, spec in gymnasium.registry.items() if "saver_envs" in str(spec.entry_point)]
ids = [id for id in ids if "Dense" not in id]  # the same models with another reward
assert len(ids) >= 10, ids
for id in ids:
    env = gymnasium.make(id)
    env.reset(seed=0)
    *_, info = env.step(env.action_space.sample())
    assert "is_success" in info, (id, info)
    env.close()
check_env(gymnasium.make("DualJacoPush-v0").unwrapped, skip_render_check=True)
parallel_api_test(pettingzoo.make("parallel", "saver_envs/DualJacoPush-v0"), num_cycles=60)
vector = gymnasium.make_vec("JacoPickAndPlace-v0", num_envs=4)
vector.reset(seed=0)
for _ in range(60):
    observation, reward, *_ = vector.step(vector.action_space.sample())
assert observation["observation"].shape == (4, 28), observation["observation"].shape
assert np.isfinite(observation["observation"]).all() and set(reward) <= {0.0, -1.0}, reward
print(len(ids), "ids")
"""

#: Extras that a command needs, and the command.
COMMANDS: tuple[tuple[str, str], ...] = (
    ("", "python -I rollouts.py"),
    ("", "saver envs"),
    ("train", "saver evaluate --env JacoPush-v0 --policy jaco-push --episodes 50 --json r.json"),
    ("train", f"saver train --env JacoPush-v0 --output runs/push {RUN} --steps 400"),
    ("train", "saver evaluate --env JacoPush-v0 --policy runs/push --episodes 2 --video p.mp4"),
    ("train", "saver curves runs/push --output push.png"),
    (
        "train",
        f"saver train --zoo sac --env JacoPush-v0 --output logs --steps 1000 --set {ZOO} -- "
        "--eval-freq 500 --eval-episodes 2",
    ),
)


@dataclass(frozen=True)
class Trial:
    """One Python with one set of versions.

    :param python: such as "3.11".
    :param versions: "lowest" or "newest".
    :param environment: name in `fresh_install.ENVIRONMENTS`.
    :param installed: version by name of the package, of its direct dependencies.
    :param seconds: duration, installation included.
    :param failures: what failed, one line each; empty if everything worked.
    """

    python: str
    versions: str
    environment: str
    installed: dict[str, str]
    seconds: float
    failures: tuple[str, ...]


def lower_bounds(environment: str = "base") -> dict[str, str]:
    """Return the lowest versions that pyproject.toml permits.

    :param environment: name in `fresh_install.ENVIRONMENTS`.
    :return: version by name of the package.
    :raises ValueError: for a requirement without a lower bound.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    requirements = list(project["dependencies"])
    for extra in filter(None, ENVIRONMENTS[environment].split(",")):
        requirements += project["optional-dependencies"][extra]
    bounds = {}
    for requirement in requirements:
        matched = REQUIREMENT.match(requirement)
        if matched is None:
            raise ValueError(
                f"{requirement!r} in pyproject.toml: expected NAME>=VERSION[,<VERSION]"
            )
        bounds[matched[1]] = matched[2]
    return bounds


def pip_options(environment: str, versions: str, torch: str | None, folder: Path) -> list[str]:
    """Return the words of ``pip install`` that select versions.

    :param environment: name in `fresh_install.ENVIRONMENTS`.
    :param versions: "lowest" or "newest".
    :param torch: version of PyTorch instead of the newest; None for the newest.
    :param folder: where a file of constraints is written.
    """
    bounds = lower_bounds(environment) if versions == "lowest" else {}
    if versions == "newest" and torch is not None:
        bounds["torch"] = torch
    file = folder / f"{versions}-{environment}.txt"
    file.write_text("".join(f"{name}=={bound}\n" for name, bound in bounds.items()))
    return ["--only-binary", ":all:", "-c", str(file)]


def try_out(
    environment: str, versions: str, python: str, package: Path, folder: Path, torch: str | None
) -> Trial:
    """Install the package in an environment of its own, run the commands, and remove it again.

    :param environment: name in `fresh_install.ENVIRONMENTS`.
    :param versions: "lowest" or "newest".
    :param python: such as "3.11".
    :param package: wheel or sdist.
    :param folder: new folder for all files.
    :param torch: version of PyTorch instead of the newest.
    """
    folder.mkdir(parents=True)
    start = time.perf_counter()
    installed: dict[str, str] = {}
    try:
        options = pip_options(environment, versions, torch, folder)
        programs = fresh_install.install(
            environment, package, folder / "venv", f"python{python}", options
        )
        installed = _installed(programs, list(lower_bounds(environment)))
        (folder / "rollouts.py").write_text(ROLLOUTS, encoding="utf-8")
        commands = [one for one in COMMANDS if fresh_install.has(environment, one[0])]
        found = fresh_install.run_commands(environment, programs, folder, commands)
        failures = [f"{one.command}: {one.said}" for one in found if not one.right]
        failures += _contradictions(environment, versions, installed, folder)
    except RuntimeError as error:
        failures = [str(error).strip().splitlines()[-1]]
    shutil.rmtree(folder)
    seconds = round(time.perf_counter() - start, 1)
    return Trial(python, versions, environment, installed, seconds, tuple(failures))


def _contradictions(
    environment: str, versions: str, installed: dict[str, str], folder: Path
) -> list[str]:
    """What is wrong although every command succeeded."""
    found = []
    if versions == "lowest":
        for name, bound in lower_bounds(environment).items():
            if not re.fullmatch(rf"{re.escape(bound)}(\.0)*(\+\w+)?", installed[name]):
                found.append(f"{name} {installed[name]} is installed instead of {bound}")
    if fresh_install.has(environment, "train"):
        success = json.loads((folder / "r.json").read_text())["success_rate"]
        if success < 0.9:
            found.append(f"jaco-push succeeds in {success} of its episodes instead of 0.9 or more")
    return found


def _installed(programs: Path, names: Sequence[str]) -> dict[str, str]:
    program = "import json, sys; from importlib.metadata import version; "
    program += "print(json.dumps({name: version(name) for name in sys.argv[1:]}))"
    command = [str(programs / "python"), "-I", "-c", program, *names]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    if completed.returncode:
        raise RuntimeError(completed.stderr)
    return dict(json.loads(completed.stdout))


def main() -> int:
    """Try every combination; print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("environments", nargs="+", choices=ENVIRONMENTS)
    parser.add_argument("--pythons", nargs="+", default=PYTHONS, metavar="3.X")
    parser.add_argument("--versions", nargs="+", choices=VERSIONS, default=VERSIONS)
    parser.add_argument("--torch", metavar="VERSION", help="of PyTorch, instead of the newest")
    parser.add_argument("--package", type=Path, metavar="FILE", help="wheel or sdist, not built")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the outcomes")
    args = parser.parse_args()
    trials: list[Trial] = []
    with tempfile.TemporaryDirectory() as name:
        package = args.package or fresh_install.build(Path(name) / "dist")
        for python in args.pythons:
            if not runs(python):
                print(f"{python}: skipped, python{python} is not on PATH")
                continue
            for environment in args.environments:
                for versions in args.versions:
                    folder = Path(name) / f"{python}-{versions}-{environment}"
                    trial = try_out(environment, versions, python, package, folder, args.torch)
                    trials.append(trial)
                    print(describe(trial), flush=True)
    if args.json is not None:
        args.json.write_text(json.dumps([asdict(one) for one in trials], indent=1) + "\n")
    wrong = sum(bool(one.failures) for one in trials)
    print(f"{len(trials) - wrong} passed, {wrong} failed")
    return 1 if wrong or not trials else 0


def runs(python: str) -> bool:
    """Return whether ``python3.X`` runs and is that version; a version manager's may not."""
    program = f"import sys; sys.exit('{python}' != '%d.%d' % sys.version_info[:2])"
    try:
        done = subprocess.run([f"python{python}", "-c", program], capture_output=True, check=False)
    except FileNotFoundError:
        return False
    return done.returncode == 0


def describe(trial: Trial) -> str:
    """One line on a trial, and one on each failure."""
    outcome = "FAILED" if trial.failures else "ok"
    versions = ", ".join(f"{name} {version}" for name, version in trial.installed.items())
    line = f"{trial.python} {trial.versions} {trial.environment}: {outcome}, {trial.seconds} s"
    return "\n  ".join([f"{line}: {versions}", *trial.failures])


if __name__ == "__main__":
    sys.exit(main())
