"""Record a third-party training run: its evaluations, its best weights and its final result.

The file is rewritten atomically after every evaluation, so an interrupted run leaves all results up
to then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import curve_point, evaluate_policy
from saver_advisors.evaluation.protocol import REPORT_SEED, SELECTION_SEED, off_protocol
from saver_advisors.experiments.training_runs import KIND
from saver_advisors.reporting.provenance import load_averages, provenance, write_json_atomic
from saver_envs.digest import world_digest

Predict = Callable[[dict[str, NDArray[Any]]], NDArray[Any]]


@dataclass(frozen=True)
class BenchmarkPlan:
    """The settings of a run.

    :param name: of the run and its files
    :param row: its row in tables; runs of a row differ in their seed
    :param env_id: its environment
    :param env_kwargs: keyword arguments of the environment
    :param algorithm: as given, ``MODULE:CLASS``
    :param algo_kwargs: keyword arguments of the algorithm, as given
    :param source_sha256: of the algorithm's file, None without a file
    :param n_envs: number of training environments
    :param total_steps: environment steps, summed over environments
    :param seed: of the run
    :param eval_every: environment steps between evaluations
    :param eval_episodes: episodes per evaluation
    :param report_episodes: episodes of the reported evaluation
    :param teacher_steps: environment steps that trained its teachers, as stated by its author
    :param demonstration_steps: environment steps of its demonstrations, as stated by its author
    :param group: of the grid that the run is part of, None outside a grid
    :param train_env_kwargs: further keyword arguments for training only, such as easier starts
    """

    name: str
    row: str
    env_id: str
    env_kwargs: Mapping[str, Any]
    algorithm: str
    algo_kwargs: Mapping[str, Any]
    source_sha256: str | None
    n_envs: int
    total_steps: int
    seed: int
    eval_every: int
    eval_episodes: int
    report_episodes: int
    teacher_steps: int = 0
    demonstration_steps: int = 0
    group: str | None = None
    train_env_kwargs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def training_options(self) -> dict[str, Any]:
        """Keyword arguments of the environments that it trains in."""
        return {**self.env_kwargs, **self.train_env_kwargs}

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, the arguments of the class."""
        return asdict(self)

    def config(self) -> dict[str, Any]:
        """Return the settings that determine the outcome, as the result file contains them."""
        labels = ("name", "row", "group", "teacher_steps", "demonstration_steps")
        settings = {name: value for name, value in asdict(self).items() if name not in labels}
        return {**settings, "eval_seed": SELECTION_SEED, "report_seed": REPORT_SEED}


