"""Time gradient steps of SBX's TD3 (Stable-Baselines3 in JAX) in its own virtual environment.

This program imports nothing of SAVER. Usage: ``python sbx_worker.py OBSERVATION ACTION BATCH WIDTH
...``: sizes of the network's input, of an action and of a batch, and widths of the hidden layers.
It prints ``{"ready": ...}``. For each line with a number of gradient steps on its input it prints a
line of JSON with their processor seconds, on a buffer of random transitions. JAX compiles again for
each new number of steps, so the first answer for a number is not representative.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from importlib import metadata
from typing import Any

#: One thread, as the learners that it is compared with.
FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
STORED = 20_000


def make_model(observation: int, action: int, batch: int, widths: list[int]) -> Any:
    """Create TD3 with twin critics and LayerNorm, and a buffer full of random transitions."""
    numpy: Any = importlib.import_module("numpy")
    gymnasium: Any = importlib.import_module("gymnasium")
    td3: Any = importlib.import_module("sbx").TD3

    class Noise(gymnasium.Env):
        """Declares the spaces; it is never stepped."""

        observation_space = gymnasium.spaces.Box(-5, 5, (observation,), numpy.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (action,), numpy.float32)

    model = td3(
        "MlpPolicy",
        Noise(),
        batch_size=batch,
        buffer_size=STORED,
        policy_kwargs={"net_arch": widths, "layer_norm": True},
        seed=0,
    )
    random = numpy.random.default_rng(0)
    buffer = model.replay_buffer
    for values in (buffer.observations, buffer.next_observations, buffer.actions):
        values[:] = random.uniform(-1, 1, values.shape)
    buffer.rewards[:] = -1.0
    buffer.full = True
    return model


def main(observation: int, action: int, batch: int, widths: list[int]) -> None:
    """Create the learner, and answer requests."""
    os.environ["XLA_FLAGS"] = FLAGS
    os.environ["JAX_PLATFORMS"] = "cpu"
    # Output of the libraries goes to the log, so that the reader receives only answers.
    answers, sys.stdout = sys.stdout, sys.stderr
    model = make_model(observation, action, batch, widths)
    logger: Any = importlib.import_module("stable_baselines3.common.logger").Logger
    model.set_logger(logger(folder=None, output_formats=[]))
    model._current_progress_remaining = 1.0
    sys.stdout = answers
    versions = {name: metadata.version(name) for name in ("sbx-rl", "jax")}
    print(json.dumps({"ready": True, "versions": versions}), flush=True)
    for line in sys.stdin:
        updates = int(line)
        began = time.process_time()
        model.train(updates, batch)
        print(json.dumps({"seconds": time.process_time() - began}), flush=True)


if __name__ == "__main__":
    sizes = [int(word) for word in sys.argv[1:]]
    main(sizes[0], sizes[1], sizes[2], sizes[3:])
