"""Watch a policy, push things, or move an arm by hand and record demonstrations.

The view is a page for browsers, also over ssh (ssh -L 8080:localhost:8080 HOST), or a window.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli import arguments
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.datasets.episode_folder import EpisodeFolder
    from saver_advisors.viewing.playback import Playback, View

EXAMPLES = """\
examples:
  saver view --env DualJacoPush-v0
  saver view --env JacoPush-v0 --policy runs/push --randomization mild --seed 5
  saver view --env JacoPush-v0 --window
  saver view --env JacoPush-v0 --control keyboard --record saver/push/mine-v0 --episodes 20

keys:
  space, home, end        pause or run; restart; next seed
  with --control keyboard:
  arrow keys              move the hand in the plane, as the camera in front shows it
  page up, page down      move the hand up and down, where the task lets it
  insert, delete          open and close the gripper
  enter                   finish: let the rest of the episode's time run
  A gamepad at the machine with the browser does all of this, too.

Ctrl-C ends the view, and then writes what was recorded. If the process is killed, the same command
goes on with the demonstrations that it had."""

CONTROLS: Final = ("policy", "keyboard")
DEFAULT_PORT: Final = 8080


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    arguments.add_env(parser, required=True)
    text = "the first policy, as for `saver evaluate`; the page can switch to others"
    arguments.add(parser, "--policy", text, "expert", metavar="POLICY")
    arguments.add_count(parser, "--seed", 0, "of the first episode", least=0, metavar="S")
    arguments.add_env_kwargs(parser)
    text = "how fast time runs, as a multiple of real time"
    arguments.add(parser, "--speed", text, 1.0, type=arguments.positive, metavar="X")
    arguments.add_count(parser, "--episodes", None, "stop after this many (default: go on)")
    where = parser.add_argument_group("where")
    arguments.add_flag(where, "--window", "open MuJoCo's viewer instead of serving a page")
    arguments.add(where, "--host", "address of the page", "127.0.0.1", metavar="ADDRESS")
    text = "port of the page; 0 for a free one"
    arguments.add_count(where, "--port", DEFAULT_PORT, text, least=0)
    hand = parser.add_argument_group("by hand")
    text = "who moves --arm; the policy moves other arms"
    arguments.add(hand, "--control", text, CONTROLS[0], choices=CONTROLS)
    arguments.add_count(hand, "--arm", 0, "the arm that is moved by hand", least=0, metavar="K")
    text = "write the successful episodes as a data set of Minari with this id"
    arguments.add(hand, "--record", text, metavar="ID")
    arguments.add_flag(hand, "--keep-failures", "record episodes without success, too")
    text = "folder of all data sets (default: $MINARI_DATASETS_PATH, or ~/.minari/datasets)"
    arguments.add_folder(hand, "--output", text)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Show episodes until nobody watches any longer."""
    from saver_advisors.training.run_folder import locked

    _check(args)
    env_kwargs = arguments.checked_env_kwargs(args.env, args.env_kwargs)
    if args.record is None:
        _watch(args, env_kwargs, None)
        return 0
    with ExitStack() as stack:
        with user_mistakes("argument --record or --output"):
            stack.enter_context(locked(_unfinished(args)))
            kept = _kept(args, env_kwargs)
        if found := len(kept):
            print(f"going on with {found} demonstrations in {kept.path}", file=sys.stderr)
        try:
            if args.episodes is None or found < args.episodes:
                _watch(args, env_kwargs, kept)
            if not (count := len(kept)):
                print("nothing was recorded: no demonstration ended with success", file=sys.stderr)
                return 1
            folder = _write(args, env_kwargs, kept)
            kept.remove()
        finally:
            if not len(kept):
                kept.remove()
    print(f"wrote {count} demonstrations to {folder}")
    return 0


