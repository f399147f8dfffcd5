"""Resolve a policy's name on the command line: shipped, trained, scripted or random."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Observation, Predict
from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes
from saver_advisors.training.run_folder import RECORD_FILE
from saver_envs.registration import make_episodes
from saver_envs.tasks.contract import PENDING
from saver_envs.tasks.layout import Layout

SIDE_BY_SIDE = "side-by-side"
FROZEN = "frozen-arm"
BLIND = "expert-uncoordinated"
KINDS = f"random, expert, {BLIND}, {FROZEN}, {SIDE_BY_SIDE}:TEACHER"

#: Keyword argument of environments that adds the part ``PENDING`` to their observations.
PENDING_OPTION = "observe_pending_motion"
#: Size of each entry of an observation, and of an action.
Sizes = dict[str, int]


def resolve(word: str, env_id: str, env_kwargs: Mapping[str, Any], seed: int = 0) -> Predict:
    """Resolve a policy's name, and check that the policy fits the environment.

    :param word: a shipped policy's name, a weight file, a run's folder (of ours or of RL Zoo),
        ``random``, ``expert``, ``expert-uncoordinated``, ``frozen-arm`` or ``side-by-side:TEACHER``
        (``side-by-side:TEACHER,TEACHER`` with one for each arm)
    :param env_id: id of the environment
    :param env_kwargs: keyword arguments of that environment
    :param seed: of a random policy
    :return: the policy: batched observation (n, size) -> actions (n, action_size)
    :raises UsageError: for an unknown policy, or one of other sizes
    """
    episodes = make_episodes(env_id, **env_kwargs)
    n_arms = episodes.task.n_arms
    kind, _, rest = word.partition(":")
    if word == "random":
        return _random(episodes.action_size, seed)
    if word in ("expert", BLIND):
        return _expert(env_id, env_kwargs, coordinated=word == "expert")
    if kind == FROZEN:
        return _expert(env_id, env_kwargs, free_arm=_free_arm(rest, env_id, n_arms))
    sizes = {"observation": episodes.observation_size, "action": episodes.action_size}
    sizes |= dict.fromkeys(("achieved_goal", "desired_goal"), episodes.goal_size)
    with user_mistakes("argument --policy"):  # a name may be too long for a path
        if kind == SIDE_BY_SIDE:
            model, needed = _side_by_side(rest, episodes.task.goal_layout, sizes)
        else:
            model, needed = _loaded(word)
    given = {name: sizes.get(name, 0) for name in needed}
    if needed == given:
        return _deterministic(model)
    pending = PENDING.size * n_arms * (not episodes.task.observe_pending_motion)
    fits = needed == {**given, "observation": given.get("observation", 0) + pending}
    hint = f": pass --env-kwargs {PENDING_OPTION}=true" if fits else ""
    raise UsageError(
        f"argument --policy: {word!r} does not fit {env_id}: the policy has {_in_words(needed)}; "
        f"the environment has {_in_words(given)}{hint}"
    )


def options_that_fit(word: str, env_id: str, env_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Return keyword arguments with which a policy fits: these, or with pending motion as well.

    :param word: as for :func:`resolve`
    :param env_id: id of the environment
    :param env_kwargs: keyword arguments of that environment
    :raises UsageError: for an unknown policy, or one that fits neither
    """
    try:
        resolve(word, env_id, env_kwargs)
    except UsageError:
        wider = {**env_kwargs, PENDING_OPTION: True}
        with suppress(UsageError):
            resolve(word, env_id, wider)
            return wider
        raise
    return dict(env_kwargs)


def fitting(env_id: str, env_kwargs: Mapping[str, Any]) -> list[str]:
    """Return names of policies that ship and fit an environment.

    :param env_id: id of the environment
    :param env_kwargs: keyword arguments of that environment
    :return: of scripted, random and trained ones
    """
    from saver_advisors.pretrained import shipped_policies

    names = []
    for name in ("expert", "random", *shipped_policies()):
        with suppress(UsageError):
            resolve(name, env_id, env_kwargs)
            names.append(name)
    return names


def _in_words(sizes: Sizes) -> str:
    return ", ".join(f"{name} {size}" for name, size in sizes.items())


