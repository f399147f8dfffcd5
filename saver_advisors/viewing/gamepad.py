"""A script for the page that presses its keys for the gamepad of whoever looks at it.

Browsers read gamepads (https://www.w3.org/TR/gamepad/); the machine that simulates need not have
one. viser cannot pass on a gamepad, but it passes on keys, so the script makes them.
"""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Final

BUTTONS: Final = {
    **{0: "Delete", 1: "Insert", 2: "Home", 3: "Enter", 8: "End", 9: " "},
    **{12: "ArrowUp", 13: "ArrowDown", 14: "ArrowLeft", 15: "ArrowRight"},
}
"""Keys of the buttons, by their numbers in the standard layout."""


def gamepad_script(action_seconds: float) -> str:
    """Return the script, JavaScript.

    :param action_seconds: duration of an action; a stick that is fully deflected presses a key once
        in it, which moves the hand at top speed
    """
    script = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")
    script = script.replace("PERIOD", f"{1000 * action_seconds:g}")
    return script.replace("BUTTONS", json.dumps(BUTTONS))


def gamepad_html(action_seconds: float) -> str:
    """Return HTML with a line that says whether there is a gamepad, and the script.

    A ``script`` that is inserted into a page does not run, so a picture without a source starts it.

    :param action_seconds: see :func:`gamepad_script`
    """
    script = html.escape(gamepad_script(action_seconds), quote=True)
    return (
        '<small id="saver-gamepad"></small>'
        f'<img src="data:," alt="" style="display:none" onerror="{script}">'
    )
