"""Learned inverse kinematics in use: any model of the table behind the environments' seam.

A model guesses, some Newton steps refine, and what is out of reach gets the joints that bring the
tool nearest. Joint limits are kept whatever the model says.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import InverseModel, load_model
from saver_envs.modelling.refinement import Refinement
from saver_envs.modelling.shipped import shipped_model
from saver_envs.modelling.solvers import judge, nearest, newton
from saver_envs.robots.description import Robot
from saver_envs.simulation import ArmState

#: Newton steps behind a shipped model's guess.
REFINEMENT = 2


@dataclass(frozen=True)
class Solution:
    """Joints for targets.

    :param joints: (n, dof), radians and metres, within the joint limits.
    :param error: (n,) distance of the tool from its target, metres; NaN-free.
    :param reachable: (n,) whether the target is reached to 1 mm and 0.01 rad.
    """

    joints: FloatArray
    error: FloatArray
    reachable: NDArray[np.bool_]


class LearnedInverseKinematics:
    """Set-points to joint targets by a learned model; an `saver_envs.control.InverseKinematics`.

    Pass it to an environment: ``gymnasium.make("MicoPush-v0", inverse_kinematics=learned)``.

    :param robot: the arm that will be driven, by name or as its description.
    :param model: a fitted model, the path of a weight file, or None for the shipped one.
    :param refinement: Newton steps behind the model's guess; 0 leaves it as it is.
    :param nearest: whether targets that the refined guess misses are searched for further, up to
        the nearest reachable point; by default where there is a refinement.
    :raises ValueError: for a model of another arm or task, or a negative number of steps.
    """

    def __init__(
        self,
        robot: str | Robot,
        model: InverseModel | str | Path | None = None,
        refinement: int = REFINEMENT,
        nearest: bool | None = None,
    ) -> None:
        name = robot if isinstance(robot, str) else robot.name
        if model is None:
            model = shipped_model(name)
        elif not isinstance(model, InverseModel):
            model = load_model(Path(model), name, "ik")
        if model.robot != name or model.task != "ik":
            raise ValueError(
                f"model={model.name!r} is of robot {model.robot!r}, task {model.task!r}: "
                f"{name!r} needs inverse kinematics of its own"
            )
        if refinement < 0:
            raise ValueError(f"refinement={refinement!r}: must not be below 0")
        self.model, self.arm = model, model.arm
        self.refinement = refinement
        self._nearest = refinement > 0 if nearest is None else nearest
        self._chain = self.arm.tool_chain
        self._refine = Refinement(self.arm)
        #: Which targets of the latest call were out of reach: its leading shape, (n, arms).
        self.unreachable: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def __call__(self, state: ArmState, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof); see `saver_envs.control.InverseKinematics`.

        What the refined guess misses by more than 8 mm or 30 mrad, or reaches on another branch
        than that of the present joints, gets damped steps from the present joints; it counts as out
        of reach if it is still missed: the next call goes on from there.
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
            orientation take (n, 6) as well, with the rotation vector from tool-down. Values that
            are not finite are refused.
        :param present: (n, dof) the joints now: models that ask for them need them, and endless
            joints turn the shorter way from them.
        :raises ValueError: for a wrong shape or a value that is not finite.
        """
        targets = self._full(targets)
        guess = self.model.predict(targets, present)
        if present is not None:
            now = np.asarray(present, dtype=np.float64)
            guess = self._refine.settled(guess, now, still=self.refinement > 0)
        joints = newton(self.arm, targets, guess, self.refinement, self._chain)
        found = judge(targets, joints, self._chain)
        reached = found.reached
        if self._nearest and not reached.all():
            missed = np.flatnonzero(~reached)
            start = (
                joints[missed]
                if present is None
                else self._nearer(targets[missed], joints[missed], present[missed])
            )
            better = nearest(self.arm, targets[missed], start, self._chain)
            joints[missed], reached[missed] = better.joints, better.reached
            error = found.position_error.copy()
            error[missed] = better.position_error
            return Solution(joints, error, reached)
        return Solution(joints, found.position_error, reached)

    def _full(self, targets: FloatArray) -> FloatArray:
        targets = np.asarray(targets, dtype=np.float64)
        size = self.arm.target_size
        if targets.ndim != 2 or targets.shape[1] not in (3, size):
            raise ValueError(f"targets of shape {targets.shape}: must have shape (n, {size})")
        if not np.isfinite(targets).all():
            raise ValueError("targets: every value must be finite")
        if targets.shape[1] < size:
            targets = np.concatenate([targets, np.zeros((len(targets), size - 3))], axis=1)
        return targets

    def _nearer(self, targets: FloatArray, joints: FloatArray, present: FloatArray) -> FloatArray:
        """Of guesses and present joints, those from which the target is nearer."""
        first = judge(targets, joints, self._chain).position_error
        second = judge(targets, present, self._chain).position_error
        return np.where((first <= second)[:, None], joints, present)
