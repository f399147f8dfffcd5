"""Install the wheel in fresh environments and run the documented commands there:

    python tools/fresh_install.py base train all --json fresh.json

`COMMANDS` is the list of the documented commands, with settings that make each of them short. A
command runs in every environment that has the extras which it needs; where one is missing, it must
say in one line what to install. Only the installation needs a network.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ALL = "train,logging,cluster,datasets,view,pose,pose-tools,modelling,integration"
#: Name of an environment -> the extras that are installed there.
ENVIRONMENTS = {
    "base": "",
    "train": "train",
    "logging": "train,logging",
    "datasets": "train,datasets",
    "pose": "pose",
    "modelling": "modelling",
    "robot": "train,modelling,integration",
    "all": ALL,
}

SHORT = "max_episode_steps=10"
TINY = (
    "net_arch=[8] batch_size=16 gradient_steps=2 n_envs=2 buffer_size=400 eval_every=20 "
    "eval_episodes=2 checkpoint_every=20"
)
RUN = f"--steps 40 --no-progress --env-kwargs {SHORT} --set {TINY}"
BENCH = f"--steps 80 --n-envs 2 --eval-every 40 --report-episodes 3 --env-kwargs {SHORT}"
ZOO = "learning_starts=900 batch_size=16 gradient_steps=1"
PLOT = "-a sac -e JacoPush-v0 -f logs"

HELPFUL = (
    *("envs", "train", "evaluate", "dataset", "view", "export", "curves", "experiments"),
    *("pose", "train-pose"),
    *("benchmark", "benchmark speed", "benchmark run", "benchmark compare", "benchmark pose"),
    *("model", "run", "demo"),
)
LOG = "saver train --output runs/log --no-progress --tensorboard"
DATA = "saver dataset"
LOGGED = f"{LOG} --wandb --env JacoPush-v0 {RUN}"

#: Extras that a command needs, and the command. Later ones use what earlier ones wrote.
COMMANDS: tuple[tuple[str, str], ...] = (
    ("", "saver --help"),
    ("", "saver --version"),
    ("", "saver envs"),
    ("", "saver envs --all --json envs.json"),
    ("", "saver envs --markdown"),
    *(("", f"saver {name} --help") for name in HELPFUL),
    ("train", "saver evaluate --env JacoPush-v0 --policy jaco-push --episodes 4 --json r.json"),
    ("train", "saver evaluate --env JacoPush-v0 --policy random --episodes 2 --video push.mp4"),
    ("train", "saver evaluate --env DualJacoPush-v0 --policy expert --episodes 2 --paths p.png"),
    ("train", "saver evaluate --env DualJacoPush-v0 --policy side-by-side:jaco-push --episodes 2"),
    ("train", "saver train --env JacoPush-v0 --print-config"),
    ("train", f"saver train --env JacoPush-v0 --output runs/push {RUN}"),
    ("train", "saver train --output runs/push --resume --steps 80 --no-progress"),
    (
        "train",
        "saver train --env DualJacoPush-v0 --output runs/advised --advice mc-q --teacher jaco-push "
        f"--budget 30 --threshold 0.1 {RUN}",
    ),
    ("train", "saver evaluate --env JacoPush-v0 --policy runs/push --episodes 2"),
    ("train", "saver curves runs/push --output push.png --json push.json"),
    ("train", "saver export runs/push --path push.safetensors --episodes 2"),
    ("train", "saver experiments estimate grid.yml --steps 20"),
    ("train", "saver experiments search --help"),
    ("train", "saver benchmark submit --help"),
    ("train", "saver experiments run grid.yml --output runs/grid --processes 2"),
    ("train", "saver experiments status runs/grid"),
    ("train", "saver experiments resume runs/grid"),
    (
        "train",
        "saver benchmark run --env JacoPush-v0 --algo mine.py:Mine --seeds 0-1 --processes 2 "
        f"--output results {BENCH}",
    ),
    (
        "train",
        "saver benchmark run --env JacoPush-v0 --algo stable_baselines3:SAC --name sac --seed 0 "
        f"--output results --algo-kwargs batch_size=8 learning_starts=30 {BENCH}",
    ),
    (
        "train",
        "saver benchmark compare results --baselines runs/grid/results --table mine.md "
        "--figure mine.png",
    ),
    (
        "train",
        "saver benchmark speed --envs JacoPush-v0 --n-envs 4 --threads 1 --rounds 1 --seconds 0.1",
    ),
    ("train,modelling", "saver run wrist-push --true-state --video trial.mp4"),
    (
        "train",
        f"saver train --zoo sac --env JacoPush-v0 --output logs --steps 1200 --set {ZOO} -- "
        "--eval-freq 500 --eval-episodes 2",
    ),
    ("train", "python -m saver_advisors.zoo enjoy --algo sac --env JacoPush-v0 -f logs --no-render"
              " -n 20"),
    ("train", "python -m rl_zoo3.enjoy --gym-packages saver_envs --algo sac --env JacoPush-v0"
              " -f logs --no-render -n 20"),
    ("train", "python -m rl_zoo3.train --gym-packages saver_envs --conf-file CONFIGS/sac.yml "
              "--algo sac --env JacoPush-v0 -f opt -n 1000 -optimize --n-trials 2 "
              "--n-startup-trials 1 --n-evaluations 1"),
    ("train", f"python -m rl_zoo3.plots.plot_train {PLOT}"),
    ("train", f"python -m rl_zoo3.plots.all_plots {PLOT} --no-million"),
    ("train,logging", LOGGED),
    ("train,logging", f"{LOG} --resume --steps 80"),
    ("train,datasets", f"{DATA} expert --env JacoPush-v0 --episodes 2 --output sets"),
    ("train,datasets", f"{DATA} replay runs/push --output sets"),
    ("train,datasets", f"{DATA} expert --env JacoPush-v0 --episodes 2 --format lerobot "
                       "--output lerobot --size 64 48"),
    ("all", f"saver view --env JacoPush-v0 --port 0 --episodes 1 --env-kwargs {SHORT}"),
    ("pose", "saver pose photo.png --json joints.json"),
    ("modelling", "saver model train --robot mico --data workspace --samples 400 --set epochs=1 "
                  "--output mico-ik.safetensors"),
    ("all", "saver benchmark pose --frames 20 --hard-frames 20 --rounds 1 --only accuracy"),
    ("all", "saver experiments run grid.yml --output runs/ray --ray local --only none"),
    ("train,modelling,integration", "saver run wrist-push --apart --true-state"),
    ("all", "saver demo --output demo --train-seconds 10 --episodes 2 --video-episodes 1"),
)  # fmt: skip

FILES = {
    "mine.py": """\
