"""Observations in which a person is where a camera sees them, not where the simulation has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from saver_envs.episodes import Episodes
from saver_envs.perception.skeleton import JOINTS
from saver_envs.simulation import ACTION_DURATION
from saver_envs.wrappers.pose_observation import PoseCamera

#: Pictures per second, and seconds from a picture to its result.
RATE, LATENCY = 12.5, 0.04
#: Least confidence of a joint: where a robot's arm hides one, it is below.
_LEAST_SCORE: Final = 0.55
#: Share of a new position in the estimate; a joint that is farther from its estimate than this (m)
#: counts only when it is seen so again, in so many pictures in a row.
_SHARE, _JUMP, _INSISTS = 0.6, 0.10, 3
#: Parts that follow from others: the object's position relative to the gripper.
_RELATIVE: Final = ("object position relative to the gripper", "object position")
_GRIPPER: Final = "gripper position"


class SeenPeople:
    """What agents observe of n episodes when a camera has to find the person.

    The parts of the observation that are joints of the person, or bends between them, come from
    pictures, as does a goal that depends on where the person lies. A joint that is hidden, or
    jumps, keeps its place. Until all joints have been seen that the task needs, :attr:`ready` is
    false and the observation has the true ones.

    :param episodes: of a care task.
    :param camera: name of one of the scene's cameras.
    :param options: of :class:`saver_envs.wrappers.pose_observation.PoseObservation`; ``turn`` puts
        the person's head up by default.
    :raises TypeError: for a task that does not say which parts are joints.
    """

    def __init__(self, episodes: Episodes, camera: str = "overhead", **options: Any) -> None:
        task: Any = episodes.task
        if not getattr(task, "joint_parts", None):
            raise TypeError(f"task {task.name!r}: has no joint_parts, which a camera could see")
        quarter = round(task.facing / (math.pi / 2)) % 4
        options = {"rate": RATE, "latency": LATENCY, "turn": quarter, **options}
        self._episodes, self._task = episodes, task
        self._camera = PoseCamera(episodes, camera, **options)
        used = {one for names in task.joint_parts.values() for one in names}
        self._used = [any(name.endswith(f"_{one}") for one in used) for name in JOINTS]
        self._joints = np.full((episodes.n, len(JOINTS), 3), np.nan)
        self._insisting = np.zeros((episodes.n, len(JOINTS)), dtype=np.intp)

    def begin(self, seeds: list[int | None] | None = None) -> None:
        """Begin all episodes.

        :param seeds: of the depth's noise, an episode each.
        """
        for row in range(self._episodes.n):
            self._camera.begin(row, None if seeds is None else seeds[row])
        self._joints[:] = np.nan
        self._insisting[:] = 0

    def advance(self) -> None:
        """Let the duration of an action pass."""
        self._camera.times += ACTION_DURATION

    @property
    def ready(self) -> NDArray[np.bool_]:
        """(n,) whether all joints have been seen."""
        seen: NDArray[np.bool_] = np.isfinite(self._joints[:, self._used]).all(axis=(1, 2))
        return seen

    def observed(self) -> dict[str, NDArray[np.float32]]:
        """Return the observations of all episodes now."""
        for row in range(self._episodes.n):
            self._take(row)
        seen = self._episodes.observation().as_dict()
        ready = np.flatnonzero(self.ready)
        if not ready.size:
            return seen
        task, scene = self._task, self._episodes.scene
        joints = dict(zip(JOINTS, self._joints[ready].swapaxes(0, 1), strict=True))
        parts = task.parts_from(joints, scene)
        for layout, name in (
            (task.observation_layout, "observation"),
            (task.goal_layout, "achieved_goal"),
        ):
            _write(layout, seen[name], ready, parts)
        goal = task.goal_from(joints, scene)
        if goal is not None:
            seen["desired_goal"][ready] = goal
        return seen

    def _take(self, row: int) -> None:
        """Take over what the newest result for an episode says about its joints."""
        entries = self._camera.entries(row)
        places, found = entries["pose_3d"], entries["pose_scores_3d"] >= _LEAST_SCORE
        if not found.any():
            return
        known = self._joints[row]
        unknown = found & np.isnan(known[:, 0])
        known[unknown] = places[unknown]
        near = np.linalg.norm(places - known, axis=-1) < _JUMP
        insisting = self._insisting[row]
        insisting[:] = np.where(near | ~found, 0, insisting + 1)
        taken = found & (near | (insisting >= _INSISTS))
        known[taken] += _SHARE * (places[taken] - known[taken])

    def close(self) -> None:
        """Free the graphics context."""
        self._camera.close()


def _write(
    layout: Any,
    values: NDArray[np.float32],
    rows: NDArray[np.intp],
    parts: Mapping[str, NDArray[np.float64]],
) -> None:
    """Write parts (k, arms, size) into the rows of vectors (n, size)."""
    known = {part.name for part in layout.parts}
    chosen = values[rows]
    for name, part in parts.items():
        if name in known:
            layout.get(chosen, name)[...] = part * layout.part(name).scale
    relative, position = _RELATIVE
    if relative in known and position in parts:
        gripper = layout.get(chosen, _GRIPPER)
        layout.get(chosen, relative)[...] = parts[position] - gripper
    values[rows] = chosen


class SeenPersonObservation(
    gymnasium.Wrapper[dict[str, Any], Any, dict[str, Any], Any], RecordConstructorArgs
):
    """Lets a policy act on what a camera sees of the person, in a single environment.

    ``info["person_seen"]`` tells whether all joints have been seen; until then the observation has
    the true ones.

    :param env: an environment of a care task.
    :param camera: name of one of its cameras.
    :param options: of :class:`saver_envs.wrappers.pose_observation.PoseObservation`.
    :raises TypeError: for a task that does not say which parts are joints.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], camera: str = "overhead", **options: Any
    ) -> None:
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, camera=camera, **options)
        gymnasium.Wrapper.__init__(self, env)
        unwrapped: Any = env.unwrapped
        self._people = SeenPeople(unwrapped.episodes, camera, **options)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; the first picture is taken at once."""
        _, info = self.env.reset(seed=seed, options=options)
        self._people.begin([seed])
        return self._seen(info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Apply an action; reward and success are those of the true state."""
        _, reward, terminated, truncated, info = self.env.step(action)
        self._people.advance()
        observation, info = self._seen(info)
        return observation, reward, terminated, truncated, info

    def _seen(self, info: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        seen = {name: values[0] for name, values in self._people.observed().items()}
        return seen, {**info, "person_seen": bool(self._people.ready[0])}

    def close(self) -> None:
        """Free the graphics context as well."""
        self._people.close()
        super().close()
