"""Pictures of episodes, off screen."""

from __future__ import annotations

import copy
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import OffScreenView
from saver_envs.scenes import Scene

DEFAULT_CAMERA = "three_quarter"
DEFAULT_SIZE = (640, 480)  # width, height in pixels


class Drawable(Protocol):
    """What is drawn: :class:`saver_envs.episodes.Episodes`."""

    @property
    def simulation(self) -> Any:
        """Has positions ``qpos`` (n, positions)."""

    def variant_of(self, index: int) -> int:
        """Return which of the scene's models an episode has."""

    def decorate(self, model: mujoco.MjModel, index: int) -> None:
        """Adapt a drawing model to an episode."""


class SceneRenderer:
    """Draws simulations of one scene off screen.

    :param scene: the scene that the simulations share.
    :param width: pixels.
    :param height: pixels.
    :param camera: name of a camera of the scene.
    :param plain: as a sensor's picture, for speed: no targets, shadows or anti-aliasing.
    :raises ValueError: for a camera that the scene does not have; the message lists those it has.
    """

    def __init__(
        self,
        scene: Scene,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str = DEFAULT_CAMERA,
        plain: bool = False,
    ) -> None:
        self._scene = scene
        self._view_of = (camera, width, height)
        self._plain = plain
        self._take_variant(0)

    def _take_variant(self, variant: int) -> None:
        """Switch to a variant of the scene."""
        self._variant = variant
        # What is drawn, also for an interactive viewer.
        # Targets are sites, which belong to the model: drawn on a copy, since scenes are shared.
        self.model = copy.copy(self._scene.drawing_model(variant))
        if self._plain:
            # Multi-sampling triples the cost, and a larger buffer only takes time to clear.
            self.model.vis.quality.offsamples = 0
            buffer = self.model.vis.global_
            _, buffer.offwidth, buffer.offheight = self._view_of
        self.data = mujoco.MjData(self.model)
        self._view = OffScreenView(self.model, *self._view_of)
        self._view.options.sitegroup[0] = not self._plain

    def update(
        self, episodes: Drawable, index: int, qpos: NDArray[np.float64] | None = None
    ) -> None:
        """Copy the state of an episode, with its decorations and targets.

        :param episodes: of this scene.
        :param index: which episode.
        :param qpos: positions to draw instead of the current ones.
        """
        variant = episodes.variant_of(index)
        if variant != self._variant:
            self.close()
            self._take_variant(variant)
        episodes.decorate(self.model, index)
        self.data.qpos[:] = episodes.simulation.qpos[index] if qpos is None else qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def rgb(self) -> NDArray[np.uint8]:
        """Return a colour picture (height, width, 3)."""
        return self._view.draw(self.data, "rgb", shadows=not self._plain)

    def depth(self) -> NDArray[np.float32]:
        """Return distances along the camera's axis (height, width), metres."""
        return self._view.draw(self.data, "depth", shadows=not self._plain)

    def rgbd(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return what :meth:`rgb` and :meth:`depth` do, from one drawing."""
        return self._view.draw_both(self.data, shadows=not self._plain)

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        self._view.close()
