"""Rendering of episodes, for every adapter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import camera_index, require_display
from saver_envs.cameras.rendering import DEFAULT_CAMERA, DEFAULT_SIZE, SceneRenderer
from saver_envs.episodes import Episodes
from saver_envs.simulation import ACTION_DURATION
from saver_envs.validation import require, require_kind

RENDER_MODES = ("human", "rgb_array", "depth_array")
#: Frames per second at which a recording plays in real time.
RENDER_FPS = round(1 / ACTION_DURATION)


class Pictures:
    """Draws episodes in a render mode; nothing is allocated until the first picture.

    A copy, by pickling or ``copy.deepcopy``, draws the copied episodes with a graphics context of
    its own.

    :param episodes: what is drawn.
    :param render_mode: one of ``valid_modes`` or ``None``.
    :param width: pixels of a picture.
    :param height: pixels of a picture.
    :param camera: name of a camera of the scene.
    :param valid_modes: the render modes of the adapter.
    :param plain: see :class:`saver_envs.cameras.rendering.SceneRenderer`.
    :raises ValueError: for an unknown render mode or camera, where the message lists the valid
        ones, or a size out of range.
    :raises RuntimeError: for ``human`` without a display.
    """

    def __init__(
        self,
        episodes: Episodes,
        render_mode: str | None,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str = DEFAULT_CAMERA,
        valid_modes: tuple[str, ...] = RENDER_MODES,
        plain: bool = False,
    ) -> None:
        if render_mode is not None and render_mode not in valid_modes:
            raise ValueError(
                f"render_mode={render_mode!r}: valid modes are {', '.join(valid_modes)}"
            )
        if render_mode == "human":
            require_display()
        camera_index(episodes.scene.model, camera)
        buffer = episodes.scene.model.vis.global_
        for name, pixels, most in (
            ("width", width, buffer.offwidth),
            ("height", height, buffer.offheight),
        ):
            require_kind(name, pixels, "int")
            require(name, pixels, 1 <= pixels <= most, f"1 to {most} pixels")
        self.render_mode = render_mode
        self._episodes = episodes
        self._view = (width, height, camera, plain)
        self._renderer: SceneRenderer | None = None
        self._viewer: Any = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None, "_viewer": None}

    def draw(self, index: int = 0) -> Any:
        """Draw episode ``index``.

        :return: (height, width, 3) uint8 or (height, width) float32 metres; ``None`` in ``human``
            mode, where a window shows it, and without a render mode.
        """
        if self.render_mode is None:
            return None
        renderer = self.of(index)
        if self.render_mode == "rgb_array":
            return renderer.rgb()
        if self.render_mode == "depth_array":
            return renderer.depth()
        if self._viewer is None:
            from mujoco import viewer  # opens a display: only when a window is asked for

            self._viewer = viewer.launch_passive(renderer.model, renderer.data)
        self._viewer.sync()
        return None

    def of(self, index: int, qpos: NDArray[np.float64] | None = None) -> SceneRenderer:
        """Return a renderer of the present state of episode ``index``.

        :param index: which episode.
        :param qpos: positions to draw instead of the current ones.
        """
        if self._renderer is None:
            self._renderer = SceneRenderer(self._episodes.scene, *self._view)
        self._renderer.update(self._episodes, index, qpos)
        return self._renderer

    def close(self) -> None:
        """Close the window and free the graphics context."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
