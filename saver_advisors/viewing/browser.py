"""Show a playback in browsers, with buttons, keys and a handle to drag the hand by."""

from __future__ import annotations

import socket
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import mujoco
import numpy as np
import viser

from saver_advisors.viewing.browser_scene import BrowserScene
from saver_advisors.viewing.gamepad import gamepad_html
from saver_advisors.viewing.operator import KEYS
from saver_advisors.viewing.playback import Playback
from saver_envs.cameras.off_screen import camera_index
from saver_envs.cameras.rendering import DEFAULT_CAMERA, SceneRenderer
from saver_envs.simulation import ACTION_DURATION

TIME_KEYS: Final = {"space": "Pause or run", "home": "Restart", "end": "Next seed"}
OPERATOR_KEYS: Final = {
    "enter": "Finish the episode",
    "insert": "Open the gripper",
    "delete": "Close the gripper",
    **{key: f"Move the hand ({key})" for key in KEYS},
}
GRIPPER_KEYS: Final = ("insert", "delete")
DEFAULT_PUSH: Final = 2.0
MOST_PUSH: Final = 20.0


class BrowserView:
    """Serves a page with the scene, what there is to say about it, and controls.

    :param playback: what is shown
    :param host: address to listen on
    :param port: to listen on; a free one if 0
    :param speed: how fast time runs, 1 for real time; a gamepad keeps up with it
    :raises OSError: for an address or a port that cannot be listened on
    """

    def __init__(self, playback: Playback, host: str, port: int, speed: float = 1.0) -> None:
        # viser takes another port, and waits for ever at a wrong address.
        socket.create_server((host, port)).close()
        self._playback, self._speed = playback, speed
        self._server = viser.ViserServer(host=host, port=port, label=playback.env_id, verbose=False)
        #: Address of the page.
        self.url = f"http://{host}:{self._server.get_port()}"
        self._renderer = SceneRenderer(playback.episodes.scene)
        self._scene = BrowserScene(self._server)
        self._said = ""
        with self._server.atomic():
            self._server.gui.configure_theme(show_logo=False, show_share_button=False)
            self._place_camera("front" if playback.operator else DEFAULT_CAMERA)
            self._add_controls()
            if playback.operator is not None:
                self._add_operator()

    def show(self) -> bool:
        """Send what has changed; return True, since browsers come and go."""
        playback = self._playback
        self._renderer.update(playback.episodes, 0)
        said = "\n".join(f"**{head}:** {text}  " for head, text in playback.status().items())
        with self._server.atomic():
            self._scene.update(self._renderer.model, self._renderer.data)
            if said != self._said:
                self._text.content = self._said = said
            if playback.operator is not None:
                self._move_handle(playback.operator.target)
        return True

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()
        self._renderer.close()

    def _place_camera(self, name: str) -> None:
        """Let browsers begin with the view of one of the scene's cameras."""
        model, data = self._renderer.model, self._renderer.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        index = camera_index(model, name)
        position, forward = data.cam_xpos[index], -data.cam_xmat[index].reshape(3, 3)[:, 2]
        camera = self._server.initial_camera
        camera.position = position
        camera.look_at = position - forward * position[2] / forward[2]  # on the table
        camera.fov = float(np.radians(model.cam_fovy[index]))

    def _add_controls(self) -> None:
        gui, playback = self._server.gui, self._playback
        self._text = gui.add_markdown("")
        policies = gui.add_dropdown("Policy", playback.names, initial_value=playback.policy)
        policies.on_update(lambda _: self._later(partial(playback.choose, policies.value)))
        for key, label in TIME_KEYS.items():
            self._button(label, partial(playback.press, key), key)
        self._button("One action", playback.single_step)
        with gui.add_folder("Push", expand_by_default=False):
            body = gui.add_dropdown("What", tuple(playback.bodies()))
            force = gui.add_slider("Force (N)", 0.5, MOST_PUSH, 0.5, DEFAULT_PUSH)
            self._button("Push", lambda: playback.push(body.value, force.value))

    def _add_operator(self) -> None:
        gui, playback, operator = self._server.gui, self._playback, self._playback.operator
        assert operator is not None
        with gui.add_folder("Hand"):
            gui.add_markdown("Drag the handle at the hand, or use arrow keys, page up and down.")
            gui.add_html(gamepad_html(ACTION_DURATION / self._speed))
            arms = tuple(map(str, range(playback.episodes.task.n_arms)))
            arm = gui.add_dropdown("Arm", arms, initial_value=str(operator.arm))
            arm.on_update(lambda _: self._later(lambda: setattr(operator, "arm", int(arm.value))))
            waits = gui.add_checkbox("Time waits for me", playback.waits)
            waits.on_update(lambda _: setattr(playback, "waits", waits.value))
            for key, label in OPERATOR_KEYS.items():
                if key in GRIPPER_KEYS and not operator.grips:
                    continue
                if key in KEYS:
                    self._hotkey(label, partial(playback.press, key), key)
                else:
                    self._button(label, partial(playback.press, key), key)
        held = playback.episodes.worlds.set_points.held_height is not None
        self._handle = self._server.scene.add_transform_controls(
            "/hand",
            scale=0.2,
            active_axes=(True, True, not held),
            disable_rotations=True,
            depth_test=False,
            position=operator.target,
        )
        self._handle_at = operator.target
        self._handle.on_update(self._dragged)

    async def _dragged(self, event: Any) -> None:
        """Obey the handle; viser keeps the order of the calls, since this is a coroutine."""
        target = np.array(self._handle.position)

        def drag() -> None:
            operator = self._playback.operator
            assert operator is not None
            operator.drag(target)
            # At the end the handle comes back into the workspace.
            self._handle_at = target if event.phase == "end" else operator.target

        self._later(drag)

    def _move_handle(self, target: Any) -> None:
        """Move the handle, unless it was the handle that moved the target."""
        if not np.allclose(target, self._handle_at, atol=1e-6):
            self._handle_at = target
            self._handle.position = target

    def _button(self, label: str, command: Callable[[], object], key: Any = None) -> None:
        button = self._server.gui.add_button(f"{label} ({key})" if key else label)
        button.on_click(lambda _: self._later(command))
        if key:
            self._hotkey(label, command, key)

    def _hotkey(self, label: str, command: Callable[[], object], key: Any) -> None:
        hotkey = self._server.gui.add_command(label, hotkey=key)
        hotkey.on_trigger(lambda _: self._later(command))

    def _later(self, command: Callable[[], object]) -> None:
        self._playback.later(command)
