"""Draw the figures of wrist push: ``python -m tools.wrist_push_figures`` from the root.

Writes ``docs/images/wrist-push/scene.jpg``, the scene from four sides, and ``episode.jpg``, an
episode of the scripted expert's from above. The same seeds give the same pictures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.episodes import Episodes
from saver_envs.experts import make_expert
from saver_envs.people.bench import CAMERA
from saver_envs.registration import make_episodes

ENV_ID = "WristPush-v0"
OUTPUT = Path("docs/images/wrist-push")
PANEL = (512, 424)  # width, height in pixels: the camera's
SCENE_SEED, EPISODE_SEED = 4, 5
VIEWS = (CAMERA, "three_quarter", "front", "side")
#: Actions after which the episode is shown, the last of them at its end.
MOMENTS = (0, 12, 24, 40, 60, 249)
QUALITY = 88


def started(seed: int) -> Episodes:
    """Return an episode at its start."""
    episodes = make_episodes(ENV_ID)
    episodes.set_generator(0, np.random.default_rng(seed))
    episodes.reset()
    return episodes


def picture(episodes: Episodes, camera: str) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3)."""
    renderer = SceneRenderer(episodes.scene, *PANEL, camera)
    renderer.update(episodes, 0)
    drawn = renderer.rgb()
    renderer.close()
    return drawn


def save(name: str, pictures: list[NDArray[np.uint8]], columns: int) -> None:
    """Write pictures in rows of ``columns``."""
    rows = [np.concatenate(pictures[i : i + columns], 1) for i in range(0, len(pictures), columns)]
    OUTPUT.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(rows)).save(OUTPUT / name, quality=QUALITY, optimize=True)


def main() -> None:
    """Draw both."""
    episodes = started(SCENE_SEED)
    save("scene.jpg", [picture(episodes, view) for view in VIEWS], columns=2)
    episodes, expert, frames = started(EPISODE_SEED), make_expert(ENV_ID), []
    for step in range(MOMENTS[-1] + 1):
        if step in MOMENTS:
            frames.append(picture(episodes, CAMERA))
        episodes.step(expert.predict(episodes.observation().as_dict())[0])
    save("episode.jpg", frames, columns=3)


if __name__ == "__main__":
    main()
