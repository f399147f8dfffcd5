"""Estimate how long a grid takes: time a slice of training, and an evaluation, of each row."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from typing import Any, Final

from saver_advisors.evaluation.episodes import evaluate_policy
from saver_advisors.evaluation.protocol import SELECTION_SEED
from saver_advisors.experiments.grid import ExperimentRun, Grid
from saver_advisors.experiments.recorder import BenchmarkPlan, Recorder
from saver_advisors.training.settings import RunConfig

TIMED_EPISODES: Final = 32
"""Two batches of an evaluation."""


@dataclass(frozen=True)
class RowEstimate:
    """The time that the runs of a row take, in processor seconds of this machine.

    :param group: of the row
    :param row: its name
    :param runs: number of its runs
    :param steps: environment steps of each
    :param episodes: of each run's evaluations
    :param step_s: seconds of training per environment step
    :param episode_s: seconds per episode of an evaluation
    """

    group: str
    row: str
    runs: int
    steps: int
    episodes: int
    step_s: float
    episode_s: float

    @property
    def core_hours(self) -> float:
        """Processor hours of all its runs."""
        return self.runs * (self.steps * self.step_s + self.episodes * self.episode_s) / 3600


@dataclass
class _Clock:
    """Processor time at numbers of environment steps, from its creation on."""

    marks: list[tuple[int, float]] = field(default_factory=lambda: [(0, time.process_time())])

    def mark(self, steps: int) -> None:
        """Note the present time."""
        self.marks.append((steps, time.process_time()))

    def per_step(self, start: int) -> float:
        """Return the seconds per step from the first mark at ``start`` or later to the last."""
        *earlier, (last, end) = self.marks
        first, begin = next((one for one in earlier if one[0] >= start), earlier[-1])
        return (end - begin) / (last - first)


def rows_of(grid: Grid) -> list[list[ExperimentRun]]:
    """Return the runs of a grid by row, in the order of the file."""
    rows: dict[tuple[str, str], list[ExperimentRun]] = {}
    for run in grid.runs:
        rows.setdefault((run.group, run.row), []).append(run)
    return list(rows.values())


def estimate_row(runs: list[ExperimentRun], steps: int) -> RowEstimate:
    """Time a slice of a row's first run, after as many steps of warm-up, and an evaluation.

    Both last whole blocks of an episode in each environment, since updates follow them.

    :param runs: of the row, which differ in their seeds
    :param steps: least number of environment steps of the slice
    :return: the estimate for all its runs
    :raises AlgorithmError: for a third-party algorithm that cannot be built
    """
    from saver_envs.registration import task_and_settings

    run, config = runs[0], runs[0].config
    block = task_and_settings(config.env_id, config.env_kwargs)[1].horizon * config.n_envs
    timed, learning = (ceil(n / block) * block for n in (steps, _steps_before_learning(config) + 1))
    end = min(max(timed, learning) + timed, config.total_steps)
    start = max(end - timed, end // 2)
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(config, BenchmarkPlan):
            reports = 2  # its best checkpoint is evaluated on the report seeds as well
            seconds = _other_slice(config, start, end, Path(folder))
        else:
            reports, seconds = 1, _own_slice(config, start, end, Path(folder))
    episodes = ceil(config.total_steps / config.eval_every) * config.eval_episodes
    episodes += reports * run.final_episodes
    return RowEstimate(run.group, run.row, len(runs), config.total_steps, episodes, *seconds)


def _steps_before_learning(config: RunConfig | BenchmarkPlan) -> int:
    """Return the steps that only fill the replay, as far as the settings tell."""
    if isinstance(config, BenchmarkPlan):
        return int(config.algo_kwargs.get("learning_starts", 0))
    demonstrated = 0 if config.advice is None else config.advice.demonstration_steps
    return demonstrated + config.learning_starts


def _own_slice(config: RunConfig, start: int, end: int, folder: Path) -> tuple[float, float]:
    """Return the seconds per step and per episode of our learner."""
    from saver_advisors.training.launch import open_run

    clock, never = _Clock(), config.total_steps + end
    quiet = replace(config, eval_every=never, checkpoint_every=never)
    with open_run(quiet, folder) as run:

        def mark(local: Mapping[str, Any], _: Mapping[str, Any]) -> bool:
            clock.mark(run.steps)
            return True

        run.train(progress=False, stop_after_steps=end, callback=mark)
        began = time.process_time()
        evaluate_policy(
            lambda observation: run.model.predict(observation, deterministic=True)[0],
            config.env_id,
            episodes=TIMED_EPISODES,
            seed=SELECTION_SEED,
            env_kwargs=config.env_kwargs,
        )
        episode_s = (time.process_time() - began) / TIMED_EPISODES
    return clock.per_step(start), episode_s


def _other_slice(plan: BenchmarkPlan, start: int, end: int, folder: Path) -> tuple[float, float]:
    """Return the seconds per step and per episode of a third-party algorithm."""
    from saver_advisors.experiments.third_party import load_class, train
    from saver_advisors.training.threads import one_thread_of_algebra

    clock, evaluated = _Clock(), _Clock()
    short = replace(
        plan, total_steps=end, eval_every=end, eval_episodes=TIMED_EPISODES, report_episodes=1
    )
    recorder = Recorder(short, folder, lambda line: evaluated.mark(line["steps"]), clock.mark)
    with one_thread_of_algebra():
        train(load_class(plan.algorithm), recorder)
    episode_s = (evaluated.marks[-1][1] - clock.marks[-1][1]) / TIMED_EPISODES
    return clock.per_step(start), episode_s
