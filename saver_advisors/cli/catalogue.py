"""What is said about an environment, read from its code: the table and the pages both use it."""

from __future__ import annotations

from dataclasses import dataclass

from saver_envs.registration import DENSE, ENVIRONMENTS, PIXELS, make_episodes

COLUMNS = (
    "id",
    "task",
    "robot",
    "arms",
    "obs.",
    "act.",
    "goal",
    "horizon",
    "succeeds when, on the last step,",
    "cost",
)


@dataclass(frozen=True)
class Entry:
    """A row of the table of environments.

    :param env_id: its id
    :param task: name of the task
    :param robot: name of the robot
    :param arms: number of arms
    :param observation_size: numbers in ``observation``
    :param action_size: numbers in an action
    :param goal_size: numbers in a goal
    :param horizon: actions in an episode
    :param reward: ``sparse`` or ``dense``
    :param succeeds: when an episode succeeds, in words
    :param costs: every cost that ``info`` reports
    :param summed_costs: those that ``info["cost"]`` adds up
    """

    env_id: str
    task: str
    robot: str
    arms: int
    observation_size: int
    action_size: int
    goal_size: int
    horizon: int
    reward: str
    succeeds: str
    costs: tuple[str, ...]
    summed_costs: tuple[str, ...]

    @property
    def cells(self) -> list[str]:
        """The row of the table, in the order of ``COLUMNS``."""
        sizes = (self.observation_size, self.action_size, self.goal_size, self.horizon)
        return [
            self.env_id,
            self.task,
            self.robot,
            str(self.arms),
            *map(str, sizes),
            self.succeeds,
            ", ".join(self.summed_costs),
        ]


def entry(env_id: str) -> Entry:
    """The entry of an id.

    :param env_id: a registered id
    :return: what its code says
    """
    row = ENVIRONMENTS[env_id]
    episodes = make_episodes(env_id)
    return Entry(
        env_id=env_id,
        task=row.task.name,
        robot=row.robot,
        arms=row.n_arms,
        observation_size=episodes.observation_size,
        action_size=episodes.action_size,
        goal_size=episodes.goal_size,
        horizon=episodes.settings.horizon,
        reward=row.reward_type,
        succeeds=episodes.task.page(episodes.scene).succeeds,
        costs=tuple(sorted(episodes.task.costs)),
        summed_costs=episodes.task.summed,
    )


def sparse_ids() -> list[str]:
    """The ids with a sparse reward; each has a dense twin."""
    return [name for name, row in ENVIRONMENTS.items() if row.reward_type == "sparse"]


def dense_twin(env_id: str) -> str:
    """The id of the same task with a dense reward.

    :param env_id: a sparse id
    :return: its twin's
    """
    name, _, version = env_id.rpartition("-")
    return f"{name}{DENSE}-{version}"


def pixel_ids() -> list[str]:
    """A sentence for each id that gives the camera's picture alone."""
    return [
        f"`{name}` is `{behind}` with the picture of its RGB-D camera as the only observation."
        for name, behind in PIXELS.items()
    ]
