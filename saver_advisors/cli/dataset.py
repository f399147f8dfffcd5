"""Write a data set of episodes, for learning offline: Minari's format, or LeRobot's with pictures.

Episode i starts from seed + i. The default seed is one of training, so that a policy can be
evaluated on other episodes than those that it learned from.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli import arguments
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.datasets.actors import Actor
    from saver_advisors.datasets.recorded_episodes import RecordedEpisode

EXAMPLES = """\
examples:
  saver dataset expert --env JacoPush-v0 --episodes 200 --output sets
  saver dataset medium --env JacoPush-v0 --policy jaco-push --noise 0.8
  saver dataset advised --env DualJacoPush-v0 --teacher jaco-push --advice mc-act --threshold 0.5
  saver dataset replay runs/push --output sets
  saver dataset expert --env JacoPush-v0 --episodes 20 --format lerobot --output lerobot/push

kinds:
  expert    the scripted expert of the task, or another policy as it is
  medium    the same with Gaussian noise on its actions
  advised   the medium policy as a student, whose actions a teacher replaces where a strategy
            decides so; infos["advised"] marks them
  replay    the episodes in the replay buffer of a training run; they have no seeds"""

FORMATS: Final = ("minari", "lerobot")
STRATEGY: Final = "mc-act"
THRESHOLD: Final = 1.0
"""Of the default strategy: a difference of actions, which span [-1, 1], that noise often makes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of every kind."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    for name, text in (
        ("expert", "episodes of the scripted expert, or of another policy"),
        ("medium", "episodes of a policy with noise"),
        ("advised", "episodes of a student with a teacher's advice"),
    ):
        kind = kinds.add_parser(name, help=text, description=f"Write {text}.")
        _add_played(kind, noise=name != "expert")
        if name == "advised":
            _add_advice(kind)
    text = "the episodes in the replay buffer of a training run"
    replay = kinds.add_parser("replay", help=text, description=f"Write {text}.")
    arguments.add_path(replay, "run_dir", "a folder of `saver train`", metavar="RUN_DIR")
    arguments.add_count(replay, "--episodes", None, "number of newest episodes (default: all)")
    for kind in kinds.choices.values():
        text = "folder of all data sets of Minari (default: $MINARI_DATASETS_PATH, or "
        text += "~/.minari/datasets), or of the data set of LeRobot"
        arguments.add_folder(kind, "--output", text)
        text = "id of the data set of Minari (default: saver/ENV/KIND-v0)"
        arguments.add(kind, "--name", text, metavar="ID")
        arguments.add_json(kind)


def _add_played(parser: argparse.ArgumentParser, noise: bool) -> None:
    from saver_advisors.evaluation.protocol import TRAINING_SEED

    arguments.add_env(parser, required=True)
    text = "the policy, as for `saver evaluate`"
    arguments.add(parser, "--policy", text, "expert", metavar="POLICY")
    if noise:
        text = "standard deviation of the noise; actions span [-1, 1] (default: 1)"
        arguments.add(parser, "--noise", text, type=float, metavar="S")
    arguments.add_count(parser, "--episodes", 100, "number of episodes")
    arguments.add_count(parser, "--seed", TRAINING_SEED, "of episode 0", least=0, metavar="S")
    arguments.add_env_kwargs(parser)
    arguments.add(parser, "--format", "of the files", FORMATS[0], choices=FORMATS)
    pictures = parser.add_argument_group("LeRobot")
    arguments.add_several(pictures, "--cameras", str, ["front"], "of the pictures", "NAME")
    size: Any = {"nargs": 2, "type": arguments.at_least(2), "metavar": ("WIDTH", "HEIGHT")}
    arguments.add(pictures, "--size", "of the pictures, pixels", [320, 240], **size)
    arguments.add(pictures, "--instruction", "the task in words", metavar="TEXT")


def _add_advice(parser: argparse.ArgumentParser) -> None:
    text = "teacher of every arm, as for `saver train` (default: scripted:ENV)"
    arguments.add(parser, "--teacher", text, type=arguments.teacher, metavar="NAME")
    arguments.add(parser, "--advice", "strategy", STRATEGY, metavar="STRATEGY")
    text = f"of a strategy that corrects (default: the strategy's; {THRESHOLD:g} for {STRATEGY})"
    arguments.add(parser, "--threshold", text, type=float, metavar="T")
    text = "environment steps that may be advised (default: all)"
    arguments.add_count(parser, "--budget", None, text, least=0)


