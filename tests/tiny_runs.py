"""The settings of a training run that takes about a second."""

from __future__ import annotations

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
