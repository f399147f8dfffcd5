"""The twins' data sets, made where they are missing."""

from __future__ import annotations


def prepare_data(robot: str, seed: int = 0) -> None:
    """Make the arm's data set if it is not there, with a progress bar.

    :param robot: the arm's name
    :param seed: of the data set
    """
    from tqdm import tqdm

    from saver_envs.modelling.datasets import simulated_steps, twin_data_set

    with tqdm(
        total=simulated_steps(robot), desc=f"{robot}: data", unit="step", delay=2.0, leave=False
    ) as bar:

        def progress(steps: int) -> None:
            bar.update(steps)

        twin_data_set(robot, seed, progress=progress)
