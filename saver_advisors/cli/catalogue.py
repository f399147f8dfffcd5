"""Describe environments from their code, for the table and the generated pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from saver_advisors.reporting.tables import Column
from saver_envs.registration import DENSE, ENVIRONMENTS, PIXELS, make_episodes

COLUMNS: Final[dict[str, Column]] = {
    "id": "{env_id}",
    "task": "{task}",
    "robot": "{robot}",
    "arms": "{arms}",
    "obs.": "{observation_size}",
    "act.": "{action_size}",
    "goal": "{goal_size}",
    "horizon": "{horizon}",
    "succeeds when, on the last step,": "{succeeds}",
    "cost": lambda row: ", ".join(_grouped(row["summed_costs"])),
}
"""Headings, and how an :func:`entry` fills each column."""

#: As many costs of a kind are named one by one.
_FEW: Final = 2


def _grouped(costs: Sequence[str]) -> list[str]:
    """Return costs with those of many parts, such as forces, as one: ``force_*``."""
    kinds = [cost.partition("_")[0] for cost in costs]
    many = {kind for kind in kinds if kinds.count(kind) > _FEW}
    named = (f"{kind}_*" if kind in many else cost for kind, cost in zip(kinds, costs, strict=True))
    return list(dict.fromkeys(named))


def entry(env_id: str) -> dict[str, Any]:
    """Return the row of a registered id in the table of environments.

    :param env_id: id of the environment
    :return: ``env_id``, ``task``, ``robot``, ``arms``, sizes and ``horizon`` (actions); ``reward``:
        ``sparse`` or ``dense``; ``succeeds``: the condition for success, in words; ``costs``: all
        that ``info`` reports; ``summed_costs``: those that are summed in ``info["cost"]``
    """
    row = ENVIRONMENTS[env_id]
    episodes = make_episodes(env_id)
    return {
        "env_id": env_id,
        "task": row.task.name,
        "robot": row.robot,
        "arms": row.n_arms,
        "observation_size": episodes.observation_size,
        "action_size": episodes.action_size,
        "goal_size": episodes.goal_size,
        "horizon": episodes.settings.horizon,
        "reward": row.reward_type,
        "succeeds": episodes.task.page(episodes.scene).succeeds,
        "costs": tuple(sorted(episodes.task.costs)),
        "summed_costs": episodes.task.summed,
    }


def sparse_ids() -> list[str]:
    """Return the ids with a sparse reward; each has a twin with a dense reward."""
    return [name for name, row in ENVIRONMENTS.items() if row.reward_type == "sparse"]


def dense_twin(env_id: str) -> str:
    """Return the id of the same environment with a dense reward."""
    name, _, version = env_id.rpartition("-")
    return f"{name}{DENSE}-{version}"


def pixel_ids() -> list[str]:
    """Return a sentence about each environment with pictures as observations."""
    return [
        f"`{name}` is `{behind}` with the picture of its RGB-D camera as the only observation."
        for name, behind in PIXELS.items()
    ]
