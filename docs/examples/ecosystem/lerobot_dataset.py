"""LeRobot: write an episode of the scripted expert with its camera as a data set, and read it."""

import tempfile
from pathlib import Path

import gymnasium
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from saver_envs.experts import make_expert

env = gymnasium.make("saver_envs:JacoPush-v0", render_mode="rgb_array", width=96, height=96)
size, actions = env.observation_space["observation"].shape, env.action_space.shape
features = {
    "observation.state": {"dtype": "float32", "shape": size, "names": None},
    "observation.images.front": {
        "dtype": "image",
        "shape": (96, 96, 3),
        "names": ["height", "width", "channel"],
    },
    "action": {"dtype": "float32", "shape": actions, "names": None},
}
root = Path(tempfile.mkdtemp()) / "jaco-push"
dataset = LeRobotDataset.create("saver/jaco-push", fps=25, features=features, root=root)
expert = make_expert("JacoPush-v0")
observation, _ = env.reset(seed=0)
truncated = False
while not truncated:
    action = expert.predict({name: part[None] for name, part in observation.items()})[0][0]
    frame = {"observation.state": observation["observation"], "action": action.astype("float32")}
    dataset.add_frame({**frame, "observation.images.front": env.render(), "task": "push the cube"})
    observation, _, _, truncated, _ = env.step(action)
dataset.save_episode()
dataset.finalize()
read = LeRobotDataset("saver/jaco-push", root=root)
print("frames", len(read), "state", tuple(read[0]["observation.state"].shape))
