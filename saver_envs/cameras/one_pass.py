"""Colour and depth from one drawing of a scene, for loops that take hundreds of pictures.

`mujoco.Renderer` draws once for colour and once for depth; the depth buffer of the first drawing
already holds what the second one computes.
"""

from __future__ import annotations

import copy
import weakref
from typing import Any, Final

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import camera_index, require_graphics
from saver_envs.cameras.rgbd import Camera
from saver_envs.robots.description import COLLISION_GROUP

#: Most geoms that a frame may hold, more than any of our scenes has.
_MOST_GEOMS: Final = 2000


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
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = camera_index(model, name)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 0
        self._options.sitegroup[:] = 0
        self._size = (camera.height, camera.width)
        self._rectangle = mujoco.MjrRect(0, 0, camera.width, camera.height)
        self._perturbation = mujoco.MjvPerturb()
        self._scene: Any = None
        self._gl: Any = None
        self._context: Any = None
        self._freed: weakref.finalize[..., Any] | None = None

    def capture(self, data: mujoco.MjData) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw the present state.

        :param data: of the model, with kinematics up to date
        :return: colour (height, width, 3), and exact depth (height, width) along the view, metres
        """
        self._open()
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(
            *(self.model, data, self._options, self._perturbation, self._view),
            *(everything, self._scene),
        )
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = False
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        rgb = np.empty((*self._size, 3), dtype=np.uint8)
        buffer = np.empty(self._size, dtype=np.float32)
        mujoco.mjr_readPixels(rgb, buffer, self._rectangle, self._context)
        # OpenGL's rows begin at the bottom.
        return rgb[::-1].copy(), self._metres(buffer[::-1])

    def _metres(self, buffer: NDArray[np.float32]) -> NDArray[np.float32]:
        """Undo the perspective, with the far plane at 0 and the near one at 1 of the buffer."""
        extent, planes = self.model.stat.extent, self.model.vis.map
        near, far = planes.znear * extent, planes.zfar * extent
        exact = near * far / (near + buffer.astype(np.float64) * (far - near))
        return exact.astype(np.float32)

    def _open(self) -> None:
        if self._context is None:
            height, width = self._size
            require_graphics()
            self._gl = gl_context.GLContext(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_50)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
            self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
            self._scene = mujoco.MjvScene(self.model, _MOST_GEOMS)
            self._freed = weakref.finalize(self, _free, self._gl, self._context)
            # MuJoCo ends its displays itself when the process ends.
            self._freed.atexit = False
        else:
            self._gl.make_current()

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        if self._freed is not None:
            self._freed()
            self._context = self._gl = self._scene = self._freed = None


def _free(gl: Any, context: Any) -> None:
    """Free a camera's part of OpenGL, in its own context.

    A camera that was not closed may be collected while another one draws. In the other's context
    the same numbers name the other's buffers, which would be deleted.
    """
    with gl.as_current():
        context.free()
    gl.free()
