"""Run another suite's environment in that suite's own virtual environment, and time it.

This program imports nothing of SAVER. Usage: ``python worker.py SUITE ENV N``. It prints
``{"ready": ...}`` and then answers each input line ``MODE SECONDS`` with one line: the seconds per
environment step.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable
from importlib import metadata
from typing import Any

import numpy as np

#: Actions per piece of work in robosuite, whose episodes of 1000 actions take half a minute each.
PIECE = 25

#: Modes by name, each a piece of work, and the number of environment steps in a piece.
Work = tuple[dict[str, Callable[[], None]], int]


def gymnasium_robotics(env_id: str, n: int) -> Work:
    """Prepare whole episodes with their resets: ``vector`` (Gymnasium's), and ``loop``.

    :param env_id: a registered id
    :param n: environments in this process
    """
    gymnasium: Any = importlib.import_module("gymnasium")
    gymnasium.register_envs(importlib.import_module("gymnasium_robotics"))
    vector = gymnasium.vector.SyncVectorEnv([lambda: gymnasium.make(env_id)] * n)
    vector.reset(seed=0)
    horizon = gymnasium.spec(env_id).max_episode_steps
    random = np.random.default_rng(0)
    actions = random.uniform(-1, 1, (horizon, *vector.action_space.shape)).astype("float32")

    def as_loop() -> None:
        for env in vector.envs:
            env.reset()
        for action in actions:
            for index, env in enumerate(vector.envs):
                env.step(action[index])

    return {"vector": lambda: _episode(vector, actions), "loop": as_loop}, n * horizon


def envpool(env_id: str, n: int) -> Work:
    """Prepare whole episodes with their resets: ``vector``, on one thread.

    :param env_id: a registered id
    :param n: environments in this process
    """
    suite: Any = importlib.import_module("envpool")
    env = suite.make(env_id, env_type="gymnasium", num_envs=n, num_threads=1, seed=0)
    env.reset()
    horizon = env.spec.config.max_episode_steps
    random = np.random.default_rng(0)
    actions = random.uniform(-1, 1, (horizon, n, *env.action_space.shape)).astype("float32")

    return {"vector": lambda: _episode(env, actions)}, n * horizon


def _episode(env: Any, actions: Any) -> None:
    for action in actions:
        env.step(action)
    env.step(actions[0])  # this step resets all environments


def robosuite(env_id: str, n: int) -> Work:
    """Prepare an environment with two Pandas, the default controller and the objects' state.

    There are no cameras, and resets, which take half a second per thousand steps, are left out.

    :param env_id: name of the environment
    :param n: must be 1: robosuite has no vector environment
    """
    if n != 1:
        raise ValueError(f"n={n}: robosuite has no vector environment")
    suite: Any = importlib.import_module("robosuite")
    env = suite.make(
        env_id,
        robots=["Panda", "Panda"],
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        ignore_done=True,
    )
    env.reset()
    lower, upper = env.action_spec
    random = np.random.default_rng(0)
    actions = random.uniform(lower, upper, (PIECE, len(lower)))

    def single() -> None:
        for action in actions:
            env.step(action)

    return {"single": single}, PIECE


#: Distribution -> how its environments are prepared.
SUITES = {"gymnasium-robotics": gymnasium_robotics, "envpool": envpool, "robosuite": robosuite}


def serve(work: Work, versions: dict[str, str]) -> None:
    """Measure on request, until the input ends.

    :param work: see :data:`Work`
    :param versions: of the measured packages, reported at the start
    """
    modes, steps = work
    for one in modes.values():
        one()  # first calls load and compile
    print(json.dumps({"ready": True, "modes": list(modes), "versions": versions}), flush=True)
    for line in sys.stdin:
        mode, seconds = line.split()
        began, pieces = time.perf_counter(), 0
        while pieces == 0 or time.perf_counter() - began < float(seconds):
            modes[mode]()
            pieces += 1
        print((time.perf_counter() - began) / (pieces * steps), flush=True)


def main(suite: str, env_id: str, n: int) -> None:
    """Prepare a suite's environments and serve.

    :param suite: a key of :data:`SUITES`
    :param env_id: one of its environments
    :param n: number of environments
    """
    # Redirect what the suites print to the log: only answers may reach our reader.
    answers, sys.stdout = sys.stdout, sys.stderr
    work = SUITES[suite](env_id, n)
    sys.stdout = answers
    installed = {one.name.lower(): one.version for one in metadata.distributions()}
    # EnvPool contains the simulator.
    serve(work, {name: installed[name] for name in (suite, "mujoco", "numpy") if name in installed})


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
