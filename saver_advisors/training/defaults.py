"""What a run in an environment starts from: `zoo_configs/saver.yml`, one entry an environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

FILE: Final = "saver.yml"
ANY_ENVIRONMENT: Final = "default"


def defaults_path() -> Path:
    """The file: beside this module in an installed package, in ``zoo_configs/`` in a checkout."""
    installed = Path(__file__).parents[1] / FILE
    checkout = Path(__file__).resolve().parents[2] / "zoo_configs" / FILE
    return installed if installed.is_file() else checkout


def default_settings(env_id: str) -> dict[str, Any]:
    """What is said about an environment.

    :param env_id: its id
    :return: fields of a run's configuration, with ``env_id``
    """
    return read_settings(defaults_path(), env_id)


def read_settings(path: Path, env_id: str | None) -> dict[str, Any]:
    """The settings in a file: all of it, or the entry of an environment where it has such entries.

    :param path: a YAML or JSON file
    :param env_id: the environment that is asked for, None where the file shall say
    :return: fields of a run's configuration, with ``env_id``
    :raises ValueError: where the file is no YAML or says nothing about the environment
    :raises OSError: where it cannot be read
    """
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is no YAML: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold names and values")
    by_environment = all(isinstance(value, dict) for value in content.values())
    if by_environment:
        entry = content.get(env_id, content.get(ANY_ENVIRONMENT))
        if env_id is None or entry is None:
            raise ValueError(
                f"{path} has no entry for {env_id or 'no environment'}; it has "
                f"{', '.join(map(str, content))}"
            )
        content = entry
    if env_id is None and "env_id" not in content:
        raise ValueError(f"{path} names no env_id: say which environment to train in")
    return {**content, "env_id": env_id or content["env_id"]}
