"""Render an environment at the start of an episode, for the documentation and the demo's page."""

from __future__ import annotations

from contextlib import closing
from typing import Final

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
    with closing(env):
        env.reset(seed=seed)
        return np.asarray(env.render(), dtype=np.uint8)
