"""Makes the expert of an id, with the ``predict`` of a trained policy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.episodes import ACTION_DURATION, DEFAULT_HORIZON, DEFAULT_SPEED, RATED_SPEED
from saver_envs.experts.blocks import ArmView, view
from saver_envs.experts.coordination import JACO_CLOSED, JACO_HOLDING, Coordinator
from saver_envs.experts.distance import DistanceExpert
from saver_envs.experts.frozen import ServesAll
from saver_envs.experts.pick import PickSkill
from saver_envs.experts.push import PushSkill
from saver_envs.experts.wrist import WristSkill
from saver_envs.registration import Options, Row, parse_options, row_of
from saver_envs.scenes import base_poses
from saver_envs.tasks.distance import Distance
from saver_envs.tasks.push import Push
from saver_envs.tasks.wrist_push import WristPush

FloatArray = NDArray[np.floating]

#: What differs between robots' hands. The MICO's is pitched, and its two fingers close further.
PUSH = {"jaco": PushSkill(), "mico": PushSkill(trail=0.02)}
PICK = {
    "jaco": PickSkill(),
    "mico": PickSkill(finger_held=0.60, finger_closing=0.45, half_open=0.40),
}


class Expert:
    """A scripted policy.

    :param n_arms: number of arms.
    :param act: from what the arms see to their actions (n, arms, size).
    """

    def __init__(self, n_arms: int, act: Callable[[ArmView], FloatArray]) -> None:
        self.n_arms = n_arms
        self._act = act

    def predict(
        self, observation: dict[str, FloatArray], deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """Return actions for observations, as Stable-Baselines3's policies do.

        :param observation: of one environment, or of n with a leading dimension; an expert that
            looks ahead keeps its plans from call to call, so give it the same n in the same order.
        :param deterministic: not used; experts always are.
        :return: actions (size,) or (n, size), and no state.
        """
        single = np.ndim(observation["observation"]) == 1
        batch = {name: np.atleast_2d(values) for name, values in observation.items()}
        actions = self._act(view(batch, self.n_arms))
        flat = np.clip(actions.reshape(len(actions), -1), -1.0, 1.0).astype(np.float32)
        return (flat[0] if single else flat), None


def make_expert(
    env_id: str, *, coordinated: bool = True, free_arm: int | None = None, **options: Any
) -> Expert:
    """Build the expert of an id.

    :param env_id: a registered id.
    :param coordinated: arms give way to one another; else each acts as if it were alone.
    :param free_arm: the only arm that moves, and serves all cubes in turn; all move by default.
    :param options: the environment's keyword arguments.
    :return: the expert.
    :raises ValueError: for an unknown id, or options that no expert is written for.
    :raises TypeError: for an unknown option.
    """
    row, chosen = row_of(env_id), parse_options(options)
    n_arms = row.n_arms if chosen.n_arms is None else chosen.n_arms
    if chosen.control != "cartesian":
        raise ValueError(f"control={chosen.control!r}: experts command Cartesian displacements")
    if chosen.layout != "row" and n_arms > 1 and coordinated:
        raise ValueError(f"layout={chosen.layout!r}: experts coordinate arms in a row")
    if free_arm is not None and not 0 <= free_arm < n_arms:
        raise ValueError(f"free_arm={free_arm!r}: must be 0 to {n_arms - 1}")
    if row.task is WristPush:
        return _wrist_expert(chosen, free_arm)
    skill = _skill(row, chosen)
    base = base_poses(n_arms, "row")[0][:, :2]
    if free_arm is not None:
        last = isinstance(skill, PickSkill)
        return Expert(n_arms, ServesAll(skill, base, free_arm, own_last=last).actions)
    if row.task is Distance and isinstance(skill, PickSkill):
        return Expert(n_arms, DistanceExpert(base, skill).actions)
    if not coordinated or (n_arms == 1 and isinstance(skill, PickSkill)):
        return Expert(n_arms, skill.actions)
    steps = round(DEFAULT_HORIZON * DEFAULT_SPEED * ACTION_DURATION / skill.step)
    closed = JACO_HOLDING if isinstance(skill, PickSkill) else JACO_CLOSED
    return Expert(n_arms, Coordinator(skill, base, closed, steps=steps).actions)


def _wrist_expert(options: Options, free_arm: int | None) -> Expert:
    """Return the expert of wrist push, whose arms never meet and need no coordination."""
    skill = WristSkill(_step(options))

    def act(view: ArmView) -> FloatArray:
        actions = skill.actions(view)
        if free_arm is not None:
            others = np.arange(actions.shape[1]) != free_arm
            actions[:, others] = 0.0
        return actions

    return Expert(len(skill.inwards), act)


def _step(options: Options) -> float:
    """Return the longest displacement of an action, metres."""
    speed = options.max_speed or (RATED_SPEED if options.rated else DEFAULT_SPEED)
    return speed * ACTION_DURATION


def _skill(row: Row, options: Options) -> PushSkill | PickSkill:
    step = _step(options)
    if row.task is Push:
        return replace(PUSH[row.robot], step=step, object_size=options.object_size)
    return replace(PICK[row.robot], step=step, object_size=options.object_size)
