"""Golden trajectories: short, contact-free episodes, stored to be met again to 1e-6.

Contact-rich physics is chaotic across machines; a hand that moves through the air beside a cube at
rest is not. A person's arms rest in contact, and settle, as does a block on a board: of wrist push
and carry the hands alone are kept after the start. What a change of behaviour moves here asks for a
new version of the ids. Then:

    python tests/envs/golden.py --write
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from saver_envs.registration import ENVIRONMENTS
from saver_envs.tasks.contract import Task
from saver_envs.tasks.table import TableTask

FOLDER = Path(__file__).parent.parent / "golden"
SEED, STEPS, EVERY = 11, 24, 6
#: Numbers of an arm's block that tell of its hand.
HAND = 12
IDS = [env_id for env_id, row in ENVIRONMENTS.items() if row.reward_type == "sparse"]


def play(env_id: str) -> dict[str, Any]:
    """Play the episode and return its goal and some of its observations.

    :raises RuntimeError: when anything but the table touches a cube.
    """
    env = gymnasium.make(env_id).unwrapped
    seen, _ = env.reset(seed=SEED)
    episodes = env.episodes
    settles = not isinstance(episodes.task, TableTask)
    driven = type(episodes.task).drive is not Task.drive  # a bed moves what lies on it
    resting = seen["achieved_goal"]
    observations = [seen["observation"]]
    size = env.action_space.shape[0]
    for step in range(1, STEPS + 1):
        action = 0.3 * np.sin(0.7 * step + np.arange(size))
        seen = env.step(action)[0]
        moved = float(np.abs(seen["achieved_goal"] - resting).max())
        if episodes.simulation.touching(np.arange(1), episodes.task.resting).any() or moved > (
            math.inf if driven else 0.012 if settles else 1e-3
        ):
            raise RuntimeError(f"{env_id}: step {step} is not free of contact")
        if step % EVERY == 0:
            kept = episodes.task.observation_layout.blocks(seen["observation"])
            observations.append(kept[:, :HAND].ravel() if settles else kept.ravel())
    return {
        "env": env_id,
        "seed": SEED,
        "mujoco": mujoco.__version__,
        "desired_goal": [round(float(one), 8) for one in seen["desired_goal"]],
        "observations": [[round(float(one), 8) for one in row] for row in observations],
    }


def main() -> None:
    """Write the files, or say how far they are from what is played now."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="store what is played now")
    arguments = parser.parse_args()
    FOLDER.mkdir(exist_ok=True)
    for env_id in IDS:
        path, played = FOLDER / f"{env_id}.json", play(env_id)
        if arguments.write:
            rows = ",\n  ".join(json.dumps(row) for row in played.pop("observations"))
            head = json.dumps(played)[:-1]
            path.write_text(f'{head},\n "observations": [\n  {rows}\n ]}}\n')
            print(f"{path.name}: written")
        else:
            stored = json.loads(path.read_text())
            gap = np.subtract(played["observations"], stored["observations"])
            print(f"{path.name}: largest difference {np.abs(gap).max():.1e}")


if __name__ == "__main__":
    main()
