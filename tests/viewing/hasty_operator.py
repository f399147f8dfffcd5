"""`saver view` without a browser, whose operator always lets time run."""

from __future__ import annotations

import argparse
import sys

from saver_advisors.cli import main, view
from saver_advisors.viewing.playback import Playback


class HastyView:
    """Presses a direction and enter, before every action."""

    def __init__(self, playback: Playback) -> None:
        self._playback = playback

    def show(self) -> bool:
        """Command, and go on."""
        self._playback.press("arrowup")
        self._playback.press("enter")
        return True

    def close(self) -> None:
        """Nothing is open."""


def make_view(args: argparse.Namespace, playback: Playback) -> HastyView:
    """Take the place of the page."""
    return HastyView(playback)


if __name__ == "__main__":
    view._view = make_view
    sys.exit(main(sys.argv[1:]))
