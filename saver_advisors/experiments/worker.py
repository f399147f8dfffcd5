"""Execute one run of a grid in its own process: ``python -m saver_advisors.experiments.worker``.

The process resumes from the run's checkpoint, if any, and writes the result when it ends, even if
the run is incomplete. A third-party algorithm has no checkpoint and starts again. On SIGTERM, or
when its parent process ends, it writes a checkpoint and stops. A lock prevents two processes from
executing the same run.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.experiments.recorder import BenchmarkPlan, Recorder
from saver_advisors.experiments.results import STEPS_FILE, is_done, write_result
from saver_advisors.reporting.provenance import COMMAND_VARIABLE, command_line, write_json_atomic

RUN_FILE: Final = "experiment.json"
LOG_FILE: Final = "worker.log"
#: Exit statuses.
DONE, FAILED, STOPPED, BUSY = 0, 1, 3, 4
#: Seconds between two checks of whether the parent process still exists.
LOOK_EVERY: Final = 1.0


def execute(run: ExperimentRun, folder: Path, result: Path, threads: int = 1) -> int:
    """Execute or resume a run in this process.

    :param run: of a grid
    :param folder: the run's own, created if missing
    :param result: path of its result
    :param threads: see ``saver_advisors.training.launch.train``
    :return: ``DONE``, ``STOPPED`` before its end, or ``BUSY`` if another process executes it
    """
    from saver_advisors.training.launch import train
    from saver_advisors.training.run_folder import FolderInUseError, locked

    try:
        with locked(folder):
            if is_done(result, run):
                return DONE
            if isinstance(run.config, BenchmarkPlan):
                stepped = _steps_file(folder / STEPS_FILE)
                _train_third_party(Recorder(run.config, result.parent, stepped=stepped), threads)
                return DONE
            outcome = train(run.config, folder, resume=True, progress=False, threads=threads)
            if outcome.success_rate is not None:
                write_result(run, folder, result, threads)
            return DONE if outcome.finished else STOPPED
    except FolderInUseError:
        return BUSY


def _train_third_party(recorder: Recorder, threads: int) -> None:
    """Run a third-party algorithm from its first step; a stop loses it until its steps are done."""
    from saver_advisors.experiments.third_party import load_class, train
    from saver_advisors.training.threads import threads_of_algebra

    def stop(number: int, frame: object) -> None:
        if not recorder.spent:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        with threads_of_algebra(threads):
            train(load_class(recorder.plan.algorithm), recorder)
    finally:
        signal.signal(signal.SIGTERM, before)


def _steps_file(path: Path) -> Callable[[int], None]:
    """Return a function that writes a number of steps to a file, at most every two seconds."""
    written = -math.inf

    def write(steps: int) -> None:
        nonlocal written
        if time.monotonic() - written > 2.0:
            write_json_atomic(path, steps)
            written = time.monotonic()

    return write


def start(
    run: ExperimentRun,
    folder: Path,
    result: Path,
    command: str | None = None,
    threads: int = 1,
) -> subprocess.Popen[bytes]:
    """Execute a run in its own process, with its output in a log in the run's folder.

    :param run: of a grid
    :param folder: the run's own, created if missing
    :param result: path of its result
    :param command: that results record as their origin; that of this process by default
    :param threads: see ``saver_advisors.training.launch.train``
    :return: the process, which stops when this process ends
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json_atomic(folder / RUN_FILE, run.to_mapping())
    # -P: nothing is imported from the current folder, where files may have the names of packages.
    words = [sys.executable, "-P", "-m", __name__, str(folder), str(result)]
    words += ["--threads", str(threads)]
    # A new session, since Ctrl-C reaches all processes of the terminal's foreground group.
    with open(folder / LOG_FILE, "ab") as log:
        return subprocess.Popen(
            words,
            env={**os.environ, COMMAND_VARIABLE: command or command_line()},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def last_words(folder: Path) -> str:
    """Return the last line of a log.

    :param folder: of a run that failed
    """
    try:
        text = (folder / LOG_FILE).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return "".join(text.strip().splitlines()[-1:]).strip()


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute the run that is described in the folder.

    :param arguments: of the command line
    :return: exit status
    """
    parser = argparse.ArgumentParser(description="Execute one run of a grid of experiments.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args(arguments)
    threading.Thread(target=_stop_without, args=(os.getppid(),), daemon=True).start()
    values = json.loads((args.folder / RUN_FILE).read_text(encoding="utf-8"))
    run = ExperimentRun.from_mapping(values)
    # Training finishes its block on this signal; all else stops at once.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return execute(run, args.folder, args.result, args.threads)
    except KeyboardInterrupt:
        return STOPPED


def _stop_without(parent: int) -> None:
    """Send SIGTERM to this process when it gets another parent, since its own has ended."""
    while os.getppid() == parent:
        time.sleep(LOOK_EVERY)
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(main())
