"""d3rlpy: TD3+BC on a hundred random episodes, without an environment while it learns."""

import d3rlpy
import gymnasium

env = gymnasium.wrappers.FlattenObservation(gymnasium.make("saver_envs:JacoPushDense-v0"))
buffer = d3rlpy.dataset.create_fifo_replay_buffer(limit=10_000, env=env)
random = d3rlpy.algos.RandomPolicyConfig().create()
random.build_with_env(env)
random.collect(env, buffer, n_steps=1_000, show_progress=False)
algorithm = d3rlpy.algos.TD3PlusBCConfig(batch_size=64).create()
algorithm.fit(buffer, n_steps=200, n_steps_per_epoch=200, save_interval=10, show_progress=False)
print("episodes", len(buffer.episodes))
