"""Learned inverse kinematics in use: any model of the table behind the environments' seam.

A model guesses, some Newton steps refine, and what is out of reach gets the joints that bring the
tool nearest. Joint limits are kept whatever the model says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import bounded, least_squares_step
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.models import InverseModel, load_model
from saver_envs.modelling.solvers import error_at, judge, nearest, newton
from saver_envs.robots.description import Robot
from saver_envs.simulation import ArmState

#: Weights that come along, one file an arm.
WEIGHTS = Path(__file__).parent / "weights"
#: Newton steps behind a shipped model's guess.
REFINEMENT = 2
_TURN = 2 * math.pi
#: Squared damping of the steps with the present Jacobian, next to nothing.
_DAMPING = 1e-6
#: Guesses farther off than this (m, rad), those that a step would change by more than this (rad,
#: m), as out of reach, and those that meet a joint limit are left to `solve`.
_FAR, _LONG = 0.05, 0.3
#: Unless they are this near after all (m, rad).
_ENOUGH = 0.005
#: Errors below this need no further step (m, rad): the first has made them about a tenth.
_CLOSE = 0.02


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


def shipped_model(robot: str) -> InverseModel:
    """Return the inverse kinematics that comes along for an arm.

    :raises ValueError: for an arm without one.
    """
    path = WEIGHTS / f"{robot}-ik.safetensors"
    if not path.is_file():
        names = sorted(one.name.removesuffix("-ik.safetensors") for one in WEIGHTS.glob("*-ik.*s"))
        raise ValueError(f"robot={robot!r}: weights come along for {', '.join(names) or 'none'}")
    return load_model(path, robot, "ik")


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
        self._endless = ~np.isfinite(self.arm.joint_lower)
        self._idle = np.array(self.arm.idle_joints, dtype=np.intp)
        self._idle_at = np.asarray(self.arm.robot.home)[self._idle]
        #: Which targets of the latest call were out of reach: its leading shape, (n, arms).
        self.unreachable: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def __call__(self, state: ArmState, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof); see `saver_envs.control.InverseKinematics`.

        The refinement uses the Jacobian of the present joints, which the state has anyway: a
        set-point is a step of some centimetres away. Where that is not enough, :meth:`solve` is.
        """
        dof = self.arm.dof
        present = state.joint_position.reshape(-1, dof)
        targets = self._full(target.reshape(-1, 3))
        if self.refinement:
            jacobian = state.jacobian.reshape(-1, 6, dof)[:, : self.arm.target_size]
            joints, left = self._chord(targets, present, jacobian)
        else:
            joints, left = self._guess(targets, present), np.ones(len(targets), dtype=bool)
        unreachable = np.zeros(len(targets), dtype=bool)
        if left.any():
            solution = self.solve(targets[left], present[left])
            joints[left], unreachable[left] = solution.joints, ~solution.reachable
        self.unreachable = unreachable.reshape(target.shape[:-1])
        return joints.reshape(*target.shape[:-1], dof)

    def _chord(
        self, targets: FloatArray, present: FloatArray, jacobian: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Refine guesses by steps with one Jacobian; say for which that does not do (n,)."""
        joints = self._guess(targets, present)
        left = np.zeros(len(targets), dtype=bool)
        rows: NDArray[np.intp] | slice = slice(None)
        for _ in range(self.refinement):
            error = error_at(joints[rows], targets[rows], self._chain)
            step = least_squares_step(jacobian[rows], error, _DAMPING)
            wanted = joints[rows] + step
            joints[rows] = bounded(wanted, self.arm.joint_lower, self.arm.joint_upper)
            largest = np.abs(error).max(axis=1)
            if largest.max() > _FAR or np.abs(step).max() > _LONG or (joints[rows] != wanted).any():
                bad = (largest > _FAR) | (np.abs(step).max(axis=1) > _LONG)
                left[rows] |= bad | (joints[rows] != wanted).any(axis=1)
            if largest.max() < _CLOSE:
                break
            rows = np.arange(len(targets))[rows][largest >= _CLOSE]
        if left.any():
            # Most of these are near enough all the same: a glance is cheaper than a search.
            doubtful = np.flatnonzero(left)
            error = error_at(joints[doubtful], targets[doubtful], self._chain)
            left[doubtful] = np.abs(error).max(axis=1) > _ENOUGH
        return joints, left

    def _guess(self, targets: FloatArray, present: FloatArray | None) -> FloatArray:
        """The model's joints, endless ones nearest to the present, all within the limits."""
        guess = self.model.predict(targets, present)
        if present is not None:
            guess += self._whole_turns(present - guess)
        guess = bounded(guess, self.arm.joint_lower, self.arm.joint_upper)
        if self._idle.size and self.refinement:
            guess[:, self._idle] = self._idle_at
        return guess

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
        guess = self._guess(targets, present)
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

    def _whole_turns(self, difference: FloatArray) -> FloatArray:
        """Whole turns of endless joints that make up most of a difference (n, dof)."""
        return np.where(self._endless, _TURN * np.rint(difference / _TURN), 0.0)

    def _nearer(self, targets: FloatArray, joints: FloatArray, present: FloatArray) -> FloatArray:
        """Of guesses and present joints, those from which the target is nearer."""
        first = judge(targets, joints, self._chain).position_error
        second = judge(targets, present, self._chain).position_error
        return np.where((first <= second)[:, None], joints, present)
