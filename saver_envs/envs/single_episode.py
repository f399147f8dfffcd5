"""What the adapters of a single episode share: how it is built and rendered."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.off_screen import displays_named
from saver_envs.cameras.rendering import DEFAULT_CAMERA, DEFAULT_SIZE
from saver_envs.control import InverseKinematics, checked_action
from saver_envs.envs.pictures import RENDER_FPS, RENDER_MODES, Pictures
from saver_envs.episodes import Outcome
from saver_envs.registration import make_episodes


class SingleEpisode:
    """One episode of a registered id that can be rendered; base of the adapters.

    Its arguments are documented at :class:`saver_envs.envs.goal_env.SaverGoalEnv`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's base class declares it like this)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(
        self,
        env_id: str,
        render_mode: str | None = None,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera_name: str = DEFAULT_CAMERA,
        inverse_kinematics: InverseKinematics | None = None,
        **options: Any,
    ) -> None:
        self.render_mode = render_mode
        self.episodes = make_episodes(env_id, 1, 1, inverse_kinematics, **options)
        self._pictures = Pictures(self.episodes, render_mode, width, height, camera_name)
        if not displays_named():
            # Gymnasium's checker opens every mode that an environment offers.
            modes = [mode for mode in RENDER_MODES if mode != "human"]
            self.metadata = {**self.metadata, "render_modes": modes}

    def _stepped(self, action: NDArray[np.floating]) -> Outcome:
        """Apply one action, (action_size,), of all arms."""
        checked = checked_action(action, (self.episodes.action_size,))
        return self._shown(self.episodes.step(checked[None]))

    def _shown(self, outcome: Outcome) -> Outcome:
        """Show the present state in the window, if there is one."""
        if self.render_mode == "human":
            self.render()
        return outcome

    @property
    def model(self) -> mujoco.MjModel:
        """The model of the episode, with the fields that it has now; changing it has no effect."""
        return self.episodes.simulation.model_of(0)

    @property
    def data(self) -> mujoco.MjData:
        """The state of the episode as MuJoCo's data, copied; changing it has no effect."""
        data = mujoco.MjData(self.episodes.scene.model)
        self.episodes.simulation.copy_into(0, data)
        return data

    def render(self) -> Any:
        """Draw the scene.

        :return: (height, width, 3) uint8 or (height, width) float32 metres; ``None`` in ``human``
            mode, where a window shows it, and without a render mode.
        """
        return self._pictures.draw()

    def close(self) -> None:
        """Close the window and free the graphics context."""
        self._pictures.close()
