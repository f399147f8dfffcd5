"""Pictures and clips of the environments, for the documentation and the demo's page."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from saver_advisors.cli.policies import NamedPolicy, resolve
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.video import Frame, record

PICTURE_SIZE: Final = (640, 480)
CLIP_SIZE: Final = (400, 300)
CLIP_EVERY: Final = 2
_SEARCHED: Final = 12


def start_picture(env_id: str, seed: int = 0) -> Frame:
    """An environment at the start of an episode.

    :param env_id: a registered id
    :param seed: of the episode
    :return: (height, width, 3)
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


def clip_frames(env_id: str) -> list[Frame]:
    """An episode played by the best that there is, the first successful one of a few.

    :param env_id: a registered id
    :return: every second frame
    """
    from saver_advisors.evaluation.episodes import evaluate_policy

    policy = best_policy(env_id)
    outcomes = evaluate_policy(policy.predict, env_id, episodes=_SEARCHED)
    seed = int(np.argmax(outcomes.success))
    width, height = CLIP_SIZE
    [recording] = record(
        best_policy(env_id).predict,
        env_id,
        episodes=1,
        seed=seed,
        width=width,
        height=height,
        every=CLIP_EVERY,
    )
    return recording.frames


def best_policy(env_id: str) -> NamedPolicy:
    """The shipped policy of an environment, else its scripted expert, else random actions.

    :param env_id: a registered id
    :return: the policy
    """
    from saver_advisors.pretrained import load_policy, shipped_policies

    for name in shipped_policies():
        if load_policy(name).card.env_id == env_id:
            return resolve(name, env_id, {})
    try:
        return resolve("expert", env_id, {})
    except UsageError:
        return resolve("random", env_id, {})


def save_jpeg(path: Path, picture: Frame, quality: int = 88) -> None:
    """Write a picture.

    :param path: ending in ``.jpg``
    :param picture: (height, width, 3)
    :param quality: 1 to 95
    """
    from PIL import Image

    Image.fromarray(picture).save(path, quality=quality, optimize=True)
