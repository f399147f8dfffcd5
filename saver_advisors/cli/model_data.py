"""Record the data sets of the twins where they are missing."""

from __future__ import annotations


def prepare_data(robot: str, seed: int = 0) -> None:
    """Record an arm's data set if it is missing, with a progress bar.

    :param robot: the arm's name
    :param seed: seed of the data set
    :raises UsageError: for an arm without a twin
    """
    from tqdm import tqdm

    from saver_advisors.reporting.errors import user_mistakes
    from saver_envs.modelling.datasets import simulated_steps, twin_data_set

    with user_mistakes("argument --robot"):
        total = simulated_steps(robot)
    with tqdm(total=total, desc=f"{robot}: data", unit="step", delay=2.0, leave=False) as bar:

        def progress(steps: int) -> None:
            bar.update(steps)

        twin_data_set(robot, seed, progress=progress)