def _watch(
    args: argparse.Namespace, env_kwargs: dict[str, Any], kept: EpisodeFolder | None
) -> None:
    """Show episodes, and keep the demonstrations among them where they are recorded."""
    from saver_advisors.training.stopping import Stop
    from saver_advisors.viewing.playback import watch

    stop = Stop()
    with ExitStack() as stack:
        seed = args.seed if kept is None else max(args.seed, kept.next_seed)
        playback = stack.enter_context(closing(_playback(args, env_kwargs, seed)))
        view = stack.enter_context(closing(_view(args, playback)))
        stack.enter_context(stop.on_signals())
        passed = 0
        if kept is not None:
            playback.demonstrations = passed = len(kept)
        for episode in watch(playback, view, lambda: bool(stop), args.speed):
            if kept is not None:
                if playback.disturbed or not (episode.success or args.keep_failures):
                    continue
                kept.add(episode)
                playback.demonstrations = len(kept)
            passed += 1
            if passed == args.episodes:
                return


def _check(args: argparse.Namespace) -> None:
    """Refuse what does not go together, before anything is opened."""
    if args.record is None:
        if args.keep_failures or args.output is not None:
            raise UsageError("argument --record: --keep-failures and --output need it")
        return
    if args.control != "keyboard":
        raise UsageError(
            "argument --record: only with --control keyboard; `saver dataset expert` writes the "
            "episodes of policies"
        )
    import minari  # noqa: F401  (say that it is missing before someone demonstrates)

    from saver_advisors.datasets.minari_files import minari_folder

    with user_mistakes("argument --record"):
        folder = minari_folder(args.record, args.output)
    if folder.exists():
        raise UsageError(f"argument --record: {folder} exists: choose another id, or remove it")


def _unfinished(args: argparse.Namespace) -> Path:
    """Return the folder of demonstrations that are not a data set yet."""
    from saver_advisors.datasets.minari_files import minari_folder

    folder = minari_folder(args.record, args.output)
    return folder.with_name(f"{folder.name}.unfinished")


def _kept(args: argparse.Namespace, env_kwargs: dict[str, Any]) -> EpisodeFolder:
    """Open the demonstrations so far, also those of a process that was killed."""
    from saver_advisors.datasets.episode_folder import EpisodeFolder
    from saver_envs.digest import world_digest

    world = world_digest(args.env, env_kwargs)
    about = {"env": args.env, "env_kwargs": env_kwargs, "world": world}
    return EpisodeFolder(_unfinished(args), about)


def _playback(args: argparse.Namespace, env_kwargs: dict[str, Any], seed: int) -> Playback:
    from saver_advisors.cli.policies import fitting, resolve
    from saver_advisors.viewing.playback import Playback

    # The first one must fit; the page offers others that do.
    resolve(args.policy, args.env, env_kwargs, args.seed)
    others = [name for name in fitting(args.env, env_kwargs) if name != args.policy]
    with user_mistakes("argument --control or --arm"):
        return Playback(
            args.env,
            env_kwargs,
            lambda name: resolve(name, args.env, env_kwargs, args.seed),
            [args.policy, *others],
            seed=seed,
            arm=args.arm if args.control == "keyboard" else None,
        )


def _view(args: argparse.Namespace, playback: Playback) -> View:
    if args.window:
        from saver_advisors.viewing.window import WindowView

        try:
            return WindowView(playback)
        except RuntimeError as error:
            raise UsageError(
                "argument --window: there is no display to open a window on; without --window, a "
                "page for browsers is served"
            ) from error
    from saver_advisors.viewing.browser import BrowserView

    try:
        view = BrowserView(playback, args.host, args.port, args.speed)
    except (OSError, OverflowError) as error:
        raise UsageError(
            f"argument --host or --port: {args.host}:{args.port} cannot be listened on "
            f"({error}): choose another port, or 0 for a free one"
        ) from error
    print(f"open {view.url} in a browser; Ctrl-C ends", flush=True)
    return view


def _write(args: argparse.Namespace, env_kwargs: dict[str, Any], kept: EpisodeFolder) -> Path:
    """Write the data set, and return its folder."""
    from saver_advisors.cli.dataset import about_episodes
    from saver_advisors.datasets.minari_files import write_minari

    algorithm = f"a hand, arm {args.arm}"
    more = {"policy": args.policy, "arm": args.arm, "keeps_failures": args.keep_failures}
    return write_minari(
        args.record,
        kept,
        args.env,
        env_kwargs,
        algorithm=algorithm,
        description=f"Demonstrations of {args.env.rpartition(':')[2]} by hand.",
        about=about_episodes("demonstrations", args.env, env_kwargs, algorithm, more),
        root=args.output,
    )
