"""Pictures of a simulation; the graphics context is opened when the first one is asked for."""

from __future__ import annotations

import copy
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import off_screen
from saver_envs.robots.description import COLLISION_GROUP
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
    :param plain: as a sensor's picture, which is taken often: no targets, no shadows, and edges as
        the pixels have them.
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
        if camera not in scene.cameras:
            raise ValueError(
                f"camera={camera!r}: this scene has the cameras {', '.join(scene.cameras)}"
            )
        self._scene = scene
        self._size = (width, height)
        self._camera = camera
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 0
        self._options.sitegroup[0] = not plain
        self._plain = plain
        self._renderer: mujoco.Renderer | None = None
        self._take_variant(0)

    def _take_variant(self, variant: int) -> None:
        """Draw that variant of the scene from now on."""
        self.close()
        self._variant = variant
        # Targets are sites, which belong to the model: drawn on a copy, since scenes are shared.
        self._model = copy.copy(self._scene.drawing_model(variant))
        if self._plain:
            self._model.vis.quality.offsamples = 0
        self._data = mujoco.MjData(self._model)

    def update(
        self, episodes: Drawable, index: int, qpos: NDArray[np.float64] | None = None
    ) -> None:
        """Take over the state of an episode, its decorations and its targets.

        :param episodes: of this scene.
        :param index: which episode.
        :param qpos: positions to draw instead of the present ones.
        """
        variant = episodes.variant_of(index)
        if variant != self._variant:
            self._take_variant(variant)
        episodes.decorate(self._model, index)
        self._data.qpos[:] = episodes.simulation.qpos[index] if qpos is None else qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def rgb(self) -> NDArray[np.uint8]:
        """Return a colour picture (height, width, 3)."""
        return np.array(self._draw(depth=False), dtype=np.uint8)

    def depth(self) -> NDArray[np.float32]:
        """Return distances along the camera's axis (height, width), metres."""
        return np.array(self._draw(depth=True), dtype=np.float32)

    def _draw(self, depth: bool) -> NDArray[Any]:
        if self._renderer is None:
            width, height = self._size
            self._renderer = off_screen(self._model, height, width)
        if depth:
            self._renderer.enable_depth_rendering()
        else:
            self._renderer.disable_depth_rendering()
        self._renderer.update_scene(self._data, self._camera, self._options)
        if self._plain:
            self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        picture: NDArray[Any] = self._renderer.render()
        return picture

    @property
    def model_and_data(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The copies that are drawn, for an interactive viewer."""
        return self._model, self._data

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