@dataclass
class _Source:
    """Where the episodes of a data set come from.

    :param env_id: their environment
    :param env_kwargs: its keyword arguments
    :param episodes: the episodes, made as they are read
    :param count: how many there will be
    :param algorithm: what chose the actions
    :param about: further facts
    """

    env_id: str
    env_kwargs: dict[str, Any]
    episodes: Iterator[RecordedEpisode]
    count: int
    algorithm: str
    about: dict[str, Any]


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Play or read the episodes, and write them."""
    import minari  # noqa: F401  (say that it is missing before episodes are played)
    import pyarrow  # noqa: F401

    from saver_advisors.reporting import tables

    source = _replayed(args) if args.kind == "replay" else _played(args)
    figures = about_episodes(
        args.kind, source.env_id, source.env_kwargs, source.algorithm, source.about
    )
    totals = _Totals()
    try:
        where = _write(args, source, figures, totals)
    except (ValueError, FileExistsError) as error:
        raise UsageError(str(error)) from error
    figures |= {"folder": str(where), **totals.figures()}
    rows = [[str(where), *totals.cells()]]
    tables.show(("data set", "episodes", "steps", "success", "advised"), rows)
    arguments.write_json(args.json, figures)
    return 0


def about_episodes(
    kind: str, env_id: str, env_kwargs: dict[str, Any], algorithm: str, more: dict[str, Any]
) -> dict[str, Any]:
    """Return what a data set says about its episodes, with their provenance.

    :param kind: such as ``expert``
    :param env_id: their environment
    :param env_kwargs: its keyword arguments
    :param algorithm: what chose the actions
    :param more: further JSON-able facts
    """
    from saver_advisors.reporting.provenance import provenance
    from saver_envs.digest import world_digest

    return {
        "kind": "dataset",
        "episodes_of": kind,
        "env": env_id,
        "env_kwargs": env_kwargs,
        "world": world_digest(env_id, env_kwargs),
        "algorithm": algorithm,
        **more,
        "provenance": provenance(),
    }


def _write(
    args: argparse.Namespace, source: _Source, about: dict[str, Any], totals: _Totals
) -> Path:
    """Write the data set and return its folder."""
    counted = totals.count(source)
    if getattr(args, "format", FORMATS[0]) == "lerobot":
        return _write_lerobot(args, source, counted)
    from saver_advisors.datasets.minari_files import write_minari

    short = source.env_id.rpartition(":")[2]
    return write_minari(
        args.name or f"saver/{short}/{args.kind}-v0",
        counted,
        source.env_id,
        source.env_kwargs,
        algorithm=source.algorithm,
        description=f"Episodes of {short}: {source.algorithm}.",
        about=about,
        root=args.output,
    )


def _write_lerobot(
    args: argparse.Namespace, source: _Source, episodes: Iterator[RecordedEpisode]
) -> Path:
    from saver_advisors.datasets.lerobot_check import check_lerobot
    from saver_advisors.datasets.lerobot_files import write_lerobot

    if args.output is None:
        raise UsageError("argument --output: say in which folder LeRobot's data set goes")
    if args.name is not None:
        raise UsageError("argument --name: only for --format minari; LeRobot's have a folder")
    write_lerobot(
        args.output,
        episodes,
        source.env_id,
        source.env_kwargs,
        instruction=args.instruction,
        cameras=tuple(args.cameras),
        size=(args.size[0], args.size[1]),
    )
    check_lerobot(args.output)
    folder: Path = args.output
    return folder


def _played(args: argparse.Namespace) -> _Source:
    """Return episodes that are played now."""
    from saver_advisors.cli.policies import resolve
    from saver_advisors.datasets.actors import MEDIUM_NOISE, Actor, NoisyActor
    from saver_advisors.datasets.recorded_episodes import record_episodes

    env_kwargs = arguments.checked_env_kwargs(args.env, args.env_kwargs)
    try:
        json.dumps(env_kwargs)
    except TypeError as error:
        raise UsageError(f"argument --env-kwargs: {error}, which a data set must be") from error
    actor = Actor(resolve(args.policy, args.env, env_kwargs, args.seed))
    algorithm = "scripted expert" if args.policy == "expert" else f"policy {args.policy}"
    about: dict[str, Any] = {"policy": args.policy, "seed": args.seed}
    if args.kind != "expert":
        noise = MEDIUM_NOISE if args.noise is None else args.noise
        with user_mistakes("argument --noise"):
            actor = NoisyActor(actor.predict, noise)
        algorithm += f" with noise of {noise:g}"
        about["noise"] = noise
    if args.kind == "advised":
        actor = _advised(args, actor, env_kwargs, about)
        algorithm += f", advised by {about['teacher']} ({about['advice']})"
    seeds = range(args.seed, args.seed + args.episodes)
    episodes = record_episodes(actor, args.env, seeds, env_kwargs)
    return _Source(args.env, env_kwargs, episodes, args.episodes, algorithm, about)


def _advised(
    args: argparse.Namespace, student: Actor, env_kwargs: dict[str, Any], about: dict[str, Any]
) -> Actor:
    """Give a student a teacher, and note which."""
    from saver_advisors.advising import make_advisor
    from saver_advisors.advising.strategies import BetterOfBoth
    from saver_advisors.datasets.actors import AdvisedActor
    from saver_advisors.policies.scripted import PREFIX
    from saver_envs.envs.spaces import action_space, observation_space
    from saver_envs.registration import make_episodes

    if args.advice == BetterOfBoth.name:
        raise UsageError(
            f"argument --advice: {args.advice!r} reads the critics of a student that learns, and "
            "the student of a data set has none"
        )
    episodes = make_episodes(args.env, **env_kwargs)
    horizon = episodes.settings.horizon
    steps = args.episodes * horizon
    teacher = args.teacher or PREFIX + args.env
    threshold = args.threshold
    if threshold is None and args.advice == STRATEGY:
        threshold = THRESHOLD
    with user_mistakes("argument --teacher, --advice or --threshold"):
        advisor = make_advisor(
            args.advice,
            teacher,
            steps if args.budget is None else args.budget,
            episodes=episodes,
            n_arms=episodes.task.n_arms,
            observation_space=observation_space(episodes),
            action_space=action_space(episodes),
            threshold=threshold,
            total_steps=steps,
            horizon=horizon,
            seed=args.seed,
        )
    about |= {"teacher": teacher, "advice": args.advice, "threshold": threshold}
    about["budget"] = advisor.budget.total
    return AdvisedActor(student, advisor)


def _replayed(args: argparse.Namespace) -> _Source:
    """Return the episodes of a run's replay buffer."""
    from saver_advisors.datasets.replay_episodes import read_replay

    with user_mistakes("argument RUN_DIR"):
        replay = read_replay(args.run_dir)
    config = replay.config
    count = len(replay.buffer.ended_slots())
    return _Source(
        config.env_id,
        replay.env_kwargs,
        replay.episodes(args.episodes),
        count if args.episodes is None else min(count, args.episodes),
        f"{config.algorithm} while it learned",
        {"run": args.run_dir.resolve().name, "run_steps": replay.steps, "seed": config.seed},
    )


class _Totals:
    """Counts what passes: episodes, steps, successes and advised actions of arms."""

    def __init__(self) -> None:
        self.episodes = self.steps = self.successes = 0
        self.advised = self.advisable = 0

    def count(self, source: _Source) -> Iterator[RecordedEpisode]:
        """Pass episodes on, with a progress bar from the first one on."""
        from tqdm import tqdm

        for episode in tqdm(source.episodes, total=source.count, unit="episode"):
            self.episodes += 1
            self.steps += len(episode)
            self.successes += episode.success
            if "advised" in episode.infos:
                self.advised += int(episode.infos["advised"][1:].sum())
                self.advisable += int(episode.infos["advised"][1:].size)
            yield episode

    def figures(self) -> dict[str, Any]:
        """Return JSON-able results."""
        return {
            "episodes": self.episodes,
            "steps": self.steps,
            "success_rate": self.successes / self.episodes,
            "advised_share": self.advised / self.advisable if self.advisable else None,
        }

    def cells(self) -> list[str]:
        """Return the cells of the table."""
        share = f"{self.advised / self.advisable:.3f}" if self.advisable else "-"
        rate = f"{self.successes / self.episodes:.3f}"
        return [f"{self.episodes:,}", f"{self.steps:,}", rate, share]
