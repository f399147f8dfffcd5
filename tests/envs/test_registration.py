"""Tasks and robots are refused when they are registered, with what they lack."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from saver_envs import Part, Task, register_robot, register_task
from saver_envs.registration import ENVIRONMENTS, row_of
from saver_envs.robots import ROBOTS
from saver_envs.tasks.push import Push


def refuse(task: Any, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        register_task(task, "Odd", robot="jaco", n_arms=1)
    assert "Odd-v0" not in ENVIRONMENTS


def test_a_taken_id_and_an_unknown_robot() -> None:
    with pytest.raises(ValueError, match="'JacoPush-v0' is taken"):
        register_task(Push, "JacoPush", robot="jaco", n_arms=1)
    with pytest.raises(ValueError, match=r"robot='jacco' is not registered.*'jaco'"):
        register_task(Push, "Odd", robot="jacco", n_arms=1)
    with pytest.raises(ValueError, match="'jaco' is registered already"):
        register_robot(ROBOTS["jaco"])


def test_what_is_no_task() -> None:
    refuse(object, "must be a dataclass derived from saver_envs.Task")


def test_a_task_that_misses_a_method() -> None:
    @dataclass(frozen=True)
    class Missing(Push):
        def start_rules(self) -> Any:
            raise NotImplementedError

    refuse(Missing, r"Missing lacks the method start_rules\(\)")


def test_a_task_without_bodies() -> None:
    @dataclass(frozen=True)
    class Empty(Task):
        name = "empty"

    refuse(Empty, r"Empty lacks the method build\(\)")


def test_a_body_that_is_not_there() -> None:
    @dataclass(frozen=True)
    class Lost(Push):
        resting = ("cup",)

    refuse(Lost, "cup")


def test_goals_of_another_size() -> None:
    @dataclass(frozen=True)
    class Wide(Push):
        goal = (Part("object position", 4, "m"),)

    refuse(Wide, r"Wide.achieved: the goal has shape \(2, 3\), but Wide.goal declares \(2, 4\)")


def test_an_observation_of_another_size() -> None:
    @dataclass(frozen=True)
    class Long(Push):
        observation = (Part("gripper position", 4, "m"),)

    refuse(
        Long,
        r"Long.observe: part 'gripper position' has shape \(2, 1, 3\), .* declares \(2, 1, 4\)",
    )


def test_a_cost_that_is_not_measured() -> None:
    @dataclass(frozen=True)
    class Costly(Push):
        costs = ("collision", "noise")

    refuse(Costly, "returns no cost_noise")


def test_a_hard_constraint_that_is_no_cost() -> None:
    @dataclass(frozen=True)
    class Strict(Push):
        hard = ("distance",)

    refuse(Strict, r"hard names \['distance'\]")


def test_a_reward_of_another_shape() -> None:
    @dataclass(frozen=True)
    class Summed(Push):
        def reward_and_reached(self, achieved: Any, desired: Any) -> Any:
            reward, reached = super().reward_and_reached(achieved, desired)
            return np.float32(reward.sum()), reached

    refuse(Summed, r"reward has shape \(\), must be \(2,\)")


def test_a_body_that_starts_beyond_the_table() -> None:
    @dataclass(frozen=True)
    class Fallen(Push):
        table_depth = (-0.16, 0.30)

    refuse(Fallen, "Fallen.place: .* beyond the table's edge: set Fallen.table_depth")


def test_a_module_that_is_not_there() -> None:
    with pytest.raises(ValueError, match="'no_such_module' cannot be imported"):
        row_of("no_such_module:Push-v0")
    with pytest.raises(ValueError, match="did you mean 'JacoPush-v0'"):
        row_of("saver_envs:JacoPsh-v0")
