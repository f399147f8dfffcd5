"""Install and run other suites' environments, each in its own virtual environment."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from saver_advisors.benchmark.peers.process import PeerProcess, run_quietly

WORKER: Final = Path(__file__).with_name("worker.py")
#: File in a virtual environment that marks a complete installation.
COMPLETE: Final = "saver-complete.json"


@dataclass(frozen=True)
class Peer:
    """An environment of another suite.

    :param env: its name in the suite
    :param suite: the distribution
    :param n_envs: number of environments per process in the suite's usual use
    :param requirements: pinned packages, so that figures are comparable
    """

    env: str
    suite: str
    n_envs: int
    requirements: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name in tables and messages: two suites have a FetchPush."""
        return f"{self.env} ({self.suite})"


#: The suites in Python fail with MuJoCo 3.12 and later, where its enumerations no longer equal
#: NumPy's integers; robosuite also reads `MjData.qM`, which later versions of 3 lack.
FETCH_PUSH: Final = Peer(
    "FetchPush-v4", "gymnasium-robotics", 64, ("gymnasium-robotics==1.4.2", "mujoco==3.11.0")
)
TWO_ARM_LIFT: Final = Peer("TwoArmLift", "robosuite", 1, ("robosuite==1.5.2", "mujoco==3.3.7"))
#: The same environment in C++, with its own MuJoCo.
ENVPOOL_PUSH: Final = Peer("FetchPush-v4", "envpool", 64, ("envpool==1.2.5",))
PEERS: Final = (FETCH_PUSH, ENVPOOL_PUSH, TWO_ARM_LIFT)


def install(peer: Peer, cache: Path) -> Path:
    """Create the peer's virtual environment, unless it exists.

    :param peer: the suite
    :param cache: folder of the virtual environments
    :return: its Python
    :raises PeerError: if a package cannot be installed
    """
    return environment(cache / peer.suite, [list(peer.requirements)], peer.suite)


def environment(folder: Path, installs: Sequence[Sequence[str]], name: str) -> Path:
    """Create a virtual environment, unless it exists with the same installations.

    :param folder: of the environment
    :param installs: arguments of ``pip install``, one list per call
    :param name: what is installed, for messages
    :return: its Python
    :raises PeerError: if an installation fails
    """
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    complete = folder / COMPLETE
    wanted = json.dumps([list(one) for one in installs])
    if complete.is_file() and complete.read_text(encoding="utf-8") == wanted:
        return python
    print(f"installing {name} into {folder}", flush=True)
    run_quietly([sys.executable, "-m", "venv", "--clear", str(folder)], f"{name}: no environment")
    for words in installs:
        pip = [str(python), "-m", "pip", "install", "--quiet", *words]
        run_quietly(pip, f"{name} cannot be installed")
    complete.write_text(wanted, encoding="utf-8")
    return python


class RunningPeer(PeerProcess):
    """A process of a suite that is timed on request; a context manager.

    :param peer: the suite
    :param python: of its virtual environment
    :raises PeerError: if it does not start
    """

    def __init__(self, peer: Peer, python: Path) -> None:
        super().__init__(peer.name, python, WORKER, peer.suite, peer.env, str(peer.n_envs))
        self.peer = peer
        ready = self.read()
        self.modes: list[str] = ready["modes"]
        self.versions: dict[str, str] = ready["versions"]

    def measure(self, mode: str, seconds: float) -> float:
        """Time a mode.

        :param mode: one of ``modes``
        :param seconds: shortest duration; at least one piece of work is done
        :return: seconds per environment step
        """
        return float(self.ask(f"{mode} {seconds}"))
