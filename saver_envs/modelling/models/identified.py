"""Dynamics identified from data: masses, centres of mass, friction, damping and armature.

The structure is the rigid body's, plus what joints and drives add; the numbers are fitted by
``mujoco.sysid``. What a network must learn everywhere, this knows from a few hundred samples.
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from saver_envs.modelling.arms import Task
from saver_envs.modelling.inertia import Links
from saver_envs.modelling.models.base import FloatArray, History, InverseModel, Training
from saver_envs.modelling.newton_euler import inverse_dynamics

#: Samples that the fit sees, evenly spaced over those that are given.
SAMPLES = 1000
_ITERATIONS = 15
#: Coulomb friction changes sign over this share of a joint's usual speed.
_SMOOTHING = 0.02
#: Bounds of the fit: masses as shares of Appendix A's, centres of mass about them (m). What joints
#: and drives add may be twice the usual torque at the usual speed or acceleration.
_MASS_BOUND, _CENTRE_BOUND = (0.3, 3.0), 0.25


class Identified(InverseModel):
    """Newton-Euler with fitted inertia, friction, damping and armature.

    :raises ValueError: for inverse kinematics, or an arm that Appendix A does not have.
    """

    name: ClassVar[str] = "identified"

    def __init__(self, robot: str, task: Task) -> None:
        if task != "id":
            raise ValueError(f"task={task!r}: 'identified' is for inverse dynamics alone")
        super().__init__(robot, task)
        if self.arm.appendix_links is None:
            raise ValueError(f"robot={robot!r}: Appendix A has no inertia of it to start from")
        self._start = self.arm.appendix_links()
        self._values: dict[str, FloatArray] | None = None

    def fit(
        self,
        inputs: FloatArray,
        outputs: FloatArray,
        training: Training | None = None,
        progress: Callable[[int, float], None] | None = None,
    ) -> History:
        """Fit; of the training only the seed and the validation share are used.

        :raises ImportError: without the extra ``modelling``, which has mujoco's ``sysid``.
        """
        training = training or Training()
        inputs, outputs = self._samples(inputs, outputs)
        order = np.random.default_rng(training.seed).permutation(len(inputs))
        held_out = max(1, round(training.validation_share * len(inputs)))
        used = np.sort(order[held_out:])
        used = used[:: max(1, len(used) // SAMPLES)]
        self._values = self._identify(inputs[used], outputs[used])
        held = order[:held_out]
        history = History()
        history.add(self.predict(inputs[held]) - outputs[held])
        return history

    def _identify(self, inputs: FloatArray, outputs: FloatArray) -> dict[str, FloatArray]:
        # Not by an import statement: the typed sub-package would have mypy read all of mujoco.
        sysid: Any = importlib.import_module("mujoco.sysid")

        dof = self.output_size
        speed = inputs[:, dof : 2 * dof].std(axis=0)
        rate = inputs[:, 2 * dof :].std(axis=0)
        scale = outputs.std(axis=0)
        zero = np.zeros(dof)
        self._speed = _SMOOTHING * speed
        bounds = {
            "mass": (np.ones(dof), np.full(dof, _MASS_BOUND[0]), np.full(dof, _MASS_BOUND[1])),
            "centre": (
                np.zeros(3 * dof),
                np.full(3 * dof, -_CENTRE_BOUND),
                np.full(3 * dof, _CENTRE_BOUND),
            ),
            "friction": (0.1 * scale, zero, 2 * scale),
            "damping": (0.1 * scale / speed, zero, 2 * scale / speed),
            "armature": (0.1 * scale / rate, zero, 2 * scale / rate),
        }
        parameters = sysid.ParameterDict()
        for name, (first, low, high) in bounds.items():
            parameters.add(sysid.Parameter(name, first, low, high))
        splits = np.cumsum([len(first) for first, _, _ in bounds.values()])[:-1]

        def residual(x: FloatArray, _: Any) -> tuple[list[FloatArray], None, None]:
            columns = x.reshape(len(x), -1).T
            rows = []
            for column in columns:
                values = dict(zip(bounds, np.split(column, splits), strict=True))
                rows.append(((self._torque(inputs, values) - outputs) / scale).ravel())
            result = np.stack(rows, axis=-1) / np.sqrt(outputs.size)
            return [result if x.ndim > 1 else result[:, 0]], None, None

        # Its progress is printed to the given stream, whatever `verbose` says.
        _, result = sysid.optimize(
            parameters,
            residual,
            verbose=False,
            max_iters=_ITERATIONS,
            x_scale="jac",
            output=io.StringIO(),
        )
        fitted = dict(zip(bounds, np.split(np.ravel(result.x), splits), strict=True))
        return {**fitted, "speed": self._speed}

    def predict(self, inputs: FloatArray, present: FloatArray | None = None) -> FloatArray:
        """Return torques; see :class:`InverseModel`."""
        if self._values is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        return self._torque(self._checked(inputs, self.input_size, "inputs"), self._values)

    def _torque(self, inputs: FloatArray, values: dict[str, FloatArray]) -> FloatArray:
        position, velocity, acceleration = np.split(inputs, 3, axis=1)
        start, share = self._start, values["mass"]
        links = Links(
            start.mass * share,
            start.centre + values["centre"].reshape(-1, 3),
            start.inertia * share[:, None, None],
        )
        torque = inverse_dynamics(self.arm.chain, links, position, velocity, acceleration)
        torque += values["friction"] * np.tanh(velocity / self._speed)
        torque += values["damping"] * velocity + values["armature"] * acceleration
        return torque

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        if self._values is None:
            raise ValueError(f"{self.name} of {self.robot} is not fitted")
        return {name: torch.from_numpy(one) for name, one in self._values.items()}, {}

    @classmethod
    def _from_state(
        cls, robot: str, task: Task, tensors: dict[str, Tensor], settings: dict[str, Any]
    ) -> InverseModel:
        model = cls(robot, task)
        model._values = {name: one.numpy() for name, one in tensors.items()}
        model._speed = model._values["speed"]
        return model
