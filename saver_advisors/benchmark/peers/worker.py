"""Runs another suite's environment in that suite's own virtual environment, and times it.

It imports nothing of ours. Usage: ``python worker.py SUITE N``. It says ``{"ready": ...}``,
then answers every line ``MODE SECONDS`` on its input with one line of JSON: the environment
``steps`` that it took, the ``seconds`` (wall clock) and the ``cpu_seconds``.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable
from importlib import metadata
from typing import Any

FETCH, TWO_ARM_LIFT = "FetchPush-v4", "TwoArmLift"
#: Actions in an episode of FetchPush, and in one piece of work of TwoArmLift, whose episodes of
#: 1000 actions would take half a minute each.
FETCH_HORIZON, LIFT_PIECE = 50, 25

#: Modes by name, each a piece of work, and the environment steps in a piece.
Work = tuple[dict[str, Callable[[], None]], int]


def fetch(n: int) -> Work:
    """FetchPush, whole episodes with their resets: ``vector`` as Gymnasium does it, and ``loop``.

    :param n: environments in this process
    """
    numpy: Any = importlib.import_module("numpy")
    gymnasium: Any = importlib.import_module("gymnasium")
    gymnasium.register_envs(importlib.import_module("gymnasium_robotics"))
    vector = gymnasium.vector.SyncVectorEnv([lambda: gymnasium.make(FETCH)] * n)
    vector.reset(seed=0)
    random = numpy.random.default_rng(0)
    actions = random.uniform(-1, 1, (FETCH_HORIZON, n, 4)).astype("float32")

    def as_vector() -> None:
        for action in actions:
            vector.step(action)
        vector.step(actions[0])  # the step in which all are reset

    def as_loop() -> None:
        for env in vector.envs:
            env.reset()
        for action in actions:
            for index, env in enumerate(vector.envs):
                env.step(action[index])

    return {"vector": as_vector, "loop": as_loop}, n * FETCH_HORIZON


def two_arm_lift(n: int) -> Work:
    """TwoArmLift with two Pandas, their default controller and the objects' state, no cameras.

    Resets, half a second in a thousand steps, are left out.

    :param n: must be 1: robosuite has no vector of environments
    """
    if n != 1:
        raise ValueError(f"n={n}: robosuite has no vector of environments")
    numpy: Any = importlib.import_module("numpy")
    robosuite: Any = importlib.import_module("robosuite")
    env = robosuite.make(
        TWO_ARM_LIFT,
        robots=["Panda", "Panda"],
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        ignore_done=True,
    )
    env.reset()
    lower, upper = env.action_spec
    random = numpy.random.default_rng(0)
    actions = random.uniform(lower, upper, (LIFT_PIECE, len(lower)))

    def single() -> None:
        for action in actions:
            env.step(action)

    return {"single": single}, LIFT_PIECE


def serve(work: Work, versions: dict[str, str]) -> None:
    """Measure whatever is asked for, until the input ends.

    :param work: see :data:`Work`
    :param versions: of the packages at work, told at the start
    """
    modes, steps = work
    for one in modes.values():
        one()  # first calls load and compile
    print(json.dumps({"ready": True, "modes": list(modes), "versions": versions}), flush=True)
    for line in sys.stdin:
        mode, seconds = line.split()
        began, began_cpu = time.perf_counter(), time.process_time()
        pieces = 0
        while pieces == 0 or time.perf_counter() - began < float(seconds):
            modes[mode]()
            pieces += 1
        answer = {
            "steps": pieces * steps,
            "seconds": time.perf_counter() - began,
            "cpu_seconds": time.process_time() - began_cpu,
        }
        print(json.dumps(answer), flush=True)


def main(suite: str, n: int) -> None:
    """Make a suite's environments and serve.

    :param suite: ``FetchPush-v4`` or ``TwoArmLift``
    :param n: environments
    """
    # What the suites print belongs to the log, the answers alone to our reader.
    answers, sys.stdout = sys.stdout, sys.stderr
    work = fetch(n) if suite == FETCH else two_arm_lift(n)
    sys.stdout = answers
    package = "gymnasium-robotics" if suite == FETCH else "robosuite"
    serve(work, {name: metadata.version(name) for name in (package, "mujoco", "numpy")})


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
