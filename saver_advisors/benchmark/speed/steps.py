"""Measure how fast environments step and reset, and their memory."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from mujoco import mjtStage
from numpy.typing import NDArray

from saver_advisors.benchmark.machine import cores, median_ratio, time_of_all
from saver_envs.simulation import CONTACT_SAMPLES, SUBSTEPS

if TYPE_CHECKING:
    from mujoco.batch import Batch

    from saver_envs.episodes import Episodes

#: The simulator alone, the core, and the two vector environments of users -> prefix of its figures.
WAYS: Final = {"raw": "raw_", "core": "core_", "gymnasium": "", "sb3": "sb3_"}
#: Numbers of episodes that are reset together.
RESET_N_ENVS: Final = (1, 64)
#: Timing ends this many actions before the end of an episode, so that it includes no reset.
SPARE: Final = 5
#: Linux's file with the memory of this process, in pages.
MEMORY_FILE: Final = Path("/proc/self/statm")
#: Stages of the simulator's calls of one action, as :class:`saver_envs.simulation.Simulation` asks
#: for them.
STAGES: Final = [int(mjtStage.mjSTAGE_NONE)] * (CONTACT_SAMPLES - 1) + [int(mjtStage.mjSTAGE_VEL)]


class _Bench:
    """Step an environment in every way, with given numbers of environments and threads.

    :param env_id: a registered id
    :param n_envs: number of environments
    :param threads: number of native threads
    """

    def __init__(self, env_id: str, n_envs: int, threads: int) -> None:
        from mujoco.batch import Batch

        from saver_envs.envs.sb3_vec_env import SaverVecEnv
        from saver_envs.envs.vector_env import SaverVectorEnv
        from saver_envs.registration import make_episodes

        self.n_envs = n_envs
        self._core = make_episodes(env_id, n_envs, threads)
        self._vector = SaverVectorEnv(env_id, n_envs, threads=threads)
        self._sb3 = SaverVecEnv(env_id, n_envs, threads=threads)
        self._raw = Batch(self._core.scene.model, n_envs, min(threads, n_envs), persistent=True)
        self._vector.reset(seed=0)
        self._sb3.reset()

    def round(self, seed: int, seconds: float) -> dict[str, float]:
        """Time all ways of stepping on the same episodes and actions.

        :param seed: of the episodes and the actions
        :param seconds: shortest measurement, unless the episodes end before
        :return: way -> seconds per action of all environments
        """
        from gymnasium.utils import seeding

        core, vector, sb3 = self._core, self._vector, self._sb3
        for index in range(self.n_envs):
            core.set_generator(index, seeding.np_random(seed + index)[0])
        core.reset()
        start = core.get_state()
        most = core.settings.horizon - SPARE
        shape = (most, self.n_envs, core.action_size)
        actions = np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)
        controls = []
        began = time.perf_counter()
        for action in actions:
            core.step(action)
            controls.append(core.simulation.ctrl.copy())
            if time.perf_counter() - began >= seconds:
                break
        actions = actions[: len(controls)]

        # Sampling the same starts in each of them would take longer than the timed steps.
        for episodes in (core, vector.episodes, sb3.episodes):
            episodes.set_state(start)
        self._raw.state[:] = start.simulation
        times = {
            "core": time_of_all(partial(step_and_observe, core), actions),
            "gymnasium": time_of_all(vector.step, actions),
            "sb3": time_of_all(sb3.step, actions),
            "raw": time_of_all(partial(step_raw, self._raw), controls),
        }
        return {way: duration / len(actions) for way, duration in times.items()}


def step_and_observe(episodes: Episodes, action: NDArray[np.float32]) -> None:
    """Do a step of the core, without an adapter."""
    episodes.step(action)
    episodes.observation()


def step_raw(raw: Batch, control: NDArray[np.float64]) -> None:
    """Make only the simulator's calls of one action."""
    raw.ctrl = control
    for stage in STAGES:
        raw.step(None, SUBSTEPS // CONTACT_SAMPLES, stage)


def step_rows(
    env_id: str,
    n_envs: int,
    threads: Sequence[int],
    rounds: int,
    seconds: float,
    advance: Callable[[], None],
) -> list[dict[str, Any]]:
    """Time every way of stepping, alternating between numbers of threads.

    :param env_id: a registered id
    :param n_envs: number of environments
    :param threads: numbers of native threads; those above ``n_envs`` are skipped
    :param rounds: number of rounds
    :param seconds: shortest measurement
    :param advance: called after each round
    :return: one row per number of threads
    """
    threads = [count for count in threads if count <= n_envs]
    benches = {}
    for count in threads:
        with cores(count):  # threads inherit the cores of the thread that starts them
            benches[count] = _Bench(env_id, n_envs, count)
            benches[count].round(0, seconds)
    times: dict[int, dict[str, list[float]]] = {count: defaultdict(list) for count in threads}
    for index in range(rounds):
        for count, bench in benches.items():
            with cores(count):
                for way, duration in bench.round(index, seconds).items():
                    times[count][way].append(duration)
        advance()
    return [_step_row(env_id, n_envs, count, times) for count in threads]


def _step_row(
    env_id: str, n_envs: int, threads: int, times: dict[int, dict[str, list[float]]]
) -> dict[str, Any]:
    own = times[threads]
    row: dict[str, Any] = {"env": env_id, "n_envs": n_envs, "threads": threads}
    for way, prefix in WAYS.items():
        row[f"{prefix}steps_per_second"] = n_envs / median(own[way])
        if way != "raw":
            row[f"{prefix}ratio_to_raw"] = median_ratio(own["raw"], own[way])
    fewest = times[min(times)]
    return {**row, "speed_up_of_threads": median_ratio(fewest["gymnasium"], own["gymnasium"])}


def reset_row(env_id: str, rounds: int) -> dict[str, Any]:
    """Time the reset of an episode, alone and with others; the mean, since starts differ.

    :param env_id: a registered id
    :param rounds: proportional to the number of resets
    :return: ``env`` and ``milliseconds_per_episode`` by number of environments
    """
    from saver_envs.registration import make_episodes

    found = {}
    for n_envs in RESET_N_ENVS:
        episodes = make_episodes(env_id, n_envs)
        for index in range(n_envs):
            episodes.set_generator(index, np.random.default_rng(index))
        repeats = max(1, 40 // n_envs) * rounds
        with cores(1):
            episodes.reset()
            spent = time_of_all(episodes.reset, [None] * repeats)
            found[str(n_envs)] = spent / (repeats * n_envs) * 1e3
    return {"env": env_id, "milliseconds_per_episode": found}


def memory_per_env(
    env_id: str, n_envs: Sequence[int], randomization: str = "none"
) -> dict[int, float]:
    """Measure in a new process how much memory each environment takes.

    :param env_id: a registered id
    :param n_envs: numbers of environments
    :param randomization: a preset
    :return: megabytes (10^6 bytes) per environment, by number; without the number 1, whose memory
        cannot be separated from the rest of the process, and empty if the system does not report it
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    counts = sorted({count for count in n_envs if count > 1})
    if not counts or not MEMORY_FILE.is_file():
        return {}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
        return pool.submit(_memory_here, env_id, counts, randomization).result()


def _memory_here(env_id: str, counts: list[int], randomization: str) -> dict[int, float]:
    from saver_envs.registration import make_episodes

    def grow(count: int) -> Any:
        episodes = make_episodes(env_id, count, randomization=randomization)
        episodes.reset()
        for _ in range(3):
            episodes.step(np.zeros((count, episodes.action_size)))
        return episodes

    kept = [grow(1)]  # loads the model and everything that environments share
    found = {}
    for count in counts:
        before = _resident()
        kept.append(grow(count))
        found[count] = (_resident() - before) / count / 1e6
    return found


def _resident() -> int:
    """Return the resident memory of this process in bytes."""
    pages = int(MEMORY_FILE.read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
