"""Start and resume runs, and load the policies of finished ones.

A run is a folder::

    run.json       the configuration, and for each session its command, commit, versions, machine
    curve.jsonl    one line per evaluation
    latest/        the checkpoint from which `resume=True` continues
    best/          the policy with the highest success rate so far, and its evaluation
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import MaybeCallback

from saver_advisors.training.building import build_env, build_model
from saver_advisors.training.checkpoint import POLICY_FILE, load_policy, read_tensors
from saver_advisors.training.run import Run, RunResult, find_own_checkpoint
from saver_advisors.training.run_folder import read_record
from saver_advisors.training.settings import RunConfig
from saver_advisors.training.threads import threads_of_algebra


def train(
    config: RunConfig,
    output_dir: str | Path,
    *,
    resume: bool = False,
    progress: bool = True,
    threads: int = 1,
    stop_after_steps: int | None = None,
    callback: MaybeCallback = None,
) -> RunResult:
    """Start a run, or resume one.

    Ctrl-C and SIGTERM let the current block finish, write a checkpoint and return; a second Ctrl-C
    stops at once.

    :param config: settings of the run.
    :param output_dir: the run's folder, created if missing.
    :param resume: continue from the folder's checkpoint if it has one.
    :param progress: show a progress bar.
    :param threads: see ``open_run``.
    :param stop_after_steps: stop with a checkpoint after this many steps of the whole run.
    :param callback: SB3 callbacks; their start and end hooks are called once per block.
    :return: the state of the run.
    :raises FileExistsError: if the folder holds a run and ``resume`` is false.
    :raises FileNotFoundError: if it holds a run whose checkpoint is missing.
    :raises FolderInUseError: if another process trains in the folder.
    :raises ValueError: for settings that do not fit together, a checkpoint that is damaged or has
        another configuration, or less than one thread.
    :raises TypeError: for unknown arguments of the environment or unsuitable teachers.
    :raises OSError: if a checkpoint cannot be written; the previous one is intact.
    """
    # First the folder: the settings of a run may name code, which is imported when it is built.
    find_own_checkpoint(Path(output_dir), config, resume)
    with open_run(config, output_dir, threads) as run:
        return run.train(resume, progress, stop_after_steps, callback)


@contextmanager
def open_run(config: RunConfig, output_dir: str | Path, threads: int = 1) -> Iterator[Run]:
    """Build a run's environment and learner, and close the environment at the end.

    Every mistake in the settings raises here, before ``Run.train`` writes the first file.

    :param config: settings of the run.
    :param output_dir: the run's folder.
    :param threads: threads of the simulation, whose results do not depend on them, and of torch,
        whose sums may differ in the last bit.
    :return: the run, for use within the context.
    :raises ValueError: for settings that do not fit together, or less than one thread.
    :raises TypeError: for unknown arguments of the environment or unsuitable teachers.
    """
    with threads_of_algebra(threads), closing(build_env(config, threads)) as env:
        yield Run(config, Path(output_dir), env, threads)


def load_trained(output_dir: str | Path, which: str = "best") -> OffPolicyAlgorithm:
    """Load the learner of a run with trained networks, for prediction or export.

    :param output_dir: the run's folder.
    :param which: ``best`` or ``latest``.
    :return: the learner, without advisor and with an empty replay buffer.
    :raises FileNotFoundError: if the run has no such policy.
    :raises ValueError: for a damaged file.
    """
    if which not in ("best", "latest"):
        raise ValueError(f"which={which} must be 'best' or 'latest'")
    output_dir = Path(output_dir)
    values = read_record(output_dir)["config"]
    config = replace(RunConfig.from_mapping(values), advice=None, n_envs=1)
    read_tensors(output_dir / which / POLICY_FILE)  # verified before an environment's module runs
    with closing(build_env(config)) as env:
        model = build_model(config, env)
    load_policy(output_dir / which / POLICY_FILE, model.policy)
    return model
