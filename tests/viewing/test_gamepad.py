"""The script for gamepads in headless Chromium, with pads that are made up."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("websockets")

from chromium import Page, chromium

from saver_advisors.viewing.gamepad import BUTTONS, gamepad_script

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="Chromium is not installed"),
]

#: Collects the keys, and leaves it to the test when the pad is read.
SETUP = """
window.keys = [];
document.addEventListener("keydown", (event) => window.keys.push(event.code));
window.setInterval = (poll, period) => { window.period = period; return 1; };
window.pads = [null];
navigator.getGamepads = () => window.pads;
document.body.innerHTML = '<small id="saver-gamepad"></small>';
"""


def pad(axes: tuple[float, ...] = (0, 0, 0, 0), pressed: tuple[int, ...] = ()) -> str:
    """What a browser says about a pad, as JavaScript."""
    buttons = [{"pressed": number in pressed} for number in range(17)]
    return json.dumps({"mapping": "standard", "axes": axes, "buttons": buttons})


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    opened = Page(tmp_path_factory.mktemp("chromium"), 400, 300)
    opened.evaluate(SETUP)
    opened.evaluate(gamepad_script(0.04))
    yield opened
    opened.close()


def keys(page: Page, *pads: str) -> Any:
    """The keys that are pressed while the pads are read, one after the other."""
    page.evaluate("window.keys = []")
    for one in pads:
        page.evaluate(f"window.pads = [null, {one}]; window.saverGamepad.poll()")
    pressed = page.evaluate("JSON.stringify(window.keys)")
    page.evaluate(f"window.pads = [null, {pad()}]; window.saverGamepad.poll()")
    return json.loads(pressed)


def text(page: Page) -> Any:
    return page.evaluate("document.getElementById('saver-gamepad').textContent")


def test_a_stick_moves_as_far_as_it_is_deflected(page: Page) -> None:
    assert page.evaluate("window.period") == 40
    assert keys(page, *[pad((1, 0, 0, 0))] * 3) == ["ArrowRight"] * 3
    assert keys(page, *[pad((0, -0.5, 0, 0))] * 8) == ["ArrowUp"] * 4
    assert keys(page, *[pad((0, 0, 0, 1 / 3))] * 6) == ["PageDown"] * 2
    assert keys(page, *[pad((0, 0, 1, -1))] * 2) == ["PageUp"] * 2
    # Together no farther than the hand gets in that time, which is one key's way.
    diagonal = keys(page, *[pad((-1, 1, 0, 0))] * 100)
    assert set(diagonal) == {"ArrowLeft", "ArrowDown"}
    assert diagonal.count("ArrowLeft") == diagonal.count("ArrowDown") == 70


def test_a_stick_at_rest_does_nothing(page: Page) -> None:
    assert keys(page, *[pad((0.1, -0.1, 0, 0.0))] * 50) == []
    half = pad((0.9, 0, 0, 0))
    assert keys(page, half, pad(), half, pad(), half) == []  # each starts anew


def test_a_button_is_one_key(page: Page) -> None:
    for number, key in BUTTONS.items():
        code = "Space" if key == " " else key
        held = pad(pressed=(number,))
        assert keys(page, held, held, pad(), held) == [code, code]
    assert keys(page, pad(pressed=(4, 5, 6, 7, 16))) == []


def test_what_it_says(page: Page) -> None:
    keys(page, pad())
    assert text(page) == "Gamepad: connected"
    page.evaluate("window.pads = [null, null]; window.saverGamepad.poll()")
    assert text(page).startswith("Gamepad: none")
    other = pad((1, 0, 0, 0)).replace("standard", "")
    assert keys(page, other) == []
    page.evaluate(f"window.pads = [{other}]; window.saverGamepad.poll()")
    assert text(page) == "Gamepad: its layout is unknown"


def test_it_is_started_once(page: Page) -> None:
    page.evaluate("window.first = window.saverGamepad")
    page.evaluate(gamepad_script(0.04))
    assert page.evaluate("window.first === window.saverGamepad") is True


def test_the_script_is_in_the_package() -> None:
    import saver_advisors.viewing.gamepad as module

    assert Path(module.__file__).with_suffix(".js").is_file()
