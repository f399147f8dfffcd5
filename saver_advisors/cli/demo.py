"""Run the whole robot and the shipped policies, train for two minutes, and write a report page.

The videos and the results as JSON are written to the same folder.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from saver_advisors.cli.arguments import add_count, add_folder, add_json, add_seconds
from saver_advisors.cli.benchmark_worlds import entrants
from saver_advisors.cli.catalogue import COLUMNS, entry, sparse_ids
from saver_advisors.cli.curves import summary
from saver_advisors.cli.demo_page import ROBOT_VIDEO, jpeg_uri, render, video_uri
from saver_advisors.cli.evaluate import measure, show
from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.provenance import provenance, write_json_atomic
from saver_advisors.reporting.tables import row_cells
from saver_advisors.training.threads import one_thread_of_algebra
from saver_envs.registration import ONE_ARM_ID, SHOWN_IDS, row_of

EXAMPLES = """\
examples:
  saver demo                                       about six minutes on two cores
  saver demo --output /tmp/demo --train-seconds 30 --episodes 16"""

VIDEO_SIZE: Final = (480, 360)
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    text = "folder of the page (default: demo_output)"
    add_folder(parser, "--output", text, default=Path("demo_output"))
    add_count(parser, "--episodes", 50, "episodes per evaluation")
    add_count(parser, "--video-episodes", 3, "episodes per video")
    add_seconds(parser, "--train-seconds", "training time", 120.0)
    add_count(parser, "--seed", 0, "seed of all random numbers", least=0, metavar="S")
    add_json(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Run every part and write the page; an interruption loses only the page."""
    from saver_advisors.reporting.video import start_picture

    start = time.perf_counter()
    args.output.mkdir(parents=True, exist_ok=True)
    print("[1/5] the whole robot: camera, pose network, policy, learned kinematics, servos")
    robot = _whole_robot(args)
    print(f"[2/5] evaluating the shipped policies, {args.episodes} episodes each")
    evaluations = []
    for name, env, kwargs in players():
        evaluations.append(measure(name, env, args.episodes, args.seed, kwargs))
        show(evaluations[-1])
    print(f"[3/5] recording {args.video_episodes} episodes of the best policy per environment")
    videos = _record(args, evaluations, robot["env"])
    scenes = [{"env": env, "picture": jpeg_uri(start_picture(env))} for env in SHOWN_IDS]
    print(f"[4/5] training two students for {args.train_seconds:.0f} s: with and without advice")
    learning = _learn(args)
    print("[5/5] writing the page")
    figures: dict[str, Any] = {
        "kind": "demo",
        "robot": robot,
        "evaluations": evaluations,
        "learning": learning,
        "total_s": round(time.perf_counter() - start, 1),
        "provenance": provenance(),
    }
    page = render(
        args,
        figures,
        videos=videos,
        scenes=scenes,
        teacher=TEACHER,
        environment_columns=COLUMNS,
        environment_rows=row_cells(map(entry, sparse_ids()), COLUMNS.values()),
    )
    (args.output / "index.html").write_text(page, encoding="utf-8")
    for path in (args.output / "demo.json", args.json):
        if path is not None:
            write_json_atomic(path, figures)
    print(f"done in {figures['total_s'] / 60:.1f} minutes: open {args.output / 'index.html'}")
    return 0


def _whole_robot(args: argparse.Namespace) -> dict[str, Any]:
    """Run and record a trial with all learned components, from the camera to the pushed wrists.

    Its ten simulated seconds take about a minute.
    """
    from saver_advisors.integration import POLICY
    from saver_advisors.integration.assembly import build_loop, settings_for
    from saver_advisors.integration.casualty import ENV_ID
    from saver_advisors.integration.recording import VideoRecorder
    from saver_advisors.integration.trial import SUCCEEDED, run_trial
    from saver_advisors.integration.wrist_bench import WristBench

    began = time.perf_counter()
    settings = settings_for(POLICY)
    with closing(WristBench()) as bench:
        loop = build_loop(settings, bench)
        with closing(VideoRecorder(args.output / ROBOT_VIDEO, loop, every=3)) as recorder:
            trial = run_trial(loop, args.seed, look=recorder)
            recorder.end(trial)
    return {
        "env": ENV_ID,
        "policy": settings.policy,
        "trials": 1,
        "succeeded": int(trial.outcome == SUCCEEDED),
        "causes": [str(trial.cause or trial.outcome)],
        "seconds": round(time.perf_counter() - began, 1),
    }


def _learn(args: argparse.Namespace) -> dict[str, Any]:
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


def players() -> list[tuple[str, str, dict[str, Any]]]:
    """Return the shipped policies, each in its environment, followed by the baselines.

    Those are side-by-side teachers for the multi-arm environments, and random actions.

    :return: name of a policy, id and keyword arguments of the environment
    """
    shipped = [(name, *place) for name, place in entrants(None, None).items()]
    single = {
        (row.task, row.robot): policy
        for policy, env_id, _ in shipped
        if (row := row_of(env_id)).n_arms == 1
    }
    found = list(shipped)
    for env_id, env_kwargs in {environment_text(*one[1:]): one[1:] for one in shipped}.values():
        row = row_of(env_id)
        teacher = single.get((row.task, row.robot))
        if row.n_arms > 1 and teacher is not None:
            found.append((f"side-by-side:{teacher}", env_id, env_kwargs))
    return found + [("random", *one[1:]) for one in shipped[:1]]


def best_shipped(
    evaluations: Sequence[Mapping[str, Any]], left_out: str
) -> list[Mapping[str, Any]]:
    """Return the evaluation of the best shipped policy in each environment; ties go to the first.

    :param evaluations: as ``saver evaluate`` writes them
    :param left_out: id of an environment to leave out
    :return: one evaluation per environment
    """
    from saver_advisors.pretrained import shipped_policies

    found: dict[str, list[Mapping[str, Any]]] = {}
    for one in evaluations:
        if one["policy"] in shipped_policies() and one["env"] != left_out:
            found.setdefault(environment_text(one["env"], one["env_kwargs"]), []).append(one)
    return [max(of_env, key=lambda one: one["success_rate"]) for of_env in found.values()]


def _record(
    args: argparse.Namespace, evaluations: list[dict[str, Any]], robot_env: str
) -> list[dict[str, Any]]:
    """Record a video per environment, except that of the whole robot, which has its own."""
    from saver_advisors.cli.policies import resolve
    from saver_advisors.reporting.video import GREY, captioned, record, write_mp4

    videos = []
    for one in best_shipped(evaluations, left_out=robot_env):
        name, env, kwargs = one["policy"], one["env"], one["env_kwargs"]
        recordings = record(
            resolve(name, env, kwargs),
            env,
            env_kwargs=kwargs,
            episodes=args.video_episodes,
            seed=args.seed,
            width=VIDEO_SIZE[0],
            height=VIDEO_SIZE[1],
            progress=True,
        )
        path = args.output / f"{name}.mp4"
        write_mp4(path, recordings, name)
        videos.append(
            {
                "policy": name,
                "env": environment_text(env, kwargs),
                "episodes": len(recordings),
                "successes": sum(one.success for one in recordings),
                "data": video_uri(path),
                "poster": jpeg_uri(captioned(recordings[0].frames[0], name, GREY)),
            }
        )
    return videos
