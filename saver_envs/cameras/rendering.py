"""Pictures of a simulation; the graphics context is opened when the first one is asked for."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import off_screen
from saver_envs.people.patient import People
from saver_envs.people.stretcher import STRETCHER
from saver_envs.robots.description import COLLISION_GROUP
from saver_envs.scenes import Scene
from saver_envs.simulation import Simulation

DEFAULT_CAMERA = "three_quarter"
DEFAULT_SIZE = (640, 480)  # width, height in pixels


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
        names = [scene.model.camera(index).name for index in range(scene.model.ncam)]
        if camera not in names:
            raise ValueError(f"camera={camera!r}: this scene has the cameras {', '.join(names)}")
        self._scene = scene
        self._size = (width, height)
        self._camera = camera
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 0
        self._options.sitegroup[0] = not plain
        self._plain = plain
        self._renderer: mujoco.Renderer | None = None
        self._body = 0
        self._take_model(0)

    def _take_model(self, body: int) -> None:
        """Draw the scene with that body from now on."""
        self.close()
        self._body = body
        # Targets are sites, which belong to the model: drawn on a copy, since scenes are shared.
        self._model = copy.copy(self._scene.drawing_model(body))
        if self._plain:
            self._model.vis.quality.offsamples = 0
        self._data = mujoco.MjData(self._model)

    def update(
        self,
        simulation: Simulation,
        index: int,
        target: NDArray[np.float64],
        people: People | None = None,
        qpos: NDArray[np.float64] | None = None,
    ) -> None:
        """Take over the state of simulation ``index`` and its targets (arms, 3), world frame, m.

        :param simulation: of this scene.
        :param index: which one.
        :param target: (arms, 3), world frame, metres.
        :param people: who lies on the bench, in a scene with a person.
        :param qpos: positions to draw instead of the present ones.
        """
        if people is not None:
            if people.body[index] != self._body:
                self._take_model(int(people.body[index]))
            # The stretcher lies where the person was laid down.
            stretcher = self._model.body(STRETCHER).id
            yaw = people.yaw[index] / 2
            self._model.body_pos[stretcher, :2] = people.hips[index]
            self._model.body_quat[stretcher] = (np.cos(yaw), 0, 0, np.sin(yaw))
        self._data.qpos[:] = simulation.qpos[index] if qpos is None else qpos
        self._model.site_pos[self._scene.target_site] = target
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
