"""The demo's training: two students in parallel until the time is up."""

from __future__ import annotations

import argparse
import time
from typing import Any, Final

from saver_advisors.cli.curves import summary
from saver_advisors.reporting.errors import UsageError
from saver_envs.registration import ONE_ARM_ID

#: Teacher of the advised student.
TEACHER: Final = "jaco-push"
#: Small networks and frequent evaluations, for a run of two minutes (docs/decisions.md).
LESSON_SETTINGS: Final = {
    "net_arch": [128, 128, 128],
    "gradient_steps": 120,
    "eval_every": 1600,
    "eval_episodes": 32,
    # More steps than fit into the time limit, which ends the run.
    "total_steps": 10_000_000,
}
#: Further settings of each student. One is advised in every step and imitates the teacher; the
#: other learns from hindsight relabelling.
STUDENTS: Final[dict[str, dict[str, Any]]] = {
    "taught": {
        "imitation_weight": 50,
        "imitation_filter_start": 1_000_000_000,
        "relabel_probability": 0,
        "policy_delay": 1,
        "advice": {"strategy": "early", "teacher": TEACHER, "budget": 1_000_000_000},
    },
    "alone": {"advice": None},
}
#: Time in which the students' processes start (s), which the training time does not include.
START_UP: Final = 8.0


def learn(args: argparse.Namespace) -> dict[str, Any]:
    """Train the students in parallel until the time is up.

    :param args: arguments of ``saver demo``
    :return: a summary of each student's curve; students without an evaluation are left out
    :raises UsageError: if a student's process fails
    """
    from saver_advisors.experiments.grid import ExperimentRun, Grid
    from saver_advisors.experiments.progress import shown_progress
    from saver_advisors.experiments.scheduler import LocalProcesses, Places, work_off
    from saver_advisors.experiments.training_runs import read_training_runs
    from saver_advisors.pretrained import shipped_policies
    from saver_advisors.training.defaults import default_settings
    from saver_advisors.training.settings import RunConfig
    from saver_advisors.training.stopping import Stop

    students = [name for name in STUDENTS if name == "alone" or TEACHER in shipped_policies()]
    common = {**default_settings(ONE_ARM_ID), **LESSON_SETTINGS, "seed": args.seed}
    configs = {name: RunConfig.from_mapping({**common, **STUDENTS[name]}) for name in students}
    grid = Grid("", tuple(ExperimentRun(one, "", one, configs[one]) for one in students))
    # A new folder each time, so that no run is overwritten.
    folder = args.output / "learning" / time.strftime("%Y%m%d-%H%M%S")
    places = Places(folder, folder / "results")
    backend, stop = LocalProcesses(places, len(students)), Stop(START_UP + args.train_seconds)
    with shown_progress(grid, places) as look:
        progress = work_off(grid, places, backend, stop, look)
    for name, words in progress.failed.items():
        raise UsageError(f"training failed: {name}: {words} (see {folder / name})")
    runs = sorted(read_training_runs([places.results]).runs, key=lambda run: run.row != "taught")
    return {
        "seconds": args.train_seconds,
        "students": students,
        "runs": [summary(run) for run in runs],
    }
