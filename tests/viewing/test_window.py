"""The window, with a stand-in for MuJoCo's viewer: there is no display in tests."""

from __future__ import annotations

from typing import Any

import mujoco.viewer
import pytest
from scripted_operator import playback

from saver_advisors.viewing import window


class Handle:
    """What ``launch_passive`` returns, as far as it is used."""

    def __init__(self, model: Any, data: Any, *, key_callback: Any, **_: Any) -> None:
        self.model, self.press, self.running = model, key_callback, True
        self.synced = 0

    def is_running(self) -> bool:
        return self.running

    def set_texts(self, texts: Any) -> None:
        self.texts = texts

    def sync(self) -> None:
        self.synced += 1

    def close(self) -> None:
        self.running = False


def test_window(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Handle] = []

    def launch(*args: Any, **options: Any) -> Handle:
        opened.append(Handle(*args, **options))
        return opened[-1]

    monkeypatch.setattr(mujoco.viewer, "launch_passive", launch)
    monkeypatch.setattr(window, "require_display", lambda: None)
    shown = playback(arm=0, max_episode_steps=5)
    view = window.WindowView(shown)
    assert view.show()
    (handle,) = opened
    assert "seed 0, action 0 of 5" in handle.texts[3]
    handle.press(265)  # arrow up
    handle.press(80)  # P, which is MuJoCo's own
    shown.tick()
    assert view.show()
    assert "action 1 of 5" in handle.texts[3]
    assert (len(opened), handle.synced) == (1, 2)
    handle.running = False
    assert not view.show()
    view.close()
