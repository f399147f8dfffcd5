"""A run in progress: blocks of training, evaluations and checkpoints between them.

Every environment does one episode, then come some gradient steps; in the first blocks the teachers
demonstrate, where that is asked for. At a checkpoint the environments are reset with a seed made
from the run's seed and its step count, on resuming likewise, so that a run that was stopped at a
checkpoint and resumed does exactly what an uninterrupted one does.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import MaybeCallback
from stable_baselines3.common.utils import ConstantSchedule
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from saver_advisors.learner.algorithms import GoalLearnerMixin, episode_horizon
from saver_advisors.learner.cloning import clone
from saver_advisors.learner.demonstrations import DemonstrationReplayBuffer
from saver_advisors.learner.replay import GoalReplayBuffer
from saver_advisors.reporting.provenance import load_averages, provenance, write_json_atomic
from saver_advisors.training.building import (
    build_model,
    build_stages,
    demonstration_steps,
)
from saver_advisors.training.checkpoint import (
    POLICY_FILE,
    load_checkpoint,
    save_checkpoint,
    save_policy,
)
from saver_advisors.training.curve_file import append_point, read_curve, write_curve
from saver_advisors.training.settings import RunConfig

if TYPE_CHECKING:
    from saver_advisors.advising import Advisor

Observation = dict[str, npt.NDArray[Any]]


class EvaluationResult(Protocol):
    """What ``evaluate_policy`` returns, as far as it is used here."""

    @property
    def success(self) -> npt.NDArray[np.bool_]:
        """(episodes,)"""

    @property
    def cost_sums(self) -> Mapping[str, npt.NDArray[np.float64]]:
        """Sums over each episode, (episodes,) for each kind of cost."""


Evaluate = Callable[..., EvaluationResult]


@dataclass(frozen=True)
class RunResult:
    """How a run, or a part of it, ended.

    :param output_dir: its folder
    :param finished: whether it did all its steps; otherwise ``resume=True`` goes on
    :param steps: environment steps done
    :param updates: gradient steps done
    :param wall_clock_s: seconds of training, evaluations and checkpoints not counted
    :param success_rate: of the last evaluation, None before the first
    :param best_success_rate: of the best one
    """

    output_dir: Path
    finished: bool
    steps: int
    updates: int
    wall_clock_s: float
    success_rate: float | None
    best_success_rate: float | None


class Run:
    """A run in progress."""

    def __init__(
        self, config: RunConfig, output_dir: Path, env: VecEnv, evaluate: Evaluate
    ) -> None:
        self.config = config
        self.output_dir = output_dir
        self.env = env
        self.evaluate = evaluate
        self.model = build_model(config, env)
        self.stages = build_stages(config, self.model)
        horizon = episode_horizon(env)
        self.block = horizon * config.n_envs
        self.demonstration_steps = demonstration_steps(config, horizon)
        self.wall_clock_s = 0.0
        self.curve: list[dict[str, Any]] = []

    @property
    def steps(self) -> int:
        """Environment steps done."""
        return self.model.num_timesteps

    @property
    def best_success_rate(self) -> float | None:
        """The highest of the curve."""
        return max((line["success_rate"] for line in self.curve), default=None)

    def begin(self, checkpoint: Path | None) -> None:
        """Take over a checkpoint, or start afresh; write down who runs this where."""
        if checkpoint is not None:
            extra = load_checkpoint(checkpoint, self.model)
            self.wall_clock_s = extra["wall_clock_s"]
            self._learner.training_cost = extra.get("training_cost", 0.0)
            if extra["advisor"] is not None:
                self._advisor().load_state_dict(extra["advisor"])
            if self.stages is not None:
                self.stages.load_state_dict(extra["stages"], self.model)
            self.curve = [
                line for line in read_curve(self.output_dir) if line["steps"] <= self.steps
            ]
        # Lines written after the checkpoint would come a second time.
        write_curve(self.output_dir, self.curve)
        self._write_record()
        self._restart_environments()

    def loop(
        self, callback: MaybeCallback, progress: bool, stop_after_steps: int | None
    ) -> RunResult:
        """Train in blocks until the steps are done or somebody asks to stop."""
        total = self.config.total_steps
        limit = total if stop_after_steps is None else min(total, stop_after_steps)
        bar = tqdm(total=total, initial=self.steps, unit="step", disable=not progress)
        saved_at = self.steps
        with bar, _stop_requests() as stop:
            while self.steps < limit and not stop.is_set():
                before = self.steps
                if self.steps < self.demonstration_steps:
                    self._demonstrate_block()
                else:
                    self._train_block(callback)
                bar.update(self.steps - before)
                done = self.steps >= total
                evaluated = done or self._is_due(self.config.eval_every, before)
                if evaluated:
                    self._evaluate()
                    bar.set_postfix(success=f"{self.curve[-1]['success_rate']:.2f}")
                if self.stages is not None:
                    rate = self.curve[-1]["success_rate"] if evaluated else None
                    self.stages.update(self.model, success_rate=rate)
                if done or self._is_due(self.config.checkpoint_every, before):
                    self._checkpoint()
                    saved_at = self.steps
            if saved_at != self.steps:
                self._checkpoint()
        return self._result()

    def _is_due(self, every: int, before: int) -> bool:
        """Whether a multiple of ``every`` lies in the steps done since ``before``."""
        return self.steps // every > before // every

    def _demonstrate_block(self) -> None:
        """One episode of the teachers in each environment; after the last, behaviour cloning."""
        start = time.perf_counter()
        model: Any = self.model
        replay = _replay(model)
        assert isinstance(replay, DemonstrationReplayBuffer)
        model.demonstrate(self.block, replay.demonstrations)
        if self.steps >= self.demonstration_steps:
            assert self.config.advice is not None
            clone(
                model,
                replay.demonstrations,
                updates=self.config.advice.cloning_updates,
                batch_size=self.config.batch_size,
                learning_rate=self.config.learning_rate,
            )
        self.wall_clock_s += time.perf_counter() - start

    def _train_block(self, callback: MaybeCallback) -> None:
        """One episode in each environment, then the gradient steps."""
        start = time.perf_counter()
        # SB3 asks the schedule for the progress of one `learn`, which here is a block.
        self.model.lr_schedule = ConstantSchedule(self.config.learning_rate_at(self.steps))
        self.model.learn(
            self.block,
            callback=callback,
            log_interval=None,  # type: ignore[arg-type]  # None means no log; the hint forgets it
            reset_num_timesteps=False,
        )
        self.wall_clock_s += time.perf_counter() - start

    def _evaluate(self) -> None:
        """Measure the student alone, add a line to the curve, keep the best policy."""
        student = Student(self.model)
        result = self.evaluate(
            student.predict,
            self.config.env_id,
            episodes=self.config.eval_episodes,
            seed=self.config.eval_seed,
            env_kwargs=self.config.env_kwargs,
        )
        best_before = self.best_success_rate
        success_rate = float(np.mean(result.success))
        logged = self.model.logger.name_to_value
        line: dict[str, Any] = {
            "steps": self.steps,
            "updates": self.model._n_updates,
            "wall_clock_s": round(self.wall_clock_s, 3),
            "success_rate": success_rate,
            "mean_q": student.mean_q,
            **{name: float(np.mean(cost)) for name, cost in sorted(result.cost_sums.items())},
            "training_cost": self._learner.training_cost,
            # What the seconds are worth: more than the cores means that others had a share.
            "load_average": None if (averages := load_averages()) is None else averages[0],
            "advice_spent": 0 if self.config.advice is None else int(self._advisor().spent),
            "actor_loss": _number(logged.get("train/actor_loss")),
            "critic_loss": _number(logged.get("train/critic_loss")),
            **_rates(result),
        }
        if self.stages is not None:
            line["stage"] = self.stages.stage.name
        append_point(self.output_dir, line)
        self.curve.append(line)
        if self.config.advice is not None:
            self._advisor().student_evaluated(success_rate)
        # Of equals the later: longer trained, it does better on other episodes.
        if best_before is None or success_rate >= best_before:
            folder = self.output_dir / "best"
            folder.mkdir(exist_ok=True)
            save_policy(folder / POLICY_FILE, self.model.policy)
            write_json_atomic(folder / "evaluation.json", line)

    def _checkpoint(self) -> None:
        """Save everything, then go on as a resumed run would."""
        _replay(self.model).end_running_episodes()
        extra = {
            "config": self.config.to_mapping(),
            "wall_clock_s": self.wall_clock_s,
            "training_cost": self._learner.training_cost,
            "advisor": None if self.config.advice is None else self._advisor().state_dict(),
            "stages": None if self.stages is None else self.stages.state_dict(),
        }
        save_checkpoint(self.output_dir / "latest", self.model, extra)
        self._restart_environments()

    def _restart_environments(self) -> None:
        """Reset with a seed that only the run's seed and its step count decide."""
        seed = np.random.SeedSequence([self.config.seed, self.steps]).generate_state(1)[0]
        # SB3 adds an environment's number to the seed: leave room below 2**31.
        self.env.seed(int(seed % 2**30))
        self.model._last_obs = self.env.reset()  # type: ignore[assignment]
        self.model._last_episode_starts = np.ones(self.config.n_envs, bool)

    @property
    def _learner(self) -> GoalLearnerMixin:
        assert isinstance(self.model, GoalLearnerMixin), "build_model makes no other"
        return self.model

    def _advisor(self) -> Advisor:
        advisor: Advisor = self.model.advisor  # type: ignore[attr-defined]  # the advised class's
        return advisor

    def _write_record(self) -> None:
        """Append this session to ``run.json``."""
        path = self.output_dir / "run.json"
        sessions: list[Any] = []
        if self.steps > 0 and path.exists():
            sessions = json.loads(path.read_text(encoding="utf-8"))["sessions"]
        sessions.append({"from_steps": self.steps, **provenance()})
        record = {
            "seed": self.config.seed,
            "config": self.config.to_mapping(),
            "sessions": sessions,
        }
        write_json_atomic(path, record)

    def _result(self) -> RunResult:
        return RunResult(
            output_dir=self.output_dir,
            finished=self.steps >= self.config.total_steps,
            steps=self.steps,
            updates=self.model._n_updates,
            wall_clock_s=self.wall_clock_s,
            success_rate=self.curve[-1]["success_rate"] if self.curve else None,
            best_success_rate=self.best_success_rate,
        )