import numpy as np


class Mine:
    def __init__(self, env, *, seed):
        self.env, self.size = env, env.single_action_space.shape[0]

    def learn(self, steps):
        self.env.reset()
        while True:
            self.env.step(self.env.action_space.sample())

    def predict(self, observation):
        return np.zeros((len(observation["observation"]), self.size), np.float32)
""",
    "grid.yml": """\
final_episodes: 3
groups:
  push:
    env_id: JacoPush-v0
    settings: {total_steps: 40, eval_every: 20, eval_episodes: 2, n_envs: 2, net_arch: [8],
               batch_size: 16, gradient_steps: 2, buffer_size: 400,
               env_kwargs: {max_episode_steps: 10}}
    rows:
      none: {}
      mine: {algorithm: "mine.py:Mine"}
""",
}


@dataclass(frozen=True)
class Outcome:
    """What a command left behind.

    :param environment: its name in `ENVIRONMENTS`.
    :param command: the command line.
    :param needed: extras that it needs.
    :param status: exit status.
    :param seconds: its duration.
    :param said: the last line of its output, or its whole error if an extra is missing.
    """

    environment: str
    command: str
    needed: str
    status: int
    seconds: float
    said: str

    @property
    def complete(self) -> bool:
        """Whether the environment has the extras that the command needs."""
        return has(self.environment, self.needed)

    @property
    def right(self) -> bool:
        """Whether the command succeeded, or, where an extra is missing, said so in one line."""
        if self.complete or self.status == 0:
            return self.status == 0
        return self.status == 2 and "\n" not in self.said and "error:" in self.said


def has(environment: str, needed: str) -> bool:
    """Return whether an environment has all extras of a list."""
    there = {*ENVIRONMENTS[environment].split(","), ""}
    return {*(ALL if needed == "all" else needed).split(",")} <= there


def build(folder: Path) -> Path:
    """Build the sdist of this checkout and, from it, the wheel; return the wheel.

    :param folder: where both are written.
    :raises RuntimeError: if the build fails; the message is what it printed.
    """
    command = [sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    if completed.returncode:
        raise RuntimeError(completed.stdout + completed.stderr)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(
    environment: str,
    package: Path,
    folder: Path,
    python: str = sys.executable,
    pip_options: Sequence[str] = ("-c", str(ROOT / "constraints.txt")),
) -> Path:
    """Make a virtual environment with the package and extras; return the folder of programs.

    :param environment: name in `ENVIRONMENTS`.
    :param package: wheel or sdist.
    :param folder: of the virtual environment.
    :param python: interpreter that the environment is made with.
    :param pip_options: further words of ``pip install``; by default the tested versions.
    :return: the folder of programs.
    :raises RuntimeError: if pip fails; the message is what it printed.
    """
    subprocess.run([python, "-m", "venv", "--without-pip", str(folder)], check=True)
    programs = folder / ("Scripts" if sys.platform == "win32" else "bin")
    extras = ENVIRONMENTS[environment]
    # This Python's pip installs there: quicker than another pip in each environment.
    pip = [sys.executable, "-m", "pip", "--python", str(programs / "python")]
    pip += ["install", "--quiet", "--no-compile"]
    command = [*pip, *pip_options, f"{package}{f'[{extras}]' * bool(extras)}"]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    if completed.returncode:
        raise RuntimeError(completed.stderr)
    return programs


def run_commands(
    environment: str,
    programs: Path,
    folder: Path,
    commands: Sequence[tuple[str, str]] = COMMANDS,
) -> list[Outcome]:
    """Run commands in a folder, where no file of the checkout is found, without a network."""
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "photo.png").write_bytes((ROOT / "docs/images/scenes.png").read_bytes())
    (folder / "runs").mkdir(exist_ok=True)
    nowhere = dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"), "http://127.0.0.1:9")
    variables = {**os.environ, **nowhere, "WANDB_MODE": "offline", "MPLBACKEND": "agg"}
    variables |= {name.lower(): value for name, value in nowhere.items()}
    variables["COLUMNS"] = "200"
    for name in ("PYTHONPATH", "VIRTUAL_ENV"):
        variables.pop(name, None)
    found = []
    for needed, command in commands:
        # A program of RL Zoo does not say which extra it needs.
        if not command.startswith("saver") and not has(environment, needed):
            continue
        program, *words = command.replace("CONFIGS", str(ROOT / "zoo_configs")).split()
        start = time.perf_counter()
        completed = subprocess.run(
            [str(programs / program), *words],
            cwd=folder,
            env=variables,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = round(time.perf_counter() - start, 1)
        lines = (completed.stdout + completed.stderr).strip().splitlines() or [""]
        said = lines[-1] if has(environment, needed) else completed.stderr.strip()
        found.append(Outcome(environment, command, needed, completed.returncode, seconds, said))
        print(f"{environment:10} {completed.returncode:4} {seconds:6.1f} s  {command}", flush=True)
        if not found[-1].right:
            print(f"{'':24}{completed.stdout[-2000:]}\n{completed.stderr[-4000:]}", flush=True)
    return found


def main() -> int:
    """Install, run, and print every command with its status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("environments", nargs="+", choices=ENVIRONMENTS)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the outcomes")
    args = parser.parse_args()
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = build(folder / "dist")
        for environment in args.environments:
            programs = install(environment, wheel, folder / environment)
            (folder / f"{environment}-work").mkdir()
            outcomes += run_commands(environment, programs, folder / f"{environment}-work")
    wrong = [one for one in outcomes if not one.right]
    print(f"{len(outcomes) - len(wrong)} of {len(outcomes)} commands did what they must")
    if args.json is not None:
        args.json.write_text(json.dumps([asdict(one) for one in outcomes], indent=1) + "\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
