"""Colour and depth from one drawing of a scene, for loops that take hundreds of pictures.

`mujoco.Renderer` draws once for colour and once for depth; the depth buffer of the first drawing
already holds what the second one computes.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import camera_index, require_graphics
from saver_envs.cameras.rgbd import Camera
from saver_envs.robots.description import COLLISION_GROUP


class _OnePassRenderer(mujoco.Renderer):
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


class OnePassCamera:
    """Draws a camera's view without shadows; the first picture opens the graphics context.

    :param model: with the camera, copied: targets and other marks (sites) are not drawn
    :param name: of the camera
    :param camera: its intrinsics; pictures are of its size
    :raises ValueError: for a camera that the model does not have; the message lists those it has
    """

    def __init__(self, model: mujoco.MjModel, name: str, camera: Camera) -> None:
        self.model = copy.copy(model)
        # Multi-sampling triples the cost, and a larger buffer only takes time to clear.
        self.model.vis.quality.offsamples = 0
        self.model.vis.global_.offwidth = camera.width
        self.model.vis.global_.offheight = camera.height
        self._view = camera_index(model, name)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 0
        self._options.sitegroup[:] = 0
        self._size = (camera.height, camera.width)
        self._renderer: _OnePassRenderer | None = None

    def capture(self, data: mujoco.MjData) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw the present state.

        :param data: of the model, with kinematics up to date
        :return: colour (height, width, 3), and exact depth (height, width) along the view, metres
        """
        if self._renderer is None:
            require_graphics()
            self._renderer = _OnePassRenderer(self.model, *self._size)
        self._renderer.update_scene(data, self._view, self._options)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[flag] = False
        rgb, buffer = self._renderer.render_both()
        # Undo the perspective, with the far plane at 0 and the near one at 1 of the buffer.
        extent, planes = self.model.stat.extent, self.model.vis.map
        near, far = planes.znear * extent, planes.zfar * extent
        exact = near * far / (near + buffer.astype(np.float64) * (far - near))
        return rgb, exact.astype(np.float32)

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
