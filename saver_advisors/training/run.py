"""A run in progress: blocks of training, with evaluations and checkpoints between them.

A block consists of one episode in every environment and the gradient steps that follow; in the
first blocks the teachers demonstrate, if configured. At a checkpoint, and when a run resumes, the
environments are reset with a seed derived from the run's seed and its step count, so that a resumed
run equals an uninterrupted one.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.type_aliases import MaybeCallback
from stable_baselines3.common.utils import ConstantSchedule
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from saver_advisors.advising import Advisor, names_code
from saver_advisors.evaluation.episodes import Observation, curve_point, evaluate_policy
from saver_advisors.evaluation.protocol import training_seed
from saver_advisors.learner.algorithms import episode_horizon
from saver_advisors.learner.imitation import clone
from saver_advisors.learner.replay import DemonstrationReplayBuffer
from saver_advisors.reporting.provenance import load_averages, provenance, write_json_atomic
from saver_advisors.training.building import build_model, build_stages, demonstration_steps
from saver_advisors.training.checkpoint import (
    POLICY_FILE,
    STATE_FILE,
    find_checkpoint,
    load_checkpoint,
    load_policy,
    read_state,
    save_checkpoint,
    save_policy,
)
from saver_advisors.training.curve_file import CURVE_FILE, append_point, read_curve, write_curve
from saver_advisors.training.run_folder import RECORD_FILE, locked, read_record
from saver_advisors.training.settings import RunConfig, naming
from saver_advisors.training.stopping import Stop
from saver_envs.digest import world_digest
from saver_envs.registration import varied_in

#: Settings that may change on resuming: the length, and the intervals of evaluations and saving.
MAY_CHANGE = {"total_steps", "eval_every", "eval_episodes", "checkpoint_every"}


@dataclass(frozen=True)
class RunResult:
    """The state in which a run ended or stopped.

    :param output_dir: the run's folder.
    :param finished: whether all steps are done; otherwise ``resume=True`` continues.
    :param steps: environment steps done.
    :param updates: gradient steps done.
    :param wall_clock_s: seconds of training, without evaluations and checkpoints.
    :param success_rate: success rate of the last evaluation, None before the first.
    :param best_success_rate: success rate of the best evaluation.
    """

    output_dir: Path
    finished: bool
    steps: int
    updates: int
    wall_clock_s: float
    success_rate: float | None
    best_success_rate: float | None


class Run:
    """A run in progress. Creating it builds the learner and writes nothing.

    :param config: settings of the run.
    :param output_dir: the run's folder.
    :param env: the vector env to train in.
    :param threads: of the simulation in evaluations.
    :raises ValueError: for settings that do not fit together.
    """

    def __init__(self, config: RunConfig, output_dir: Path, env: VecEnv, threads: int = 1) -> None:
        self.config = config
        self.output_dir = output_dir
        self.env = env
        self.threads = threads
        if config.algorithm == "dagger" and config.advice is None:
            raise ValueError("algorithm='dagger' needs advice, whose teacher it imitates")
        if (plain := _without_code(config)) is not None:
            # Everything else must fit before the code that the settings name is imported.
            build_model(plain, env)
        self.model = build_model(config, env)
        self.advisor: Advisor | None = getattr(self.model, "advisor", None)
        self.stages = build_stages(config, self.model)
        horizon = episode_horizon(env)
        self.block = horizon * config.n_envs
        self.demonstration_steps = demonstration_steps(config, horizon)
        self.wall_clock_s = self.processor_s = 0.0
        self.curve: list[dict[str, Any]] = []

    @property
    def steps(self) -> int:
        """Environment steps done."""
        return self.model.num_timesteps

    @property
    def best_success_rate(self) -> float | None:
        """The highest success rate of the curve, None before the first evaluation."""
        return max((point["success_rate"] for point in self.curve), default=None)

    def train(
        self,
        resume: bool = False,
        progress: bool = True,
        stop_after_steps: int | None = None,
        callback: MaybeCallback = None,
        time_limit: float | None = None,
    ) -> RunResult:
        """Train in blocks until the steps are done or the process is asked to stop.

        :param resume: see ``saver_advisors.training.train``, as for the others.
        :param progress: show a progress bar.
        :param stop_after_steps: stop with a checkpoint after this many steps of the whole run.
        :param callback: SB3 callbacks.
        :param time_limit: seconds after which no further block begins.
        :return: the state of the run.
        :raises FileExistsError: if the folder holds a run and ``resume`` is false.
        :raises FileNotFoundError: if the run in the folder has no checkpoint to resume from, or
            that of ``start_from`` has no policy.
        :raises FolderInUseError: if another process trains in the folder.
        :raises ValueError: for a checkpoint that is damaged or has another configuration.
        :raises OSError: if a checkpoint cannot be written.
        """
        total = self.config.total_steps
        limit = total if stop_after_steps is None else min(total, stop_after_steps)
        stop = Stop(time_limit)
        # Blocks are never interrupted.
        words = "stopping after this block; Ctrl-C again to stop at once"
        with locked(self.output_dir), stop.on_signals(words):
            self._begin(resume)
            saved_at = self.steps
            with tqdm(total=total, initial=saved_at, unit="step", disable=not progress) as bar:
                while self.steps < limit and not stop:
                    before, start, busy = self.steps, time.perf_counter(), time.process_time()
                    if self.steps < self.demonstration_steps:
                        self._demonstrate_block()
                    else:
                        self._train_block(callback)
                    self.wall_clock_s += time.perf_counter() - start
                    self.processor_s += time.process_time() - busy
                    bar.update(self.steps - before)
                    done = self.steps >= total
                    rate = None
                    if done or self._is_due(self.config.eval_every, before):
                        rate = self._evaluate()
                        bar.set_postfix(success=f"{rate:.2f}")
                    if self.stages is not None:
                        self.stages.advance(rate)
                    if done or self._is_due(self.config.checkpoint_every, before):
                        self._checkpoint()
                        saved_at = self.steps
                if saved_at != self.steps:
                    self._checkpoint()
        return RunResult(
            output_dir=self.output_dir,
            finished=self.steps >= total,
            steps=self.steps,
            updates=self.model._n_updates,
            wall_clock_s=self.wall_clock_s,
            success_rate=self.curve[-1]["success_rate"] if self.curve else None,
            best_success_rate=self.best_success_rate,
        )

    def _begin(self, resume: bool) -> None:
        """Load the folder's checkpoint or write the first; append this session to ``run.json``."""
        checkpoint = find_own_checkpoint(self.output_dir, self.config, resume)
        sessions: list[Any] = []
        self.model.is_trained |= self.config.start_from is not None
        if checkpoint is None and self.config.start_from is not None:
            with naming("start_from"):
                load_policy(Path(self.config.start_from) / "best" / POLICY_FILE, self.model.policy)
            features: Any = self.model.policy.shared_features
            features.settle()
        if checkpoint is not None:
            extra = load_checkpoint(checkpoint, self.model)
            self.wall_clock_s = extra["wall_clock_s"]
            self.processor_s = extra.get("processor_s", 0.0)
            self.model.training_cost = extra.get("training_cost", 0.0)
            if self.advisor is not None:
                self.advisor.load_state_dict(extra["advisor"])
            if self.stages is not None:
                self.stages.load_state_dict(extra["stages"])
            curve = read_curve(self.output_dir)
            self.curve = [point for point in curve if point["steps"] <= self.steps]
            if (self.output_dir / RECORD_FILE).exists():
                sessions = read_record(self.output_dir)["sessions"]
        # Points written after the checkpoint would appear twice.
        write_curve(self.output_dir, self.curve)
        sessions.append({"from_steps": self.steps, **provenance()})
        record = {
            "seed": self.config.seed,
            "config": self.config.to_mapping(),
            "world": _world_of(self.config),
        }
        if "randomization" in self.config.env_kwargs:
            record["randomization"] = varied_in(self.config.env_id, self.config.env_kwargs)
        write_json_atomic(self.output_dir / RECORD_FILE, {**record, "sessions": sessions})
        if checkpoint is None:
            # There is always one to resume from, and a full disk is noticed before the training.
            self._checkpoint()
        else:
            self._restart_environments()

    def _is_due(self, every: int, before: int) -> bool:
        """Return whether the steps done since ``before`` include a multiple of ``every``."""
        return self.steps // every > before // every

    def _demonstrate_block(self) -> None:
        """Let the teachers play an episode in each environment; after the last, clone them."""
        model: Any = self.model
        replay = model.replay_buffer
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

    def _train_block(self, callback: MaybeCallback) -> None:
        """Play an episode in each environment, then do the gradient steps."""
        # SB3 passes the schedule the progress of one `learn`, which here is a block.
        self.model.lr_schedule = ConstantSchedule(self.config.learning_rate_at(self.steps))
        self.model.learn(
            self.block,
            callback=callback,
            log_interval=None,  # type: ignore[arg-type]  # None means no log; the hint omits it
            reset_num_timesteps=False,
        )

    def _evaluate(self) -> float:
        """Evaluate the student alone, add a point to the curve, keep the best policy.

        :return: the success rate.
        """
        values: list[npt.NDArray[Any]] = []

        def predict(observation: Observation) -> npt.NDArray[Any]:
            action, _ = self.model.predict(observation, deterministic=True)
            if self.model.learns_values:
                values.append(self.model.student_value(observation, action))
            return action

        result = evaluate_policy(
            predict,
            self.config.env_id,
            episodes=self.config.eval_episodes,
            seed=self.config.eval_seed,
            env_kwargs=self.config.env_kwargs,
            threads=self.threads,
        )
        best_before = max(map(self.config.score, self.curve), default=0.0)
        success_rate = result.success_rate
        logged = self.model.logger.name_to_value
        averages = load_averages()
        point: dict[str, Any] = {
            "steps": self.steps,
            "updates": self.model._n_updates,
            "wall_clock_s": round(self.wall_clock_s, 3),
            "processor_s": round(self.processor_s, 3),
            **curve_point(result.summary()),
            # Q(s, pi(s)) over the states seen, as in the dissertation's figures 5.4 to 5.8.
            "mean_q": _mean(values),
            "training_cost": self.model.training_cost,
            # Above the number of cores, the wall-clock time includes waiting for other processes.
            "load_average": None if averages is None else averages[0],
            "advice_spent": 0 if self.advisor is None else int(self.advisor.spent),
            "actor_loss": _number(logged.get("train/actor_loss")),
            "critic_loss": _number(logged.get("train/critic_loss")),
        }
        for name in ("episode_cost", "cost_multiplier"):
            if f"train/{name}" in logged:
                point[name] = _number(logged[f"train/{name}"])
        if self.stages is not None:
            point["stage"] = self.stages.stage.name
        append_point(self.output_dir, point)
        self.curve.append(point)
        if self.advisor is not None:
            self.advisor.student_evaluated(success_rate)
        # Of equal policies keep the later one, which does better on other episodes.
        if self.config.score(point) >= best_before:
            folder = self.output_dir / "best"
            folder.mkdir(exist_ok=True)
            save_policy(folder / POLICY_FILE, self.model.policy)
            write_json_atomic(folder / "evaluation.json", point)
        return success_rate

    def _checkpoint(self) -> None:
        """Save everything, then continue as a resumed run would."""
        self.model.replay_buffer.end_running_episodes()
        extra = {
            "config": self.config.to_mapping(),
            "wall_clock_s": self.wall_clock_s,
            "processor_s": self.processor_s,
            "training_cost": self.model.training_cost,
            "advisor": None if self.advisor is None else self.advisor.state_dict(),
            "stages": None if self.stages is None else self.stages.state_dict(),
        }
        save_checkpoint(self.output_dir / "latest", self.model, extra)
        self._restart_environments()

    def _restart_environments(self) -> None:
        """Reset with a seed that depends only on the run's seed and its step count."""
        self.env.seed(training_seed(self.config.seed, self.steps))
        self.model._last_obs = self.env.reset()  # type: ignore[assignment]
        self.model._last_episode_starts = np.ones(self.config.n_envs, bool)


