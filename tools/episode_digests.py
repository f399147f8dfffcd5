"""Digest whole episodes of every id, to show that a change of the code leaves them as they were.

    python tools/episode_digests.py --json before.json      # on the old code
    python tools/episode_digests.py --against before.json   # on the new code, on the same machine

Every id is played from seeds 0 upwards by its shipped policy, or else by its scripted expert, as
single environments and as one vector. A digest covers positions, observations, goals, rewards and
costs of every step. Contact-rich physics differs between machines: compare on one machine.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from saver_advisors.pretrained import load_policy, shipped_policies
from saver_envs.experts import make_expert
from saver_envs.registration import ENVIRONMENTS
from saver_envs.tasks.push import Push

#: Ids that no policy of their own ships for, by the variants that one does ship for.
VARIANTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "DualJacoPush-v0 n_arms=3": ("DualJacoPush-v0", {"n_arms": 3}, "triple-jaco-push"),
    "DualJacoPush-v0 ring": ("DualJacoPush-v0", {"layout": "ring"}, "dual-jaco-push"),
    "JacoPush-v0 rated": (
        "JacoPush-v0",
        {"rated": True, "max_episode_steps": Push.rated_horizon},
        "jaco-push",
    ),
    "JacoPush-v0 joints": ("JacoPush-v0", {"control": "joints"}, "random"),
    "JacoPickAndPlace-v0 in hand": (
        "JacoPickAndPlace-v0",
        {"in_hand_probability": 0.5},
        "jaco-pick-and-place",
    ),
    "JacoPush-v0 objects": (
        "JacoPush-v0",
        {"object_size": 0.07, "object_mass": 0.4, "object_friction": 0.8, "object_damping": 1.0},
        "jaco-push",
    ),
}


def cases() -> dict[str, tuple[str, dict[str, Any], str]]:
    """Name -> id, keyword arguments and the policy that plays it."""
    shipped: dict[str, str] = {}
    for name in shipped_policies():
        card = load_policy(name).card
        if not card.env_kwargs:
            shipped.setdefault(card.env_id, name)
    found: dict[str, tuple[str, dict[str, Any], str]] = {}
    for env_id in ENVIRONMENTS:
        found[env_id] = (env_id, {}, shipped.get(env_id.replace("Dense", ""), "expert"))
    return found | VARIANTS


def actor(policy: str, env_id: str, kwargs: dict[str, Any], size: int) -> Callable[[Any], Any]:
    """Return what turns batched observations into actions."""
    if policy == "random":
        generator = np.random.default_rng(0)
        return lambda seen: generator.uniform(-1, 1, (len(seen["observation"]), size))
    model: Any = make_expert(env_id, **kwargs) if policy == "expert" else load_policy(policy)
    return lambda seen: model.predict(seen, deterministic=True)[0]


class Digest:
    """SHA-256 over arrays, and how many episodes succeeded."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self.successes = 0

    def add(self, *arrays: Any) -> None:
        """Take in arrays, by their bytes."""
        for array in arrays:
            self.hash.update(np.ascontiguousarray(array).tobytes())


def play_single(name: str, episodes: int) -> dict[str, Any]:
    """Play episodes one by one."""
    env_id, kwargs, policy = cases()[name]
    env = gymnasium.make(f"saver_envs:{env_id}", **kwargs)
    simulation: Any = env.unwrapped.episodes.simulation  # type: ignore[attr-defined]
    digest = Digest()
    for seed in range(episodes):
        act = actor(policy, env_id, kwargs, env.action_space.shape[0])
        seen, info = env.reset(seed=seed)
        truncated = False
        while not truncated:
            digest.add(simulation.qpos, *(seen[key] for key in sorted(seen)))
            action = act({key: values[None] for key, values in seen.items()})[0]
            seen, reward, _, truncated, info = env.step(action)
            costs = [info[key] for key in sorted(info) if key.startswith("cost")]
            digest.add(np.float64(reward), np.float64(costs))
        digest.add(simulation.qpos, *(seen[key] for key in sorted(seen)))
        digest.successes += bool(info["is_success"])
    env.close()
    return {"digest": digest.hash.hexdigest(), "successes": digest.successes}


def play_vector(name: str, episodes: int) -> dict[str, Any]:
    """Play the same episodes side by side."""
    env_id, kwargs, policy = cases()[name]
    env = gymnasium.make_vec(f"saver_envs:{env_id}", num_envs=episodes, **kwargs)
    digest = Digest()
    act = actor(policy, env_id, kwargs, env.single_action_space.shape[0])
    seen, info = env.reset(seed=0)
    truncated = np.zeros(episodes, dtype=bool)
    simulation: Any = env.unwrapped.episodes.simulation  # type: ignore[attr-defined]
    while not truncated.all():
        digest.add(simulation.qpos, *(seen[key] for key in sorted(seen)))
        seen, reward, _, truncated, info = env.step(act(seen))
        costs = [info[key] for key in sorted(info) if key.startswith("cost")]
        digest.add(reward, np.float64(costs))
    digest.add(simulation.qpos, *(seen[key] for key in sorted(seen)))
    digest.successes = int(np.sum(info["is_success"]))
    env.close()
    return {"digest": digest.hash.hexdigest(), "successes": digest.successes}


def main() -> int:
    """Write digests, or compare with those of a file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the digests there")
    parser.add_argument("--against", type=Path, help="compare with the digests of this file")
    parser.add_argument("--episodes", type=int, default=20, help="of every case (default: 20)")
    parser.add_argument("--only", default="", help="cases whose names contain this text")
    arguments = parser.parse_args()
    before = json.loads(arguments.against.read_text()) if arguments.against else {}
    played: dict[str, Any] = {}
    different = []
    for name in cases():
        if arguments.only not in name:
            continue
        played[name] = {
            "policy": cases()[name][2],
            "single": play_single(name, arguments.episodes),
            "vector": play_vector(name, arguments.episodes),
        }
        same = before.get(name, played[name]) == played[name]
        different += [] if same else [name]
        print(name, *played[name].values(), "" if same else "DIFFERENT", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(played, indent=1) + "\n")
    if before:
        print(f"{len(played) - len(different)} of {len(played)} cases equal", *different)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
