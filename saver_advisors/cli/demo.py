"""Play the whole robot and the shipped policies, learn for two minutes, write a page about it.

The page is a single file: pictures, videos and figures are inside. Beside it lie the videos and
the figures as JSON.
"""

from __future__ import annotations

import argparse
import base64
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

from saver_advisors.cli.arguments import add_json, at_least, positive_seconds
from saver_advisors.cli.demo_robot import VIDEO
from saver_advisors.cli.errors import UsageError
from saver_advisors.threads import one_thread_of_algebra

EXAMPLES = """\
examples:
  saver demo                                       about five minutes on two cores
  saver demo --output /tmp/demo --train-seconds 30 --episodes 16"""

#: What is learned, and from whom.
LESSON_ENV: Final = "JacoPush-v0"
TEACHER: Final = "jaco-push"
#: Small nets and frequent looks: there are two minutes (docs/decisions.md).
LESSON_SETTINGS: Final = (
    "net_arch=[128,128,128]",
    "gradient_steps=120",
    "eval_every=1600",
    "eval_episodes=32",
)
#: A name and further words of the command line for each student. The one that is taught gets the
#: teacher's advice all the time and imitates it; the other has hindsight to learn from.
STUDENTS: Final = {
    "taught": (
        *("imitation_weight=50", "imitation_filter_from=1000000000"),
        *("relabel_probability=0", "policy_delay=1"),
        *("--advice", "early", "--teacher", TEACHER, "--budget", "1000000000"),
    ),
    "alone": ("--advice", "none"),
}
#: Far more than fit into the time: the clock ends it.
LESSON_STEPS: Final = 10_000_000
#: Of the whole robot; ten seconds each, and a minute to compute.
ROBOT_TRIALS: Final = 1
VIDEO_SIZE: Final = (480, 360)
PICTURE_WIDTH: Final = 480
#: A process that was asked to stop finishes its block and its checkpoint within this (s).
PATIENCE: Final = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("demo_output"),
        metavar="DIR",
        help="where the page goes (default: demo_output)",
    )
    parser.add_argument(
        "--episodes",
        type=at_least(1),
        default=50,
        metavar="N",
        help="of each evaluation (default: 50)",
    )
    parser.add_argument(
        "--video-episodes",
        type=at_least(1),
        default=3,
        metavar="N",
        help="of each video (default: 3)",
    )
    parser.add_argument(
        "--train-seconds",
        type=positive_seconds,
        default=120.0,
        metavar="SECONDS",
        help="time to learn (default: 120)",
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="S", help="of everything (default: 0)"
    )
    add_json(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Do all of it; whoever interrupts it loses nothing but the page."""
    from saver_advisors.cli.catalogue import COLUMNS, entry, sparse_ids
    from saver_advisors.cli.demo_robot import whole_robot
    from saver_advisors.provenance import provenance, write_json_atomic

    start = time.perf_counter()
    if args.output.exists() and not args.output.is_dir():
        raise UsageError(f"argument --output: {str(args.output)!r} is a file, no folder")
    args.output.mkdir(parents=True, exist_ok=True)
    print("[1/5] the whole robot: camera, pose network, policy, learned kinematics, servos")
    robot = whole_robot(args.output, ROBOT_TRIALS, args.seed)
    print(f"[2/5] evaluating the shipped policies, {args.episodes} episodes each")
    evaluations = _evaluate(args)
    print(f"[3/5] recording {args.video_episodes} episodes of each")
    videos, scenes = _record(args, evaluations, robot["env"]), _scenes()
    print(
        f"[4/5] learning for {args.train_seconds:.0f} seconds: one student is taught, one is alone"
    )
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
    page = _render(
        args,
        figures,
        videos=videos,
        scenes=scenes,
        environment_columns=COLUMNS,
        environment_rows=[entry(name).cells for name in sparse_ids()],
    )
    (args.output / "index.html").write_text(page, encoding="utf-8")
    for path in (args.output / "demo.json", args.json):
        if path is not None:
            write_json_atomic(path, figures)
    print(f"done in {figures['total_s'] / 60:.1f} minutes: open {args.output / 'index.html'}")
    return 0


# Playing ------------------------------------------------------------------------------------------


def _evaluate(args: argparse.Namespace) -> list[dict[str, Any]]:
    """The shipped policies on their tasks, then what they are to be compared with."""
    from saver_advisors.cli.evaluate import measure, show
    from saver_advisors.cli.policies import resolve
    from saver_advisors.pretrained import load_policy, shipped_policies

    tasks = [(name, load_policy(name).card.env_id) for name in shipped_policies()]
    tasks += _baselines([env for _, env in tasks])
    results = []
    for name, env in tasks:
        policy = resolve(name, env, {}, args.seed)
        results.append(measure(policy, env, args.episodes, args.seed))
        show(results[-1])
    return results


def _baselines(envs: list[str]) -> list[tuple[str, str]]:
    """For every task of several arms that has a policy: its single-arm teacher on every arm."""
    from saver_advisors.pretrained import load_policy, shipped_policies
    from saver_envs.registration import row_of

    single = {
        (row_of(env).task, row_of(env).robot): name
        for name in shipped_policies()
        if row_of(env := load_policy(name).card.env_id).n_arms == 1
    }
    pairs = []
    for env in dict.fromkeys(envs):
        row = row_of(env)
        teacher = single.get((row.task, row.robot))
        if row.n_arms > 1 and teacher is not None:
            pairs.append((f"side-by-side:{teacher}", env))
    return pairs + ([("random", envs[0])] if envs else [])


def _record(
    args: argparse.Namespace, evaluations: list[dict[str, Any]], robot_env: str
) -> list[dict[str, Any]]:
    """A video of each shipped policy, but for the whole robot's, which has one of its own."""
    from saver_advisors.cli.policies import resolve
    from saver_advisors.cli.video import GREY, captioned, record, write_mp4
    from saver_advisors.pretrained import shipped_policies

    videos = []
    for one in evaluations:
        name, env = one["policy"], one["env"]
        if name not in shipped_policies() or env == robot_env:
            continue
        recordings = record(
            resolve(name, env, {}).predict,
            env,
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
                "env": env,
                "episodes": len(recordings),
                "successes": sum(one.success for one in recordings),
                "data": _video_uri(path),
                "poster": _jpeg_uri(captioned(recordings[0].frames[0], name, GREY)),
            }
        )
    return videos


