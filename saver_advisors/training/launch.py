"""Runs: started, resumed, checked beforehand, loaded when they are done.

A run is a folder::

    run.json       the configuration, and for each session its command, commit, versions, machine
    curve.jsonl    one line an evaluation
    latest/        the checkpoint that `resume=True` goes on from
    best/          the policy with the highest success rate so far, and its figures
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import MaybeCallback
from stable_baselines3.common.vec_env import VecEnv

from saver_advisors.training.building import (
    ALGORITHMS,
    build_advisor,
    build_model,
)
from saver_advisors.training.checkpoint import (
    POLICY_FILE,
    find_checkpoint,
    load_policy,
    read_state,
)
from saver_advisors.training.curve_file import CURVE_FILE
from saver_advisors.training.run import Evaluate, EvaluationResult, Run, RunResult
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_advisors.training.threads import threads_of_algebra

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

EnvFactory = Callable[[RunConfig], VecEnv]


def train(
    config: RunConfig,
    output_dir: str | Path,
    *,
    resume: bool = False,
    progress: bool = True,
    threads: int = 1,
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
    :param threads: of the simulation, which does the same with any number, and of torch, whose
        sums may differ in their last bit from those with another number
    :param stop_after_steps: stop, with a checkpoint, when the run has done this many steps in all
    :param env_factory: makes the vector env, ``SaverVecEnv`` with so many threads where None
    :param evaluate: ``saver_advisors.evaluation.episodes.evaluate_policy`` where None
    :param callback: SB3 callbacks; their start and end hooks run once a block
    :return: where the run stands
    :raises FileExistsError: when the folder holds a run and ``resume`` is false
    :raises ValueError: when the checkpoint is damaged or of another configuration, or for less
        than one thread
    :raises OSError: when a checkpoint cannot be written; the one before is intact
    """
    output_dir = Path(output_dir)
    with threads_of_algebra(threads):
        checkpoint = _prepare_folder(output_dir, config, resume)
        env = (env_factory or partial(_saver_env, threads=threads))(config)
        try:
            run = Run(config, output_dir, env, evaluate or _evaluate_policy(threads))
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


def _saver_env(config: RunConfig, threads: int = 1) -> VecEnv:
    from saver_envs.envs.sb3_vec_env import SaverVecEnv

    options = {**config.env_kwargs, **config.train_env_kwargs}
    return SaverVecEnv(
        config.env_id, n_envs=config.n_envs, seed=config.seed, threads=threads, **options
    )


def _evaluate_policy(threads: int) -> Evaluate:
    from saver_advisors.evaluation.episodes import evaluate_policy

    return partial(evaluate_policy, threads=threads)


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


def _require(condition: bool, name: str, value: Any, wanted: str) -> None:
    if not condition:
        raise ValueError(f"{name}={value} must be {wanted}")
