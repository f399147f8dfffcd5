"""The video of the loop: its first frame, and a full disk."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from saver_advisors.integration import recording
from saver_advisors.integration.assembly import LoopSettings
from saver_advisors.integration.messages import Picture
from saver_advisors.reporting.video import mp4_writer


class Writer:
    """Keeps frames instead of compressing them."""

    def __init__(self) -> None:
        self.frames: list[float] = []

    def send(self, frame: Any) -> None:
        self.frames.append(float(frame[0, 0, 0]))


@pytest.fixture
def writer(monkeypatch: pytest.MonkeyPatch) -> Writer:
    kept = Writer()
    monkeypatch.setattr(recording.video, "mp4_writer", lambda *_: kept)
    monkeypatch.setattr(recording, "SceneRenderer", lambda *_, **__: None)
    monkeypatch.setattr(recording, "wrist_bench", lambda bench: bench)
    drawn = lambda _, now: np.full((2, 2, 3), 100 * now, np.uint8)  # noqa: E731
    monkeypatch.setattr(recording.VideoRecorder, "_drawn", drawn)
    return kept


@pytest.mark.parametrize(
    ("seeing", "picture_at", "first"), [(True, 0.12, 12), (True, None, 100), (False, None, 0)]
)
def test_no_frame_before_the_first_picture(
    writer: Writer, tmp_path: Any, seeing: bool, picture_at: float | None, first: int
) -> None:
    observers: list[Any] = []
    loop: Any = SimpleNamespace(
        bench=SimpleNamespace(episodes=SimpleNamespace(scene=None)),
        graph=SimpleNamespace(observers=observers),
        settings=LoopSettings(seeing=seeing),
    )
    recorder = recording.VideoRecorder(tmp_path / "trial.mp4", loop)
    for number in range(30):
        now = 0.04 * number
        if picture_at is not None and abs(now - picture_at) < 1e-9:
            observers[0]("picture", Picture.__new__(Picture), now)
        recorder(now)
    assert writer.frames[0] == first


def test_an_error_of_the_encoder_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any, **__: Any) -> Iterator[None]:
        yield
        raise OSError("[Errno 32] Broken pipe\n\nFFMPEG COMMAND:\nffmpeg -y ...")

    monkeypatch.setattr("imageio_ffmpeg.write_frames", broken)
    writer = mp4_writer(tmp_path / "trial.mp4", 4, 4)
    with pytest.raises(
        OSError, match=r"trial\.mp4 could not be written: is the disk full\?$"
    ) as caught:
        writer.send(np.zeros((4, 4, 3), np.uint8))
    assert caught.value.errno == errno.EIO
    writer.close()
