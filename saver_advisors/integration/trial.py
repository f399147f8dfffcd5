"""One trial of the closed loop: played, recorded, judged as the dissertation's table does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.assembly import Loop
from saver_advisors.integration.health import Event
from saver_advisors.integration.messages import Message, ServoCommand
from saver_advisors.integration.wrist_bench import WristBench
from saver_envs.episodes import ACTION_DURATION
from saver_envs.tasks.base import SUCCESS_THRESHOLD
from saver_envs.tasks.wrist_push import DISPLACEMENT_LIMIT, FORCE_LIMIT, HORIZON

#: A wrist that has come nearer to its target by this much (m) has been reached and pushed.
PUSHED: Final = 0.02
SUCCEEDED, REACHING, PUSHING = "succeeded", "failed in reaching", "failed in pushing"
Look = Callable[[float], None]


@dataclass(frozen=True)
class TrialRecord:
    """What happened in a trial; arrays of T + 1 instants, one an action.

    :param seed: it started from
    :param distance: (T + 1, arms) of the wrists from their targets, metres
    :param torso_force: (T + 1,) the highest since the instant before, newtons
    :param torso_displacement: (T + 1,) likewise, metres
    :param hand_force: (T + 1, arms) against each hand, newtons
    :param speed: (T + 1, arms) of the tools, m/s
    :param holding: (T + 1,) whether the arms were held still
    :param log: of the stages' health
    :param diverged: whether the simulation broke down
    """

    seed: int
    distance: NDArray[np.float64]
    torso_force: NDArray[np.float64]
    torso_displacement: NDArray[np.float64]
    hand_force: NDArray[np.float64]
    speed: NDArray[np.float64]
    holding: NDArray[np.bool_]
    log: tuple[Event, ...]
    diverged: bool = False

    @property
    def unharmed(self) -> bool:
        """Whether the trunk was never pressed nor moved beyond its limits (SPEC 5.6)."""
        return bool(
            self.torso_force.max() <= FORCE_LIMIT
            and self.torso_displacement.max() <= DISPLACEMENT_LIMIT
        )

    @property
    def outcome(self) -> str:
        """How it ended.

        It succeeded where both wrists end within 5 cm of their targets and the trunk is unharmed.
        It failed in reaching where a wrist that missed was never brought 2 cm nearer to its target:
        the hand has not come to push it. Else it failed in pushing.
        """
        arrived = self.distance[-1] <= SUCCESS_THRESHOLD
        if arrived.all() and self.unharmed and not self.diverged:
            return SUCCEEDED
        nearer = self.distance[0] - self.distance.min(axis=0)
        return REACHING if (~arrived & (nearer < PUSHED)).any() else PUSHING

    @property
    def cause(self) -> str:
        """Why it failed, in words; empty where it succeeded."""
        outcome = self.outcome
        if outcome == SUCCEEDED:
            return ""
        if self.diverged:
            return f"{outcome}: the simulation broke down"
        missed = np.flatnonzero(self.distance[-1] > SUCCESS_THRESHOLD)
        reasons = [
            f"the {('right', 'left')[arm]} wrist ended {100 * self.distance[-1, arm]:.0f} cm away"
            for arm in missed
        ]
        if self.torso_force.max() > FORCE_LIMIT:
            reasons.append(f"the trunk was pressed with {self.torso_force.max():.0f} N")
        if self.torso_displacement.max() > DISPLACEMENT_LIMIT:
            moved = 1000 * self.torso_displacement.max()
            reasons.append(f"the trunk was moved by {moved:.0f} mm")
        share = self.holding.mean()
        if share > 0.1:
            stops = [event for event in self.log if event.kind == "stopped"]
            last = f", at last for {stops[-1].stage}: {stops[-1].reason}" if stops else ""
            reasons.append(f"the arms were held for {100 * share:.0f}% of the time{last}")
        return f"{outcome}: {'; '.join(reasons)}"

    def summary(self) -> dict[str, Any]:
        """Plain values, for JSON."""
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
            "stops": [str(event) for event in self.log if event.kind == "stopped"],
        }


@dataclass
class _Watch:
    """What is written down in the course of a trial."""

    loop: Loop
    bench: WristBench
    held: bool = False
    rows: list[tuple[NDArray[np.float64], float, float, bool]] = field(default_factory=list)

    def __call__(self, topic: str, message: Message, now: float) -> None:
        if isinstance(message, ServoCommand):
            self.held = message.holding

    def look(self) -> None:
        """Write down how things are."""
        truth = self.bench.truth()
        distance = np.linalg.norm(truth.wrists - truth.targets, axis=-1)
        state = self.bench.episodes.simulation.arm_state()
        speed = np.linalg.norm(state.tool_velocity[0], axis=-1)
        force, moved = self.bench.taken_peaks()
        hand = self.bench.hand_force()
        self.rows.append((np.stack([distance, speed, hand]), force, moved, self.held))

    def record(self, seed: int) -> TrialRecord:
        """Everything that was written down."""
        stacked = np.stack([row[0] for row in self.rows])
        return TrialRecord(
            seed=seed,
            distance=stacked[:, 0],
            torso_force=np.array([row[1] for row in self.rows]),
            torso_displacement=np.array([row[2] for row in self.rows]),
            hand_force=stacked[:, 2],
            speed=stacked[:, 1],
            holding=np.array([row[3] for row in self.rows]),
            log=tuple(self.loop.health.log),
            diverged=self.bench.diverged,
        )


def run_trial(
    loop: Loop,
    seed: int,
    actions: int = HORIZON,
    look: Look | None = None,
    advance: Look | None = None,
) -> TrialRecord:
    """Play one trial on the simulation's clock.

    :param loop: round a `WristBench`
    :param seed: of the person, the start and the camera's noise
    :param actions: of 0.04 s
    :param look: called with the time after each action, such as a recorder's
    :param advance: lets the loop go on until a time, where its graph alone does not do
    :raises TypeError: for a loop round another bench
    """
    bench = loop.bench
    if not isinstance(bench, WristBench):
        raise TypeError(f"loop.bench of {type(bench).__name__}: must be a WristBench")
    bench.reset(seed)
    loop.graph.reset()
    loop.stop.release()
    watch = _Watch(loop, bench)
    if advance is None:

        def advance(end: float) -> None:
            loop.graph.run_until(end, bench)

    loop.graph.observers.append(watch)
    try:
        watch.look()
        if look is not None:
            look(0.0)
        for action in range(1, actions + 1):
            advance(action * ACTION_DURATION)
            watch.look()
            if look is not None:
                look(action * ACTION_DURATION)
    finally:
        loop.graph.observers.remove(watch)
    return watch.record(seed)
