"""One run: environment, algorithm, advice, evaluation and checkpoints.

A run is a folder::

    run.json       the configuration, and for each session its command, commit, versions, machine
    curve.jsonl    one line an evaluation
    latest/        the checkpoint that `resume=True` goes on from
    best/          the policy with the highest success rate so far, and its figures

It goes on in blocks: every environment does one episode, then some gradient steps; in the first
blocks the teachers demonstrate, where that is asked for. Evaluations and checkpoints fall between
blocks. At a checkpoint the environments are reset with a seed made from the run's seed and its step
count, on resuming likewise, so that a run that was stopped at a checkpoint and resumed does exactly
what an uninterrupted one does.
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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import MaybeCallback
from stable_baselines3.common.utils import ConstantSchedule
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from saver_advisors.building import (
    ALGORITHMS,
    build_advisor,
    build_model,
    build_stages,
    demonstration_steps,
)
from saver_advisors.curves import CURVE_FILE, append_point, read_curve, write_curve
from saver_advisors.learner.algorithms import GoalLearnerMixin, episode_horizon
from saver_advisors.learner.checkpoint import (
    POLICY_FILE,
    find_checkpoint,
    load_checkpoint,
    load_policy,
    read_state,
    save_checkpoint,
    save_policy,
)
from saver_advisors.learner.cloning import clone
from saver_advisors.learner.configuration import AdviceConfig, RunConfig
from saver_advisors.learner.demonstrations import DemonstrationReplayBuffer
from saver_advisors.learner.replay import GoalReplayBuffer
from saver_advisors.provenance import load_averages, provenance, write_json_atomic
from saver_advisors.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from saver_advisors.advising import Advisor

__all__ = [
    "ALGORITHMS",
    "AdviceConfig",
    "EvaluationResult",
    "RunConfig",
    "RunResult",
    "build_advisor",
    "build_model",
    "check_run",
    "load_trained",
    "train",
]

# What may change when a run is resumed: how long it goes on and how closely it is watched.
MAY_CHANGE = {"total_steps", "eval_every", "eval_episodes", "checkpoint_every"}

Observation = dict[str, npt.NDArray[Any]]
Predict = Callable[[Observation], npt.NDArray[Any]]
EnvFactory = Callable[[RunConfig], VecEnv]


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


@one_thread_of_algebra()
def train(
    config: RunConfig,
    output_dir: str | Path,
    *,
    resume: bool = False,
    progress: bool = True,
    stop_after_steps: int | None = None,
    env_factory: EnvFactory | None = None,
    evaluate: Evaluate | None = None,
    callback: MaybeCallback = None,
) -> RunResult:
    """Do a run, or go on with one.

    Ctrl-C and SIGTERM let the block finish, write a checkpoint and return; a second Ctrl-C ends
    it at once.

    :param config: what to do
    :param output_dir: the run's folder, made if need be
    :param resume: go on from the folder's checkpoint, if it has one
    :param progress: show a progress bar
    :param stop_after_steps: stop, with a checkpoint, when the run has done this many steps in all
    :param env_factory: makes the vector env, ``SaverVecEnv`` where None
    :param evaluate: ``saver_advisors.evaluation.episodes.evaluate_policy`` where None
    :param callback: SB3 callbacks; their start and end hooks run once a block
    :return: where the run stands
    :raises FileExistsError: when the folder holds a run and ``resume`` is false
    :raises ValueError: when the checkpoint is damaged or of another configuration
    :raises OSError: when a checkpoint cannot be written; the one before is intact
    """
    output_dir = Path(output_dir)
    checkpoint = _prepare_folder(output_dir, config, resume)
    env = (env_factory or _saver_env)(config)
    try:
        run = _Run(config, output_dir, env, evaluate or _evaluate_policy())
        run.begin(checkpoint)
        return run.loop(callback, progress, stop_after_steps)
    finally:
        env.close()


def check_run(config: RunConfig) -> None:
    """Build a run's learner and let it go: whatever is wrong with the settings is wrong by then.

    :param config: of the run
    :raises ValueError: where teachers, arms, strategy, budget or networks do not fit
    :raises TypeError: for a teacher that cannot be used so
    """
    env = _saver_env(config)
    try:
        build_model(config, env)
    finally:
        env.close()


def load_trained(
    output_dir: str | Path,
    which: str = "best",
    *,
    env_factory: EnvFactory | None = None,
) -> OffPolicyAlgorithm:
    """The learner of a run with trained networks, for prediction or to be frozen as a teacher.

    :param output_dir: the run's folder
    :param which: ``best`` or ``latest``
    :param env_factory: as for ``train``
    :return: the learner, without advisor and with an empty replay buffer
    :raises FileNotFoundError: when the run has no such policy
    :raises ValueError: when a file is damaged
    """
    _require(which in ("best", "latest"), "which", which, "'best' or 'latest'")
    output_dir = Path(output_dir)
    values = json.loads((output_dir / "run.json").read_text(encoding="utf-8"))["config"]
    config = replace(RunConfig.from_mapping(values), advice=None, n_envs=1)
    env = (env_factory or _saver_env)(config)
    try:
        model = build_model(config, env)
    finally:
        env.close()
    load_policy(output_dir / which / POLICY_FILE, model.policy)
    return model


class _Run:
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
        student = _Student(self.model)
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


class _Student:
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


def _saver_env(config: RunConfig) -> VecEnv:
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    options = {**config.env_kwargs, **config.train_env_kwargs}
    return SaverVecEnv(config.env_id, n_envs=config.n_envs, seed=config.seed, **options)


def _evaluate_policy() -> Evaluate:
    from saver_advisors.evaluation.episodes import evaluate_policy

    return evaluate_policy


def _replay(model: OffPolicyAlgorithm) -> GoalReplayBuffer:
    assert isinstance(model.replay_buffer, GoalReplayBuffer)
    return model.replay_buffer


def _prepare_folder(output_dir: Path, config: RunConfig, resume: bool) -> Path | None:
    """Make the folder; find the checkpoint to go on from and see that it is of this run."""
    output_dir.mkdir(parents=True, exist_ok=True)
    checkpoint = find_checkpoint(output_dir / "latest")
    if not resume:
        if checkpoint is not None or (output_dir / CURVE_FILE).exists():
            raise FileExistsError(
                f"output_dir={output_dir} holds a run already: go on with it by resume=True, or "
                "choose another folder"
            )
        return None
    if checkpoint is not None:
        # Both by way of the class and JSON: settings that are newer than the checkpoint have their
        # defaults in it, and tuples equal the lists they became.
        recorded = RunConfig.from_mapping(read_state(checkpoint)["extra"]["config"])
        saved, wanted = (json.loads(json.dumps(one.to_mapping())) for one in (recorded, config))
        different = sorted(
            name
            for name in wanted.keys() | saved.keys()
            if name not in MAY_CHANGE and wanted.get(name) != saved.get(name)
        )
        if different:
            changes = ", ".join(f"{n}: {saved.get(n)!r} -> {wanted.get(n)!r}" for n in different)
            raise ValueError(
                f"the checkpoint in {output_dir} is of another configuration ({changes}); only "
                f"{sorted(MAY_CHANGE)} may change when a run is resumed"
            )
    return checkpoint


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


def _require(condition: bool, name: str, value: Any, wanted: str) -> None:
    if not condition:
        raise ValueError(f"{name}={value} must be {wanted}")
