"""What differs between n episodes: their tasks, models, speeds, delays and sensors' errors."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import SetPointRule
from saver_envs.randomization.delays import delay_line, delayed, fill
from saver_envs.randomization.model_fields import move_cameras, write_arm_fields
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
        held = task.held_height
        height = None if held is None else held + task.table_height
        #: How Cartesian actions move the set-points of the episodes.
        self.set_points = SetPointRule(workspace, speed * ACTION_DURATION, height)
        if randomization:
            self.speed = np.full((n, 1, 1), speed)
            lower = np.tile(workspace.lower, (n, 1, 1))
            self.set_points = SetPointRule(
                replace(workspace, lower=lower),
                self.speed * ACTION_DURATION,
                None if height is None else np.full((n, 1), height),
            )
        sizes = {"action_delay": action_size, "observation_delay": task.observation_layout.size}
        self._lines = {
            name: delay_line(n, distribution.ends[1], size)
            for name, size in sizes.items()
            if (distribution := randomization.distribution_of(name)) and distribution.ends[1] > 0
        }
        self._errors: SensorErrors | None = None
        noise = randomization.distribution_of("sensor_noise")
        if noise is not None and noise.ends[1] > 0:
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
        write_arm_fields(simulation, rows, chosen)
        self._task.vary(simulation, rows, chosen)
        simulation.update_constants(rows)

    def begin_delays(self, rows: Rows, resting: Array, seen: Array) -> None:
        """Fill the delays of episodes that begin with what an arm at rest sends and sees.

        :param rows: (k,) which episodes.
        :param resting: (k, action size) actions that change nothing.
        :param seen: (k, observation size).
        """
        for name, values in (("action_delay", resting), ("observation_delay", seen)):
            if name in self._lines:
                fill(self._lines[name], rows, values)

    def arriving(self, actions: Array, rows: Rows) -> Array:
        """Return the actions (n, size) that take effect when those of ``rows`` are sent."""
        return self._through("action_delay", actions, rows)

    def measured(self, observation: Array, rows: Rows) -> Array:
        """Return observations (n, size) of which those of ``rows`` are what the sensors measure."""
        if self._errors is None:
            return observation
        factor = self.values["sensor_noise"][rows]
        noisy = factor[:, 0] > 0
        if not noisy.all():
            rows, factor = rows[noisy], factor[noisy]
        measured = observation.copy()
        measured[rows] = self._errors.disturb(observation[rows], rows, factor)
        return measured

    def arrived(self, observation: Array, rows: Rows) -> Array:
        """Return the measurements (n, size) that arrive when those of ``rows`` are made."""
        return self._through("observation_delay", observation, rows)

    def _through(self, name: str, values: Array, rows: Rows) -> Array:
        if name not in self._lines:
            return values
        result = values.copy()
        result[rows] = delayed(self._lines[name], rows, values[rows], self.values[name])
        return result

    def get_state(self) -> dict[str, Any]:
        """Return a copy of everything that differs."""
        names = ("values", "_drawn", "_lines", "_errors")
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
        move_cameras(model, self._simulation.scene, self.values, row)
