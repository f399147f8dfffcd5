"""Settle the starts of a task with a limp person: `python tools/settle_starts.py ID`."""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from saver_envs.files import written_whole
from saver_envs.people.limp_people import PEOPLE
from saver_envs.registration import row_of
from saver_envs.tasks.care import CareTask
from saver_envs.tasks.care_starts import FOLDER, alone, settled_path

#: Postures that are laid down before one is at rest.
MOST_TRIES = 50


def settled_start(task: CareTask, who: int, index: int) -> NDArray[np.float64]:
    """Return posture ``index`` of a person at rest, (35,).

    :raises RuntimeError: when none of many comes to rest.
    """
    generator, world = np.random.default_rng([who, index]), alone(who, task.bed)
    for _ in range(MOST_TRIES):
        pose = world.laid(task.posture(index, generator), task.bed.centre[:2], task.facing)
        if pose is not None and task.keeps(world, index):
            return pose
    raise RuntimeError(f"person {who}, posture {index}: none of {MOST_TRIES} came to rest")


def settled_person(env_id: str, who: int) -> NDArray[np.float64]:
    """Return all postures of a person, (postures, 35)."""
    task = care_task(env_id)
    return np.stack([settled_start(task, who, index) for index in range(task.postures)])


def care_task(env_id: str) -> CareTask:
    """Return the task of an id.

    :raises ValueError: for a task without a limp person.
    """
    row = row_of(env_id)
    task = row.task(row.n_arms)
    if not isinstance(task, CareTask):
        raise ValueError(f"{env_id} has no starts to settle: its task is no CareTask")
    return task


def main() -> None:
    """Settle and store the starts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("env_id")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    people = range(len(PEOPLE))
    with ProcessPoolExecutor(options.processes) as pool:
        poses = list(pool.map(settled_person, repeat(options.env_id), people))
    FOLDER.mkdir(exist_ok=True)
    with written_whole(settled_path(care_task(options.env_id).name)) as file:
        np.save(file, np.stack(poses).astype(np.float32), allow_pickle=False)


if __name__ == "__main__":
    main()
