"""Teachers: frozen single-arm policies, and a group of them that acts for n arms at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.policies.inference import FloatArray, FrozenPolicy, check_rows
from saver_advisors.policies.networks import PolicyNetworks

if TYPE_CHECKING:
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

TeacherFunction = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]


class Teacher:
    """Advise with a frozen, deterministic policy of one arm, optionally with critics.

    Observations, goals and actions are NumPy arrays in the environment's units.

    Attributes: `observation_size` and `goal_size`, the sizes of its inputs `observation` and
    `desired_goal` (0 if it does not read that entry), `action_size`, `has_critics`.

    :param networks: the weights, which are copied.
    :param name: of the teacher in logs and saved runs.
    """

    def __init__(self, networks: PolicyNetworks, name: str = "teacher") -> None:
        self.networks = networks
        self.name = name
        self._policy = FrozenPolicy(networks, name)
        sizes = networks.spec.sizes
        self.observation_size = sizes.get("observation", 0)
        self.goal_size = sizes.get("desired_goal", 0)
        self.action_size = networks.spec.action_size
        self.has_critics = networks.spec.n_critics > 0

    @classmethod
    def from_sb3(cls, model: OffPolicyAlgorithm, name: str | None = None) -> Teacher:
        """Create a teacher from a copy of a trained model's actor and critics.

        :param model: DDPG, TD3, SAC or TQC with a Dict observation of flat entries.
        :param name: of the teacher; by default the algorithm's.
        :raises TypeError: for a model of another kind.
        """
        return cls(networks_from_sb3(model), name or f"sb3-{type(model).__name__}")

    def act(
        self,
        observation: NDArray[Any],
        goal: NDArray[Any],
        achieved_goal: NDArray[Any] | None = None,
    ) -> FloatArray:
        """Return the deterministic action.

        :param observation: (n, observation_size).
        :param goal: (n, goal_size) desired goals.
        :param achieved_goal: (n, goal_size), only for a teacher that reads it.
        :return: (n, action_size) in the environment's units.
        :raises ValueError: if a shape does not fit.
        """
        return self._policy.action(self._features(observation, goal, achieved_goal))

    def q_value(
        self,
        observation: NDArray[Any],
        goal: NDArray[Any],
        action: NDArray[Any],
        achieved_goal: NDArray[Any] | None = None,
        *,
        twin_minimum: bool = True,
    ) -> FloatArray:
        """Return the teacher's value of an action, Q_tr(s_i, a).

        :param observation: (n, observation_size).
        :param goal: (n, goal_size) desired goals.
        :param action: (n, action_size), or (k, n, action_size) for k actions in each of the n
            states.
        :param achieved_goal: (n, goal_size), only for a teacher that reads it.
        :param twin_minimum: whether to return the minimum of the critics, which guards against
            overestimation, else the first.
        :return: (n,) or (k, n).
        :raises ValueError: if a shape does not fit or the teacher has no critics.
        """
        if not self.has_critics:
            raise ValueError(
                f"teacher {self.name!r} has no critics: q_value needs weights saved with critics"
            )
        if action.shape[-1] != self.action_size or action.shape[-2] != len(observation):
            raise ValueError(
                f"action has shape {action.shape}: teacher {self.name!r} needs "
                f"(..., {len(observation)}, {self.action_size})"
            )
        features = self._features(observation, goal, achieved_goal)
        rows = action.reshape(-1, self.action_size).astype(np.float32, copy=False)
        repeated = np.tile(features, (len(rows) // max(1, len(features)), 1))
        values = self._policy.q_value(repeated, rows, twin_minimum=twin_minimum)
        return values.reshape(action.shape[:-1])

    def _features(
        self, observation: NDArray[Any], goal: NDArray[Any], achieved: NDArray[Any] | None
    ) -> FloatArray:
        return self._policy.features(
            {"observation": observation, "desired_goal": goal, "achieved_goal": achieved}
        )

    def __repr__(self) -> str:
        sizes = f"observation {self.observation_size}, goal {self.goal_size}"
        return f"{type(self).__name__}({self.name!r}, {sizes}, action {self.action_size})"


class FunctionTeacher(Teacher):
    """Advise with a function of one arm's observation and goal; it has no critics and no weights.

    :param function: (n, observation_size) and (n, goal_size) -> actions (n, action_size).
    :param sizes: of an arm's observation, goal and action.
    :param name: of the teacher.
    """

    def __init__(self, function: TeacherFunction, sizes: tuple[int, int, int], name: str) -> None:
        self.observation_size, self.goal_size, self.action_size = sizes
        self.function = function
        self.name = name
        self.has_critics = False

    def act(
        self,
        observation: NDArray[Any],
        goal: NDArray[Any],
        achieved_goal: NDArray[Any] | None = None,
    ) -> FloatArray:
        """Return the function's actions; see ``Teacher.act``.

        :raises ValueError: if their shape does not fit, or one is not finite.
        """
        check_rows("observation", observation, self.observation_size, self.name)
        check_rows("desired_goal", goal, self.goal_size, self.name)
        action = np.asarray(self.function(observation, goal), np.float32)
        if action.shape != (len(observation), self.action_size) or not np.isfinite(action).all():
            raise ValueError(
                f"teacher {self.name!r} returned {action.shape}: it must return finite actions "
                f"({len(observation)}, {self.action_size})"
            )
        return action


class TeacherGroup:
    """Teachers of n arms; arms that share a teacher share its forward pass.

    :param teachers: one for all arms, or one per arm.
    :param n_arms: number of arms.
    :raises ValueError: if the numbers do not match or the teachers' sizes differ.
    """

    def __init__(self, teachers: Teacher | Sequence[Teacher], n_arms: int) -> None:
        given = (teachers,) if isinstance(teachers, Teacher) else tuple(teachers)
        if len(given) not in (1, n_arms):
            raise ValueError(
                f"{len(given)} teachers for {n_arms} arms: give one for all, or one per arm"
            )
        self.teachers = given * n_arms if len(given) == 1 else given
        first = self.teachers[0]
        for teacher in self.teachers:
            sizes = (teacher.observation_size, teacher.goal_size, teacher.action_size)
            if sizes != (first.observation_size, first.goal_size, first.action_size):
                raise ValueError(
                    f"teachers of one group must have the same sizes: {first} and {teacher} differ"
                )
        self.n_arms = n_arms
        self.names = [teacher.name for teacher in self.teachers]
        self.action_size = first.action_size
        self.has_critics = all(teacher.has_critics for teacher in self.teachers)
        # Compared by identity: equal weights in two teachers take two passes.
        unique = {id(teacher): teacher for teacher in self.teachers}
        self._members = [
            (teacher, [arm for arm, other in enumerate(self.teachers) if other is teacher])
            for teacher in unique.values()
        ]

    def act(
        self,
        observations: NDArray[Any],
        goals: NDArray[Any],
        achieved_goals: NDArray[Any] | None = None,
    ) -> FloatArray:
        """Return the action of every arm.

        :param observations: (n_envs, n_arms, observation_size).
        :param goals: (n_envs, n_arms, goal_size) desired goals.
        :param achieved_goals: (n_envs, n_arms, goal_size), only if a teacher reads it.
        :return: (n_envs, n_arms, action_size).
        """
        n_envs = len(observations)
        actions = np.empty((n_envs, self.n_arms, self.action_size), dtype=np.float32)
        for teacher, arms, seen in self._batches(observations, goals, achieved_goals):
            actions[:, arms] = teacher.act(*seen).reshape(n_envs, len(arms), self.action_size)
        return actions

    def q_value(
        self,
        observations: NDArray[Any],
        goals: NDArray[Any],
        actions: NDArray[Any],
        achieved_goals: NDArray[Any] | None = None,
        *,
        twin_minimum: bool = True,
    ) -> FloatArray:
        """Return the values of k candidate actions of every arm.

        :param observations: (n_envs, n_arms, observation_size).
        :param goals: (n_envs, n_arms, goal_size) desired goals.
        :param actions: (k, n_envs, n_arms, action_size).
        :param achieved_goals: (n_envs, n_arms, goal_size), only if a teacher reads it.
        :param twin_minimum: whether to return the minimum of the critics, else the first.
        :return: (k, n_envs, n_arms).
        """
        n_candidates, n_envs = actions.shape[:2]
        values = np.empty((n_candidates, n_envs, self.n_arms), dtype=np.float32)
        for teacher, arms, (seen, goal, achieved) in self._batches(
            observations, goals, achieved_goals
        ):
            candidates = actions[:, :, arms].reshape(n_candidates, -1, self.action_size)
            batch = teacher.q_value(seen, goal, candidates, achieved, twin_minimum=twin_minimum)
            values[:, :, arms] = batch.reshape(n_candidates, n_envs, len(arms))
        return values

    def _batches(self, *parts: NDArray[Any] | None) -> Iterator[tuple[Teacher, list[int], Any]]:
        """Yield each teacher, its arms, and the parts of these with the arms in the batch."""
        for teacher, arms in self._members:
            yield teacher, arms, [None if one is None else _stack(one, arms) for one in parts]


def _stack(per_arm: NDArray[Any], arms: list[int]) -> NDArray[Any]:
    """Move the arms into the batch: (n_envs, n_arms, size) -> (n_envs * len(arms), size)."""
    chosen = per_arm if len(arms) == per_arm.shape[1] else per_arm[:, arms]
    return chosen.reshape(-1, per_arm.shape[-1])
