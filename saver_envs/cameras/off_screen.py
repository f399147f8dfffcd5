"""Pictures of a model without a window, by MuJoCo's renderer."""

from __future__ import annotations

import os
import sys
from typing import Any, Literal

import mujoco
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
        self._renderer: mujoco.Renderer | None = None

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
        :raises RuntimeError: on Linux without a display and without another way to draw: GLFW,
            which MuJoCo would try, would end the process.
        """
        if self._renderer is None:
            _require_graphics()
            self._renderer = mujoco.Renderer(self._model, *self._size)
        renderer = self._renderer
        renderer.disable_depth_rendering()
        renderer.disable_segmentation_rendering()
        if kind == "depth":
            renderer.enable_depth_rendering()
        elif kind == "segmentation":
            renderer.enable_segmentation_rendering()
        renderer.update_scene(data, self._camera, self.options)
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        picture: NDArray[Any] = renderer.render().copy()
        return picture

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _require_graphics() -> None:
    displays = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    # Not the variable: MuJoCo read it when it was imported.
    context = getattr(mujoco, "GLContext", None)  # there is none with MUJOCO_GL=disable
    by_glfw = getattr(context, "__module__", "") == "mujoco.glfw"
    if sys.platform == "linux" and by_glfw and not displays:
        raise RuntimeError(
            "no display: pictures need one, or MUJOCO_GL=egl (with a driver) or MUJOCO_GL=osmesa "
            "(without) in the environment before MuJoCo is imported"
        )
