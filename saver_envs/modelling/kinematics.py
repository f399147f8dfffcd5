"""Use any inverse model as the inverse kinematics of the environments.

A model predicts, Newton steps refine, and targets out of reach get the joints that bring the tool
nearest. Joints stay within their limits for any prediction.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import InverseModel
from saver_envs.modelling.refinement import Refinement
from saver_envs.modelling.shipped import model_for
from saver_envs.modelling.solvers import Solution, evaluate, nearest, newton
from saver_envs.robots.description import Robot
from saver_envs.simulation import ArmState

#: Newton steps after a shipped model's guess.
REFINEMENT = 2


class LearnedInverseKinematics:
    """Set-points to joint targets by a learned model; an `saver_envs.control.InverseKinematics`.

    Pass it to an environment: ``gymnasium.make("MicoPush-v0", inverse_kinematics=learned)``.

    :param robot: the arm to drive, by name or by its description.
    :param model: a fitted model, the path of a weight file, ``gan`` for the shipped adversarial
        model, or None for the shipped network.
    :param refinement: Newton steps after the model's guess; 0 leaves the guess unchanged.
    :param nearest: whether :meth:`solve` searches for the nearest reachable point where the refined
        guess misses its target; by default where there is a refinement.
    :raises ValueError: for a model of another arm or task, or a negative number of steps.
    """

    def __init__(
        self,
        robot: str | Robot,
        model: InverseModel | str | Path | None = None,
        refinement: int = REFINEMENT,
        nearest: bool | None = None,
    ) -> None:
        self.model = model_for(robot if isinstance(robot, str) else robot.name, "ik", model)
        if refinement < 0:
            raise ValueError(f"refinement={refinement!r}: must not be below 0")
        self.arm = self.model.arm
        self.refinement = refinement
        self._nearest = refinement > 0 if nearest is None else nearest
        self._chain = self.arm.tool_chain
        self._refine = Refinement(self.arm)
        #: Which targets of the latest call were out of reach, (n, arms).
        self.unreachable: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def __call__(self, state: ArmState, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof); see `saver_envs.control.InverseKinematics`.

        If the refined guess misses its target by more than 8 mm or 30 mrad, or reaches it on
        another branch than the present joints', damped steps start from the present joints instead.
        Targets that these miss count as out of reach; the next call continues from there.
        """
        targets = self._full(target.reshape(-1, 3))
        present = state.joint_position.reshape(-1, self.arm.dof)
        if self.refinement:
            guess = self.model.predict(targets, present)
            joints, unreachable = self._refine(targets, guess, present, self.refinement)
        else:
            solution = self.solve(targets, present)
            joints, unreachable = solution.joints, ~solution.reachable
        self.unreachable = unreachable.reshape(target.shape[:-1])
        return joints.reshape(*target.shape[:-1], self.arm.dof)

    def solve(self, targets: FloatArray, present: FloatArray | None = None) -> Solution:
        """Return joints for targets.

        :param targets: (n, 3) tool positions in the base frame, metres; arms that hold their
            orientation also accept (n, 6), with the rotation vector from tool-down.
        :param present: (n, dof) present joints: required by some models; continuous joints take
            the shorter way from them.
        :raises ValueError: for a wrong shape or a value that is not finite.
        """
        targets = self._full(targets)
        guess = self.model.predict(targets, present)
        if present is not None:
            now = np.asarray(present, dtype=np.float64)
            guess = self._refine.settled(guess, now, still=self.refinement > 0)
        joints = newton(self.arm, targets, guess, self.refinement, self._chain)
        found = evaluate(targets, joints, self._chain)
        missed = np.flatnonzero(~found.reachable)
        if self._nearest and len(missed):
            start = joints[missed]
            if present is not None:
                here = evaluate(targets[missed], present[missed], self._chain).error
                start = np.where((found.error[missed] <= here)[:, None], start, present[missed])
            better = nearest(self.arm, targets[missed], start, self._chain)
            found.joints[missed] = better.joints
            found.error[missed] = better.error
            found.orientation_error[missed] = better.orientation_error
        return found

    def _full(self, targets: FloatArray) -> FloatArray:
        """Return targets (n, target_size); positions alone stand for tool-down poses."""
        targets = np.asarray(targets, dtype=np.float64)
        size = self.arm.target_size
        if targets.ndim != 2 or targets.shape[1] not in (3, size):
            raise ValueError(f"targets of shape {targets.shape}: must have shape (n, {size})")
        if not np.isfinite(targets).all():
            raise ValueError("targets: every value must be finite")
        if targets.shape[1] < size:
            targets = np.concatenate([targets, np.zeros((len(targets), size - 3))], axis=1)
        return targets
