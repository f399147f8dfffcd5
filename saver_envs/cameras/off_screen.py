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
    # Not the variable: MuJoCo read it when it was imported.
    context = getattr(mujoco, "GLContext", None)  # there is none with MUJOCO_GL=disable
    by_glfw = getattr(context, "__module__", "") == "mujoco.glfw"
    if sys.platform == "linux" and by_glfw and not displays:
        raise RuntimeError(
            "no display: pictures need one, or MUJOCO_GL=egl (with a driver) or MUJOCO_GL=osmesa "
            "(without) in the environment before MuJoCo is imported"
        )
    return mujoco.Renderer(model, height, width)
