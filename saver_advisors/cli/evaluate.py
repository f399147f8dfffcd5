"""Evaluate a policy: episodes with fixed seeds and deterministic actions.

Episode i starts from seed + i, so two policies see the same initial states.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from saver_advisors.cli import arguments
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.reporting.evaluation_table import EVALUATION_COLUMNS, collision_force
from saver_advisors.reporting.tables import show_rows
from saver_advisors.training.threads import one_thread_of_algebra

EXAMPLES = """\
examples:
  saver evaluate --env JacoPush-v0 --policy jaco-push --episodes 100 --seed 0 --json result.json
  saver evaluate --env JacoPush-v0 --policy runs/push --video push.mp4
  saver evaluate --env JacoPush-v0 --policy random --episodes 20
  saver evaluate --env DualJacoPush-v0 --policy side-by-side:jaco-push
  saver evaluate --env DualJacoDistance-v0 --policy side-by-side:jaco-pick-and-place --shield
  saver evaluate --env JacoPush-v0 --policy jaco-push --env-kwargs object_mass=0.4
  saver evaluate --env JacoPush-v0 --policy jaco-push --randomization held-out:object_size

policies:
  NAME                    a shipped policy, such as jaco-push
  FILE.safetensors        a weight file
  RUN_DIR                 the best policy of a training run; RUN_DIR/latest for its latest
  ZOO_DIR, FILE.zip       the best model of a run under RL Zoo, or one of its models
  random                  uniform actions
  side-by-side:TEACHER    one single-arm policy per arm; each ignores the other arms
  side-by-side:A,B        the same with a policy of its own for each arm
  expert                  the scripted expert of the task
  expert-uncoordinated    the same; each arm ignores the others
  frozen-arm, frozen-arm:K   the expert with arm 0 or K only: it moves every cube in turn"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    arguments.add_env(parser, required=True)
    arguments.add(
        parser, "--policy", "the policy; see the list below", required=True, metavar="POLICY"
    )
    arguments.add_count(parser, "--episodes", 100, "number of episodes")
    arguments.add_count(parser, "--seed", 0, "of episode 0", least=0, metavar="S")
    arguments.add_env_kwargs(parser)
    arguments.add_json(parser)
    text = "record a video of the first episodes"
    arguments.add_file(parser, "--video", text, ".mp4", metavar="FILE.mp4")
    text = "plot the paths of hands and objects in the first episode, and the objects' distance"
    arguments.add_figure(parser, "--paths", text)
    arguments.add_count(parser, "--video-episodes", 4, "number of recorded episodes")
    text = "replace actions that would leave the task's constraint; not in videos and paths"
    arguments.add_flag(parser, "--shield", text)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Evaluate, print, write."""
    from saver_advisors.cli.policies import resolve

    env_kwargs = arguments.checked_env_kwargs(args.env, args.env_kwargs)
    figures = measure(args.policy, args.env, args.episodes, args.seed, env_kwargs, args.shield)
    show(figures)
    arguments.write_json(args.json, figures)
    if args.video is not None:
        from saver_advisors.reporting.video import record, write_mp4

        recordings = record(
            resolve(args.policy, args.env, env_kwargs, args.seed),
            args.env,
            episodes=min(args.video_episodes, args.episodes),
            seed=args.seed,
            env_kwargs=env_kwargs,
            progress=True,
        )
        write_mp4(args.video, recordings, f"{args.env}   {args.policy}")
        print(f"wrote {args.video}")
    if args.paths is not None:
        from saver_advisors.reporting.episode_paths import draw_paths, follow

        predict = resolve(args.policy, args.env, env_kwargs, args.seed)
        title = f"{args.env}, {args.policy}, seed {args.seed}"
        episode = follow(predict, args.env, title=title, seed=args.seed, env_kwargs=env_kwargs)
        with user_mistakes("argument --paths"):
            draw_paths([episode]).savefig(args.paths)
        print(f"wrote {args.paths}")
    return 0


def measure(
    policy: str,
    env: str,
    episodes: int,
    seed: int,
    env_kwargs: dict[str, Any],
    shield: bool = False,
) -> dict[str, Any]:
    """Evaluate a policy.

    :param policy: its name, as ``policies.resolve`` accepts it
    :param env: id of the environment
    :param episodes: number of episodes
    :param seed: of the first episode
    :param env_kwargs: keyword arguments of the environment
    :param shield: whether to replace actions that would leave the task's constraint
    :return: JSON-able: ``env``, ``policy``, ``episodes``, ``success_rate``, ``ci95`` and more
    :raises UsageError: for a policy that is unknown or does not fit
    """
    from saver_advisors.cli.policies import resolve
    from saver_advisors.evaluation.episodes import evaluate_policy
    from saver_advisors.evaluation.shield import Shield
    from saver_envs.registration import task_and_settings

    predict = resolve(policy, env, env_kwargs, seed)
    if shield and task_and_settings(env, env_kwargs)[0].constraint is None:
        raise UsageError(f"argument --shield: the task of {env} has no constraint to keep")
    start = time.perf_counter()
    guard = Shield if shield else None
    options: dict[str, Any] = {"env_kwargs": env_kwargs, "guard": guard, "progress": True}
    outcomes = evaluate_policy(predict, env, episodes=episodes, seed=seed, **options)
    return {
        "kind": "evaluation",
        "policy": f"{policy}, with a shield" if shield else policy,
        "env_kwargs": dict(env_kwargs),
        **outcomes.summary(),
        "wall_clock_s": round(time.perf_counter() - start, 3),
    }


def show(figures: dict[str, Any]) -> None:
    """Print the results as a table."""
    forces = {"highest force of collisions (N), mean and maximum": collision_force}
    show_rows([figures], {**EVALUATION_COLUMNS, **forces})
    for name, mean in figures["cost_means"].items():
        if mean:
            share = figures["cost_rates"][name]
            print(f"{name}: {mean:.2f} per episode, in {100 * share:.1f}% of the episodes")
    if figures.get("object_lost"):
        print(f"an object left the table in {figures['object_lost']} episodes")
    if figures["diverged"]:
        print(f"the simulation diverged in {figures['diverged']} episodes")
