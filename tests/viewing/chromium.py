"""A page in headless Chromium, driven through its debugging protocol."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from websockets.sync.client import connect

FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--disable-dev-shm-usage"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0"),
    *("--no-first-run", "--disable-extensions", "--disable-background-networking"),
)
PATIENCE = 400.0
"""Seconds until a page that does not come is given up."""
CODES = {"ArrowUp": 38, "ArrowRight": 39, "Enter": 13, " ": 32}


def chromium() -> str | None:
    """The program, if it is installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


class Page:
    """One page; close it."""

    def __init__(self, folder: Path, width: int, height: int) -> None:
        size = f"--window-size={width},{height}"
        program = [str(chromium()), *FLAGS, size, f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(
            program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._numbers = itertools.count()
        port_file = folder / "DevToolsActivePort"
        self.wait_until(port_file.is_file)
        port = port_file.read_text().split()[0]
        with urlopen(f"http://127.0.0.1:{port}/json", timeout=PATIENCE) as answer:
            pages = json.load(answer)
        (page,) = (one for one in pages if one["type"] == "page")
        self._socket = connect(
            page["webSocketDebuggerUrl"], max_size=None, open_timeout=PATIENCE, ping_interval=None
        )
        view = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **view)

    @staticmethod
    def wait_until(ready: Callable[[], object]) -> None:
        """Wait until something is true."""
        end = time.monotonic() + PATIENCE
        while not ready():
            if time.monotonic() > end:
                raise TimeoutError(f"nothing came within {PATIENCE:g} s")
            time.sleep(0.2)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol, and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result

    def evaluate(self, expression: str) -> Any:
        """The value of JavaScript."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    def wait_for(self, text: str) -> None:
        """Wait until the page says a text."""
        self.wait_until(lambda: text in (self.evaluate("document.body.innerText") or ""))

    def press(self, key: str) -> None:
        """Press a key, and let it go."""
        code = {"windowsVirtualKeyCode": CODES[key], "code": "Space" if key == " " else key}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, **code)

    def picture(self) -> bytes:
        """A screenshot, PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait()
