"""Samples for learned inverse kinematics: tool targets over a workspace, and joints for them.

Targets follow cubics through random way-points, like the joints of the paper's trajectories. Each
has a single solution, reached from the home posture along a straight line (see `solvers.reach`):
a function that a network can learn, whereas the paper's data have several solutions for one point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.arms import arm_named
from saver_envs.modelling.arms.description import KinematicArm
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.solvers import reach
from saver_envs.modelling.trajectories import Trajectory

#: Samples from one way-point to the next.
_SAMPLES_PER_WAY = 40
#: Targets solved at once.
_ROWS = 4096


@dataclass(frozen=True)
class WorkspaceSamples:
    """Targets with their joints, in temporal order.

    :param targets: (n, 3) positions, or (n, 6) poses, of the tool that set-points refer to.
    :param joints: (n, dof).
    """

    targets: FloatArray
    joints: FloatArray


def workspace_samples(name: str, count: int, seed: int) -> WorkspaceSamples:
    """Draw samples over an arm's workspace.

    :param name: the arm's name.
    :param count: number of samples.
    :param seed: of the way-points.
    :raises ValueError: for an unknown arm.
    """
    arm, generator = arm_named(name), np.random.default_rng(seed)
    targets: list[FloatArray] = []
    joints: list[FloatArray] = []
    missing = count
    while missing > 0:
        drawn = _targets(arm, generator)
        found = reach(arm, drawn, None, arm.tool_chain)
        kept = found.reachable
        targets.append(drawn[kept])
        joints.append(found.joints[kept])
        missing -= int(kept.sum())
    return WorkspaceSamples(np.concatenate(targets)[:count], np.concatenate(joints)[:count])


def _targets(arm: KinematicArm, generator: np.random.Generator) -> FloatArray:
    """Draw targets along cubics through way-points; those outside the region are dropped."""
    region, size = arm.region, arm.target_size
    lower = np.concatenate([region.lower, np.full(3, -region.turn)])[:size]
    upper = np.concatenate([region.upper, np.full(3, region.turn)])[:size]
    ways = _ROWS // _SAMPLES_PER_WAY
    points = generator.uniform(lower, upper, (ways + 1, size))
    times = (np.arange(ways * _SAMPLES_PER_WAY) + 0.5) / _SAMPLES_PER_WAY
    targets = Trajectory(points, 1.0).at(times)[0]
    return targets[within(arm, targets)]


def within(arm: KinematicArm, targets: FloatArray) -> NDArray[np.bool_]:
    """Return (n,) whether targets (n, 3 or 6) lie in the arm's region."""
    position, region = targets[:, :3], arm.region
    near = np.linalg.norm(position - (0.0, 0.0, arm.robot.shoulder_height), axis=1) <= region.reach
    inside: NDArray[np.bool_] = np.all((position >= region.lower) & (position <= region.upper), 1)
    return inside & near
