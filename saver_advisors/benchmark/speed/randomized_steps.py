"""Measure steps, resets and memory of worlds that vary, in proportion to the default world."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.benchmark.machine import cores, median_ratio, time_of_all
from saver_advisors.benchmark.speed.steps import (
    STAGES,
    memory_per_env,
    step_and_observe,
    step_raw,
)

if TYPE_CHECKING:
    from saver_envs.episodes import EpisodesState

#: Number of environments, unless fewer are timed.
N_ENVS: Final = 64
#: Figure -> bound: a least share, or a greatest multiple.
MUST: Final = {
    "nominal": 0.94,
    "wide": 0.80,
    "wide_to_raw": 0.93,
    "reset": 1.3,
    "memory": 2.0,
}
#: Resets of all environments in a block.
_RESETS: Final = 3


class _Bench:
    """Step the default world, one whose every parameter has its nominal value, and ``wide``.

    :param env_id: a registered id
    :param n_envs: number of environments
    """

    def __init__(self, env_id: str, n_envs: int) -> None:
        from mujoco.batch import Batch

        from saver_envs.registration import make_episodes, parameters_of

        default = make_episodes(env_id, n_envs)
        known = parameters_of(default.task)
        nominal = {one.name: one.usual for one in known if one.usual is not None}
        self.n_envs = n_envs
        #: Actions of a block: it has no reset.
        self.actions = default.settings.horizon - 1
        self._worlds = {
            "default": default,
            "nominal": make_episodes(env_id, n_envs, randomization=nominal),
            "wide": make_episodes(env_id, n_envs, randomization="wide"),
        }
        self._raw = Batch(default.scene.model, n_envs, 1, persistent=True)

    def round(self, seed: int) -> tuple[dict[str, float], bool]:
        """Time resets and an episode in each world, and MuJoCo alone on the models of ``wide``.

        :param seed: of the episodes and the actions
        :return: what -> seconds of processor time; whether the nominal world's episodes are those
            of the default one, bit for bit
        """
        default = self._worlds["default"]
        shape = (self.actions, self.n_envs, default.action_size)
        actions = np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)
        times: dict[str, float] = {}
        ends: dict[str, tuple[NDArray[Any], NDArray[Any]]] = {}
        starts: dict[str, EpisodesState] = {}
        for name, episodes in self._worlds.items():
            for index in range(self.n_envs):
                episodes.set_generator(index, np.random.default_rng((seed, index)))
            times[f"{name} reset"] = _processor_time(episodes.reset, [None] * _RESETS)
            starts[name] = episodes.get_state()
            times[name] = _processor_time(partial(step_and_observe, episodes), actions)
            ends[name] = episodes.simulation.get_state(), episodes.observation().observation
        pairs = zip(ends["default"], ends["nominal"], strict=True)
        same = all(np.array_equal(one, other) for one, other in pairs)
        times["raw"] = self._raw_time(starts["wide"], actions)
        return times, same

    def _raw_time(self, start: EpisodesState, actions: NDArray[np.float32]) -> float:
        """Return the duration of the simulator's calls in an episode of ``wide``."""
        episodes, raw = self._worlds["wide"], self._raw
        simulation = episodes.simulation
        episodes.set_state(start)
        fields = simulation.fields()
        for name, values in fields.items():
            raw.expand(name)[:] = values
        # The friction of the joints is a damping that follows their speeds.
        damping, driven = raw.expand("dof_damping"), []
        for action in actions:
            episodes.step(action)
            driven.append((simulation.ctrl.copy(), fields["dof_damping"].copy()))
        raw.state[:] = start.simulation
        raw.forward(stage=STAGES[-1])

        def step(control: NDArray[np.float64], damped: NDArray[np.float64]) -> None:
            damping[:] = damped
            step_raw(raw, control)

        return _processor_time(lambda one: step(*one), driven)


_processor_time = partial(time_of_all, clock=time.process_time)


def randomized_row(
    env_id: str, n_envs: int, rounds: int, advance: Callable[[], None]
) -> dict[str, Any]:
    """Compare worlds that vary with the default one, in turn, on one core.

    :param env_id: a registered id
    :param n_envs: number of environments
    :param rounds: number of rounds
    :param advance: called after each round
    :return: rates of the default world and of the simulator alone; rates, resets and memory of the
        others in proportion; ``identical``
    """
    times: dict[str, list[float]] = {}
    identical = True
    with cores(1):
        bench = _Bench(env_id, n_envs)
        bench.round(0)
        for index in range(rounds):
            found, same = bench.round(index)
            identical &= same
            for what, duration in found.items():
                times.setdefault(what, []).append(duration)
            advance()
    steps = n_envs * bench.actions
    memory = [
        memory_per_env(env_id, [n_envs], randomization=one).get(n_envs) for one in ("none", "wide")
    ]
    return {
        "env": env_id,
        "n_envs": n_envs,
        "steps_per_second": steps / median(times["default"]),
        "nominal": median_ratio(times["default"], times["nominal"]),
        "identical": identical,
        "wide": median_ratio(times["default"], times["wide"]),
        "raw_steps_per_second": steps / median(times["raw"]),
        "wide_to_raw": median_ratio(times["raw"], times["wide"]),
        "reset": median_ratio(times["wide reset"], times["default reset"]),
        "memory_per_env_mb": dict(zip(("default", "wide"), memory, strict=True)),
    }
