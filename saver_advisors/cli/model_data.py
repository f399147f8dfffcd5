"""Record the data sets of the twins where they are missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from saver_advisors.reporting.errors import user_mistakes

if TYPE_CHECKING:
    from saver_envs.modelling.datasets import DataSet


def prepare_data(robot: str, seed: int = 0) -> DataSet:
    """Return an arm's data set; record it with a progress bar if it is missing.

    :param robot: the arm's name
    :param seed: seed of the data set
    :raises UsageError: for an arm without a twin
    """
    from tqdm import tqdm

    from saver_envs.modelling.datasets import simulated_steps, twin_data_set

    with user_mistakes("argument --robot"):
        total = simulated_steps(robot)
    with tqdm(total=total, desc=f"{robot}: data", unit="step", delay=2.0, leave=False) as bar:
        return twin_data_set(robot, seed, progress=bar.update)
