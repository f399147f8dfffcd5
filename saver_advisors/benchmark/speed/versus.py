"""Time our and other suites' environments alternately, on one core."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from saver_advisors.benchmark.machine import cores, median_ratio, progress
from saver_advisors.benchmark.peers import suites
from saver_envs.registration import ONE_ARM_ID, TWO_ARM_ID

#: Our id, the peer, and how many times as fast ours must be and should be, if that was set.
COMPARISONS: Final[Sequence[tuple[str, suites.Peer, float | None, float | None]]] = (
    (ONE_ARM_ID, suites.FETCH_PUSH, 3.0, 5.0),
    (TWO_ARM_ID, suites.FETCH_PUSH, 1.5, 2.5),
    (ONE_ARM_ID, suites.ENVPOOL_PUSH, None, None),
    (TWO_ARM_ID, suites.ENVPOOL_PUSH, None, None),
    (TWO_ARM_ID, suites.TWO_ARM_LIFT, 20.0, 40.0),
)
N_ENVS: Final = 64


def peer_rows(cache: Path, rounds: int, seconds: float) -> dict[str, Any]:
    """Time whole episodes with resets of ours and of the peers, alternately on one core.

    :param cache: folder of the peers' virtual environments
    :param rounds: number of rounds
    :param seconds: shortest measurement
    :return: ``peers``, ``ours`` and ``ratios``
    :raises PeerError: if a peer cannot be installed or run
    """
    pythons = {peer: suites.install(peer, cache) for peer in suites.PEERS}
    with ExitStack() as stack:
        stack.enter_context(cores(1))
        running = [
            stack.enter_context(suites.RunningPeer(peer, pythons[peer])) for peer in suites.PEERS
        ]
        ours = {env_id: _whole_episodes(env_id) for env_id, *_ in COMPARISONS}
        peer_times: dict[str, dict[str, list[float]]] = {
            one.peer.name: {mode: [] for mode in one.modes} for one in running
        }
        our_times: dict[str, list[float]] = {env_id: [] for env_id in ours}
        with progress("peers", rounds) as advance:
            for _ in range(rounds):
                for env_id, episodes in ours.items():
                    our_times[env_id].append(episodes(seconds))
                for one in running:
                    for mode, times in peer_times[one.peer.name].items():
                        times.append(one.measure(mode, seconds))
                advance()
    return {
        "peers": [
            {
                "env": one.peer.env,
                "suite": one.peer.suite,
                "mode": mode,
                "n_envs": one.peer.n_envs,
                "steps_per_second": 1 / median(times),
                "versions": one.versions,
            }
            for one in running
            for mode, times in peer_times[one.peer.name].items()
        ],
        "ours": [
            {"env": env_id, "n_envs": N_ENVS, "steps_per_second": 1 / median(times)}
            for env_id, times in our_times.items()
        ],
        "ratios": [
            {
                "env": env_id,
                "peer": peer.name,
                "ratio": median_ratio(
                    min(peer_times[peer.name].values(), key=median), our_times[env_id]
                ),
                "must": must,
                "aim": aim,
            }
            for env_id, peer, must, aim in COMPARISONS
        ],
    }


def _whole_episodes(env_id: str) -> Callable[[float], float]:
    """Return a function that times whole episodes with resets: seconds per step."""
    from saver_envs.envs.vector_env import SaverVectorEnv

    env = SaverVectorEnv(env_id, N_ENVS)
    env.reset(seed=0)
    horizon = env.episodes.settings.horizon
    shape = (horizon, N_ENVS, env.episodes.action_size)
    actions = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)

    def per_step(seconds: float) -> float:
        began, episodes = time.perf_counter(), 0
        while episodes == 0 or time.perf_counter() - began < seconds:
            for action in actions:
                env.step(action)
            env.step(actions[0])  # this step resets all environments
            episodes += 1
        return (time.perf_counter() - began) / (episodes * horizon * N_ENVS)

    return per_step
