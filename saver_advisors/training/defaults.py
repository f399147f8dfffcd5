"""Default settings of runs: `zoo_configs/saver.yml`, one entry per environment."""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from saver_advisors.training.settings import read_mapping

FILE: Final = "saver.yml"
ANY_ENVIRONMENT: Final = "default"
"""The entry for environments without one of their own; RL Zoo's word."""


def defaults_path() -> Path:
    """Return the path of the file, in an installed package or in a checkout's ``zoo_configs/``."""
    installed = Path(__file__).parents[1] / FILE
    checkout = Path(__file__).resolve().parents[2] / "zoo_configs" / FILE
    return installed if installed.is_file() else checkout


def default_settings(env_id: str) -> dict[str, Any]:
    """Return the default settings of an environment's runs.

    :param env_id: a registered id.
    :return: fields of ``RunConfig``, with ``env_id``.
    """
    return copy.deepcopy(_shipped(env_id))


@functools.cache  # a grid asks for every run
def _shipped(env_id: str) -> dict[str, Any]:
    return read_settings(defaults_path(), env_id)


def read_settings(path: Path, env_id: str | None) -> dict[str, Any]:
    """Read settings from a file: all of it, or an environment's entry if it has entries.

    :param path: a YAML or JSON file.
    :param env_id: the environment; None if the file names it.
    :return: fields of ``RunConfig``, with ``env_id``.
    :raises ValueError: for a file without settings for the environment.
    :raises OSError: for a file that cannot be read.
    """
    content = read_mapping(path)
    if all(isinstance(value, dict) for value in content.values()):
        content = environment_entry(content, env_id, path)
    if env_id is None and "env_id" not in content:
        raise ValueError(f"{path} has no env_id: name the environment to train in")
    return {**content, "env_id": env_id or content["env_id"]}


def environment_entry(
    content: Mapping[str, dict[str, Any]], env_id: str | None, path: Path
) -> dict[str, Any]:
    """Return an environment's entry in the content of a settings file.

    :param content: entries by environment.
    :param env_id: the environment.
    :param path: the file, for the message.
    :return: its entry, or the one for any environment.
    :raises ValueError: for an environment without an entry.
    """
    entry = None if env_id is None else content.get(env_id, content.get(ANY_ENVIRONMENT))
    if entry is None:
        names = ", ".join(map(str, content))
        raise ValueError(f"{path} has no entry for {env_id or 'no environment'}; it has {names}")
    return entry
