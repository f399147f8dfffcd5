"""Render an environment at the start of an episode, for the documentation and the demo's page."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from saver_advisors.reporting.video import Frame

PICTURE_SIZE: Final = (640, 480)


def start_picture(env_id: str, seed: int = 0) -> Frame:
    """Render an environment at the start of an episode.

    :param env_id: a registered id
    :param seed: seed of the episode
    :return: (height, width, 3), uint8
    """
    import gymnasium

    width, height = PICTURE_SIZE
    env = gymnasium.make(
        f"saver_envs:{env_id}", render_mode="rgb_array", width=width, height=height
    )
    try:
        env.reset(seed=seed)
        picture: Any = env.render()
        return np.asarray(picture, dtype=np.uint8)
    finally:
        env.close()
