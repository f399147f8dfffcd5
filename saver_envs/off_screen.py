"""A graphics context for pictures, or a word on why there is none."""

from __future__ import annotations

import os
import sys

import mujoco


def off_screen(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """Open a graphics context that needs no window.

    :param model: what will be drawn.
    :param height: pixels.
    :param width: pixels.
    :raises RuntimeError: on Linux where there is neither a display nor a word of another way, for
        GLFW, which MuJoCo would try, would end the process.
    """
    displays = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    way = os.environ.get("MUJOCO_GL", "").lower()
    if sys.platform == "linux" and way in ("", "glfw") and not displays:
        raise RuntimeError(
            f"MUJOCO_GL={way!r} and no display: pictures need a display, or MUJOCO_GL=egl (with a "
            "driver) or MUJOCO_GL=osmesa (without) in the environment before Python starts"
        )
    return mujoco.Renderer(model, height, width)
