"""Keep episodes on the disk, a file each, until a data set is written from them."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.datasets.recorded_episodes import RecordedEpisode
from saver_envs.files import read_json, written_whole

ABOUT_FILE: Final = "episodes.json"
#: Arrays of an episode that have one name each.
_FLAT: Final = ("actions", "rewards", "terminations", "truncations")
_SEPARATOR: Final = "/"


class EpisodeFolder:
    """Episodes in the order in which they were added; each is on the disk once ``add`` returns.

    A process that is killed loses the episode that it plays, and no other. The next process that
    opens the folder has the episodes that are there, and adds to them.

    :param path: of the folder; created if missing
    :param about: JSON-able; what all the episodes are of
    :raises ValueError: if the folder has episodes of something else; the message names both
    :raises OSError: if it cannot be written to
    """

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self.path = path
        wanted = json.loads(json.dumps(about))
        file = path / ABOUT_FILE
        if file.is_file():
            found = read_json(file)
            if found != wanted:
                raise ValueError(
                    f"{path} has episodes of {_short(found)}, and not of {_short(wanted)}: finish "
                    "those with the same arguments, choose another id, or remove the folder"
                )
            return
        path.mkdir(parents=True, exist_ok=True)
        with written_whole(file) as stream:
            stream.write(json.dumps(wanted, indent=1).encode())

    def __len__(self) -> int:
        return len(self._files())

    def __iter__(self) -> Iterator[RecordedEpisode]:
        return map(_read, self._files())

    @property
    def next_seed(self) -> int:
        """The seed after the newest episode's; 0 without episodes."""
        files = self._files()
        seed = _read(files[-1]).seed if files else None
        return 0 if seed is None else seed + 1

    def add(self, episode: RecordedEpisode) -> None:
        """Write an episode.

        :raises OSError: if it cannot be written; earlier ones are intact
        """
        arrays: dict[str, Any] = {name: getattr(episode, name) for name in _FLAT}
        arrays |= _flattened("observations", episode.observations)
        arrays |= _flattened("infos", episode.infos)
        if episode.seed is not None:
            arrays["seed"] = np.array(episode.seed)
        with written_whole(self.path / f"{len(self):06d}.npz") as stream:
            np.savez(stream, allow_pickle=False, **arrays)

    def remove(self) -> None:
        """Delete the folder with its episodes, if it is there."""
        shutil.rmtree(self.path, ignore_errors=True)

    def _files(self) -> list[Path]:
        return sorted(self.path.glob("*.npz"))


def _short(about: Any) -> str:
    return json.dumps(about)[:300]


def _flattened(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays of a nested mapping by their paths."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        path = f"{name}{_SEPARATOR}{key}"
        flat |= _flattened(path, value) if isinstance(value, Mapping) else {path: value}
    return flat


def _read(path: Path) -> RecordedEpisode:
    """Read an episode.

    :raises ValueError: if the file is damaged; the message names it
    """
    nested: dict[str, Any] = {}
    try:
        with np.load(path, allow_pickle=False) as arrays:
            for name in arrays.files:
                *folders, last = name.split(_SEPARATOR)
                inner = nested
                for folder in folders:
                    inner = inner.setdefault(folder, {})
                inner[last] = arrays[name]
        flat: dict[str, NDArray[Any]] = {name: nested[name] for name in _FLAT}
        return RecordedEpisode(
            observations=nested["observations"],
            infos=nested["infos"],
            seed=int(nested["seed"]) if "seed" in nested else None,
            **flat,
        )
    except (ValueError, LookupError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is not an episode: {error!r}; remove it") from error
