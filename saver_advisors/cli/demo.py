"""Play the whole robot and the shipped policies, learn for two minutes, write a page about it.

Beside the page lie the videos and the figures as JSON.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from saver_advisors.cli.arguments import add_count, add_json, positive_seconds
from saver_advisors.cli.demo_learning import learn
from saver_advisors.cli.demo_page import jpeg_uri, render, video_uri
from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.reporting.errors import UsageError
from saver_advisors.training.threads import one_thread_of_algebra

EXAMPLES = """\
examples:
  saver demo                                       about six minutes on two cores
  saver demo --output /tmp/demo --train-seconds 30 --episodes 16"""

#: Of the whole robot; ten seconds each, and a minute to compute.
ROBOT_TRIALS: Final = 1
VIDEO_SIZE: Final = (480, 360)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("demo_output"),
        metavar="DIR",
        help="where the page goes (default: demo_output)",
    )
    add_count(parser, "--episodes", 50, "of each evaluation")
    add_count(parser, "--video-episodes", 3, "of each video")
    parser.add_argument(
        "--train-seconds",
        type=positive_seconds,
        default=120.0,
        metavar="SECONDS",
        help="time to learn (default: 120)",
    )
    add_count(parser, "--seed", 0, "of everything", least=0, metavar="S")
    add_json(parser)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Do all of it; whoever interrupts it loses nothing but the page."""
    from saver_advisors.cli.catalogue import COLUMNS, entry, sparse_ids
    from saver_advisors.cli.demo_robot import whole_robot
    from saver_advisors.reporting.provenance import provenance, write_json_atomic

    start = time.perf_counter()
    if args.output.exists() and not args.output.is_dir():
        raise UsageError(f"argument --output: {str(args.output)!r} is a file, no folder")
    args.output.mkdir(parents=True, exist_ok=True)
    print("[1/5] the whole robot: camera, pose network, policy, learned kinematics, servos")
    robot = whole_robot(args.output, ROBOT_TRIALS, args.seed)
    print(f"[2/5] evaluating the shipped policies, {args.episodes} episodes each")
    evaluations = _evaluate(args)
    print(f"[3/5] recording {args.video_episodes} episodes of the best in each environment")
    videos, scenes = _record(args, evaluations, robot["env"]), _scenes()
    print(
        f"[4/5] learning for {args.train_seconds:.0f} seconds: one student is taught, one is alone"
    )
    learning = learn(args)
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
        environment_columns=COLUMNS,
        environment_rows=[entry(name).cells for name in sparse_ids()],
    )
    (args.output / "index.html").write_text(page, encoding="utf-8")
    for path in (args.output / "demo.json", args.json):
        if path is not None:
            write_json_atomic(path, figures)
    print(f"done in {figures['total_s'] / 60:.1f} minutes: open {args.output / 'index.html'}")
    return 0


class Player(NamedTuple):
    """A policy, and the environment that it plays in.

    :param policy: a word that ``policies.resolve`` knows
    :param env_id: the environment's id
    :param env_kwargs: its keyword arguments
    """

    policy: str
    env_id: str
    env_kwargs: dict[str, Any]

    @property
    def environment(self) -> str:
        """The environment with its arguments, as a text."""
        return environment_text(self.env_id, self.env_kwargs)


def players() -> list[Player]:
    """The shipped policies in their environments, then what they are to be compared with."""
    from saver_advisors.pretrained import load_policy, shipped_policies

    cards = {name: load_policy(name).card for name in shipped_policies()}
    shipped = [Player(name, card.env_id, dict(card.env_kwargs)) for name, card in cards.items()]
    return shipped + _baselines(shipped)


def _baselines(shipped: list[Player]) -> list[Player]:
    """The single-arm teacher on every arm, where a policy of several arms plays; random actions."""
    from saver_envs.registration import row_of

    single = {
        (row.task, row.robot): one.policy
        for one in shipped
        if (row := row_of(one.env_id)).n_arms == 1
    }
    found = []
    for one in {one.environment: one for one in shipped}.values():
        row = row_of(one.env_id)
        teacher = single.get((row.task, row.robot))
        if row.n_arms > 1 and teacher is not None:
            found.append(one._replace(policy=f"side-by-side:{teacher}"))
    return found + [one._replace(policy="random") for one in shipped[:1]]


def _evaluate(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Every player's figures."""
    from saver_advisors.cli.evaluate import measure, show
    from saver_advisors.cli.policies import resolve

    results = []
    for name, env, kwargs in players():
        policy = resolve(name, env, kwargs, args.seed)
        results.append(measure(policy, env, args.episodes, args.seed, kwargs))
        show(results[-1])
    return results


def best_shipped(
    evaluations: Sequence[Mapping[str, Any]], left_out: str
) -> list[Mapping[str, Any]]:
    """Of the shipped policies the best in each environment, of equals the first.

    :param evaluations: as ``saver evaluate`` writes them
    :param left_out: id of an environment that is passed over
    :return: one evaluation an environment
    """
    from saver_advisors.pretrained import shipped_policies

    best: dict[str, Mapping[str, Any]] = {}
    for one in evaluations:
        if one["policy"] in shipped_policies() and one["env"] != left_out:
            environment = environment_text(one["env"], one["env_kwargs"])
            other = best.setdefault(environment, one)
            if one["success_rate"] > other["success_rate"]:
                best[environment] = one
    return list(best.values())


def _record(
    args: argparse.Namespace, evaluations: list[dict[str, Any]], robot_env: str
) -> list[dict[str, Any]]:
    """A video from each environment, but for the whole robot's, which has one of its own."""
    from saver_advisors.cli.policies import resolve
    from saver_advisors.reporting.video import GREY, captioned, record, write_mp4

    videos = []
    for one in best_shipped(evaluations, left_out=robot_env):
        name, env, kwargs = one["policy"], one["env"], one["env_kwargs"]
        recordings = record(
            resolve(name, env, kwargs).predict,
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


def _scenes() -> list[dict[str, str]]:
    """A picture of each of a few environments."""
    from saver_advisors.cli.pictures import start_picture
    from saver_envs.registration import SHOWN_IDS

    return [{"env": env, "picture": jpeg_uri(start_picture(env))} for env in SHOWN_IDS]
