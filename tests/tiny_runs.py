"""The settings of a training run that takes about a second, and files of settings."""

from __future__ import annotations

import json
from pathlib import Path

import yaml

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


def write_settings(config: RunConfig, path: Path) -> None:
    """Write settings as a user does, in JSON or YAML by the file's name."""
    values = config.to_mapping()
    path.write_text(json.dumps(values) if path.suffix == ".json" else yaml.safe_dump(values))


def read_config(path: Path) -> RunConfig:
    """Read settings as `saver train --config` does."""
    return RunConfig.from_mapping(read_settings(path, None))
