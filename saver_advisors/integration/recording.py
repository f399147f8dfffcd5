"""Video of the loop: the camera's view with the skeleton, the scene, distance and force."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.assembly import ControlLoop
from saver_advisors.integration.casualty import TASK
from saver_advisors.integration.messages import Message, Picture, PixelPose, ServoCommand
from saver_advisors.integration.trial import SUCCEEDED, TrialRecord
from saver_advisors.integration.wrist_bench import wrist_bench
from saver_advisors.reporting import video
from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.perception.drawing import draw_poses
from saver_envs.perception.parsing import Poses
from saver_envs.simulation import ACTION_DURATION

Frame = NDArray[np.uint8]
#: Sizes (pixels) of the camera's view, of the scene on its right, and of a plot below.
CAMERA_SIZE: Final = (512, 424)
SCENE_SIZE: Final = (564, 424)
#: The scene is rendered at this size (width, height) and cropped to the hands and wrists.
_RENDERED: Final = (1016, 762)
_COLUMNS: Final = slice(226, 226 + SCENE_SIZE[0])
_ROWS: Final = slice(250, 250 + SCENE_SIZE[1])
PLOT_SIZE: Final = (538, 190)
FRAME_SIZE: Final = (
    CAMERA_SIZE[0] + SCENE_SIZE[0],
    CAMERA_SIZE[1] + PLOT_SIZE[1] + video.BAR_HEIGHT,
)
#: Seconds of a trial after which frames are recorded without a picture: the camera has failed.
_LONGEST_WAIT: Final = 1.0
#: Colours of the right and left arm, as in the skeleton.
COLOURS: Final = ("#d55e00", "#0072b2")
_LIMIT, _FORCE = "#be3c32", "#5a3c78"


class VideoRecorder:
    """Record trials as H.264, with one frame per action; an observer of the loop's graph.

    :param path: of the file, ending in ``.mp4``.
    :param loop: with a `WristBench`.
    :param actions: in a trial, which determine the width of the plots.
    :param every: actions between two drawings; drawing is slow, so each is shown for that long.
    :raises TypeError: for a loop with another bench.
    """

    def __init__(
        self, path: Path, loop: ControlLoop, actions: int = TASK.horizon, every: int = 1
    ) -> None:
        self._bench = wrist_bench(loop.bench)
        self._observers = loop.graph.observers
        self._seeing = loop.settings.seeing
        self._seconds = actions * ACTION_DURATION
        self._every = every
        self._scene = SceneRenderer(self._bench.episodes.scene, *_RENDERED, camera="front")
        self._writer = video.mp4_writer(path, *FRAME_SIZE)
        self._observers.append(self._keep)
        self._begin()

    def _begin(self) -> None:
        """Clear everything at the start of a trial."""
        self._newest: dict[type[Message], Any] = {}
        self._history: list[tuple[float, float, float, float]] = []
        self._calls = 0
        self._last: Frame | None = None

    def _keep(self, topic: str, message: Message, now: float) -> None:
        """Keep the newest message of each class."""
        self._newest[type(message)] = message

    def __call__(self, now: float) -> None:
        """Record a frame; the argument ``look`` of `trial.run_trial`."""
        if now == 0:
            self._begin()
        if self._seeing and Picture not in self._newest and now < _LONGEST_WAIT:
            return  # before the first picture, the camera's half of a frame would be black
        if self._calls % self._every == 0 or self._last is None:
            self._last = self._drawn(now)
        self._calls += 1
        self._writer.send(self._last)

    def _drawn(self, now: float) -> Frame:
        """Draw a frame (height, width, 3) of `FRAME_SIZE` at a time, seconds of the trial."""
        truth = self._bench.truth()
        right, left = np.linalg.norm(truth.wrists - truth.targets, axis=-1)
        self._history.append((now, 100 * right, 100 * left, self._bench.last_peak))
        times, right_cm, left_cm, force = np.array(self._history).T
        self._scene.update(self._bench.episodes, 0)
        top = np.concatenate([self._seen(), self._scene.rgb()[_ROWS, _COLUMNS]], axis=1)
        threshold, limit = 100 * TASK.success_threshold, TASK.torso_force_limit
        seconds = self._seconds
        title = "distance of the wrists from their targets (cm)"
        plots = [
            plot(title, times, [right_cm, left_cm], COLOURS, seconds, (30.0, threshold)),
            plot("force on the trunk (N)", times, [force], (_FORCE,), seconds, (100.0, limit)),
        ]
        frame = np.concatenate([top, np.concatenate(plots, axis=1)], axis=0)
        command: ServoCommand | None = self._newest.get(ServoCommand)
        if command is not None and command.holding:
            words = f"{now:5.2f} s   arms held: {command.cause}"
            return video.captioned(frame, words, video.RED)
        return video.captioned(frame, f"{now:5.2f} s   arms free", video.GREY)

    def _seen(self) -> Frame:
        """Return the newest picture with the newest skeleton; black without a camera that works."""
        picture: Picture | None = self._newest.get(Picture)
        pose: PixelPose | None = self._newest.get(PixelPose)
        if picture is None:
            return np.zeros((CAMERA_SIZE[1], CAMERA_SIZE[0], 3), dtype=np.uint8)
        if pose is None:
            return picture.rgb
        return draw_poses(picture.rgb, Poses(pose.joints[None], pose.scores[None], np.ones(1)))

    def end(self, record: TrialRecord) -> None:
        """Show the outcome of a trial for a while."""
        if self._last is None:
            self._last = self._drawn(self._seconds)
        colour = video.GREEN if record.outcome == SUCCEEDED else video.RED
        words = f"trial {record.seed}: {record.cause or record.outcome}"
        last = video.captioned(self._last[: -video.BAR_HEIGHT], words, colour)
        for _ in range(2 * video.HOLD):
            self._writer.send(last)

    def close(self) -> None:
        """Stop observing, finish the file, and free the graphics context."""
        self._observers.remove(self._keep)
        self._writer.close()
        self._scene.close()


def plot(
    title: str,
    times: NDArray[np.float64],
    lines: list[NDArray[np.float64]],
    colours: tuple[str, ...],
    seconds: float,
    scale: tuple[float, float],
) -> Frame:
    """Draw lines over time.

    :param title: above the plot.
    :param times: (T,) seconds.
    :param lines: (T,) each.
    :param colours: of the lines.
    :param seconds: length of the horizontal axis.
    :param scale: least height of the vertical axis, and the limit that is marked.
    :return: (height, width, 3) of `PLOT_SIZE`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    least, limit = scale
    width, height = PLOT_SIZE
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.1, 0.14, 0.87, 0.7))
    axes.set_title(title, fontsize=10, loc="left")
    for line, colour in zip(lines, colours, strict=True):
        axes.plot(times, line, color=colour)
    axes.axhline(limit, color=_LIMIT, linewidth=1)
    axes.set(xlim=(0, seconds), ylim=(0, max(least, 1.05 * np.max(lines))))
    axes.spines[["top", "right"]].set_visible(False)
    axes.xaxis.set_major_formatter("{x:g} s")
    axes.tick_params(labelsize=8)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]
