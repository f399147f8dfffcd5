"""`saver view` in headless Chromium: the scene arrives, keys and a gamepad move the arm, episodes
are written."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

viser = pytest.importorskip("viser")
minari = pytest.importorskip("minari")

from chromium import Page, chromium  # noqa: E402
from scripted_operator import playback  # noqa: E402

from saver_advisors.viewing.browser import BrowserView  # noqa: E402

NAME = "saver/by-hand-v0"
#: A gamepad, as far as the page can see.
PAD = """
window.pad = {mapping: "standard", axes: [0, 0, 0, 0], buttons: []};
for (let i = 0; i < 17; i += 1) window.pad.buttons.push({pressed: false});
navigator.getGamepads = () => [window.pad];
"""


def colours(picture: bytes) -> int:
    """How many colours a screenshot has: a page without a scene has few."""
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    return len(np.unique(np.asarray(image).reshape(-1, 3) // 8, axis=0))


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
def test_demonstrating_in_a_browser(tmp_path: Path) -> None:
    words = ["--env", "JacoPush-v0", "--control", "keyboard", "--keep-failures", "--port", "0"]
    words += ["--record", NAME, "--output", str(tmp_path / "sets"), "--episodes", "1"]
    command = [sys.executable, "-m", "saver_advisors.cli", "view", *words]
    short = ["--env-kwargs", "max_episode_steps=6"]
    page = None
    with subprocess.Popen([*command, *short], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            line = next(one for one in server.stdout if one.startswith("open "))
            page = Page(tmp_path / "chromium", 1100, 800)
            page.call("Page.navigate", url=line.split()[1])
            page.wait_for("seed 0, action 0 of 6")
            page.wait_until(lambda: colours(page.picture()) > 100)
            if folder := os.environ.get("SAVER_SCREENSHOTS"):
                (Path(folder) / "operator.png").write_bytes(page.picture())
            page.press("ArrowUp")
            page.wait_for("action 1 of 6")
            page.press("ArrowRight")
            page.wait_for("action 2 of 6")
            page.evaluate(PAD)
            page.wait_for("Gamepad: connected")
            page.evaluate("window.pad.buttons[13].pressed = true")  # down, on the cross
            page.wait_for("action 3 of 6")
            page.evaluate("window.pad.buttons[3].pressed = true")  # finish
            out = server.stdout.read()
            assert server.wait() == 0
        finally:
            server.kill()
            if page is not None:
                page.close()
    assert re.search(r"wrote 1 demonstrations? to ", out)
    (episode,) = minari.MinariDataset(tmp_path / "sets" / NAME / "data").iterate_episodes()
    wanted = np.zeros((6, 3))
    wanted[0, 0], wanted[1, 1], wanted[2, 0] = -1.0, 1.0, 1.0
    np.testing.assert_allclose(episode.actions, wanted, atol=1e-5)


def test_the_scene_follows_the_simulation() -> None:
    shown = playback("DualJacoPush-v0", seed=1, arm=1)
    view = BrowserView(shown, "127.0.0.1", 0)
    try:
        assert view.show()
        handles = view._scene._handles
        model, data = view._renderer.model, view._renderer.data
        first = {index: np.array(one.position) for index, one in handles.items()}
        places = np.array([*first.values()])
        for target in shown.episodes.targets()[0]:
            assert np.linalg.norm(places - target, axis=1).min() < 1e-5
        shown.press("arrowup")
        shown.tick()
        view.show()
        moved = [k for k, one in handles.items() if not np.allclose(one.position, first[k])]
        assert 0 < len(moved) < len(handles)
        hand = view._handle
        np.testing.assert_allclose(hand.position, shown.operator.target, atol=1e-6)  # type: ignore[union-attr]
        shown.press("end")  # another episode has other targets
        view.show()
        places = np.array([one.position for one in handles.values()])
        for target in shown.episodes.targets()[0]:
            assert np.linalg.norm(places - target, axis=1).min() < 1e-5
        assert model.nsite and data is view._renderer.data
    finally:
        view.close()
        shown.close()


def test_people_have_skins() -> None:
    shown = playback("WristPush-v0")
    view = BrowserView(shown, "127.0.0.1", 0)
    try:
        view.show()
        sizes = [len(one.vertices) for one in view._scene._handles.values()]
        assert sum(size > 500 for size in sizes) >= 1
    finally:
        view.close()
        shown.close()
