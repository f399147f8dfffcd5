"""The bench of chapter 8: two arms, a person, a camera; and what the person goes through."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.assembly import ENV_ID
from saver_advisors.integration.bench import EpisodesBench, Truth
from saver_envs.cameras.one_pass import OnePassCamera
from saver_envs.cameras.rgbd import KINECT_V2, measured_depth
from saver_envs.episodes import Episodes
from saver_envs.people.bench import CAMERA
from saver_envs.people.patient import Patient
from saver_envs.people.stretcher import STRETCHER
from saver_envs.registration import make_episodes
from saver_envs.simulation import CONTACT_SAMPLES, SUBSTEPS

#: Substeps between two samples of what the torso goes through: 100 Hz, as the environment has it.
_SAMPLE_EVERY: Final = SUBSTEPS // CONTACT_SAMPLES
#: Added to a trial's seed for the noise of its camera, which is not the episode's randomness.
_CAMERA_SEED: Final = 7_919


class WristBench(EpisodesBench):
    """An episode of `WristPush-v0` with its camera.

    :param episodes: one episode; made anew where None
    :raises ValueError: for an environment without a person
    """

    def __init__(self, episodes: Episodes | None = None) -> None:
        super().__init__(make_episodes(ENV_ID) if episodes is None else episodes)
        if self.episodes.patient is None:
            raise ValueError("episodes: nobody lies there; take those of WristPush-v0")
        self._patient: Patient = self.episodes.patient
        self._camera: OnePassCamera | None = None
        self._body = -1
        self._data: mujoco.MjData | None = None
        self._random = np.random.default_rng()
        self._force = 0.0
        #: What the torso has gone through since the last look: newtons, metres.
        self.peak_force = 0.0
        self.displacement = 0.0
        #: The highest force before that look, for those who only watch.
        self.last_peak = 0.0

    def reset(self, seed: int) -> None:
        """Begin a trial, drawn from a seed, the camera's noise included."""
        super().reset(seed)
        self._random = np.random.default_rng(seed + _CAMERA_SEED)
        self._force = self.peak_force = self.displacement = self.last_peak = 0.0

    def _after_substeps(self) -> None:
        if self.substeps % _SAMPLE_EVERY:
            return
        readings = self._patient.readings()
        self._force = float(readings["torso_force"][0])
        self.peak_force = max(self.peak_force, self._force)
        self.displacement = max(self.displacement, float(readings["torso_displacement"][0]))

    def taken_peaks(self) -> tuple[float, float]:
        """The highest torso force (N) and displacement (m) since the last call."""
        peaks = self.peak_force, self.displacement
        self.last_peak = self.peak_force
        self.peak_force = self.displacement = 0.0
        return peaks

    def torso_force(self) -> float:
        """What presses on the person's trunk now, newtons."""
        return self._force

    def truth(self) -> Truth:
        """Tell where wrists, hips and targets are."""
        wrists = self.episodes.object_state()
        targets = self.episodes.simulation.to_world(self.episodes.target)[0]
        return Truth(
            wrists=wrists.world_position[0],
            wrist_velocity=wrists.linear_velocity[0],
            wrist_quaternion=wrists.quaternion[0],
            wrist_angular_velocity=wrists.angular_velocity[0],
            hips=self._patient.hips()[0],
            targets=targets,
        )

    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Take a picture from above, with the noise of the depth sensor."""
        camera, data = self._camera_of(int(self._patient.people.body[0]))
        data.qpos[:] = self.episodes.simulation.qpos[0]
        mujoco.mj_kinematics(camera.model, data)
        mujoco.mj_camlight(camera.model, data)
        rgb, exact = camera.capture(data)
        return rgb, measured_depth(exact, KINECT_V2, self._random)

    def _camera_of(self, body: int) -> tuple[OnePassCamera, mujoco.MjData]:
        """The camera over a body, the stretcher where the person was laid down."""
        if self._camera is None or self._data is None or body != self._body:
            self.close()
            self._camera = OnePassCamera(self.episodes.scene.drawing_model(body), CAMERA, KINECT_V2)
            self._data = mujoco.MjData(self._camera.model)
            self._body = body
        model, people = self._camera.model, self._patient.people
        stretcher, yaw = model.body(STRETCHER).id, people.yaw[0] / 2
        model.body_pos[stretcher, :2] = people.hips[0]
        model.body_quat[stretcher] = (np.cos(yaw), 0, 0, np.sin(yaw))
        return self._camera, self._data

    def close(self) -> None:
        """Free the graphics context, if one was opened."""
        if self._camera is not None:
            self._camera.close()
            self._camera = self._data = None
