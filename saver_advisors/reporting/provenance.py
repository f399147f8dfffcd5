"""Where a measurement comes from: command, commit, versions and machine, for every JSON file."""

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
    "torch": "torch",
    "sb3": "stable-baselines3",
    "sb3_contrib": "sb3-contrib",
    "mujoco": "mujoco",
    "gymnasium": "gymnasium",
    "numpy": "numpy",
}
COMMAND_VARIABLE = "SAVER_COMMAND"
"""The environment variable that tells a process which command it works for, where that is not its
own command line."""
COMMIT_VARIABLE = "SAVER_COMMIT"
"""The environment variable that names the commit where the files are without their repository, as
on a cluster's node."""
REPOSITORY = Path(__file__).resolve().parents[2]
VECTOR_INSTRUCTIONS = {
    "avx2": "AVX2",
    "avx512f": "AVX-512",
    "avx512_bf16": "AVX-512 bfloat16",
    "amx_bf16": "AMX bfloat16",
    "asimd": "NEON",
    "sve": "SVE",
    "bf16": "bfloat16",
}
"""Of what a processor can do, by Linux's names, what decides how fast products of matrices are:
processors that do not share it share a name."""


def provenance() -> dict[str, Any]:
    """What is needed to say how a result came about.

    :return: JSON-able: ``command``, ``commit`` (None outside a checkout, "-dirty" appended where
        files differ from it), ``time`` (UTC, ISO 8601), ``versions`` and ``machine``
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
    """A machine as a page names it.

    :param machine: of a :func:`provenance`; older ones do not tell the vector instructions
    """
    vectors = " and ".join(machine.get("vector_instructions", []))
    told = [f"{machine['cpu']} with {vectors}" if vectors else str(machine["cpu"])]
    told.append(f"{machine['cores']} cores")
    return ", ".join([*told, *([machine["gpu"]] if "gpu" in machine else [])])


def load_averages() -> list[float] | None:
    """The system's load averages, which say whether it had other work; None where it has none."""
    return [round(one, 2) for one in os.getloadavg()] if hasattr(os, "getloadavg") else None


def write_json_atomic(path: str | Path, data: Any) -> None:
    """Write a JSON file as a whole: a reader sees the old content or the new, never a part.

    :param path: of the file
    :param data: JSON-able; NaN and infinity are refused, as no other program could read them
    :raises ValueError: for NaN or infinity
    :raises TypeError: for what JSON does not know
    :raises OSError: when it cannot be written; an old file is then intact
    """
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    with written_whole(path) as file:
        file.write(text.encode("utf-8"))


def portable_command(command: str) -> str:
    """A command line without the folders of the machine it ran on.

    :param command: words as a shell splits them; the first is the program
    :return: the same, with files and programs that were named from the root by their names alone
    """
    program, *words = shlex.split(command)
    named = (Path(word).name if Path(word).is_absolute() else word for word in words)
    return shlex.join([Path(program).name, *named])


def command_line() -> str:
    """The command that this process works for, without the folders of the machine."""
    return os.environ.get(COMMAND_VARIABLE) or portable_command(shlex.join(sys.argv))


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """The checkout's commit, or the one that the environment names; None for an installed package,
    even inside somebody's repository."""
    top_level = _git("rev-parse", "--show-toplevel")
    if top_level is None or Path(top_level).resolve() != REPOSITORY:
        return os.environ.get(COMMIT_VARIABLE)
    commit = _git("rev-parse", "HEAD")
    if commit is not None and _git("status", "--porcelain"):
        commit += "-dirty"
    return commit


def _git(*arguments: str) -> str | None:
    """The output of a git command in the repository, or None."""
    try:
        completed = subprocess.run(
            ["git", "-C", str(REPOSITORY), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return completed.stdout.strip()


def _gpu() -> dict[str, str]:
    """The name of the GPU that this process works on, if it does."""
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        return {}
    return {"gpu": torch.cuda.get_device_name()}


def _vector_instructions() -> list[str]:
    """What of :data:`VECTOR_INSTRUCTIONS` the processor has; nothing where the system is silent."""
    has = (_cpu_fact("flags") or _cpu_fact("Features")).split()
    return [words for name, words in VECTOR_INSTRUCTIONS.items() if name in has]


def _cpu_fact(name: str) -> str:
    """What Linux tells about the first processor, or nothing."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == name:
                return value.strip()
    except OSError:
        pass
    return ""