def _random(size: int, seed: int) -> Predict:
    generator = np.random.default_rng(seed)

    def predict(observation: Observation) -> NDArray[Any]:
        n = len(observation["observation"])
        return generator.uniform(-1.0, 1.0, (n, size)).astype(np.float32)

    return predict


def _expert(env_id: str, env_kwargs: Mapping[str, Any], **chosen: Any) -> Predict:
    """Make a scripted expert; experts keep their plans, so each use needs its own."""
    from saver_envs.experts import make_expert

    with user_mistakes("argument --policy: expert"):
        return _deterministic(make_expert(env_id, **chosen, **env_kwargs))


def _free_arm(arm: str, env_id: str, n_arms: int) -> int:
    """Return the arm that moves every cube in turn while the others stand still."""
    arms = [str(index) for index in range(n_arms)]
    if n_arms < 2:
        raise UsageError(
            f"argument --policy: {FROZEN} needs two arms or more, and {env_id} has one"
        )
    if arm and arm not in arms:
        raise UsageError(
            f"argument --policy: {FROZEN}:{arm}: the arm that moves must be {' or '.join(arms)}"
        )
    return int(arm or 0)


def _side_by_side(teachers: str, goal_layout: Layout, sizes: Sizes) -> tuple[Any, Sizes]:
    """Load a teacher for all arms, or one per arm, with the sizes of all arms."""
    from saver_advisors.pretrained import load_teacher, shipped_policies, side_by_side

    if not teachers:
        names = ", ".join(f"{SIDE_BY_SIDE}:{name}" for name in shipped_policies())
        raise UsageError(f"argument --policy: say which teacher drives each arm: {names}")
    loaded = [load_teacher(name) for name in teachers.split(",")]
    first, arms = loaded[0], goal_layout.n_arms
    # PettingZoo's agents see what the arms' goals share, such as a required distance.
    agents = first.goal_size == goal_layout.block + goal_layout.shared
    shared = goal_layout.shared if agents else 0
    goal = arms * (first.goal_size - shared) + shared
    # Other single-arm teachers ignore it.
    if goal < sizes["desired_goal"] < goal + first.goal_size:
        goal = sizes["desired_goal"]
    needed = {"observation": arms * first.observation_size, "desired_goal": goal}
    model = side_by_side(loaded, arms, shared)
    return model, {**needed, "action": arms * first.action_size}


def _loaded(word: str) -> tuple[Any, Sizes]:
    """Load a policy from files, with its sizes."""
    from saver_advisors.pretrained import load_policy, shipped_policies
    from saver_advisors.training.launch import load_trained

    path = Path(word)
    for folder, which in ((path, "best"), (path.parent, path.name)):
        if which in ("best", "latest") and (folder / RECORD_FILE).is_file():
            if not (folder / which).is_dir():
                latest = folder / "latest"
                hint = f"; its newest policy is {latest}" if latest.is_dir() else ""
                raise UsageError(f"argument --policy: {str(folder)!r} has no evaluation yet{hint}")
            return _with_sizes(load_trained(folder, which))
    if path.suffix == ".zip" or path.is_dir():
        from saver_advisors.zoo.runs import load_run

        return _with_sizes(load_run(path))
    if word not in shipped_policies() and not path.is_file():
        message = unknown("policy", word, shipped_policies())
        raise UsageError(
            f"argument --policy: {message}; or {KINDS}; or the path of a .safetensors file or of "
            "a run's folder"
        )
    policy = load_policy(word)
    spec = policy.networks.spec
    return policy, {**spec.sizes, "action": spec.action_size}


def _with_sizes(model: Any) -> tuple[Any, Sizes]:
    """Return an SB3 model or policy with its sizes."""
    sizes = {key: space.shape[0] for key, space in model.observation_space.spaces.items()}
    return model, {**sizes, "action": int(np.prod(model.action_space.shape or ()))}


def _deterministic(model: Any) -> Predict:
    """Wrap a model with SB3's ``predict`` as a deterministic policy."""

    def predict(observation: Observation) -> NDArray[Any]:
        return np.asarray(model.predict(observation, deterministic=True)[0])

    return predict
