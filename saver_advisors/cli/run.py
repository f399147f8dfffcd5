"""Run the whole robot: camera, pose, policy, inverse kinematics and servos in one closed loop."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from saver_advisors.cli import arguments
from saver_advisors.integration import EXTRACTION, POLICY
from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.integration.assembly import LoopSettings
    from saver_advisors.integration.trial import TrialRecord
    from saver_advisors.integration.wrist_bench import WristBench

EXAMPLES = """\
examples:
  saver run wrist-push --video trial.mp4            a trial: camera, scene, distance and force
  saver run wrist-push --trials 20 --report report  a page with each failed trial's video and cause
  saver run wrist-push --view                       a window, which needs a display
  saver run wrist-push --true-state --exact-ik      without camera, network and learned kinematics
  saver run wrist-push --apart                      its stages in three processes, in real time
  saver run extraction --true-state --trials 50     a person's limbs straight, then into the robot
  saver run ArmStraighten-v0 --video arms.mp4       one of its tasks, seen by a camera"""

Look = Callable[[float], None]
WRIST_PUSH: Final = "wrist-push"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments.

    :param parser: of the command.
    """
    text = "wrist-push, extraction, or a task of the extraction"
    arguments.add(parser, "task", text, type=_task, metavar="TASK")
    arguments.add_count(parser, "--trials", 1, "number of trials")
    arguments.add_count(parser, "--seed", 0, "of the first trial", least=0, metavar="S")
    add_loop_arguments(parser)
    arguments.add_flag(parser, "--true-state", "use the true state, no camera")
    arguments.add_flag(parser, "--exact-ik", "use damped least squares")
    shown = parser.add_mutually_exclusive_group()
    text = "record all trials in this file"
    arguments.add_file(shown, "--video", text, ".mp4", metavar="FILE.mp4")
    arguments.add_flag(shown, "--view", "show the scene in a window")
    arguments.add_folder(shown, "--report", "write a page about the trials in this folder")
    arguments.add_flag(parser, "--apart", "run the stages in three processes, in real time")
    arguments.add_json(parser)


def _task(text: str) -> str:
    """Parse the task."""
    from saver_envs.registration import EXTRACTION_IDS

    valid = (WRIST_PUSH, EXTRACTION, *EXTRACTION_IDS)
    if text not in valid:
        raise argparse.ArgumentTypeError(unknown("task", text, valid))
    return text


def add_loop_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that the reproduction shares.

    :param parser: of the command.
    """
    text = "a shipped policy, a weight file, or expert"
    arguments.add(parser, "--policy", text, POLICY, metavar="POLICY")
    text = "of the tools (default: 0.2, Table 5.3)"
    arguments.add(parser, "--max-speed", text, type=float, metavar="M/S")
    text = "use the duration of each call on this machine as its latency"
    arguments.add_flag(parser, "--measured-latency", text)


def settings_of(args: argparse.Namespace) -> LoopSettings:
    """Return the loop's settings, with all learned components.

    :param args: see :func:`add_loop_arguments`.
    :raises UsageError: for a policy that does not fit, or an invalid speed.
    """
    from saver_advisors.integration.assembly import settings_for
    from saver_advisors.integration.safety import SafetyLimits

    with user_mistakes("argument --policy"):
        settings = settings_for(args.policy)
    if args.max_speed is not None:
        with user_mistakes("argument --max-speed"):
            settings = replace(settings, limits=SafetyLimits(max_speed=args.max_speed))
    return settings.measured() if args.measured_latency else settings


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Run the trials, show them, and print their outcomes.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """
    if args.task != WRIST_PUSH:
        from saver_advisors.cli.run_extraction import run_extraction

        return run_extraction(args)
    settings = replace(
        settings_of(args), seeing=not args.true_state, learned_kinematics=not args.exact_ik
    )
    if args.apart and (args.video or args.view or args.report):
        raise UsageError("argument --apart: not with --video, --view or --report")
    records = _play(args, settings)
    trials = [one.summary() for one in records]
    arguments.write_json(args.json, {"kind": "run", "trials": trials})
    return 0


def _play(args: argparse.Namespace, settings: LoopSettings) -> list[TrialRecord]:
    from tqdm import tqdm

    from saver_advisors.integration.assembly import build_loop
    from saver_advisors.integration.casualty import TASK
    from saver_advisors.integration.recording import VideoRecorder
    from saver_advisors.integration.run_page import write_report
    from saver_advisors.integration.trial import run_trial
    from saver_advisors.integration.wrist_bench import WristBench

    records = []
    with ExitStack() as stack:
        bench = stack.enter_context(closing(WristBench()))
        processes = recorder = None
        if args.apart:
            from saver_advisors.integration.supervisor import SILENT_PERIODS, ProcessLoop

            settings = replace(settings, silent_periods=SILENT_PERIODS)
            processes = stack.enter_context(ProcessLoop(settings, bench))
        loop = processes.loop if processes else build_loop(settings, bench)
        if args.video is not None:
            stack.callback(print, f"wrote {args.video}")
            recorder = stack.enter_context(closing(VideoRecorder(args.video, loop)))
        look = recorder or (_window(bench) if args.view else None)
        actions = args.trials * (TASK.horizon + 1)
        bar = stack.enter_context(tqdm(total=actions, unit="action", dynamic_ncols=True))

        def counted(now: float) -> None:
            bar.update()
            if look is not None:
                look(now)

        advance = processes.run_until if processes else None
        for seed in range(args.seed, args.seed + args.trials):
            records.append(run_trial(loop, seed, look=counted, advance=advance))
            _tell(records[-1])
            if recorder is not None:
                recorder.end(records[-1])
        if processes:
            for name, (calls, mean) in processes.timings.items():
                print(f"  {name:14} {calls:6.0f} calls, {1000 * mean:7.2f} ms")
        elif args.report is not None:
            print(f"wrote {write_report(args.report, loop, records)}")
        elif look is None:
            print(f"to watch it: saver run {args.task} --video trial.mp4")
    return records


def _window(bench: WristBench) -> Look:
    """Return a function that shows the scene in a window after each action."""
    from saver_envs.cameras.rendering import DEFAULT_SIZE
    from saver_envs.envs.pictures import Pictures

    pictures = Pictures(bench.episodes, "human", *DEFAULT_SIZE, "front")
    return lambda now: pictures.draw()


def _tell(record: TrialRecord) -> None:
    from tqdm import tqdm

    tqdm.write(f"trial {record.seed}: {record.cause or record.outcome}")
    for event in record.log:
        tqdm.write(f"  {event}")