def find_own_checkpoint(output_dir: Path, config: RunConfig, resume: bool) -> Path | None:
    """Find the checkpoint to resume from, and check that it belongs to the same run.

    :param output_dir: the run's folder, which may be missing.
    :param config: settings of the run.
    :param resume: whether the run may continue from a checkpoint.
    :return: the checkpoint's folder; None for a new run.
    :raises FileExistsError: if the folder holds a run and ``resume`` is false.
    :raises FileNotFoundError: if it holds a run whose checkpoint is missing.
    :raises ValueError: for a checkpoint that is damaged or has another configuration.
    """
    latest = output_dir / "latest"
    checkpoint = find_checkpoint(latest)
    if not resume and (checkpoint is not None or (output_dir / CURVE_FILE).exists()):
        raise FileExistsError(
            f"output_dir={output_dir} already contains a run: continue it with resume=True, or "
            "choose another folder"
        )
    if checkpoint is None:
        if latest.exists() or (output_dir / "best").exists() or read_curve(output_dir):
            raise FileNotFoundError(
                f"{latest / STATE_FILE} is missing, so the run in {output_dir} cannot be resumed: "
                "restore the folder 'latest' from a copy, or start a new run in another folder"
            )
        return None
    # Through the class, so that settings newer than the checkpoint get their defaults.
    extra = read_state(checkpoint)["extra"]
    with naming(str(checkpoint / STATE_FILE)):
        if not {"config", "wall_clock_s"} <= extra.keys():
            raise ValueError("it lacks the settings or the time of the run")
        saved = RunConfig.from_mapping(extra["config"]).to_mapping()
    wanted = config.to_mapping()
    changes = [
        f"{name}: {saved[name]!r} -> {wanted[name]!r}"
        for name in sorted(wanted.keys() - MAY_CHANGE)
        if saved[name] != wanted[name]
    ]
    if changes:
        raise ValueError(
            f"the checkpoint in {output_dir} has another configuration ({', '.join(changes)}); "
            f"only {sorted(MAY_CHANGE)} may change when a run is resumed"
        )
    return checkpoint


def _without_code(config: RunConfig) -> RunConfig | None:
    """Return the settings without the code that they name: teachers, strategy; None if they name
    none.
    """
    advice = config.advice
    if advice is None:
        return None
    if any(map(names_code, advice.teachers)):
        return replace(config, advice=None)
    if ":" not in advice.strategy:
        return None
    plain = replace(advice, strategy="none", threshold=None, correcting=None, settings={})
    return replace(config, advice=plain)


def _mean(parts: list[npt.NDArray[Any]]) -> float | None:
    """Return the mean of all entries; None if there are none."""
    return sum(float(part.sum()) for part in parts) / sum(map(np.size, parts)) if parts else None


def _number(value: Any) -> float | None:
    """Return a logged value as JSON accepts it; None before the first update."""
    return None if value is None or not np.isfinite(value) else float(value)


def _world_of(config: RunConfig) -> str | None:
    """Return the digest of a run's world, None where its environment is not a registered id."""
    try:
        return world_digest(config.env_id, config.env_kwargs)
    except ValueError:
        return None
