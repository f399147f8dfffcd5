"""Videos of the transfer trials: a success, and each kind of failure that occurred."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.reporting.video import EpisodeVideo, Frame, write_clip, write_mp4

if TYPE_CHECKING:
    from reproduction.transfer.attempts import Attempt
    from reproduction.transfer.failures import Failure
    from reproduction.transfer.trajectories import Trajectory
    from saver_envs.episodes import Episodes

SIZE: Final = (960, 720)
"""Pixels of a picture of the whole bench, width and height."""
ROWS: Final = slice(210, 610)
"""Of a picture, what a video shows: where hands and cubes are."""
COLUMNS: Final = slice(270, 810)
"""The same across."""
STRIDE: Final = 2
"""Steps from frame to frame of a clip."""


def record_each_kind(
    folder: Path,
    found: Sequence[tuple[Attempt, Sequence[Trajectory], Sequence[Failure | None]]],
    trials: int,
    seed: int,
) -> list[dict[str, Any]]:
    """Play the attempts that have something to show once more, and draw it.

    All trials of an attempt are played again, not the drawn one alone: policies compute a batch in
    one go, and another batch would round otherwise, which contact makes large.

    :param folder: where the videos go, made if need be
    :param found: attempts with their trials and failures
    :param trials: of each attempt
    :param seed: of trial 0
    :return: JSON-able: ``file`` without its ending, and what it shows
    """
    from reproduction.transfer.attempts import by_kind
    from saver_advisors.benchmark.machine import progress

    folder.mkdir(parents=True, exist_ok=True)
    wanted: dict[int, list[tuple[str, int]]] = {}
    for kind, place, number in by_kind(found):
        wanted.setdefault(place, []).append((kind, number))
    shown = []
    with progress("videos", len(wanted)) as advance:
        for place, kinds in wanted.items():
            attempt = found[place][0]
            frames = _draw(attempt, [number for _, number in kinds], trials, seed)
            for kind, number in kinds:
                recording = EpisodeVideo(seed + number, frames[number], kind == "success")
                shown.append(_write(folder, attempt, kind, recording))
            advance()
    return sorted(shown, key=lambda one: str(one["file"]))


def _draw(
    attempt: Attempt, numbers: Sequence[int], trials: int, seed: int
) -> dict[int, list[Frame]]:
    """The frames of some of an attempt's trials."""
    from saver_envs.envs.pictures import Pictures

    frames: dict[int, list[Frame]] = {number: [] for number in numbers}
    pictures: list[Pictures] = []

    def look(episodes: Episodes, step: int) -> None:
        if not pictures:
            pictures.append(Pictures(episodes, "rgb_array", *SIZE))
        for number in numbers:
            frames[number].append(pictures[0].draw(number)[ROWS, COLUMNS].copy())

    try:
        attempt.play(trials, seed, look)
    finally:
        for one in pictures:
            one.close()
    return frames


def _write(folder: Path, attempt: Attempt, kind: str, recording: EpisodeVideo) -> dict[str, Any]:
    from reproduction.transfer.failures import WORDS

    name = f"{attempt.task}-{kind.replace('_', '-')}"
    words = WORDS.get(kind, kind)
    title = f"{attempt.entrant.label}, {attempt.condition.name}: {words}"
    write_mp4(folder / f"{name}.mp4", [recording], title)
    write_clip(folder / f"{name}.webp", recording.frames[::STRIDE], stride=STRIDE, quality=50)
    return {
        "file": name,
        "task": attempt.task,
        "kind": kind,
        "label": attempt.entrant.label,
        "condition": attempt.condition.name,
        "seed": recording.seed,
    }