def _scenes() -> list[dict[str, str]]:
    """A picture of each of a few environments."""
    from saver_advisors.cli.pictures import OVERVIEW, start_picture

    return [{"env": env, "picture": _jpeg_uri(start_picture(env))} for env in OVERVIEW]


# Learning -----------------------------------------------------------------------------------------


def _learn(args: argparse.Namespace) -> dict[str, Any]:
    """Students beside each other until the time is over.

    :return: their curves, summed up, as far as there are any
    """
    from saver_advisors.cli.runs import read_run
    from saver_advisors.pretrained import shipped_policies

    students = [name for name in STUDENTS if name == "alone" or TEACHER in shipped_policies()]
    # A new folder each time: a run never overwrites another.
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
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in processes:
            _wait(process)
    failed = [process.returncode for process in processes if process.returncode != 0]
    if failed:
        raise UsageError(f"learning ended early, with exit status {failed}; see above")
    runs = []
    for folder in folders:
        try:
            runs.append(read_run(folder, folder.name).summary())
        except UsageError:
            continue  # no evaluation within so short a time
    return {"seconds": args.train_seconds, "students": students, "runs": runs}


def _train_command(args: argparse.Namespace, folder: Path) -> list[str]:
    return [
        *(sys.executable, "-m", "saver_advisors.cli", "train", "--env", LESSON_ENV),
        *("--output", str(folder), "--seed", str(args.seed), "--steps", str(LESSON_STEPS)),
        *("--time-limit", str(args.train_seconds), "--no-progress"),
        *("--set", *LESSON_SETTINGS, *STUDENTS[folder.name]),
    ]


def _watch(processes: list[subprocess.Popen[bytes]], folders: list[Path], seconds: float) -> None:
    """Show the time and the newest success rates until every process has ended."""
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
    from saver_advisors.cli.runs import read_run

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


