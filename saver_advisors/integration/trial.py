"""One trial of the closed loop: run, recorded, and evaluated as in the dissertation's table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.assembly import ControlLoop
from saver_advisors.integration.casualty import TASK
from saver_advisors.integration.health import STOPPED, Event
from saver_advisors.integration.messages import ServoCommand
from saver_advisors.integration.tracking import SIDES
from saver_advisors.integration.wrist_bench import wrist_bench
from saver_envs.simulation import ACTION_DURATION

#: A wrist that has moved this much (m) closer to its target has been reached and pushed.
PUSHED: Final = 0.02
#: Fraction of a trial above which holding the arms counts among the reasons of a failure.
_LONG_HOLD: Final = 0.1
SUCCEEDED, REACHING, PUSHING = "succeeded", "failed in reaching", "failed in pushing"
Look = Callable[[float], None]


@dataclass(frozen=True)
class TrialRecord:
    """Record a trial: arrays of T + 1 samples, one at the start and one after each action.

    :param seed: of the trial.
    :param distance: (T + 1, arms) of the wrists from their targets, metres.
    :param torso_force: (T + 1,) peak since the last sample, newtons.
    :param torso_displacement: (T + 1,) peak since the last sample, metres.
    :param hand_force: (T + 1, arms) contact force at each hand, newtons.
    :param holding: (T + 1,) whether the arms were held still.
    :param log: of the stages' health.
    :param diverged: whether the simulation diverged.
    """

    seed: int
    distance: NDArray[np.float64]
    torso_force: NDArray[np.float64]
    torso_displacement: NDArray[np.float64]
    hand_force: NDArray[np.float64]
    holding: NDArray[np.bool_]
    log: tuple[Event, ...]
    diverged: bool = False

    @property
    def unharmed(self) -> bool:
        """Whether force and displacement of the torso stayed within their limits (SPEC 5.6)."""
        return bool(
            self.torso_force.max() <= TASK.torso_force_limit
            and self.torso_displacement.max() <= TASK.torso_displacement_limit
        )

    @property
    def outcome(self) -> str:
        """How the trial ended.

        It succeeded if both wrists end within 5 cm of their targets and the torso is unharmed. It
        failed in reaching if a wrist that missed was never pushed 2 cm closer to its target.
        Otherwise it failed in pushing.
        """
        arrived = self.distance[-1] <= TASK.success_threshold
        if arrived.all() and self.unharmed and not self.diverged:
            return SUCCEEDED
        nearer = self.distance[0] - self.distance.min(axis=0)
        return REACHING if (~arrived & (nearer < PUSHED)).any() else PUSHING

    @property
    def cause(self) -> str:
        """Why the trial failed, in words; empty after a success."""
        outcome = self.outcome
        if outcome == SUCCEEDED:
            return ""
        if self.diverged:
            return f"{outcome}: the simulation broke down"
        reasons = [
            f"the {side} wrist ended {100 * distance:.0f} cm away"
            for side, distance in zip(SIDES, self.distance[-1], strict=True)
            if distance > TASK.success_threshold
        ]
        if self.torso_force.max() > TASK.torso_force_limit:
            reasons.append(f"the trunk was pressed with {self.torso_force.max():.0f} N")
        if self.torso_displacement.max() > TASK.torso_displacement_limit:
            moved = 1000 * self.torso_displacement.max()
            reasons.append(f"the trunk was moved by {moved:.0f} mm")
        held = self.holding.mean()
        if held > _LONG_HOLD:
            stops = self._stops()
            last = f", at last for {stops[-1].stage}: {stops[-1].reason}" if stops else ""
            reasons.append(f"the arms were held for {100 * held:.0f}% of the time{last}")
        return f"{outcome}: {'; '.join(reasons)}"

    def _stops(self) -> list[Event]:
        return [event for event in self.log if event.kind == STOPPED]

    def summary(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "seed": self.seed,
            "seconds": (len(self.distance) - 1) * ACTION_DURATION,
            "outcome": self.outcome,
            "cause": self.cause,
            "distance_m": [float(one) for one in self.distance[-1]],
            "torso_force_n": float(self.torso_force.max()),
            "torso_displacement_m": float(self.torso_displacement.max()),
            "hand_force_n": float(self.hand_force.max()),
            "held_share": float(self.holding.mean()),
            "stops": [str(event) for event in self._stops()],
        }


def run_trial(
    loop: ControlLoop,
    seed: int,
    actions: int = TASK.horizon,
    look: Look | None = None,
    advance: Look | None = None,
) -> TrialRecord:
    """Run one trial on the simulation's clock.

    :param loop: with a `WristBench`.
    :param seed: of the person, the start and the camera's noise.
    :param actions: number of actions, of 0.04 s each.
    :param look: called with the time after each action, such as a video recorder.
    :param advance: runs the loop until a time; by default its graph does.
    :raises TypeError: for a loop with another bench.
    """
    bench = wrist_bench(loop.bench)
    advance = advance or (lambda end: loop.graph.run_until(end, bench.advance_to))
    samples: list[dict[str, Any]] = []
    loop.reset(seed)
    loop.stop.release()
    for action in range(actions + 1):
        now = action * ACTION_DURATION
        if action:
            advance(now)
        command = loop.graph.boxes["servo"].latest
        held = isinstance(command, ServoCommand) and command.holding
        truth, (force, displacement) = bench.truth(), bench.taken_peaks()
        samples.append(
            {
                "distance": np.linalg.norm(truth.wrists - truth.targets, axis=-1),
                "torso_force": force,
                "torso_displacement": displacement,
                "hand_force": bench.reading().hand_force,
                "holding": held,
            }
        )
        if look is not None:
            look(now)
    columns: dict[str, Any] = {
        name: np.array([one[name] for one in samples]) for name in samples[0]
    }
    return TrialRecord(seed=seed, **columns, log=tuple(loop.health.log), diverged=bench.diverged)
