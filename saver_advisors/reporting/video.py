"""Record episodes with captions, as H.264 videos or as short clips."""

from __future__ import annotations

import errno
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, repeat
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Predict, SingleEpisodeEnv, play

Frame = NDArray[np.uint8]

FPS: Final = 25
"""Real time: an action lasts 0.04 s."""
HOLD: Final = 15
"""Number of frames for which the last frame of an episode, with its outcome, is repeated."""
QUALITY: Final = 21
"""Constant rate factor of H.264: lower is larger and better."""
BAR_HEIGHT: Final = 34
PICTURE_SIZE: Final = (640, 480)
GREEN, RED, GREY = (44, 140, 76), (190, 60, 50), (70, 74, 82)


@dataclass(frozen=True)
class EpisodeVideo:
    """A recorded episode.

    :param seed: of the episode
    :param frames: (height, width, 3) each, from the start
    :param success: ``is_success`` of its last step
    """

    seed: int
    frames: list[Frame]
    success: bool


def start_picture(env_id: str) -> Frame:
    """Render an environment at the start of an episode.

    :param env_id: a registered id
    :return: (height, width, 3), uint8
    """
    from saver_envs.envs.goal_env import SaverGoalEnv

    width, height = PICTURE_SIZE
    with closing(SaverGoalEnv(env_id, "rgb_array", width=width, height=height)) as env:
        env.reset(seed=0)
        return np.asarray(env.render(), dtype=np.uint8)


def record(
    predict: Predict,
    env_id: str,
    *,
    episodes: int,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    width: int = 640,
    height: int = 480,
    every: int = 1,
    progress: bool = False,
) -> list[EpisodeVideo]:
    """Play and record episodes; episode i starts from ``seed + i``, as in an evaluation.

    :param predict: batched observation -> actions
    :param env_id: a registered id
    :param episodes: number of episodes
    :param seed: of the first episode
    :param env_kwargs: keyword arguments of the environment
    :param width: of a frame, pixels
    :param height: of a frame, pixels
    :param every: steps per frame
    :param progress: show a progress bar
    :return: the recordings
    """
    from tqdm import tqdm

    from saver_envs.envs.goal_env import SaverGoalEnv

    options: Any = {"width": width, "height": height, **(env_kwargs or {})}
    with closing(SaverGoalEnv(env_id, render_mode="rgb_array", **options)) as env:
        numbers = tqdm(range(episodes), unit="video episode", disable=not progress)
        return [_record_episode(predict, env, seed + number, every) for number in numbers]


def _record_episode(predict: Predict, env: Any, seed: int, every: int) -> EpisodeVideo:
    frames = []
    for step in play(predict, SingleEpisodeEnv(env), [seed]):
        if step.dones[0] or step.number % every == 0:
            frames.append(env.render())
    return EpisodeVideo(seed, frames, bool(step.infos[0]["is_success"]))


def write_mp4(path: Path, recordings: list[EpisodeVideo], title: str) -> None:
    """Write recordings to one video, with captions and the outcome of each episode.

    :param path: ending in ``.mp4``
    :param recordings: at least one
    :param title: start of the captions
    :raises OSError: if the file cannot be written, as on a full disk
    """
    first = captioned(recordings[0].frames[0], title, GREY)
    with closing(mp4_writer(path, first.shape[1], first.shape[0])) as writer:
        for number, recording in enumerate(recordings, start=1):
            caption = f"{title}   episode {number} of {len(recordings)}"
            outcome, colour = ("success", GREEN) if recording.success else ("failed", RED)
            last = captioned(recording.frames[-1], f"{caption}   {outcome}", colour)
            shown = (captioned(frame, caption, GREY) for frame in recording.frames)
            for frame in chain(shown, repeat(last, HOLD)):
                writer.send(frame)


def mp4_writer(
    path: Path, width: int, height: int, fps: float = FPS, keyframes_every: int | None = None
) -> Generator[None, Frame, None]:
    """Open a writer of H.264: `send` it frames, then `close` it.

    :param path: ending in ``.mp4``
    :param width: of a frame, pixels
    :param height: of a frame, pixels
    :param fps: frames per second
    :param keyframes_every: frames from one that is decoded by itself to the next, for readers of
        single frames; the encoder's choice if None
    :return: a generator that is ready for the first frame, (height, width, 3)
    :raises OSError: if the file cannot be written, as on a full disk; so do ``send`` and ``close``
    """
    keyframes = [] if keyframes_every is None else ["-g", str(keyframes_every)]
    writer = _write_frames(path, width, height, fps, keyframes)
    next(writer)
    return writer


def _write_frames(
    path: Path, width: int, height: int, fps: float, more: list[str]
) -> Generator[None, Frame, None]:
    import imageio_ffmpeg

    encoder = imageio_ffmpeg.write_frames(
        str(path),
        (width, height),
        fps=fps,
        codec="libx264",
        quality=None,
        macro_block_size=2,
        ffmpeg_log_level="error",
        # With the index at the start, a browser plays the video while it loads.
        output_params=["-crf", str(QUALITY), "-preset", "slow", "-movflags", "+faststart", *more],
    )
    try:
        with closing(encoder):
            encoder.send(None)
            while True:
                frame = yield
                encoder.send(np.ascontiguousarray(frame))
    except OSError as error:  # what ffmpeg printed, without a number
        raise OSError(errno.EIO, f"{path} could not be written: is the disk full?") from error


def captioned(frame: Frame, text: str, colour: tuple[int, int, int]) -> Frame:
    """Add a bar with text below a frame.

    :param frame: (height, width, 3)
    :param text: one line
    :param colour: of the bar
    :return: (height + bar, width, 3)
    """
    from PIL import Image, ImageDraw

    height, width = frame.shape[:2]
    picture = Image.new("RGB", (width, height + BAR_HEIGHT), colour)
    picture.paste(Image.fromarray(frame), (0, 0))
    draw = ImageDraw.Draw(picture)
    draw.text((12, height + 8), text, fill=(255, 255, 255), font=font(16))
    return np.asarray(picture)


def font(size: int) -> Any:
    """Load DejaVu Sans, which Matplotlib contains, so that captions look the same everywhere.

    :param size: pixels
    """
    from matplotlib import font_manager
    from PIL import ImageFont

    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)
