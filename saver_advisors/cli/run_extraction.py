"""`saver run extraction`: people are extracted by the care tasks in turn."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Final

from saver_advisors.cli import arguments
from saver_advisors.cli.policies import resolve
from saver_advisors.integration import EXPERT, EXTRACTION, POLICY
from saver_advisors.reporting.errors import UsageError

if TYPE_CHECKING:
    from saver_advisors.evaluation.episodes import Predict
    from saver_advisors.integration.extraction import Extraction

#: Arguments of the closed loop, which an extraction does without.
_OF_THE_LOOP: Final = ("apart", "view", "exact_ik", "measured_latency", "max_speed")
_VIDEO: Final = "extraction.mp4"


def run_extraction(args: argparse.Namespace) -> int:
    """Extract people, show it, and print how it ended.

    :param args: of `saver run`
    :return: exit status
    :raises UsageError: for an argument that an extraction does not have
    """
    from tqdm import tqdm

    from saver_advisors.evaluation.episodes import N_ENVS
    from saver_advisors.integration.extraction import extract, task_rows
    from saver_advisors.reporting.tables import show_rows

    _check(args)
    names = _policies(args.task, args.policy)
    seeing = not args.true_state
    policies = {env_id: resolve(name, env_id, {}) for env_id, name in names.items()}
    seeds = range(args.seed, args.seed + args.trials)
    film = args.report / _VIDEO if args.report else args.video
    extractions: list[Extraction] = []
    if film is not None:
        film.parent.mkdir(parents=True, exist_ok=True)
        extractions.append(_filmed(film, policies, seeds[0], seeing))
        seeds = seeds[1:]
    with tqdm(total=len(seeds), unit="person", dynamic_ncols=True) as bar:
        for first in range(0, len(seeds), N_ENVS):
            batch = extract(policies, seeds[first : first + N_ENVS], seeing=seeing)
            extractions += batch
            bar.update(len(batch))
    for one in extractions:
        print(f"person {one.seed}: {one.person}: {one.outcome}")
    rows, completed = task_rows(extractions, names), sum(one.completed for one in extractions)
    show_rows(rows, {name: f"{{{name}}}" for name in rows[0]})
    how = "seen by a camera" if seeing else "from the true state"
    print(f"{completed} of {len(extractions)} completed, {how}")
    if args.report is not None:
        from saver_advisors.integration.extraction_page import write_report

        print(f"wrote {write_report(args.report, extractions, names, seeing, _VIDEO)}")
    told = {
        "title": f"{args.task[0].upper()}{args.task[1:]}, {how}",
        "completed": completed,
        "seeing": seeing,
        "rows": rows,
    }
    people = [one.to_mapping() for one in extractions]
    arguments.write_json(args.json, {"kind": "extraction", **told, "people": people})
    return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse what an extraction does not have.

    :raises UsageError: naming the argument
    """
    for name in _OF_THE_LOOP:
        if getattr(args, name):
            raise UsageError(f"argument --{name.replace('_', '-')}: not for an extraction")


def _policies(task: str, word: str) -> dict[str, str]:
    """Return who plays each task: the policy that ships for it, or else its expert.

    :param task: an id, or ``extraction`` for the whole procedure
    :param word: ``expert`` for experts alone
    :raises UsageError: for another policy: one cannot play several tasks
    """
    from saver_advisors.policies.files import load_policy, shipped_policies
    from saver_envs.registration import EXTRACTION_IDS

    if word not in (POLICY, EXPERT):
        raise UsageError(f"argument --policy: {word!r} cannot play an extraction; {EXPERT} can")
    names = dict.fromkeys(EXTRACTION_IDS if task == EXTRACTION else (task,), EXPERT)
    for name in shipped_policies() if word == POLICY else ():
        env_id = load_policy(name).card.env_id
        if env_id in names:
            names[env_id] = name
    return names


def _filmed(path: Path, policies: Mapping[str, Predict], seed: int, seeing: bool) -> Extraction:
    """Extract a person and record it."""
    from saver_advisors.integration.extraction import extract
    from saver_advisors.integration.extraction_page import ExtractionVideo

    with closing(ExtractionVideo(path)) as recorder:
        extraction = extract(policies, [seed], recorder, seeing=seeing)[0]
        recorder.end(extraction)
    print(f"wrote {path}")
    return extraction
