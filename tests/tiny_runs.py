"""The settings of a training run that takes about a second, and files of settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import EpisodeOutcomes
from saver_advisors.training.defaults import read_settings
from saver_advisors.training.settings import RunConfig

#: Tests replace the settings that they are about.
TINY_RUN = RunConfig(
    "JacoPush-v0",
    env_kwargs={"max_episode_steps": 10},
    n_envs=2,
    total_steps=40,
    net_arch=(8,),
    batch_size=16,
    gradient_steps=1,
    buffer_size=400,
    eval_every=20,
    eval_episodes=2,
)


def outcomes(success: NDArray[np.bool_], cost_sums: dict[str, Any]) -> EpisodeOutcomes:
    """The outcomes of an evaluation in an environment of a test."""
    none = np.zeros(len(success))
    return EpisodeOutcomes(
        env_id="test",
        seed=0,
        success=success,
        returns=none,
        cost_sums=cost_sums,
        cost_maxima={},
        final_distances=none[:, None],
        lengths=none.astype(int),
        diverged=none.astype(bool),
    )


def write_settings(config: RunConfig, path: Path) -> None:
    """Write settings as a user does, in JSON or YAML by the file's name."""
    values = config.to_mapping()
    path.write_text(json.dumps(values) if path.suffix == ".json" else yaml.safe_dump(values))


def read_config(path: Path) -> RunConfig:
    """Read settings as `saver train --config` does."""
    return RunConfig.from_mapping(read_settings(path, None))
