"""Where the blocks of n arms lie in observations and goals, and how the arms' bases stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces

from saver_envs.validation import require

POSE_SIZE = 4
"""Numbers that say where a neighbour's base stands: x and y (m), cosine and sine of its turn."""


GOAL_KEYS = ("observation", "achieved_goal", "desired_goal")
"""The entries of a goal environment's Dict observation."""

MOST = 1024
"""Bound on the sizes, so that the description in a file cannot allocate gigabytes."""


@dataclass(frozen=True)
class ArmBlocks:
    """The blocks of n arms: of arm 0, of arm 1, ..., then numbers that all arms share.

    :param n_arms: number of arms.
    :param observation: size of an arm's block of the observation.
    :param goal: size of an arm's block of a goal.
    :param shared_goal: size of the part of a goal that belongs to no arm.
    :param bases: (n_arms, 3) position x, y (m) and yaw (rad) of each base, in the world's frame.
    :raises ValueError: if a size is out of range, or the bases are not those of ``n_arms`` arms.
    """

    n_arms: int
    observation: int
    goal: int
    shared_goal: int
    bases: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        for name, least in (("n_arms", 1), ("observation", 1), ("goal", 1), ("shared_goal", 0)):
            size = getattr(self, name)
            require(f"arms: {name}", size, least <= size <= MOST, f"{least} to {MOST}")
        valid = np.shape(self.bases) == (self.n_arms, 3)
        require("arms: bases", self.bases, valid, f"x, y, yaw of {self.n_arms} bases")

    @classmethod
    def of_episodes(cls, episodes: Any) -> ArmBlocks:
        """Read it off the task and the scene of ``saver_envs.episodes.Episodes``.

        :param episodes: of an environment.
        :raises ValueError: if the arms share a part of the observation.
        """
        task, arms = episodes.task, episodes.scene.arms
        observation, goal = task.observation_layout, task.goal_layout
        if observation.shared:
            raise ValueError(
                f"the arms of the task {task.name!r} share a part of the observation, so its "
                "blocks are not what an arm sees"
            )
        places = zip(arms.position.tolist(), arms.yaw.tolist(), strict=True)
        bases = tuple((place[0], place[1], yaw) for place, yaw in places)
        return cls(task.n_arms, observation.block, goal.block, goal.shared, bases)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> ArmBlocks:
        """Create it from plain values, as JSON holds them."""
        bases = tuple((float(x), float(y), float(yaw)) for x, y, yaw in values["bases"])
        return cls(**{**values, "bases": bases})

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for ``from_mapping``; SB3 saves them with a model."""
        return {**asdict(self), "bases": [list(base) for base in self.bases]}

    def of_arm(self, observation_space: spaces.Dict) -> spaces.Dict:
        """Return the space of what one arm sees.

        :param observation_space: of all arms.
        :raises ValueError: if an entry has another size.
        """
        for key, total in self.sizes().items():
            found = int(np.prod(observation_space[key].shape or ()))
            if total != found:
                raise ValueError(f"{key!r} has {found} numbers: those of {self} are {total}")
        sizes = self.sizes_of_arm().items()
        return spaces.Dict(
            {key: spaces.Box(-np.inf, np.inf, (size,), np.float32) for key, size in sizes}
        )

    def sizes_of_arm(self) -> dict[str, int]:
        """Return the sizes of what one arm sees of the entries."""
        return {key: sum(self._block_and_tail(key)) for key in GOAL_KEYS}

    def sizes(self) -> dict[str, int]:
        """Return the sizes of the entries of all arms."""
        parts = {key: self._block_and_tail(key) for key in GOAL_KEYS}
        return {key: self.n_arms * block + tail for key, (block, tail) in parts.items()}

    def _block_and_tail(self, key: str) -> tuple[int, int]:
        """Return the sizes of an arm's block of an entry, and of what all arms share."""
        return (self.observation, 0) if key == "observation" else (self.goal, self.shared_goal)

    def split(self, key: str, values: th.Tensor) -> th.Tensor:
        """Return what each arm sees of an entry: its block, then what all share.

        :param key: ``observation``, or any other name for a goal.
        :param values: (batch, size) of all arms.
        :return: (batch * n_arms, size of one arm).
        """
        block, tail = self._block_and_tail(key)
        end = self.n_arms * block
        blocks = values[:, :end].reshape(len(values) * self.n_arms, block)
        if tail == 0:
            return blocks
        return th.cat((blocks, values[:, end:].repeat_interleave(self.n_arms, dim=0)), dim=1)

    def columns(self, keys: tuple[str, ...]) -> list[list[int]]:
        """Return the columns of each arm in the concatenation of entries of all arms.

        :param keys: the entries, in their order.
        """
        found: list[list[int]] = [[] for _ in range(self.n_arms)]
        start = 0
        for key in keys:
            block, tail = self._block_and_tail(key)
            end = start + self.n_arms * block
            for arm, own in enumerate(found):
                own += range(start + arm * block, start + (arm + 1) * block)
                own += range(end, end + tail)
            start = end + tail
        return found

    def neighbours(self) -> list[list[int]]:
        """Return the other arms of each arm: the one that follows it, then the next."""
        n = self.n_arms
        return [[(arm + ahead) % n for ahead in range(1, n)] for arm in range(n)]

    def poses(self) -> th.Tensor:
        """Return where the neighbours' bases stand in each arm's base frame.

        :return: (n_arms, n_arms - 1, POSE_SIZE).
        """
        bases = np.asarray(self.bases, np.float64)
        poses = np.zeros((self.n_arms, self.n_arms - 1, POSE_SIZE))
        for arm, others in enumerate(self.neighbours()):
            x, y, yaw = (bases[others] - bases[arm]).T
            cosine, sine = np.cos(bases[arm, 2]), np.sin(bases[arm, 2])
            place = cosine * x + sine * y, cosine * y - sine * x, np.cos(yaw), np.sin(yaw)
            poses[arm] = np.stack(place, axis=-1)
        return th.as_tensor(poses, dtype=th.float32)
