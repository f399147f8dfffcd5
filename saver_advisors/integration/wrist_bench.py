"""The bench of chapter 8: two arms, a person, a camera, and measurements at the torso."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.bench import EpisodesBench, RobotBench
from saver_advisors.integration.casualty import ENV_ID
from saver_advisors.integration.messages import Floats
from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.cameras.rgbd import KINECT_V2, measured_depth
from saver_envs.people.bench import CAMERA
from saver_envs.people.patient import Patient
from saver_envs.registration import make_episodes
from saver_envs.simulation import CONTACT_SAMPLES, SUBSTEPS

#: Substeps between two samples of the torso's force and displacement: 100 Hz, as in the
#: environment.
_SAMPLE_EVERY: Final = SUBSTEPS // CONTACT_SAMPLES
#: Added to a trial's seed for the noise of its camera, which is separate from the episode's
#: randomness.
_CAMERA_SEED: Final = 7_919


class WristBench(EpisodesBench):
    """Run an episode of `casualty.ENV_ID`, with a person and a camera, as a bench."""

    def __init__(self) -> None:
        super().__init__(make_episodes(ENV_ID))
        self._patient = self.episodes.simulation.keep(Patient)
        size = KINECT_V2.width, KINECT_V2.height
        self._camera = SceneRenderer(self.episodes.scene, *size, CAMERA, plain=True)
        self._random = np.random.default_rng()
        #: Peak force (N) and displacement (m) of the torso since the last :meth:`taken_peaks`.
        self._peaks = 0.0, 0.0
        #: The peak force that the last call of :meth:`taken_peaks` returned, for drawing.
        self.last_peak = 0.0

    def reset(self, seed: int) -> None:
        """Begin a trial, drawn from a seed, with the camera's noise."""
        super().reset(seed)
        self._random = np.random.default_rng(seed + _CAMERA_SEED)
        self.torso_force = self.last_peak = 0.0
        self._peaks = 0.0, 0.0

    def _after_substeps(self) -> None:
        if self.substeps % _SAMPLE_EVERY:
            return
        readings = self._patient.readings(self.episodes.memory)
        self.torso_force = float(readings["torso_force"][0])
        displacement = float(readings["torso_displacement"][0])
        self._peaks = max(self._peaks[0], self.torso_force), max(self._peaks[1], displacement)

    def taken_peaks(self) -> tuple[float, float]:
        """Return the peak torso force (N) and displacement (m) since the last call."""
        peaks, self._peaks = self._peaks, (0.0, 0.0)
        self.last_peak = peaks[0]
        return peaks

    def _hips(self, targets: Floats) -> Floats:
        return self._patient.hips()[0]

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Take a picture from above, with the noise of the depth sensor."""
        self._camera.update(self.episodes, 0)
        rgb, exact = self._camera.rgbd()
        return rgb, measured_depth(exact, KINECT_V2, self._random)

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        self._camera.close()


def wrist_bench(bench: RobotBench) -> WristBench:
    """Return a bench that must be a `WristBench`.

    :raises TypeError: for another one.
    """
    if not isinstance(bench, WristBench):
        raise TypeError(f"loop.bench of {type(bench).__name__}: must be a WristBench")
    return bench
