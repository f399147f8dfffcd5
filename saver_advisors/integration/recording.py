"""The loop as a picture: the camera's view with the skeleton, the scene, distance and force."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.assembly import Loop
from saver_advisors.integration.messages import Message, Picture, PixelPose, ServoCommand
from saver_advisors.integration.trial import SUCCEEDED, TrialRecord
from saver_advisors.integration.wrist_bench import WristBench
from saver_advisors.reporting.video import (
    BAR_HEIGHT,
    GREEN,
    GREY,
    HOLD,
    RED,
    captioned,
    font,
    mp4_writer,
)
from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.perception.drawing import draw_poses
from saver_envs.perception.parsing import Poses
from saver_envs.tasks.base import SUCCESS_THRESHOLD
from saver_envs.tasks.wrist_push import FORCE_LIMIT

Frame = NDArray[np.uint8]
#: Sizes (pixels): of the camera's view and of the scene beside it, and of a plot below.
CAMERA_SIZE: Final = (512, 424)
SCENE_SIZE: Final = (564, 424)
#: The scene is drawn so large (width, height), and its middle is shown, where hands and wrists are.
_DRAWN: Final = (1016, 762)
_COLUMNS: Final = slice(226, 226 + SCENE_SIZE[0])
_ROWS: Final = slice(250, 250 + SCENE_SIZE[1])
PLOT_SIZE: Final = (538, 190)
FRAME_SIZE: Final = (
    CAMERA_SIZE[0] + SCENE_SIZE[0],
    CAMERA_SIZE[1] + PLOT_SIZE[1] + BAR_HEIGHT,
)
#: Right and left arm, as the sides' colours in the skeleton.
COLOURS: Final = ((213, 94, 0), (0, 114, 178))
_INK, _LINE, _LIMIT = (60, 66, 74), (216, 221, 227), (190, 60, 50)
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 14, 30, 26


class Panel:
    """Draws the loop as it is.

    :param loop: round a `WristBench`
    :param seconds: length of a trial, the plots' width
    """

    def __init__(self, loop: Loop, seconds: float) -> None:
        bench = loop.bench
        if not isinstance(bench, WristBench):
            raise TypeError(f"loop.bench of {type(bench).__name__}: must be a WristBench")
        self._bench = bench
        self._loop = loop
        self._seconds = seconds
        self._scene = SceneRenderer(bench.episodes.scene, *_DRAWN, camera="front")
        loop.graph.observers.append(self)
        self.begin()

    def begin(self) -> None:
        """Forget what was: a trial begins."""
        self._picture: Picture | None = None
        self._pose: PixelPose | None = None
        self._command: ServoCommand | None = None
        self._history: list[tuple[float, float, float, float]] = []

    def __call__(self, topic: str, message: Message, now: float) -> None:
        """Keep the newest of what is drawn; an observer of the graph."""
        if isinstance(message, Picture):
            self._picture = message
        elif isinstance(message, PixelPose):
            self._pose = message
        elif isinstance(message, ServoCommand):
            self._command = message

    def draw(self, now: float) -> Frame:
        """Draw everything.

        :param now: seconds of the trial
        :return: (height, width, 3), see `FRAME_SIZE`
        """
        bench = self._bench
        truth = bench.truth()
        right, left = np.linalg.norm(truth.wrists - truth.targets, axis=-1)
        self._history.append((now, float(right), float(left), bench.last_peak))
        episodes = bench.episodes
        self._scene.update(episodes.simulation, 0, truth.targets, episodes.people)
        top = np.concatenate([self._seen(), self._scene.rgb()[_ROWS, _COLUMNS]], axis=1)
        times, *columns = np.array(self._history).T
        distance = plot(
            "distance of the wrists from their targets (cm)",
            times,
            [100 * columns[0], 100 * columns[1]],
            COLOURS,
            self._seconds,
            (30.0, 100 * SUCCESS_THRESHOLD),
        )
        force = plot(
            "force on the trunk (N)",
            times,
            [columns[2]],
            ((90, 60, 120),),
            self._seconds,
            (100.0, FORCE_LIMIT),
        )
        frame = np.concatenate([top, np.concatenate([distance, force], axis=1)], axis=0)
        command = self._command
        if command is not None and command.holding:
            return captioned(frame, f"{now:5.2f} s   arms held: {command.cause}", RED)
        return captioned(frame, f"{now:5.2f} s   arms free", GREY)

    def _seen(self) -> Frame:
        """The newest picture with the newest skeleton; black where the loop has no camera."""
        if self._picture is None:
            return np.zeros((CAMERA_SIZE[1], CAMERA_SIZE[0], 3), dtype=np.uint8)
        if self._pose is None:
            return self._picture.rgb
        people = Poses(self._pose.joints[None], self._pose.scores[None], np.ones(1))
        return draw_poses(self._picture.rgb, people)

    def close(self) -> None:
        """Free the graphics context, and look no more."""
        self._loop.graph.observers.remove(self)
        self._scene.close()


class VideoRecorder:
    """Writes trials as H.264, a frame an action.

    :param path: ending in ``.mp4``
    :param panel: what is drawn
    :param every: actions from one drawing to the next, which is shown so long: drawing is slow
    """

    def __init__(self, path: Path, panel: Panel, every: int = 1) -> None:
        self._panel = panel
        self._every = every
        self._calls = 0
        self._writer: Any = mp4_writer(path, *FRAME_SIZE)
        self._last: Frame | None = None

    def __call__(self, now: float) -> None:
        """Write a frame; what `run_trial` takes as ``look``."""
        if now == 0:
            self._panel.begin()
            self._calls = 0
        if self._calls % self._every == 0 or self._last is None:
            self._last = self._panel.draw(now)
        self._calls += 1
        self._writer.send(np.ascontiguousarray(self._last))

    def end(self, record: TrialRecord) -> None:
        """Show for a while how a trial ended."""
        assert self._last is not None
        good = record.outcome == SUCCEEDED
        words = f"trial {record.seed}: {record.cause or record.outcome}"
        last = captioned(self._last[:-BAR_HEIGHT], words, GREEN if good else RED)
        for _ in range(2 * HOLD):
            self._writer.send(np.ascontiguousarray(last))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


def plot(
    title: str,
    times: NDArray[np.float64],
    lines: list[NDArray[np.float64]],
    colours: tuple[tuple[int, int, int], ...],
    seconds: float,
    scale: tuple[float, float],
) -> Frame:
    """Draw lines over time.

    :param title: above
    :param times: (T,) seconds
    :param lines: (T,) each
    :param colours: of the lines
    :param seconds: the axis' length
    :param scale: the least height of the vertical axis, and the limit that is marked
    :return: (height, width, 3) of `PLOT_SIZE`
    """
    from PIL import Image, ImageDraw

    width, height = PLOT_SIZE
    picture = Image.new("RGB", PLOT_SIZE, (255, 255, 255))
    draw, small = ImageDraw.Draw(picture), font(12)
    least, limit = scale
    highest = max(least, 1.05 * max(float(line.max()) for line in lines))

    def place(time: float, value: float) -> tuple[float, float]:
        x = _LEFT + (width - _LEFT - _RIGHT) * time / seconds
        return x, height - _BOTTOM - (height - _TOP - _BOTTOM) * value / highest

    draw.text((_LEFT, 8), title, fill=_INK, font=font(13))
    for share in (0.0, 0.5, 1.0):
        value = share * highest
        draw.line((*place(0, value), *place(seconds, value)), fill=_LINE)
        draw.text((8, place(0, value)[1] - 7), f"{value:.0f}", fill=_INK, font=small)
        time = share * seconds
        draw.text(
            (place(time, 0)[0] - 22 * share, height - 20), f"{time:g} s", fill=_INK, font=small
        )
    draw.line((*place(0, limit), *place(seconds, limit)), fill=_LIMIT)
    for line, colour in zip(lines, colours, strict=True):
        points = [place(float(t), float(v)) for t, v in zip(times, line, strict=True)]
        if len(points) > 1:
            draw.line(points, fill=colour, width=2)
    return np.asarray(picture)
