"""Find the cause of a failed trial from measurable events of its trajectory.

Every failure has one cause: the earliest of the events below that happened to an arm whose cube is
not at its target at the end. An event has a step; events that are known only at the end come last.

Pushing (the dissertation's Table 5.4: "the object rolled away", "time-out", "collision"):

- ``slid_away``: at the end the cube is more than `RETREAT` farther from its target than at its
  closest approach, or more than `OUT_OF_REACH` out of the arm's reach. The step is the one at which
  the cube finally left its closest approach, by `LEAVING`.
- ``collided``: arms touched one another, the table or the cube of another arm on `PRESSED` steps in
  a row. The step is the first of them.
- ``inaccurate``: at the end the cube rests (slower than `AT_REST`) within `NEAR` thresholds of its
  target.
- ``timed_out``: none of these: the cube was still moving, or never came near the target.

Pick and place ("grasp lost", "reached the target position inaccurately", "failed to grasp the
object firmly"):

- ``grasp_lost``: the cube had been lifted (its lower face `LIFTED` above the table, its centre
  within one width of the tool point) for `FIRM` steps, then moved by more than `SLIP` relative to
  the hand although it had been `OFF_THE_TABLE` above the table `FIRM` steps before, and was not
  lifted again. A cube that is set down gently has been on the table for longer.
- ``weak_grasp``: the hand closed around the cube for `FIRM` steps, then rose by `CAME_UP` without
  it, and the cube was never lifted. The step is the one at which the hand had risen.
- ``collided``, ``inaccurate``, ``timed_out``: as in pushing.

``diverged`` means that the simulation diverged; it takes precedence over all other causes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from reproduction.transfer.trajectories import TrialTrajectory

RETREAT: Final = 0.05
"""Metres from the closest approach: the success threshold."""
OUT_OF_REACH: Final = 0.05
"""Metres beyond the reach of the region of cubes and targets."""
LEAVING: Final = 0.01
"""Metres beyond the closest approach at which a cube has left it: above the noise of contact."""
PRESSED: Final = 3
"""Steps in a row, 0.12 s: successful trials have contacts of one or two steps."""
AT_REST: Final = 0.05
"""Metres per second: 2 mm per step."""
NEAR: Final = 2.0
"""Thresholds of success."""
LIFTED: Final = 0.02
"""Metres between table and cube: more than a cube tipped on its edge has."""
OFF_THE_TABLE: Final = 0.01
"""Metres between table and cube: more than the noise of contact."""
FIRM: Final = 3
"""Steps in a row, 0.12 s: longer than a cube stays near the hand by chance."""
SLIP: Final = 0.02
"""Metres relative to the hand: a third of a cube's width; held ones move by some millimetres."""
CAME_UP: Final = 0.04
"""Metres that the hand rises: twice what lifts a cube in a firm grasp."""

_COMMON_CAUSES: Final = ("collided", "inaccurate", "timed_out", "diverged")
PUSH_CAUSES: Final = ("slid_away", *_COMMON_CAUSES)
PICK_CAUSES: Final = ("grasp_lost", "weak_grasp", *_COMMON_CAUSES)
WORDS: Final = {
    **{cause: cause.replace("_", " ") for cause in (*PUSH_CAUSES, *PICK_CAUSES)},
    "diverged": "simulation broke down",
}
"""Names in tables."""


@dataclass(frozen=True)
class Failure:
    """Why and when a trial failed.

    :param cause: one of `PUSH_CAUSES` or `PICK_CAUSES`.
    :param step: step of the event, from 0; T for events known only at the end.
    :param arm: index of the cube's arm; the lowest one for events of the whole scene.
    """

    cause: str
    step: int
    arm: int


