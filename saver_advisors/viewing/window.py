"""Show a playback in MuJoCo's own viewer."""

from __future__ import annotations

from typing import Any, Final

import mujoco

from saver_advisors.viewing.playback import Playback
from saver_envs.cameras.off_screen import require_display
from saver_envs.cameras.rendering import SceneRenderer

GLFW_KEYS: Final = {
    **{32: "space", 257: "enter", 260: "insert", 261: "delete", 268: "home", 269: "end"},
    **{262: "arrowright", 263: "arrowleft", 264: "arrowdown", 265: "arrowup"},
    **{266: "pageup", 267: "pagedown"},
}


class WindowView:
    """Opens a window with the scene, what there is to say about it, and keys.

    :param playback: what is shown
    :raises RuntimeError: without a display
    """

    def __init__(self, playback: Playback) -> None:
        require_display()
        self._playback = playback
        self._renderer = SceneRenderer(playback.episodes.scene)
        self._viewer: Any = None
        self._model: mujoco.MjModel | None = None

    def show(self) -> bool:
        """Draw the present state; return whether the window is still open."""
        if self._viewer is not None and not self._viewer.is_running():
            return False
        self._renderer.update(self._playback.episodes, 0)
        if self._model is not self._renderer.model:  # the next episode's may be another
            self._open()
        lines = self._playback.status()
        heads, texts = "\n".join(lines), "\n".join(lines.values())
        self._viewer.set_texts((None, None, heads, texts))
        self._viewer.sync()
        return True

    def close(self) -> None:
        """Close the window."""
        if self._viewer is not None:
            self._viewer.close()
        self._renderer.close()

    def _open(self) -> None:
        from mujoco import viewer  # looks for a display

        if self._viewer is not None:
            self._viewer.close()
        self._model = self._renderer.model
        self._viewer = viewer.launch_passive(
            self._model,
            self._renderer.data,
            key_callback=self._pressed,
            show_left_ui=False,
            show_right_ui=False,
        )

    def _pressed(self, code: int) -> None:
        if key := GLFW_KEYS.get(code):
            self._playback.later(lambda: self._playback.press(key))
