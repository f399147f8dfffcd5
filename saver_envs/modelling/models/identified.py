"""Dynamics identified from data: masses, centres of mass, friction, damping and armature.

The structure is that of rigid bodies plus the terms of joints and drives; ``mujoco.sysid`` fits the
numbers. Unlike a network, which must learn them everywhere, it needs a few hundred samples.
"""

from __future__ import annotations

import importlib
import io
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from saver_envs.modelling.arms import Task
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models.base import History, InverseModel, Progress, Training
from saver_envs.modelling.newton_euler import Links, inverse_dynamics

#: Samples used by the fit, evenly spaced over those that are given.
SAMPLES = 1000
_ITERATIONS = 15
#: Coulomb friction changes sign over this fraction of a joint's usual speed.
_SMOOTHING = 0.02
#: Bounds of the fit: factors of Appendix A's masses, and displacements of its centres of mass (m).
_MASS_BOUND, _CENTRE_BOUND = (0.3, 3.0), 0.25


class Identified(InverseModel):
    """Newton-Euler with fitted inertia, friction, damping and armature.

    :raises ValueError: for inverse kinematics, or an arm that Appendix A does not list.
    """

    name: ClassVar[str] = "identified"
    tasks: ClassVar[tuple[Task, ...]] = ("id",)

    def __init__(self, robot: str, task: Task) -> None:
        super().__init__(robot, task)
        if self.arm.appendix_links is None:
            raise ValueError(f"robot={robot!r}: Appendix A has no inertia for it to start from")
        self._start = self.arm.appendix_links()
        self._values: dict[str, FloatArray] | None = None

    def _fit(
        self, inputs: FloatArray, outputs: FloatArray, training: Training, progress: Progress
    ) -> History:
        """Fit; of the training only the seed and the validation share are used.

        :raises ImportError: without the extra ``modelling``, which installs mujoco's ``sysid``.
        """
        held, used = training.split(len(inputs), np.random.default_rng(training.seed))
        used = np.sort(used)[:: max(1, len(used) // SAMPLES)]
        self._values = self._identify(inputs[used], outputs[used])
        history = History()
        history.add(self.predict(inputs[held]) - outputs[held])
        return history

    def _identify(self, inputs: FloatArray, outputs: FloatArray) -> dict[str, FloatArray]:
        # Not by an import statement: through the typed sub-package mypy would check all of mujoco.
        sysid: Any = importlib.import_module("mujoco.sysid")

        dof = self.output_size
        speed = inputs[:, dof : 2 * dof].std(axis=0)
        rate = inputs[:, 2 * dof :].std(axis=0)
        scale = outputs.std(axis=0)
        smoothing = {"speed": _SMOOTHING * speed}
        zero = np.zeros(dof)
        bound = np.full(3 * dof, _CENTRE_BOUND)
        parameters = sysid.ParameterDict()
        # Friction, damping and armature: up to twice the usual torque at the usual motion.
        bounds = {
            "mass": (np.ones(dof), *(np.full(dof, factor) for factor in _MASS_BOUND)),
            "centre": (np.zeros(3 * dof), -bound, bound),
            "friction": (0.1 * scale, zero, 2 * scale),
            "damping": (0.1 * scale / speed, zero, 2 * scale / speed),
            "armature": (0.1 * scale / rate, zero, 2 * scale / rate),
        }
        for name, initial_and_bounds in bounds.items():
            parameters.add(sysid.Parameter(name, *initial_and_bounds))
        ends = np.cumsum([len(initial) for initial, *_ in bounds.values()])

        def values_of(column: FloatArray) -> dict[str, FloatArray]:
            parts = np.split(column, ends[:-1])
            return {**dict(zip(bounds, parts, strict=True)), **smoothing}

        def residual(x: FloatArray, _: Any) -> tuple[list[FloatArray], None, None]:
            rows = [
                ((self._torque(inputs, values_of(column)) - outputs) / scale).ravel()
                for column in x.reshape(len(x), -1).T
            ]
            result = np.stack(rows, axis=-1) / np.sqrt(outputs.size)
            return [result if x.ndim > 1 else result[:, 0]], None, None

        # It prints progress to the stream even with `verbose=False`.
        _, result = sysid.optimize(
            parameters,
            residual,
            verbose=False,
            max_iters=_ITERATIONS,
            x_scale="jac",
            output=io.StringIO(),
        )
        return values_of(np.ravel(result.x))

    def _predict(self, inputs: FloatArray, present: FloatArray | None) -> FloatArray:
        return self._torque(inputs, self._fitted(self._values))

    def _torque(self, inputs: FloatArray, values: dict[str, FloatArray]) -> FloatArray:
        position, velocity, acceleration = np.split(inputs, 3, axis=1)
        start, mass = self._start, values["mass"]
        links = Links(
            start.mass * mass,
            start.centre + values["centre"].reshape(-1, 3),
            start.inertia * mass[:, None, None],
        )
        torque = inverse_dynamics(self.arm.chain, links, position, velocity, acceleration)
        torque += values["friction"] * np.tanh(velocity / values["speed"])
        torque += values["damping"] * velocity + values["armature"] * acceleration
        return torque

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        values = self._fitted(self._values)
        return {name: torch.from_numpy(one) for name, one in values.items()}, {}

    def _restore(self, tensors: dict[str, Tensor], settings: dict[str, Any]) -> None:
        self._values = {name: one.numpy() for name, one in tensors.items()}
