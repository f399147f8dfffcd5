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
from saver_envs.modelling.joint_steps import newton_step, search
from saver_envs.modelling.models import InverseModel, load_model
from saver_envs.modelling.multilinear import MultilinearTool
from saver_envs.modelling.shipped import shipped_model
from saver_envs.modelling.solvers import judge, nearest, newton, pose_error
from saver_envs.robots.description import Robot
from saver_envs.simulation import ArmState

#: Newton steps behind a shipped model's guess.
REFINEMENT = 2
_TURN = 2 * math.pi
#: Larger errors of a refined guess get another way to the target (m, rad).
POSITION_ENOUGH, ORIENTATION_ENOUGH = 0.008, 0.03
#: Longest step of a joint (rad, m), the squared damping of one from the present joints, and the
#: greatest number of steps of a search.
_LONG, _DAMPING, _SEARCH = 0.3, 3e-4, 2
#: A step leaves an error of up to a fifth of a metre times its length and the way from where its
#: Jacobian is. Beyond this product (rad^2), as near singular postures, the present joints are the
#: better start.
_UNSURE = 0.02


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
        self._tool = MultilinearTool(self._chain, self.arm.target_size)
        self._lower, self._upper = self.arm.joint_lower[:, None], self.arm.joint_upper[:, None]
        tolerance = np.repeat((POSITION_ENOUGH, ORIENTATION_ENOUGH), 3)[: self.arm.target_size]
        self._enough = tolerance[:, None]
        self._turns = np.where(np.isfinite(self._lower), 0.0, _TURN)
        self._idle = np.array(self.arm.idle_joints, dtype=np.intp)
        self._moving: NDArray[np.intp] | slice = slice(None)
        if self._idle.size:
            self._moving = np.setdiff1d(np.arange(self.arm.dof), self._idle)
        self._idle_at = np.asarray(self.arm.robot.home)[self._idle, None]
        #: Which targets of the latest call were out of reach: its leading shape, (n, arms).
        self.unreachable: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def __call__(self, state: ArmState, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return joint targets (n, arms, dof); see `saver_envs.control.InverseKinematics`.

        The refinement starts with the Jacobian of the present joints, which the state has anyway:
        a set-point is a step of some centimetres away. Where such a step may end too far off, a
        damped one from the present joints takes its place; what that misses by more than 8 mm or
        30 mrad is searched for further, two steps a call, and counts as out of reach if it still
        misses: the next call goes on from there.
        """
        targets = self._full(target.reshape(-1, 3))
        present = np.ascontiguousarray(state.joint_position.reshape(-1, self.arm.dof).T)
        unreachable = np.zeros(len(targets), dtype=bool)
        if self.refinement:
            columns, missed = self._refined(targets, present, state)
            joints, unreachable[missed] = columns.T.copy(), True
        else:
            solution = self.solve(targets, present.T)
            joints, unreachable = solution.joints, ~solution.reachable
        self.unreachable = unreachable.reshape(target.shape[:-1])
        return joints.reshape(*target.shape[:-1], self.arm.dof)

    def _refined(
        self, targets: FloatArray, present: FloatArray, state: ArmState
    ) -> tuple[FloatArray, NDArray[np.intp]]:
        """Refine guesses by a step with the present Jacobian.

        :param targets: (n, target_size).
        :param present: (dof, n).
        :param state: the arms'.
        :return: joints (dof, n), and which columns miss all the same.
        """
        tool, wanted = self._tool, targets.T
        jacobian = state.jacobian.reshape(-1, 6, len(present))[:, : len(wanted), self._moving]
        guess = self._guess(targets, present)
        step = newton_step(jacobian, wanted - tool.pose(tool.features(guess)))
        joints, kept = self._moved(guess, step)
        # What a step leaves is bounded by its length and the way from where its Jacobian is.
        left = np.maximum.reduce(np.abs(step)) * np.maximum.reduce(np.abs(joints - present))
        unsure = np.flatnonzero(~(kept & (left < _UNSURE)))  # a step may be no number
        if not unsure.size:
            return joints, unsure
        lack = pose_error(
            state.tool_position.reshape(-1, 3)[unsure],
            state.tool_rotation.reshape(-1, 3, 3)[unsure],
            targets[unsure],
        )
        start, few = present[:, unsure], jacobian[unsure]
        nearer = self._moved(start, least_squares_step(few, lack, _DAMPING).T)[0]
        joints[:, unsure] = nearer
        way = nearer - start
        left_over = np.abs(lack.T - np.einsum("nrj,jn->rn", few, way[self._moving]))
        short = np.square(way).max(axis=0) < _UNSURE
        far = np.flatnonzero(~(short & (left_over <= self._enough).all(axis=0)))
        if not far.size:
            return joints, far
        joints[:, unsure[far]], error = search(
            tool,
            wanted[:, unsure[far]],
            nearer[:, far],
            (self._lower, self._upper),
            self._enough,
            _SEARCH if self.refinement > 1 else 0,
        )
        return joints, unsure[far[(np.abs(error) > self._enough).any(axis=0)]]

    def _moved(self, joints: FloatArray, step: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Joints (dof, n) after a step of those that move the tool, and which met no limit (n,)."""
        moved = joints.copy()
        moved[self._moving] += bounded(step, -_LONG, _LONG)
        if self._idle.size:
            moved[self._idle] = self._idle_at
        within = bounded(moved, self._lower, self._upper)
        return within, np.logical_and.reduce(within == moved)

    def _guess(self, targets: FloatArray, present: FloatArray | None) -> FloatArray:
        """The model's joints (dof, n), endless ones nearest to the present, within the limits."""
        rows = None if present is None else present.T
        guess = np.ascontiguousarray(self.model.predict(targets, rows).T)
        if present is not None:
            guess += np.rint((present - guess) * (1 / _TURN)) * self._turns
        guess = bounded(guess, self._lower, self._upper)
        if self._idle.size and self.refinement:
            guess[self._idle] = self._idle_at
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
        guess = self._guess(targets, None if present is None else np.asarray(present).T).T
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
