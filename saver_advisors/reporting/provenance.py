"""The origin of results: command, commit, versions and machine, for every JSON file."""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from saver_envs.files import written_whole

PACKAGES = {
    "saver_envs": "saver-envs",
    "torch": "torch",
    "sb3": "stable-baselines3",
    "sb3_contrib": "sb3-contrib",
    "mujoco": "mujoco",
    "gymnasium": "gymnasium",
    "numpy": "numpy",
}
COMMAND_VARIABLE = "SAVER_COMMAND"
"""Environment variable with the command that a process works for, if not its own command line."""
COMMIT_VARIABLE = "SAVER_COMMIT"
"""Environment variable with the commit, for files without a repository, as on a cluster's node."""
REPOSITORY = Path(__file__).resolve().parents[2]
PAGE_VERSIONS = {"MuJoCo": "mujoco", "PyTorch": "torch", "Stable-Baselines3": "sb3"}
"""Packages whose versions a page states: name on the page -> key in :func:`provenance`."""
VECTOR_INSTRUCTIONS = {
    "avx2": "AVX2",
    "avx512f": "AVX-512",
    "avx512_bf16": "AVX-512 bfloat16",
    "amx_bf16": "AMX bfloat16",
    "asimd": "NEON",
    "sve": "SVE",
    "bf16": "bfloat16",
}
"""Instruction sets (by Linux's names) that determine the speed of matrix products; processors with
different ones can have the same name."""


def provenance() -> dict[str, Any]:
    """Describe the origin of a result.

    :return: JSON-able: ``command``, ``commit`` (None outside a checkout, with "-dirty" if files
        differ from it), ``time`` (UTC, ISO 8601), ``versions`` and ``machine``
    """
    return {
        "command": command_line(),
        "commit": _commit(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version()}
        | {name: _version(package) for name, package in PACKAGES.items()},
        "machine": {
            "cpu": _cpu_fact("model name") or platform.processor() or platform.machine(),
            "vector_instructions": _vector_instructions(),
            "cores": os.cpu_count(),
            "system": f"{platform.system()} {platform.machine()}",
            **_gpu(),
        },
    }


def machine_in_words(machine: Mapping[str, Any]) -> str:
    """Describe a machine for a page.

    :param machine: of a :func:`provenance`; older ones lack the vector instructions
    """
    vectors = " and ".join(machine.get("vector_instructions", []))
    told = [f"{machine['cpu']} with {vectors}" if vectors else str(machine["cpu"])]
    told.append(f"{machine['cores']} cores")
    return ", ".join([*told, *([machine["gpu"]] if "gpu" in machine else [])])


def measured_at(figures: Mapping[str, Any], packages: Mapping[str, str] = PAGE_VERSIONS) -> str:
    """Say when, at which commit, how and on which machine figures were measured.

    :param figures: content of a result file
    :param packages: packages whose versions to state, in the form of :data:`PAGE_VERSIONS`
    :return: a sentence; empty without provenance
    """
    origin = figures.get("provenance")
    if not origin:
        return ""
    versions = [f"{name} {origin['versions'][key]}" for name, key in packages.items()]
    return (
        f"Measured {origin['time']} at commit `{origin['commit']}` with `{origin['command']}` on "
        f"{', '.join([machine_in_words(origin['machine']), *versions])}."
    )


def load_averages() -> list[float] | None:
    """Return the system's load averages, which show other work; None if it has none."""
    return [round(one, 2) for one in os.getloadavg()] if hasattr(os, "getloadavg") else None


def write_json_atomic(path: str | Path, data: Any) -> None:
    """Write a JSON file atomically: a reader sees the old or the new content.

    :param path: of the file
    :param data: JSON-able, without NaN and infinity, which are not valid JSON
    :raises ValueError: for NaN or infinity
    :raises TypeError: for a value that JSON cannot represent
    :raises OSError: if it cannot be written; an old file is then intact
    """
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    with written_whole(path) as file:
        file.write(text.encode("utf-8"))


def portable_command(command: str) -> str:
    """Remove the folders of this machine from a command line.

    :param command: a shell command; its first word is the program
    :return: the command, with the program and absolute paths reduced to their file names
    """
    program, *words = shlex.split(command)
    named = [portable_word(word) for word in words]
    package, name = Path(program).parts[-2:] if "/" in program else ("", program)
    if name != "__main__.py":
        return shlex.join([name, *named])
    first = ["saver"] if package == "cli" else ["python", "-m", package]
    return shlex.join([*first, *named])


def portable_word(word: str) -> str:
    """Reduce an absolute path, also that of a setting ``name=path``, to its file name.

    :param word: of a command line, or a setting's value
    """
    name, equals, value = word.rpartition("=")
    return f"{name}{equals}{Path(value).name}" if Path(value).is_absolute() else word


def command_line() -> str:
    """Return the command that this process works for, without the folders of the machine."""
    return os.environ.get(COMMAND_VARIABLE) or portable_command(shlex.join(sys.argv))


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Return the commit of the checkout, or that of `COMMIT_VARIABLE`.

    It is None for an installed package, even inside another repository.
    """
    top_level = _git("rev-parse", "--show-toplevel")
    if top_level is None or Path(top_level).resolve() != REPOSITORY:
        return os.environ.get(COMMIT_VARIABLE)
    commit = _git("rev-parse", "HEAD")
    if commit is not None and _git("status", "--porcelain"):
        commit += "-dirty"
    return commit


def _git(*arguments: str) -> str | None:
    """Return the output of a git command in the repository, None if it fails."""
    try:
        return subprocess.run(
            ["git", "-C", str(REPOSITORY), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _gpu() -> dict[str, str]:
    """Return the name of the GPU, if this process uses one."""
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        return {}
    return {"gpu": torch.cuda.get_device_name()}


def _vector_instructions() -> list[str]:
    """Return those of :data:`VECTOR_INSTRUCTIONS` that the processor has, as far as is known."""
    has = (_cpu_fact("flags") or _cpu_fact("Features")).split()
    return [words for name, words in VECTOR_INSTRUCTIONS.items() if name in has]


def _cpu_fact(name: str) -> str:
    """Return a property of the first processor on Linux, or an empty string."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == name:
                return value.strip()
    except OSError:
        pass
    return ""
