"""What several tests of the environments need: lists of ids, exact comparison, quick episodes."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.episodes import Episodes
from saver_envs.people.patient import Patient
from saver_envs.registration import ENVIRONMENTS, make_episodes
from saver_envs.scenes import FreeBodies, free_bodies
from saver_envs.simulation import ObjectState
from saver_envs.tasks.care import CareTask
from saver_envs.tasks.care_starts import alone
from saver_envs.tasks.table import TableTask

ALL_IDS = list(ENVIRONMENTS)
SPARSE_IDS = [env_id for env_id, row in ENVIRONMENTS.items() if row.reward_type == "sparse"]
#: Those whose objects are cubes; the others' starts have rules of their own.
CUBE_IDS = [one for one in SPARSE_IDS if issubclass(ENVIRONMENTS[one].task, TableTask)]
DUAL_IDS = [env_id for env_id, row in ENVIRONMENTS.items() if row.n_arms > 1]
#: One id of each kind of scene, for what would take too long on all of them.
FEW_IDS = [
    env_id
    for env_id in ("JacoPush-v0", "DualJacoDistance-v0", "MicoPickAndPlace-v0")
    if env_id in ENVIRONMENTS
]


def assert_same(first: Any, second: Any, where: str = "") -> None:
    """Assert that nested dicts and sequences of arrays and numbers agree bit for bit."""
    if isinstance(first, dict):
        assert first.keys() == second.keys(), where
        for key in first:
            assert_same(first[key], second[key], f"{where}[{key!r}]")
    elif isinstance(first, tuple | list):
        assert len(first) == len(second), where
        for index, pair in enumerate(zip(first, second, strict=True)):
            assert_same(*pair, f"{where}[{index}]")
    else:
        np.testing.assert_array_equal(first, second, err_msg=where)


def row_of(columns: dict[str, NDArray[Any]], index: int) -> dict[str, Any]:
    """Return one row of a dict of arrays."""
    return {name: values[index] for name, values in columns.items()}


def info_row(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """Return one episode's infos from Gymnasium's vector format."""
    return {
        name: values[index]
        for name, values in infos.items()
        if not name.startswith("_") and infos[f"_{name}"][index]
    }


_built: dict[str, Episodes] = {}


def started(env_id: str, seed: int) -> Episodes:
    """Start one episode from ``seed``; the episodes of an id are built once."""
    if env_id not in _built:
        _built[env_id] = make_episodes(env_id)
    episodes = _built[env_id]
    episodes.set_generator(0, np.random.default_rng(seed))
    episodes.reset()
    return episodes


def settled_anew(task: CareTask, who: int, index: int) -> NDArray[np.float64]:
    """Settle a posture (35,) of a person as ``tools/settle_starts.py`` does."""
    world, generator = alone(who, task.bed), np.random.default_rng([who, index])
    while True:
        pose = world.laid(task.posture(index, generator), task.bed.centre[:2], task.facing)
        if pose is not None and task.keeps(world, index):
            return pose


def seen_part(episodes: Episodes, name: str) -> NDArray[np.float64]:
    """Return a part of the observation (n, arms, size), or (n, size) if shared, in its unit."""
    layout = episodes.task.observation_layout
    values = layout.get(episodes.observation().observation.astype(np.float64), name)
    return np.asarray(values / layout.part(name).scale)


def begun(env_id: str, n: int = 1, seed: int = 0, **options: Any) -> Episodes:
    """Build n episodes and start episode i from ``seed + i``."""
    episodes = make_episodes(env_id, n, **options)
    for index in range(n):
        episodes.set_generator(index, np.random.default_rng(seed + index))
    episodes.reset()
    return episodes


def cubes_of(episodes: Episodes) -> FreeBodies:
    """Return the addresses of the cubes, one an arm."""
    assert isinstance(episodes.task, TableTask)
    return free_bodies(episodes.scene, episodes.task.resting)


def objects_of(episodes: Episodes) -> ObjectState:
    """Return the state of the cubes, or of the wrists."""
    if isinstance(episodes.task, TableTask):
        return episodes.simulation.object_state(cubes_of(episodes))
    return episodes.simulation.keep(Patient).wrists()


def targets_of(episodes: Episodes) -> NDArray[np.float64]:
    """Return the targets (n, arms, 3) in the base frames, metres."""
    return episodes.task.goal_layout.get(episodes.goal, "object position")


def touching(episodes: Episodes, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Say which episodes have contact other than of what lies there."""
    return episodes.simulation.touching(rows, episodes.task.resting)


def random_actions(space_size: int, steps: int, n: int, seed: int = 0) -> NDArray[np.float32]:
    """Return uniform actions (steps, n, space_size)."""
    generator = np.random.default_rng(seed)
    return generator.uniform(-1, 1, (steps, n, space_size)).astype(np.float32)


def pickled_and_back(thing: Any) -> Any:
    """What another process would get: environments and specs must survive that.

    No file is read: the bytes are made here.
    """
    return pickle.loads(pickle.dumps(thing))
