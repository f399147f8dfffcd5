"""What is said about an environment, read from its code: the table and the pages both use it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from saver_advisors.cli import wrist_push_facts as wrist_push
from saver_envs.episodes import Episodes
from saver_envs.registration import ENVIRONMENTS, PIXELS, make_episodes
from saver_envs.tasks.distance import DISTANCE_TOLERANCE, REQUIRED_DISTANCE

DENSE = "Dense"

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
        succeeds=succeeds(episodes),
        costs=tuple(sorted(cost_names(episodes))),
        summed_costs=tuple(episodes.task.cost_names),
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


def cost_names(episodes: Episodes) -> set[str]:
    """The costs that ``info`` reports, without their prefix."""
    goal = np.zeros((1, episodes.goal_size))
    return set(episodes.task.costs(goal, goal, np.zeros(1, bool)))


def succeeds(episodes: Episodes) -> str:
    """When an episode succeeds, in words.

    :param episodes: of the id
    :return: half a sentence
    """
    task = episodes.task
    centimetres = f"{100 * task.success_threshold:g} cm"
    if task.moves_person:
        return wrist_push.SUCCEEDS.format(centimetres)
    what = "the cube is" if task.n_arms == 1 else "every cube is"
    text = f"{what} within {centimetres} of its target"
    text += " on the table" if task.held_height is not None else ", on the table or in the air"
    if task.name == "distance":
        band = f"{REQUIRED_DISTANCE:g} m +- {100 * DISTANCE_TOLERANCE:g} cm"
        text += f"; and the cubes stayed {band} apart at every step"
    return text
