"""Record the clips of the environments' pages."""

from __future__ import annotations

from typing import Final

import numpy as np

from reproduction.joint_speeds import policy_for
from saver_advisors.cli.policies import resolve
from saver_advisors.evaluation.episodes import evaluate_policy
from saver_advisors.reporting.video import Frame, record

CLIP_SIZE: Final = (400, 300)
CLIP_EVERY: Final = 2
_SEARCHED: Final = 12


def clip_frames(env_id: str) -> list[Frame]:
    """Record an episode of the best available policy, the first successful one of a few.

    :param env_id: a registered id
    :return: every second frame
    """
    policy = policy_for(env_id)
    outcomes = evaluate_policy(resolve(policy, env_id, {}), env_id, episodes=_SEARCHED)
    seed = int(np.argmax(outcomes.success))
    width, height = CLIP_SIZE
    [recording] = record(
        resolve(policy, env_id, {}),
        env_id,
        episodes=1,
        seed=seed,
        width=width,
        height=height,
        every=CLIP_EVERY,
    )
    return recording.frames
