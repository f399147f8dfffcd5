"""The demo's training: two students in parallel until the time is up."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from saver_advisors.cli.runs import read_run
from saver_advisors.reporting.errors import UsageError
from saver_envs.registration import ONE_ARM_ID

#: Teacher of the advised student.
TEACHER: Final = "jaco-push"
#: Small networks and frequent evaluations, for a run of two minutes (docs/decisions.md).
LESSON_SETTINGS: Final = (
    "net_arch=[128,128,128]",
    "gradient_steps=120",
    "eval_every=1600",
    "eval_episodes=32",
)
#: Name and further arguments of `saver train` for each student. One is advised in every step and
#: imitates the teacher; the other learns from hindsight relabelling.
STUDENTS: Final = {
    "taught": (
        *("imitation_weight=50", "imitation_filter_start=1000000000"),
        *("relabel_probability=0", "policy_delay=1"),
        *("--advice", "early", "--teacher", TEACHER, "--budget", "1000000000"),
    ),
    "alone": ("--advice", "none"),
}
#: More steps than fit into the time limit, which ends the run.
LESSON_STEPS: Final = 10_000_000
#: Time in which a stopped process must write its checkpoint (s).
PATIENCE: Final = 60.0


def learn(args: argparse.Namespace) -> dict[str, Any]:
    """Train the students in parallel until the time is up.

    :param args: arguments of ``saver demo``
    :return: a summary of each student's curve; students without an evaluation are left out
    :raises UsageError: if a student's process fails
    """
    from saver_advisors.pretrained import shipped_policies

    students = [name for name in STUDENTS if name == "alone" or TEACHER in shipped_policies()]
    # A new folder each time, so that no run is overwritten.
    stamp = time.strftime("%Y%m%d-%H%M%S")
    folders = [args.output / "learning" / stamp / name for name in students]
    processes = [
        subprocess.Popen(_train_command(args, folder), stdout=subprocess.DEVNULL)
        for folder in folders
    ]
    try:
        _watch(processes, folders, args.train_seconds)
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            _wait(process)
    failed = [process.returncode for process in processes if process.returncode != 0]
    if failed:
        raise UsageError(f"training failed with exit status {failed}; see above")
    runs = []
    for folder in folders:
        with suppress(UsageError):  # stopped before the first evaluation
            runs.append(read_run(folder, folder.name).summary())
    return {"seconds": args.train_seconds, "students": students, "runs": runs}


def _train_command(args: argparse.Namespace, folder: Path) -> list[str]:
    return [
        *(sys.executable, "-P", "-m", "saver_advisors.cli", "train", "--env", ONE_ARM_ID),
        *("--output", str(folder), "--seed", str(args.seed), "--steps", str(LESSON_STEPS)),
        *("--time-limit", str(args.train_seconds), "--no-progress"),
        *("--set", *LESSON_SETTINGS, *STUDENTS[folder.name]),
    ]


def _watch(processes: list[subprocess.Popen[bytes]], folders: list[Path], seconds: float) -> None:
    """Show the elapsed time and the latest success rates until every process has ended."""
    from tqdm import tqdm

    start = time.monotonic()
    with tqdm(
        total=round(seconds), unit="s", bar_format="{l_bar}{bar}| {n}/{total} s{postfix}"
    ) as bar:
        while any(process.poll() is None for process in processes):
            time.sleep(0.5)
            elapsed = time.monotonic() - start
            bar.n = min(round(elapsed), bar.total)
            rates = [f"{one.name} {_newest_success(one)}" for one in folders]
            bar.set_postfix_str("success: " + ", ".join(rates))
            if elapsed > seconds + PATIENCE:
                return


def _newest_success(folder: Path) -> str:
    try:
        return f"{read_run(folder, '').points[-1]['success_rate']:.2f}"
    except UsageError:
        return "-"


def _wait(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