class Student:
    """The learner as a plain function of observations, with the mean of its own Q on the way."""

    def __init__(self, model: OffPolicyAlgorithm) -> None:
        self.model = model
        self._sum = 0.0
        self._count = 0

    def predict(self, observation: Observation) -> npt.NDArray[Any]:
        """Deterministic actions (n, action_dim) for observations with entries (n, dim)."""
        action, _ = self.model.predict(observation, deterministic=True)
        assert isinstance(self.model, GoalLearnerMixin)
        values = self.model.student_value(observation, action)
        self._sum += float(values.sum())
        self._count += values.size
        return action

    @property
    def mean_q(self) -> float | None:
        """Q(s, pi(s)) over the states seen, as the dissertation's figures 5.4 to 5.8 plot it."""
        return self._sum / self._count if self._count else None


def _replay(model: OffPolicyAlgorithm) -> GoalReplayBuffer:
    assert isinstance(model.replay_buffer, GoalReplayBuffer)
    return model.replay_buffer


@contextmanager
def _stop_requests() -> Iterator[threading.Event]:
    """Turn Ctrl-C and SIGTERM into an event, so that a block is never torn apart."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        # Python delivers signals to the main thread only: whoever runs it decides.
        yield stop
        return

    def request(number: int, frame: types.FrameType | None) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()
        print("stopping after this block; Ctrl-C again to stop at once", file=sys.stderr)

    numbers = (signal.SIGINT, signal.SIGTERM)
    handlers = {number: signal.signal(number, request) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _rates(result: EvaluationResult) -> dict[str, float]:
    """GSR and CMR, where the environment tells them apart from success."""
    names = ("goal_success_rate", "constraint_met_rate")
    rates = {name: getattr(result, name, None) for name in names}
    if rates["constraint_met_rate"] is None:
        return {}  # an unconstrained task: the goal's rate is the success rate
    return {name: float(rate) for name, rate in rates.items() if rate is not None}


def _number(value: Any) -> float | None:
    """A logged value as JSON has it; None before the first update."""
    return None if value is None or not np.isfinite(value) else float(value)
