"""Record the clips of the environments' pages."""

from __future__ import annotations

from typing import Final

import numpy as np

from saver_advisors.cli.policies import resolve
from saver_advisors.evaluation.episodes import Predict, evaluate_policy
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.video import Frame, record

CLIP_SIZE: Final = (400, 300)
CLIP_EVERY: Final = 2
_SEARCHED: Final = 12


def clip_frames(env_id: str) -> list[Frame]:
    """Record an episode of the best available policy, the first successful one of a few.

    :param env_id: a registered id
    :return: every second frame
    """
    outcomes = evaluate_policy(best_policy(env_id), env_id, episodes=_SEARCHED)
    seed = int(np.argmax(outcomes.success))
    width, height = CLIP_SIZE
    [recording] = record(
        best_policy(env_id),
        env_id,
        episodes=1,
        seed=seed,
        width=width,
        height=height,
        every=CLIP_EVERY,
    )
    return recording.frames


def best_policy(env_id: str) -> Predict:
    """Return an environment's shipped policy, else its scripted expert, else random actions."""
    from saver_advisors.pretrained import load_policy, shipped_policies

    for name in shipped_policies():
        if load_policy(name).card.env_id == env_id:
            return resolve(name, env_id, {})
    try:
        return resolve("expert", env_id, {})
    except UsageError:
        return resolve("random", env_id, {})