# Writing ------------------------------------------------------------------------------------------


def _render(args: argparse.Namespace, figures: dict[str, Any], **parts: Any) -> str:
    """The page."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from saver_advisors.cli.evaluate import COLUMNS, cells
    from saver_advisors.cli.runs import COLUMNS as RUN_COLUMNS
    from saver_advisors.cli.runs import cells as run_cells

    evaluations, learning = figures["evaluations"], figures["learning"]
    collisions = [f"{one['cost_means']['cost_collision']:.2f}" for one in evaluations]
    rows = [[*cells(one), n] for one, n in zip(evaluations, collisions, strict=True)]
    templates = Environment(
        loader=PackageLoader("saver_advisors.cli"), undefined=StrictUndefined, autoescape=True
    )
    return templates.get_template("demo.html.j2").render(
        **parts,
        total_s=figures["total_s"],
        provenance=figures["provenance"],
        episodes=args.episodes,
        seed=args.seed,
        evaluations=evaluations,
        result_columns=(*COLUMNS, "collisions per episode"),
        result_rows=rows,
        baselines=_described_baselines(evaluations),
        bars=_figure_uri(_bars(evaluations)) if evaluations else "",
        robot={**figures["robot"], "data": _video_uri(args.output / VIDEO)},
        learning={
            **learning,
            "env": LESSON_ENV,
            "teacher": TEACHER,
            "figure": _learning_figure(learning["runs"]),
            "columns": RUN_COLUMNS,
            "rows": [run_cells(one) for one in learning["runs"]],
        },
    )


def _described_baselines(evaluations: list[dict[str, Any]]) -> str:
    """What is shown for comparison, in words."""
    names = {one["policy"].partition(":")[0] for one in evaluations}
    words = []
    if "side-by-side" in names:
        words.append("the teacher of one arm driving both, each arm blind to the other")
    if "random" in names:
        words.append("random actions")
    return ", and ".join(words)


def _learning_figure(summaries: list[dict[str, Any]]) -> str:
    from saver_advisors.cli.runs import PANELS, Run, draw

    if not summaries:
        return ""
    runs = [Run(one["name"], {}, one["points"]) for one in summaries]
    return _figure_uri(draw(runs, PANELS[:2]))


def _bars(evaluations: list[dict[str, Any]]) -> Any:
    """Success with its interval, a bar a policy."""
    from matplotlib.figure import Figure

    from saver_advisors.evaluation.plots import COLOURS

    figure = Figure(figsize=(9, 0.9 + 0.45 * len(evaluations)), layout="constrained", dpi=120)
    axes = figure.subplots()
    names = [f"{one['policy']}\n{one['env']}" for one in evaluations]
    rates = [one["success_rate"] for one in evaluations]
    margins = [
        [rate - one["ci95"][0] for rate, one in zip(rates, evaluations, strict=True)],
        [one["ci95"][1] - rate for rate, one in zip(rates, evaluations, strict=True)],
    ]
    compared = [":" in one["policy"] or one["policy"] == "random" for one in evaluations]
    colours = ["0.65" if plain else COLOURS[0] for plain in compared]
    axes.barh(names, rates, xerr=margins, color=colours, height=0.62, error_kw={"capsize": 3})
    axes.invert_yaxis()
    axes.set_xlim(0, 1.02)
    axes.set_xlabel("success rate, with its 95% interval")
    axes.tick_params(axis="y", labelsize=8, length=0)
    axes.grid(axis="x", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _figure_uri(figure: Any) -> str:
    import io

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return _data_uri("image/png", buffer.getvalue())


def _jpeg_uri(picture: Any) -> str:
    import io

    from PIL import Image

    image = Image.fromarray(picture)
    image.thumbnail((PICTURE_WIDTH, PICTURE_WIDTH))
    buffer = io.BytesIO()
    image.save(buffer, format="JPEG", quality=88)
    return _data_uri("image/jpeg", buffer.getvalue())


def _video_uri(path: Path) -> str:
    return _data_uri("video/mp4", path.read_bytes())


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
