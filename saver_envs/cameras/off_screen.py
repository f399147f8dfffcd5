"""Pictures of a model without a window, by MuJoCo's renderer."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from functools import lru_cache
from typing import Any, Literal

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from saver_envs.robots.description import COLLISION_GROUP


def camera_index(model: mujoco.MjModel, name: str) -> int:
    """Return the id of a camera.

    :param model: that has the camera.
    :param name: of the camera.
    :raises ValueError: for an unknown name; the message lists the model's cameras.
    """
    names = [model.camera(index).name for index in range(model.ncam)]
    if name not in names:
        raise ValueError(f"camera={name!r}: the model has the cameras {', '.join(names)}")
    return names.index(name)


class _Renderer(mujoco.Renderer):
    """MuJoCo's renderer, which itself reads either colours or depths of a drawing."""

    def render_both(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return colours (height, width, 3), and OpenGL's depths (height, width)."""
        if self._gl_context:
            self._gl_context.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._mjr_context)
        rgb = np.empty((self._height, self._width, 3), dtype=np.uint8)
        depth = np.empty((self._height, self._width), dtype=np.float32)
        mujoco.mjr_readPixels(rgb, depth, self._rect, self._mjr_context)
        # OpenGL's rows begin at the bottom.
        return rgb[::-1].copy(), depth[::-1]


class OffScreenView:
    """What a camera of a model sees; the first picture opens the graphics context.

    :param model: what is drawn; collision geoms are left out.
    :param camera: name of the camera.
    :param width: pixels.
    :param height: pixels.
    :raises ValueError: for a camera that the model does not have; the message lists those it has.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, width: int, height: int) -> None:
        camera_index(model, camera)
        self._model, self._camera, self._size = model, camera, (height, width)
        self.options = mujoco.MjvOption()
        self.options.geomgroup[COLLISION_GROUP] = 0
        self._renderer: _Renderer | None = None

    def draw(
        self,
        data: mujoco.MjData,
        kind: Literal["rgb", "depth", "segmentation"] = "rgb",
        shadows: bool = True,
    ) -> NDArray[Any]:
        """Draw a picture.

        :param data: of the model, with kinematics up to date.
        :param kind: ``rgb`` (height, width, 3) uint8; ``depth`` (height, width) float32, metres
            along the view; or ``segmentation`` (height, width, 2) int32, object ids and types.
        :param shadows: whether lights cast shadows; without is faster.
        :raises RuntimeError: where there is no way to draw; the message says what to install.
        """
        renderer = self._updated(data, shadows)
        renderer.disable_depth_rendering()
        renderer.disable_segmentation_rendering()
        if kind == "depth":
            renderer.enable_depth_rendering()
        elif kind == "segmentation":
            renderer.enable_segmentation_rendering()
        return renderer.render().copy()

    def draw_both(
        self, data: mujoco.MjData, shadows: bool = True
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw once for colour and depth, for loops that take hundreds of pictures.

        :meth:`draw` draws once for each; the depth buffer of the first drawing already holds what
        the second one computes.

        :param data: of the model, with kinematics up to date.
        :param shadows: whether lights cast shadows.
        :return: colour (height, width, 3), and exact depth (height, width) along the view, metres.
        :raises RuntimeError: where there is no way to draw; the message says what to install.
        """
        rgb, buffer = self._updated(data, shadows).render_both()
        # Undo the perspective, with the far plane at 0 and the near one at 1 of the buffer.
        extent, planes = self._model.stat.extent, self._model.vis.map
        near, far = planes.znear * extent, planes.zfar * extent
        exact = near * far / (near + buffer.astype(np.float64) * (far - near))
        return rgb, exact.astype(np.float32)

    def _updated(self, data: mujoco.MjData, shadows: bool) -> _Renderer:
        """Return the renderer with the scene of a state."""
        if self._renderer is None:
            require_graphics()
            self._renderer = _Renderer(self._model, *self._size)
        self._renderer.update_scene(data, self._camera, self.options)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        return self._renderer

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def displays_named() -> bool:
    """Return whether there may be a display; on Linux its variable says so."""
    on_linux = sys.platform == "linux"
    return not on_linux or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def require_display() -> None:
    """Check that a window can be opened.

    :raises RuntimeError: where none can; GLFW would end the process.
    """
    if not displays_named() or (sys.platform == "linux" and not _draws("glfw")):
        raise RuntimeError(
            "render_mode='human': there is no display to open a window on; use "
            "render_mode='rgb_array', or run under xvfb-run"
        )


def require_graphics() -> None:
    """Choose a way to draw without a display where ``MUJOCO_GL`` does not: EGL, then OSMesa.

    :raises RuntimeError: where neither works; GLFW, MuJoCo's default, would end the process.
    """
    # Not the variable: MuJoCo read it when it was imported.
    context = getattr(gl_context, "GLContext", None)  # there is none with MUJOCO_GL=disable
    by_glfw = getattr(context, "__module__", "") == "mujoco.glfw"
    if sys.platform != "linux" or not by_glfw or (displays_named() and _draws("glfw")):
        return
    for backend in ("egl", "osmesa"):
        if _draws(backend):
            # As MuJoCo itself does on import; the renderer looks it up when it is built.
            gl_context.GLContext = importlib.import_module(f"mujoco.{backend}").GLContext
            return
    raise RuntimeError(
        "pictures need a display, EGL or OSMesa, and none of them works here: install one, on "
        "Debian and Ubuntu with `apt install libegl1 libgl1-mesa-dri` or `apt install libosmesa6`, "
        "or run under xvfb-run"
    )


@lru_cache(maxsize=8)
def _draws(backend: str) -> bool:
    """Return whether MuJoCo draws with a backend.

    Tried in another process: a backend that fails may end it, and PyOpenGL keeps the first one.
    """
    draw = "import mujoco as m; m.Renderer(m.MjModel.from_xml_string('<mujoco/>'), 8, 8).render()"
    environment = {**os.environ, "MUJOCO_GL": backend}
    environment.pop("PYOPENGL_PLATFORM", None)
    done = subprocess.run(
        [sys.executable, "-P", "-c", draw], env=environment, capture_output=True, check=False
    )
    return done.returncode == 0