@dataclass
class Recorder:
    """Count a run's steps, evaluate it on schedule, and write its file.

    :param plan: of the run
    :param folder: of its file and its weights
    :param progress: called after each evaluation with its entry of the curve
    :param stepped: called with the number of steps so far, whenever it has grown
    """

    plan: BenchmarkPlan
    folder: Path
    progress: Callable[[dict[str, Any]], None] = lambda line: None
    stepped: Callable[[int], None] = lambda steps: None
    steps: int = field(default=0, init=False)
    training_cost: float = field(default=0.0, init=False)
    curve: list[dict[str, Any]] = field(default_factory=list, init=False)
    _predict: Predict = field(init=False)
    _weights: Any = field(default=None, init=False)
    _seconds: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    _since: tuple[float, float] | None = field(default=None, init=False)
    _started: dict[str, Any] = field(default_factory=provenance, init=False)

    @cached_property
    def world(self) -> str:
        """The digest of the plan's world."""
        return world_digest(self.plan.env_id, self.plan.env_kwargs)

    @property
    def path(self) -> Path:
        """The path of the record."""
        return self.folder / f"{self.plan.name}.json"

    @property
    def weights_path(self) -> Path:
        """The path of the weights with the highest success rate so far."""
        return self.folder / f"{self.plan.name}.safetensors"

    @property
    def spent(self) -> bool:
        """Whether all steps of the plan are done."""
        return self.steps >= self.plan.total_steps

    def begin(self, predict: Predict, weights: Any) -> None:
        """Start the clock.

        :param predict: the current policy, deterministic
        :param weights: the object whose weights are saved, with torch's ``state_dict`` and
            ``load_state_dict``; None if checkpoints are not possible
        """
        self._predict, self._weights = predict, weights
        self._write(finished=False)
        self._since = _clocks()

    def advance(self, steps: int, cost: float = 0.0) -> None:
        """Count steps, and evaluate if an evaluation is due.

        :param steps: environment steps since the last call
        :param cost: sum of ``cost`` over these steps
        """
        self.training_cost += cost
        before, every = self.steps, self.plan.eval_every
        self.steps += steps
        self.stepped(self.steps)
        ended = self.spent and before < self.plan.total_steps
        if ended or (self.steps // every > before // every and not self.spent):
            self._measure()

    def finish(self) -> dict[str, Any]:
        """Evaluate the last policy and the best checkpoint on the report seeds, and close the file.

        Tables compare last policies, which no selection biases. The best checkpoint had the highest
        success rate on the selection seeds.

        :return: the record; its entry ``chosen`` is None without checkpoints
        """
        if not self.curve or self.curve[-1]["steps"] < self.steps:
            self._measure()
        self._pause()
        outcome = final = self._evaluate(REPORT_SEED, self.plan.report_episodes)
        chosen = None
        if self._weights is not None:
            from saver_advisors.training.checkpoint import load_policy

            best = max(self.curve, key=lambda line: (line["success_rate"], line["steps"]))
            if best["steps"] < self.curve[-1]["steps"]:
                load_policy(self.weights_path, self._weights)
                outcome = self._evaluate(REPORT_SEED, self.plan.report_episodes)
            chosen = {**outcome, "steps": best["steps"]}
        return self._write(finished=True, final=final, chosen=chosen)

    def _measure(self) -> None:
        """Add an evaluation to the curve, and save the weights if they are the best so far."""
        self._pause()
        summary = self._evaluate(SELECTION_SEED, self.plan.eval_episodes)
        best = max((earlier["success_rate"] for earlier in self.curve), default=0.0)
        line = {
            "steps": self.steps,
            "wall_clock_s": round(self._seconds[0], 3),
            "processor_s": round(self._seconds[1], 3),
            "mean_q": None,
            **curve_point(summary),
            "training_cost": self.training_cost,
            "advice_spent": 0,
            # Above the number of cores, other processes slowed down the training.
            "load_average": None if (averages := load_averages()) is None else averages[0],
        }
        self.curve.append(line)
        # In a tie the later one, which has trained longer, generalizes better.
        if self._weights is not None and line["success_rate"] >= best:
            from saver_advisors.training.checkpoint import save_policy

            save_policy(self.weights_path, self._weights)
        self._write(finished=False)
        self.progress(line)
        self._since = _clocks()

    def _pause(self) -> None:
        """Stop the clocks, which exclude evaluations."""
        if self._since is not None:
            wall, processor = (now - then for now, then in zip(_clocks(), self._since, strict=True))
            self._seconds = self._seconds[0] + wall, self._seconds[1] + processor
            self._since = None

    def _evaluate(self, seed: int, episodes: int) -> dict[str, Any]:
        """Return the summary of an evaluation of the present policy."""
        with _untouched_random():
            return evaluate_policy(
                self._predict,
                self.plan.env_id,
                episodes=episodes,
                seed=seed,
                env_kwargs=self.plan.env_kwargs,
            ).summary()

    def _write(self, finished: bool, **ending: Any) -> dict[str, Any]:
        record = {
            "kind": KIND,
            "name": self.plan.name,
            "group": self.plan.group,
            "task": self.plan.env_id,
            "row": self.plan.row,
            "seed": self.plan.seed,
            "world": self.world,
            "config": self.plan.config(),
            "curve": self.curve,
            "final": None,
            "teacher_steps": self.plan.teacher_steps,
            "demonstration_steps": self.plan.demonstration_steps,
            "finished": finished,
            "off_protocol": off_protocol(self.plan.config(), ending["final"]) if finished else None,
            **ending,
            "sessions": [{"from_steps": 0, **self._started}],
            "provenance": self._started,
        }
        write_json_atomic(self.path, record)
        return record


def _clocks() -> tuple[float, float]:
    """Return wall-clock and processor time (s)."""
    return time.perf_counter(), time.process_time()


@contextmanager
def _untouched_random() -> Iterator[None]:
    """Restore the global random generators, so that evaluations do not change a run."""
    import torch

    numbers, tensors = np.random.get_state(), torch.get_rng_state()  # noqa: NPY002  (third-party code)
    try:
        yield
    finally:
        np.random.set_state(numbers)  # noqa: NPY002
        torch.set_rng_state(tensors)
