"""Record the true state of trials step by step, whatever the sensors measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Observation, Predict
from saver_envs.episodes import Episodes
from saver_envs.registration import make_episodes
from saver_envs.robots.description import Robot
from saver_envs.tasks.table import TableTask
from saver_envs.wrappers.finger_readings import translated_fingers

FrameCallback = Callable[[Episodes, int], None]
"""Receives the episodes and the step, at the start of the trials and after each step."""


@dataclass(frozen=True)
class TrialTrajectory:
    """The true course of one trial, each arm in its own base frame; arrays of T + 1 instants.

    :param tool: (T + 1, arms, 3) tool points, metres.
    :param object: (T + 1, arms, 3) centres of the cubes, metres.
    :param object_speed: (T + 1, arms) metres per second.
    :param target: (arms, 3), metres.
    :param closing: (T, arms) whether the action closes the gripper; False if the gripper is fixed.
    :param collided: (T,) steps with contact that ``cost_collision`` counts.
    :param object_size: edge of the cubes, metres.
    :param threshold: distance to the target that counts as reached, metres.
    :param reach: horizontal distance from the base at which objects may lie, metres.
    :param success: ``is_success`` of the last step.
    :param diverged: whether the simulation broke down.
    """

    tool: NDArray[np.float64]
    object: NDArray[np.float64]
    object_speed: NDArray[np.float64]
    target: NDArray[np.float64]
    closing: NDArray[np.bool_]
    collided: NDArray[np.bool_]
    object_size: float
    threshold: float
    reach: float
    success: bool
    diverged: bool = False

    @property
    def distance(self) -> NDArray[np.float64]:
        """(T + 1, arms) from each cube to its target, metres."""
        return np.asarray(np.linalg.norm(self.object - self.target, axis=-1))

    @property
    def steps(self) -> int:
        """T."""
        return len(self.collided)


def run_trials(
    predict: Predict,
    env_id: str,
    trials: int,
    *,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    hand: Robot | None = None,
    frame_callback: FrameCallback | None = None,
) -> list[TrialTrajectory]:
    """Play trials side by side and record them; trial i starts from ``seed + i``.

    The same call plays the same trials, so that chosen trials can be drawn in a second run.

    :param predict: batched Dict observation (n, size) -> actions (n, action_size); deterministic.
    :param env_id: a registered id.
    :param trials: number of trials.
    :param seed: seed of trial 0.
    :param env_kwargs: further arguments of the environment.
    :param hand: robot whose finger readings the policy was trained with; the scene's own if None.
    :param frame_callback: see `FrameCallback`.
    :return: one trajectory per trial.
    """
    episodes = make_episodes(env_id, trials, **(env_kwargs or {}))
    for index in range(trials):
        episodes.set_generator(index, seeding.np_random(seed + index)[0])
    episodes.reset()
    task, robot = episodes.task, episodes.settings.robot
    assert isinstance(task, TableTask)
    seen = [_true_state(episodes)]
    taken, collided = [], []
    success, diverged = np.zeros((2, trials), dtype=bool)
    for step in range(episodes.settings.horizon):
        if frame_callback is not None:
            frame_callback(episodes, step)
        observation: Observation = {**episodes.observation().as_dict()}
        if hand is not None and hand is not robot:
            observation["observation"] = translated_fingers(
                observation["observation"], task.observation_layout, robot, hand
            )
        actions = predict(observation)
        outcome = episodes.step(actions)
        seen.append(_true_state(episodes))
        collided.append(outcome.measured["cost_collision"] > 0)
        # A diverged simulation restarts by itself; what follows is not this trial.
        success = outcome.success & ~diverged & ~outcome.diverged
        diverged |= outcome.diverged
        taken.append(np.asarray(actions).reshape(trials, task.n_arms, -1))
    if frame_callback is not None:
        frame_callback(episodes, episodes.settings.horizon)
    tool, position, velocity = (np.stack(parts, axis=1) for parts in zip(*seen, strict=True))
    own = [cast(TableTask, one) for one in episodes.worlds.tasks]
    closing = (np.stack(taken, axis=1)[..., -1] < 0) & (task.held_height is None)
    touched = np.stack(collided, axis=1)
    return [
        TrialTrajectory(
            tool=tool[index],
            object=position[index],
            object_speed=np.linalg.norm(velocity[index], axis=-1),
            target=task.goal_layout.blocks(episodes.goal[index]).copy(),
            closing=closing[index],
            collided=touched[index],
            object_size=own[index].object_size,
            threshold=task.success_threshold,
            reach=episodes.settings.robot.reach,
            success=bool(success[index]),
            diverged=bool(diverged[index]),
        )
        for index in range(trials)
    ]


def _true_state(episodes: Episodes) -> tuple[NDArray[np.float64], ...]:
    """Return tool points, positions and linear velocities of the objects, (trials, arms, 3) each.

    The observation has what the sensors measure, and when it arrives.
    """
    simulation = episodes.simulation
    state = episodes.task.observe(simulation, episodes.memory, simulation.arm_state())
    names = ("gripper position", "object position", "object linear velocity")
    return tuple(state[name] for name in names)
