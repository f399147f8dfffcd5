"""Run BlazePose, a third-party pose model, in its own virtual environment."""

from __future__ import annotations

import shutil
import tarfile
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.benchmark.peers.process import PeerError, PeerProcess, run_quietly
from saver_advisors.benchmark.peers.suites import Peer, install

WORKER: Final = Path(__file__).with_name("blazepose_worker.py")
VARIANTS: Final = ("lite", "full", "heavy")
#: The authors' package for web pages, Apache-2.0, which contains the models.
PACKAGE: Final = "@mediapipe/pose@0.5.1675469404"
DETECTOR: Final = "pose_detection.tflite"
RUNTIME: Final = Peer(
    "BlazePose", "blazepose", 1, ("ai-edge-litert==2.3.0", "numpy==2.4.6", "pillow==11.3.0")
)
#: Our joints among the 33 landmarks; the neck is the middle of the shoulders.
_SHOULDERS: Final = (11, 12)
_LANDMARKS: Final = (-1, 0, 12, 14, 16, 11, 13, 15, 24, 26, 28, 23, 25, 27)


def install_blazepose(cache: Path) -> tuple[Path, Path]:
    """Create the virtual environment and fetch the models, unless they exist.

    :param cache: folder of the third-party programs.
    :return: its Python and the models' folder.
    :raises PeerError: if npm is missing or the package cannot be fetched.
    """
    python = install(RUNTIME, cache)
    models = cache / "blazepose-models"
    if not (models / DETECTOR).is_file():
        npm = shutil.which("npm")
        if npm is None:
            raise PeerError("BlazePose's models come with npm, which is not installed")
        with tempfile.TemporaryDirectory() as folder:
            command = [npm, "pack", "--silent", "--pack-destination", folder, PACKAGE]
            run_quietly(command, f"{PACKAGE} cannot be fetched")
            models.mkdir(parents=True, exist_ok=True)
            with tarfile.open(next(Path(folder).glob("*.tgz"))) as archive:
                for member in archive.getmembers():
                    # The only packed asset is the detector.
                    name = DETECTOR if member.name.endswith("assets.data") else member.name
                    file = archive.extractfile(member)
                    if name.endswith(".tflite") and file is not None:
                        (models / Path(name).name).write_bytes(file.read())
    return python, models


class BlazePose(PeerProcess):
    """A running BlazePose model; a context manager.

    :param variant: ``lite``, ``full`` or ``heavy``.
    :param cache: folder of the third-party programs.
    :raises PeerError: if it cannot be installed or does not start.
    """

    def __init__(self, variant: str, cache: Path) -> None:
        python, models = install_blazepose(cache)
        super().__init__("BlazePose", python, WORKER, str(models), variant)
        self._folder = tempfile.TemporaryDirectory()
        self.read()

    def __call__(self, pictures: NDArray[np.uint8]) -> tuple[NDArray[np.float64], float]:
        """Find one person in each picture.

        :param pictures: (n, height, width, 3).
        :return: our joints (n, 14, 3): x, y in pixels and visibility, NaN without a person; and the
            seconds per picture.
        """
        source, target = (Path(self._folder.name) / name for name in ("in.npy", "out.npy"))
        np.save(source, pictures)
        seconds = float(self.ask(f"{source} {target}")["seconds"])
        found = np.load(target, allow_pickle=False).astype(np.float64)
        joints = found[:, _LANDMARKS]
        joints[:, 0] = found[:, _SHOULDERS].mean(axis=1)
        return joints, seconds

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self._folder.cleanup()
