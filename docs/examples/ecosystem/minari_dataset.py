"""Minari: record three episodes of the scripted expert, and read them back."""

import os
import tempfile

import gymnasium

from saver_envs.experts import make_expert

os.environ["MINARI_DATASETS_PATH"] = tempfile.mkdtemp()
import minari

env = minari.DataCollector(gymnasium.make("saver_envs:JacoPush-v0"))
expert = make_expert("JacoPush-v0")
for seed in range(3):
    observation, _ = env.reset(seed=seed)
    truncated = False
    while not truncated:
        action = expert.predict({name: part[None] for name, part in observation.items()})[0][0]
        observation, _, _, truncated, info = env.step(action)
env.create_dataset("saver/jaco-push/expert-v0", algorithm_name="scripted expert")
episodes = list(minari.load_dataset("saver/jaco-push/expert-v0").iterate_episodes())
print("episodes", len(episodes), "steps", sum(len(one.rewards) for one in episodes))
