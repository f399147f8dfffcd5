"""Steps of six values, with the cost after the reward, as libraries of safe learning expect."""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv, VectorWrapper

from saver_envs.validation import require

#: Entry of ``info`` that holds the sum of the costs which the task names.
COST = "cost"


class _CheckedCost:
    """Checks at every reset that ``info`` has the cost."""

    env: Any
    cost: str

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode, or those of a vector."""
        observation, info = self.env.reset(seed=seed, options=options)
        names = [name for name in info if name.startswith(COST)]
        valid = f"an entry of info: {', '.join(names) or 'it has none'}"
        require("cost", self.cost, self.cost in names, valid)
        return observation, info


class CostStep(
    _CheckedCost, gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs
):
    """Returns ``observation, reward, cost, terminated, truncated, info``, as Safety-Gymnasium does.

    It is the outermost wrapper: those of Gymnasium unpack five values.

    :param env: an environment of this package, possibly wrapped.
    :param cost: entry of ``info`` that is returned, such as ``cost_collision``.
    :raises ValueError: at the first reset, for a cost that ``info`` does not have.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], cost: str = COST) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, cost=cost)
        gymnasium.Wrapper.__init__(self, env)
        self.cost = cost

    def step(  # type: ignore[override]
        self, action: Any
    ) -> tuple[Any, float, float, bool, bool, dict[str, Any]]:
        """Apply one action.

        :param action: as the environment takes it.
        :return: observation, reward, cost, terminated, truncated, info.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward), float(info[self.cost]), terminated, truncated, info


class CostVectorStep(_CheckedCost, VectorWrapper[Any, Any, Any]):
    """The same for a vector of environments; costs are (num_envs,).

    With the reset in the same step, the cost is that of the step which ended the episode.

    :param env: a vector environment of this package.
    :param cost: entry of ``infos`` that is returned.
    :raises ValueError: at the first reset, for a cost that ``infos`` does not have.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], cost: str = COST) -> None:
        super().__init__(env)
        self.cost = cost

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Apply one action to every episode.

        :param actions: (num_envs, action_size).
        :return: observations, rewards, costs (num_envs,), terminated, truncated, infos.
        """
        observation, reward, terminated, truncated, infos = self.env.step(actions)
        cost = infos[self.cost].copy()
        if (ended := infos.get("_final_info")) is not None:
            cost[ended] = infos["final_info"][self.cost][ended]
        return observation, reward, cost, terminated, truncated, infos
