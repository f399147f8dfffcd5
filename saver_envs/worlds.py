"""What differs between n episodes: their tasks, models, speeds, delays and sensors' errors."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import SetPointRule, shortened
from saver_envs.randomization.presets import Randomization, Values
from saver_envs.robots.description import Fingers
from saver_envs.sensor_errors import SensorErrors
from saver_envs.simulation import ACTION_DURATION, Simulation
from saver_envs.tasks.contract import Task

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


class Worlds:
    """The worlds of n episodes; without a randomization they are all alike.

    :param task: as the options describe it.
    :param simulation: of its scene.
    :param randomization: what differs.
    :param speed: top speed of the set-points where that does not differ, m/s.
    :param action_size: of all arms.
    """

    def __init__(
        self,
        task: Task,
        simulation: Simulation,
        randomization: Randomization,
        speed: float,
        action_size: int,
    ) -> None:
        n, arms = simulation.n, simulation.scene.arms
        self._task, self._simulation, self._randomization = task, simulation, randomization
        #: Parameter -> (n, size) of what was drawn.
        self.values: Values = randomization.empty(n, task.n_arms)
        self._drawn = np.zeros(n, dtype=bool)
        #: The task of every episode.
        self.tasks: list[Task] = [task] * n
        #: Top speed of the set-points, m/s: one number, or (n, 1, 1).
        self.speed: float | Array = speed
        workspace = task.workspace(arms)
        #: (arms,) lower side of the workspace, metres.
        self._lowest = workspace.lower[:, 2]
        height: Any = None if task.held_height is None else task.held_height + task.table_height
        if randomization:
            self.speed = np.full((n, 1, 1), speed)
            workspace = replace(workspace, lower=np.tile(workspace.lower, (n, 1, 1)))
            height = None if height is None else np.full((n, 1), height)
        #: How Cartesian actions move the set-points of the episodes.
        self.set_points = SetPointRule(workspace, self.speed * ACTION_DURATION, height)
        sizes = {"action_delay": action_size, "observation_delay": task.observation_layout.size}
        #: Name -> (n, longest + 1, size) values that are on their way, in a ring.
        self._lines = {
            name: np.zeros((n, int(longest) + 1, size))
            for name, size in sizes.items()
            if (longest := randomization.greatest(name)) > 0
        }
        #: Name -> (n,) where the latest value is, and by how many actions values are late.
        self._latest = {name: np.zeros(n, dtype=np.intp) for name in self._lines}
        self._late = {name: np.zeros(n, dtype=np.intp) for name in self._lines}
        longest_delays = [line.shape[1] - 1 for line in self._lines.values()]
        kept = sum(longest_delays) if task.observe_pending_motion else 0
        #: (n, kept, arms, 3) displacements of the last actions, the oldest first, metres.
        self._sent = np.zeros((n, kept, task.n_arms, 3))
        self._every = np.arange(n)
        self._errors: SensorErrors | None = None
        if randomization.greatest("sensor_noise") > 0:
            moving = task.fingers is Fingers.ACTUATED
            self._errors = SensorErrors(n, task.observation_layout, moving)

    def draw(self, rows: Rows, generators: Sequence[np.random.Generator]) -> None:
        """Draw the worlds of episodes that begin.

        :param rows: (k,) which episodes.
        :param generators: of all n.
        """
        if not self._randomization:
            return
        own = [generators[row] for row in rows.tolist()]
        for name, values in self._randomization.draw(own, self._task.n_arms).items():
            self.values[name][rows] = values
        self._drawn[rows] = True
        self._give(rows)

    def begin_errors(self, rows: Rows, generators: Sequence[np.random.Generator]) -> None:
        """Start the sensors' errors, after the starts are drawn: these do not depend on sensors.

        :param rows: (k,) episodes that begin.
        :param generators: of all n.
        """
        if self._errors is not None:
            for row in rows.tolist():
                self._errors.begin(row, generators[row])

    def _give(self, rows: Rows) -> None:
        """Give episodes the task, the model and the speed of their values."""
        simulation, rule = self._simulation, self.set_points
        chosen = {name: values[rows] for name, values in self.values.items()}
        for row in rows.tolist():
            values = {name: one[row] for name, one in self.values.items()}
            self.tasks[row] = self._task.varied(values)
        for name, late in self._late.items():
            late[rows] = chosen[name][:, 0]
        if "max_speed" in chosen:
            assert isinstance(self.speed, np.ndarray) and isinstance(rule.longest, np.ndarray)
            self.speed[rows, 0] = chosen["max_speed"]
            rule.longest[rows, 0] = chosen["max_speed"] * ACTION_DURATION
        if "table_height" in chosen:  # workspaces and held hands follow the table
            height = chosen["table_height"]
            rule.workspace.lower[rows, :, 2] = self._lowest + (height - self._task.table_height)
            if isinstance(rule.held_height, np.ndarray):
                assert self._task.held_height is not None
                rule.held_height[rows] = self._task.held_height + height
        self._write_arm_fields(rows, chosen)
        self._task.vary(simulation, rows, chosen)
        simulation.update_constants(rows)

    def _write_arm_fields(self, rows: Rows, values: Values) -> None:
        """Give the arms of episodes their own servos, tool points and joint friction."""
        simulation, scene = self._simulation, self._simulation.scene
        field, base = simulation.per_simulation, scene.model
        every, servos, sites = rows[:, None], scene.arm_ctrl.ravel(), scene.tool_site
        if "servo_stiffness" in values:
            gain = base.actuator_gainprm[servos, 0] * values["servo_stiffness"]
            field("actuator_gainprm")[every, servos, 0] = gain
            field("actuator_biasprm")[every, servos, 1] = -gain
        if "servo_damping" in values:
            damping = base.actuator_biasprm[servos, 2] * values["servo_damping"]
            field("actuator_biasprm")[every, servos, 2] = damping
        if "tool_offset" in values:
            offset = values["tool_offset"].reshape(len(rows), scene.n_arms, 3)
            field("site_pos")[every, sites] = base.site_pos[sites] + offset
        if "joint_friction" in values:
            limits = np.asarray(scene.robot.joint_torque_limits)
            simulation.give_joint_friction(rows, values["joint_friction"][:, :, None] * limits)

    def begin_delays(self, rows: Rows, resting: Array, seen: Array) -> None:
        """Fill the delays of episodes that begin with what an arm at rest sends and sees.

        :param rows: (k,) which episodes.
        :param resting: (k, action size) actions that change nothing.
        :param seen: (k, observation size).
        """
        for name, values in (("action_delay", resting), ("observation_delay", seen)):
            if name in self._lines:
                self._lines[name][rows] = values[:, None]
        self._sent[rows] = 0.0

    def send(self, motion: Array, rows: Rows) -> None:
        """Remember how far actions will move the set-points, for :meth:`pending_motion`.

        :param motion: (n, arms, 3) in [-1, 1].
        :param rows: (k,) which episodes are stepped.
        """
        if self._sent.shape[1]:
            rule = self.set_points
            displacement = shortened(motion * rule.longest, rule.longest)
            if rule.held_height is not None:
                displacement[..., 2] = 0.0
            self._sent[rows, :-1] = self._sent[rows, 1:]
            self._sent[rows, -1] = displacement[rows]

    def pending_motion(self) -> Array:
        """Return the displacements (n, arms, 3) of actions that cannot be seen yet, metres."""
        age = np.arange(self._sent.shape[1])[::-1]
        late = sum(self._late.values(), np.zeros(len(self._sent)))
        pending = age < late[:, None]
        return np.einsum("nk,nkai->nai", pending, self._sent)

    def measured(self, observation: Array, rows: Rows) -> Array:
        """Return observations (n, size) of which those of ``rows`` are what the sensors measure."""
        if self._errors is None:
            return observation
        factor = self.values["sensor_noise"]
        noisy = factor[rows, 0] > 0
        if noisy.all() and len(rows) == len(observation):
            return self._errors.disturb(observation, self._every, factor)
        rows, factor = rows[noisy], factor[rows[noisy]]
        measured = observation.copy()
        measured[rows] = self._errors.disturb(observation[rows], rows, factor)
        return measured

    def delayed(self, name: str, values: Array, rows: Rows) -> Array:
        """Return the values (n, size) that arrive when those of ``rows`` are sent.

        :param name: ``action_delay`` or ``observation_delay``.
        :param values: (n, size).
        :param rows: (k,) which episodes are stepped.
        """
        if name not in self._lines:
            return values
        line, latest, every = self._lines[name], self._latest[name], len(rows) == len(values)
        rows = self._every if every else rows
        now = latest[rows] = (latest[rows] + 1) % line.shape[1]
        line[rows, now] = values if every else values[rows]
        arriving: Array = line[rows, now - self._late[name][rows]]
        if every:
            return arriving
        result = values.copy()
        result[rows] = arriving
        return result

    def get_state(self) -> dict[str, Any]:
        """Return a copy of everything that differs."""
        names = ("values", "_drawn", "_lines", "_latest", "_sent", "_errors")
        return copy.deepcopy({name: getattr(self, name) for name in names})

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to a state that :meth:`get_state` returned."""
        if not self._randomization:
            return
        for name, value in copy.deepcopy(dict(state)).items():
            setattr(self, name, value)
        if self._drawn.any():
            self._give(np.flatnonzero(self._drawn))

    def decorate(self, model: mujoco.MjModel, row: int) -> None:
        """Move the cameras of a drawing model to where they are in an episode."""
        nominal = self._simulation.scene.drawing_model()
        if "camera_position" in self.values:
            model.cam_pos[:] = nominal.cam_pos + self.values["camera_position"][row]
        if "camera_rotation" in self.values:
            for camera in range(model.ncam):
                quaternion = nominal.cam_quat[camera].copy()
                mujoco.mju_quatIntegrate(quaternion, self.values["camera_rotation"][row], 1.0)
                model.cam_quat[camera] = quaternion
