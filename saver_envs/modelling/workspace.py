"""Samples for the inverse kinematics in use: tool targets over a workspace, joints that reach them.

Targets follow cubics through random way-points, like the joints of the paper's trajectories. Each
has one answer, reached from the home posture along a straight way (see `solvers.reach`): a function
that a network can learn, where the paper's data have several answers for one point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.modelling.arms import Arm, arm_named
from saver_envs.modelling.chain import FloatArray
from saver_envs.modelling.solvers import reach
from saver_envs.modelling.trajectories import Trajectory
from saver_envs.reachability import GRID_LOWER, GRID_UPPER

#: Samples from one way-point to the next.
_SAMPLES_A_WAY = 40
#: Targets are solved so many at once.
_ROWS = 4096


@dataclass(frozen=True)
class Region:
    """Where targets are.

    :param lower: corner of a box in the base frame, metres.
    :param upper: the opposite corner.
    :param reach: farthest from the shoulder, metres.
    :param turn: largest component of the rotation vector from tool-down, radians; poses alone.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    reach: float = np.inf
    turn: float = 0.15


#: The box of hand positions of the environments, with room round it; for the MICO less what is too
#: far for its hand; for the Fetch the space in front of its chest.
REGIONS = {
    "jaco": Region(GRID_LOWER, GRID_UPPER),
    "mico": Region(GRID_LOWER, GRID_UPPER, reach=0.59),
    "fetch": Region((0.45, -0.60, 0.35), (0.95, 0.60, 1.30)),
}


@dataclass(frozen=True)
class WorkspaceSamples:
    """Targets with their joints, in the order of time.

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
    :raises ValueError: for an arm without a region.
    """
    if name not in REGIONS:
        raise ValueError(f"robot={name!r}: there are regions of {', '.join(REGIONS)}")
    arm, region = arm_named(name), REGIONS[name]
    generator = np.random.default_rng(seed)
    targets: list[FloatArray] = []
    joints: list[FloatArray] = []
    missing = count
    while missing > 0:
        drawn = _targets(arm, region, generator)
        found = reach(arm, drawn, chain=arm.tool_chain)
        kept = found.reached
        targets.append(drawn[kept])
        joints.append(found.joints[kept])
        missing -= int(kept.sum())
    return WorkspaceSamples(np.concatenate(targets)[:count], np.concatenate(joints)[:count])


def _targets(arm: Arm, region: Region, generator: np.random.Generator) -> FloatArray:
    """Draw targets along cubics through way-points, those outside of the region left out."""
    lower = np.concatenate([region.lower, np.full(3, -region.turn)])[: arm.target_size]
    upper = np.concatenate([region.upper, np.full(3, region.turn)])[: arm.target_size]
    ways = _ROWS // _SAMPLES_A_WAY
    points = generator.uniform(lower, upper, (ways + 1, arm.target_size))
    times = (np.arange(ways * _SAMPLES_A_WAY) + 0.5) / _SAMPLES_A_WAY
    targets = Trajectory(points, 1.0).at(times)[0]
    return targets[within(arm, region, targets)]


def within(arm: Arm, region: Region, targets: FloatArray) -> NDArray[np.bool_]:
    """Say which targets (n, 3 or 6) lie in the region."""
    shoulder = np.array([0.0, 0.0, arm.robot.shoulder_height])
    near = np.linalg.norm(targets[:, :3] - shoulder, axis=1) <= region.reach
    inside: NDArray[np.bool_] = near & np.all(
        (targets[:, :3] >= region.lower) & (targets[:, :3] <= region.upper), axis=1
    )
    return inside
