"""Write episodes as a data set of Minari, https://minari.farama.org."""

from __future__ import annotations

import os
import re
import shutil
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final

import gymnasium

from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_envs.registration import task_and_settings
from saver_envs.validation import require

FOLDER_VARIABLE: Final = "MINARI_DATASETS_PATH"
"""Environment variable with the folder of Minari's data sets; ``~/.minari/datasets`` without it."""
DESCRIPTION_KEY: Final = "saver"
"""Entry of the data set's metadata with what we say about it."""
_ID: Final = re.compile(r"([\w-]{2,}/)*[\w-]+-v\d+")
_AT_ONCE: Final = 256
"""Episodes that are kept in memory before they are written."""


def minari_folder(dataset_id: str, root: Path | None = None) -> Path:
    """Return the folder of a data set, which need not exist, and check its id.

    :param dataset_id: such as ``saver/NAME-v0``
    :param root: folder of all data sets; Minari's own if None
    :return: the data set's folder
    :raises ValueError: for an id that Minari does not accept
    """
    valid = _ID.fullmatch(dataset_id) is not None
    require("name", dataset_id, valid, "NAME-vVERSION, behind folders or not, as saver/push-v0")
    usual = os.environ.get(FOLDER_VARIABLE) or Path.home() / ".minari" / "datasets"
    return Path(root or usual) / dataset_id


def write_minari(
    dataset_id: str,
    episodes: Iterable[RecordedEpisode],
    env_id: str,
    env_kwargs: Mapping[str, Any],
    *,
    algorithm: str,
    description: str,
    about: Mapping[str, Any],
    root: Path | None = None,
) -> Path:
    """Write a data set; ``minari.load_dataset`` reads it, and makes its environment.

    :param dataset_id: see :func:`minari_folder`
    :param episodes: at least one, of the environment
    :param env_id: a registered id
    :param env_kwargs: keyword arguments of the environment, JSON-able
    :param algorithm: what chose the actions
    :param description: a sentence or two
    :param about: JSON-able values for the entry :data:`DESCRIPTION_KEY` of the metadata
    :param root: folder of all data sets; Minari's own if None
    :return: the data set's folder
    :raises FileExistsError: if there is a data set of that id
    :raises ValueError: for an id that Minari does not accept, or without an episode
    """
    import minari

    folder = minari_folder(dataset_id, root)
    if folder.exists():
        raise FileExistsError(f"{folder} exists: choose another name, or remove it")
    batches = _batches(episodes)
    first = next(batches, None)
    if first is None:
        raise ValueError("episodes is empty: a data set has at least one")
    env = _environment(env_id, env_kwargs)
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with _root_of_minari(root), warnings.catch_warnings():
            # It asks for an author, an address and a link.
            warnings.filterwarnings("ignore", message=".*is set to None", category=UserWarning)
            written = minari.create_dataset_from_buffers(
                dataset_id,
                first,
                env=env,
                eval_env=env,
                algorithm_name=algorithm,
                description=description,
                requirements=["saver-envs"],
            )
        for batch in batches:
            written.update_dataset_from_buffer(batch)
        written.storage.update_metadata({DESCRIPTION_KEY: dict(about)})
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        env.close()
    return folder


def _batches(episodes: Iterable[RecordedEpisode]) -> Iterator[list[Any]]:
    """Yield episodes as Minari takes them, a bounded number at once."""
    left = iter(episodes)
    while batch := [_buffer(one) for one in islice(left, _AT_ONCE)]:
        yield batch


def _buffer(episode: RecordedEpisode) -> Any:
    """Return an episode as Minari takes it."""
    from minari.data_collector import EpisodeBuffer

    arrays: dict[str, Any] = {
        name: getattr(episode, name)
        for name in ("actions", "rewards", "terminations", "truncations")
    }
    return EpisodeBuffer(
        seed=episode.seed,
        observations=dict(episode.observations),
        infos=dict(episode.infos),
        **arrays,
    )


def _environment(env_id: str, env_kwargs: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    """Make the environment whose spec the data set keeps.

    Gymnasium counts the steps, so its limit must be the horizon of these keyword arguments; and an
    id with a module must keep it, for programs that have not imported it.
    """
    horizon = task_and_settings(env_id, env_kwargs)[1].horizon
    given = {"env_id": env_id, **env_kwargs, "max_episode_steps": horizon}
    return gymnasium.make(env_id, **given)


@contextmanager
def _root_of_minari(root: Path | None) -> Iterator[None]:
    """Let Minari write its data sets to a folder."""
    before = os.environ.get(FOLDER_VARIABLE)
    try:
        if root is not None:
            os.environ[FOLDER_VARIABLE] = str(root)
        yield
    finally:
        if root is not None:
            os.environ.pop(FOLDER_VARIABLE)
            if before is not None:
                os.environ[FOLDER_VARIABLE] = before
