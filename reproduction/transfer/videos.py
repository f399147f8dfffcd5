"""Record videos of the transfer trials: a success, and each kind of failure that occurred."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from reproduction.command_parts import write_clip
from reproduction.transfer.attempts import Attempt, Played, by_kind
from reproduction.transfer.failures import WORDS
from saver_advisors.reporting.video import EpisodeVideo, Frame, write_mp4

if TYPE_CHECKING:
    from saver_envs.episodes import Episodes

SIZE: Final = (960, 720)
"""Width and height of a picture of the whole bench, in pixels."""
ROWS: Final = slice(210, 610)
"""Rows of a picture that a video shows: those with hands and cubes."""
COLUMNS: Final = slice(270, 810)
"""Columns of a picture that a video shows."""
STRIDE: Final = 2
"""Steps between two frames of a clip."""


def record_each_kind(
    folder: Path, found: Sequence[Played], trials: int, seed: int
) -> list[dict[str, Any]]:
    """Replay attempts, and record a trial of each kind.

    All trials of an attempt are replayed, not only the recorded one, because rounding depends on
    the batch size and contact amplifies the difference.

    :param folder: folder of the videos, created if missing.
    :param found: attempts with their trials and failures.
    :param trials: number of trials of each attempt.
    :param seed: seed of trial 0.
    :return: JSON-able: ``file`` without its suffix, and what it shows.
    """
    from tqdm import tqdm

    folder.mkdir(parents=True, exist_ok=True)
    wanted: dict[int, list[tuple[str, int]]] = {}
    for kind, place, number in by_kind(found):
        wanted.setdefault(place, []).append((kind, number))
    shown = []
    for place, kinds in tqdm(wanted.items(), "videos", unit="attempt", dynamic_ncols=True):
        attempt = found[place][0]
        frames = _draw(attempt, [number for _, number in kinds], trials, seed)
        for kind, number in kinds:
            recording = EpisodeVideo(seed + number, frames[number], kind == "success")
            name = f"{attempt.task}-{kind.replace('_', '-')}"
            title = f"{attempt.label}, {attempt.condition.name}: {WORDS.get(kind, kind)}"
            write_mp4(folder / f"{name}.mp4", [recording], title)
            clip = recording.frames[::STRIDE]
            write_clip(folder / f"{name}.webp", clip, stride=STRIDE, quality=50)
            shown.append(
                {
                    "file": name,
                    "task": attempt.task,
                    "kind": kind,
                    "label": attempt.label,
                    "condition": attempt.condition.name,
                    "seed": recording.seed,
                }
            )
    return sorted(shown, key=lambda one: str(one["file"]))


def _draw(
    attempt: Attempt, numbers: Sequence[int], trials: int, seed: int
) -> dict[int, list[Frame]]:
    """Draw the frames of some of an attempt's trials."""
    from saver_envs.envs.pictures import Pictures

    frames: dict[int, list[Frame]] = {number: [] for number in numbers}
    with ExitStack() as stack:
        pictures: list[Pictures] = []

        def look(episodes: Episodes, step: int) -> None:
            if not pictures:
                pictures.append(Pictures(episodes, "rgb_array", *SIZE))
                stack.callback(pictures[0].close)
            for number in numbers:
                frames[number].append(pictures[0].draw(number)[ROWS, COLUMNS].copy())

        attempt.play(trials, seed, look)
    return frames
