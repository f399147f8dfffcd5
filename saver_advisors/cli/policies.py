"""Resolve a policy's name on the command line: shipped, trained, scripted or random."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Observation, Predict
from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes
from saver_advisors.training.run_folder import RECORD_FILE
from saver_envs.registration import make_episodes

SIDE_BY_SIDE = "side-by-side"
FROZEN = "frozen-arm"
BLIND = "expert-uncoordinated"
KINDS = f"random, expert, {BLIND}, {FROZEN}, {SIDE_BY_SIDE}:TEACHER"


@dataclass(frozen=True)
class Sizes:
    """Sizes of an environment's spaces.

    :param env_id: id of the environment
    :param entries: size of each entry of an observation
    :param action: size of an action
    :param arms: number of arms
    """

    env_id: str
    entries: Mapping[str, int]
    action: int
    arms: int


def resolve(word: str, env_id: str, env_kwargs: Mapping[str, Any], seed: int = 0) -> Predict:
    """Resolve a policy's name, and check that the policy fits the environment.

    :param word: a shipped policy's name, a weight file, a run's folder (of ours or of RL Zoo),
        ``random``, ``expert``, ``expert-uncoordinated``, ``frozen-arm`` or ``side-by-side:TEACHER``
    :param env_id: id of the environment
    :param env_kwargs: keyword arguments of that environment
    :param seed: of a random policy
    :return: the policy: batched observation (n, size) -> actions (n, action_size)
    :raises UsageError: for an unknown policy, or one of other sizes
    """
    episodes = make_episodes(env_id, **env_kwargs)
    goals = dict.fromkeys(("achieved_goal", "desired_goal"), episodes.goal_size)
    entries = {"observation": episodes.observation_size, **goals}
    sizes = Sizes(env_id, entries, episodes.action_size, episodes.task.n_arms)
    kind, _, rest = word.partition(":")
    if word == "random":
        return _random(sizes.action, seed)
    if word in ("expert", BLIND):
        return _expert(sizes, env_kwargs, coordinated=word == "expert")
    if kind == FROZEN:
        return _one_free_arm(rest, sizes, env_kwargs)
    path = Path(word)
    with user_mistakes("argument --policy"):  # a name may be too long for a path
        if kind == SIDE_BY_SIDE:
            return _side_by_side(rest, sizes)
        for folder, which in ((path, "best"), (path.parent, path.name)):
            if which in ("best", "latest") and (folder / RECORD_FILE).is_file():
                return _trained(folder, which, sizes)
        if path.suffix == ".zip" or path.is_dir():
            from saver_advisors.zoo.runs import load_run

            return _of_sb3(load_run(path), word, sizes)
        return _weights(word, sizes)


def _random(size: int, seed: int) -> Predict:
    generator = np.random.default_rng(seed)

    def predict(observation: Observation) -> NDArray[Any]:
        n = len(observation["observation"])
        return generator.uniform(-1.0, 1.0, (n, size)).astype(np.float32)

    return predict


def _expert(sizes: Sizes, env_kwargs: Mapping[str, Any], **chosen: Any) -> Predict:
    """Make a scripted expert; experts keep their plans, so each use needs its own."""
    from saver_envs.experts import make_expert

    with user_mistakes("argument --policy: expert"):
        return _deterministic(make_expert(sizes.env_id, **chosen, **env_kwargs))


def _one_free_arm(arm: str, sizes: Sizes, env_kwargs: Mapping[str, Any]) -> Predict:
    """Make the expert whose one arm moves every cube in turn while the others stand still."""
    arms = [str(index) for index in range(sizes.arms)]
    if len(arms) < 2:
        raise UsageError(
            f"argument --policy: {FROZEN} needs two arms or more, and {sizes.env_id} has one"
        )
    if arm and arm not in arms:
        raise UsageError(
            f"argument --policy: {FROZEN}:{arm}: the arm that moves must be {' or '.join(arms)}"
        )
    return _expert(sizes, env_kwargs, free_arm=int(arm or 0))


def _side_by_side(teacher: str, sizes: Sizes) -> Predict:
    from saver_advisors.pretrained import load_teacher, shipped_policies, side_by_side

    if not teacher:
        names = ", ".join(f"{SIDE_BY_SIDE}:{name}" for name in shipped_policies())
        raise UsageError(f"argument --policy: say which teacher drives each arm: {names}")
    loaded = load_teacher(teacher)
    arms = sizes.arms
    needed = {
        "observation": arms * loaded.observation_size,
        "desired_goal": arms * loaded.goal_size,
    }
    # A goal may end in entries that belong to no arm, such as a required distance. Single-arm
    # teachers ignore them.
    appended = sizes.entries["desired_goal"] - needed["desired_goal"]
    if 0 < appended < loaded.goal_size:
        needed["desired_goal"] += appended
    name, policy = f"{SIDE_BY_SIDE}:{teacher}", side_by_side(loaded, arms)
    return _fitting(policy, name, needed, arms * loaded.action_size, sizes)


def _trained(folder: Path, which: str, sizes: Sizes) -> Predict:
    from saver_advisors.training.launch import load_trained

    if not (folder / which).is_dir():
        latest = folder / "latest"
        hint = f"; its newest policy is {latest}" if latest.is_dir() else ""
        raise UsageError(f"argument --policy: {str(folder)!r} has no evaluation yet{hint}")
    return _of_sb3(load_trained(folder, which), str(folder), sizes)


def _of_sb3(model: Any, name: str, sizes: Sizes) -> Predict:
    """Wrap an SB3 model or policy that fits the environment."""
    needed = {key: space.shape[0] for key, space in model.observation_space.spaces.items()}
    return _fitting(model, name, needed, int(np.prod(model.action_space.shape or ())), sizes)


def _weights(word: str, sizes: Sizes) -> Predict:
    from saver_advisors.pretrained import load_policy, shipped_policies

    if word not in shipped_policies() and not Path(word).is_file():
        message = unknown("policy", word, shipped_policies())
        raise UsageError(
            f"argument --policy: {message}; or {KINDS}; or the path of a .safetensors file or of "
            "a run's folder"
        )
    policy = load_policy(word)
    spec = policy.networks.spec
    return _fitting(policy, word, spec.sizes, spec.action_size, sizes)


def _fitting(
    model: Any, name: str, entries: Mapping[str, int], action: int, sizes: Sizes
) -> Predict:
    """Wrap a policy, and reject one with other sizes than the environment."""
    wanted = {key: sizes.entries.get(key, 0) for key in entries}
    if dict(entries) == wanted and action == sizes.action:
        return _deterministic(model)

    def words(entries: Mapping[str, int], action: int) -> str:
        return ", ".join(f"{key} {size}" for key, size in entries.items()) + f", action {action}"

    raise UsageError(
        f"argument --policy: {name!r} does not fit {sizes.env_id}: the policy has "
        f"{words(entries, action)}; the environment has {words(wanted, sizes.action)}"
    )


def _deterministic(model: Any) -> Predict:
    """Wrap a model with SB3's ``predict`` as a deterministic policy."""

    def predict(observation: Observation) -> NDArray[Any]:
        return np.asarray(model.predict(observation, deterministic=True)[0])

    return predict
