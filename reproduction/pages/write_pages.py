"""Write the generated documentation: pages of environments, weights and results.

The tables in the README are updated between their markers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.arguments import add_flag, add_path
from saver_advisors.reporting.errors import UsageError, unknown

if TYPE_CHECKING:
    from saver_advisors.reporting.video import Frame

EXAMPLES = """\
examples:
  python -m reproduction pages                  all pages, pictures and clips (minutes)
  python -m reproduction pages --no-pictures    text only
  python -m reproduction pages --check          fails if a page differs; writes nothing"""

CLIP_SIZE: Final[dict[str, Any]] = {"width": 400, "height": 300}
CLIP_EVERY: Final = 2
"""Steps per frame of a clip."""
_SEARCHED: Final = 12
"""Episodes among which a successful one is searched."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    text = "folder of the documentation (default: docs)"
    add_path(parser, "--output", text, metavar="DIR", default=Path("docs"))
    text = "README whose tables are updated (default: README.md next to the folder)"
    add_path(parser, "--readme", text)
    add_flag(parser, "--check", "compare, write nothing")
    add_flag(parser, "--no-pictures", "draw nothing")
    parser.add_argument("--only", nargs="+", metavar="ID", help="draw only these environments")


def run(args: argparse.Namespace) -> int:
    """Compare the pages with the code, or write them.

    :param args: see :func:`add_arguments`.
    :return: exit status: 1 if a compared page is out of date, else 0.
    :raises UsageError: for an unknown environment, or a README without markers.
    """
    from reproduction.pages.generated import all_pages

    beside = args.output.resolve().parent / "README.md"
    readme = args.readme or (beside if beside.is_file() else None)
    texts = all_pages(args.output, readme)
    stale = [
        path
        for path, text in texts.items()
        if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]
    if args.check:
        for path in stale:
            print(f"{path} is out of date: run `python -m reproduction pages`", file=sys.stderr)
        print(f"{len(texts) - len(stale)} of {len(texts)} pages are up to date")
        return 1 if stale else 0
    for path in stale:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(texts[path], encoding="utf-8")
        print(f"wrote {path}")
    if not args.no_pictures:
        draw_all(args.output, args.only)
    return 0


def draw_curves(folder: Path) -> None:
    """Draw the learning curves in files of ``saver curves``, each next to its file.

    :param folder: of the JSON files.
    """
    from saver_advisors.cli.curves import draw
    from saver_advisors.experiments.training_runs import drawn_run
    from saver_envs.files import read_json

    for path in sorted(folder.glob("*.json")):
        content = read_json(path)
        draw([drawn_run(one, content) for one in content["runs"]]).savefig(path.with_suffix(".png"))


def draw_all(output: Path, only: Sequence[str] | None = None) -> None:
    """Draw a picture and record a clip of every environment, worlds that vary of some, and curves.

    :param output: folder of the documentation.
    :param only: ids of the environments; all of them if None.
    :raises UsageError: for an unknown environment.
    """
    from saver_advisors.cli.catalogue import sparse_ids

    for name in only or ():
        if name not in sparse_ids():
            raise UsageError(f"argument --only: {unknown('environment', name, sparse_ids())}")
    from PIL import Image
    from tqdm import tqdm

    from reproduction.command_parts import write_clip
    from reproduction.pages.limp_person import limp_person_picture
    from reproduction.pages.results import CURVES_FOLDER
    from reproduction.pages.worlds import SHOWN, world_pictures
    from saver_advisors.reporting.video import start_picture

    if only is None:
        person = Image.fromarray(limp_person_picture())
        person.save(output / "images" / "limp-person.webp", quality=80, method=6)
    folder = output / "images" / "environments"
    folder.mkdir(parents=True, exist_ok=True)
    for env_id in tqdm(list(only or sparse_ids()), unit="environment"):
        picture = Image.fromarray(start_picture(env_id))
        picture.save(folder / f"{env_id}.jpg", quality=88, optimize=True)
        write_clip(folder / f"{env_id}.webp", _clip(env_id), stride=CLIP_EVERY)
        if env_id in SHOWN:
            worlds = output / "images" / "worlds" / f"{env_id}.webp"
            worlds.parent.mkdir(exist_ok=True)
            Image.fromarray(world_pictures(env_id)).save(worlds, quality=80, method=6)
    draw_curves(output / CURVES_FOLDER)


def _clip(env_id: str) -> list[Frame]:
    """Record an episode of the best available policy, the first successful one of a few."""
    from reproduction.joint_speeds import policy_for
    from saver_advisors.cli.policies import resolve
    from saver_advisors.evaluation.episodes import evaluate_policy
    from saver_advisors.reporting.video import record

    policy = policy_for(env_id)
    outcomes = evaluate_policy(resolve(policy, env_id, {}), env_id, episodes=_SEARCHED)
    seed = int(outcomes.success.argmax())
    # An expert keeps the plans of past episodes: resolve it anew.
    fresh = resolve(policy, env_id, {})
    return record(fresh, env_id, episodes=1, seed=seed, every=CLIP_EVERY, **CLIP_SIZE)[0].frames