def find_failure(task: str, trial: TrialTrajectory) -> Failure | None:
    """Find the cause of a failed trial.

    :param task: ``push`` or ``pick``.
    :param trial: the trajectory.
    :return: the failure; None for a success.
    """
    if trial.success:
        return None
    if trial.diverged:
        return Failure("diverged", trial.steps, 0)
    failed = np.flatnonzero(trial.distance[-1] > trial.threshold).tolist()
    own = (_slid_away,) if task == "push" else (_grasp_lost, _weak_grasp)
    # All cubes are at their targets if the episode violated a constraint.
    found = (event(trial, arm) for arm in failed or [0] for event in (*own, _collided, _at_the_end))
    return min((one for one in found if one is not None), key=lambda one: one.step)


def _at_the_end(trial: TrialTrajectory, arm: int) -> Failure:
    near = trial.distance[-1, arm] <= NEAR * trial.threshold
    rests = trial.object_speed[-1, arm] <= AT_REST
    return Failure("inaccurate" if near and rests else "timed_out", trial.steps, arm)


def _collided(trial: TrialTrajectory, arm: int) -> Failure | None:
    starts = _runs(trial.collided, PRESSED)
    return Failure("collided", starts[0][0], arm) if starts else None


def _slid_away(trial: TrialTrajectory, arm: int) -> Failure | None:
    distance = trial.distance[:, arm]
    closest = distance.min()
    from_base = np.linalg.norm(trial.object[-1, arm, :2])
    if distance[-1] - closest <= RETREAT and from_base <= trial.reach + OUT_OF_REACH:
        return None
    near = np.flatnonzero(distance <= closest + LEAVING)
    return Failure("slid_away", min(int(near[-1]) + 1, trial.steps), arm)


def _above_table(trial: TrialTrajectory, arm: int) -> NDArray[np.float64]:
    """Compute the height (T + 1,) of a flat cube's lower face above the table, metres."""
    return trial.object[:, arm, 2] - trial.object_size / 2


def _in_hand(trial: TrialTrajectory, arm: int) -> NDArray[np.bool_]:
    """Tell at each instant (T + 1,) whether the cube is within a width of the tool point."""
    separation = np.linalg.norm(trial.object[:, arm] - trial.tool[:, arm], axis=-1)
    return np.asarray(separation <= trial.object_size)


def _lifted(trial: TrialTrajectory, arm: int) -> list[tuple[int, int]]:
    """Find the spans [first, last] in which the hand holds the cube above the table."""
    return _runs(_in_hand(trial, arm) & (_above_table(trial, arm) > LIFTED), FIRM)


def _grasp_lost(trial: TrialTrajectory, arm: int) -> Failure | None:
    spans = _lifted(trial, arm)
    if not spans:
        return None
    first, last = spans[-1]
    offset = trial.object[:, arm] - trial.tool[:, arm]
    # Relative to the median of the span: a cube that settles in the hand is not lost.
    moved = np.linalg.norm(offset - np.median(offset[first : last + 1], axis=0), axis=-1) > SLIP
    height = _above_table(trial, arm)
    for step in range(first + FIRM, trial.steps + 1):
        if moved[step] and height[step - FIRM] > OFF_THE_TABLE:
            return Failure("grasp_lost", step, arm)
    return None


def _weak_grasp(trial: TrialTrajectory, arm: int) -> Failure | None:
    if _lifted(trial, arm):
        return None
    closed = _in_hand(trial, arm)[1:] & trial.closing[:, arm]
    height = trial.tool[:, arm, 2]
    for first, _ in _runs(closed, FIRM):
        lowest = np.minimum.accumulate(height[first + 1 :])
        risen = np.flatnonzero(height[first + 1 :] - lowest >= CAME_UP)
        if risen.size:
            return Failure("weak_grasp", first + 1 + int(risen[0]), arm)
    return None


def _runs(flags: NDArray[np.bool_], least: int) -> list[tuple[int, int]]:
    """Find spans [first, last] of at least ``least`` True in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    spans = zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
    return [(first, last) for first, last in spans if last - first + 1 >= least]
