"""Translate the arguments of `saver train --zoo` to those of RL Zoo."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes
from saver_advisors.safe_baselines import ALGORITHMS as SAFE
from saver_advisors.training.defaults import environment_entry
from saver_advisors.training.settings import read_mapping
from saver_advisors.zoo.algorithms import ADVISED, ALGORITHMS, STOCK

ADVICE_KEY: Final = "advice"
"""Entry of a settings file, beside those of the environments: the advice for each of them."""
ON_POLICY: Final = ("ppo", *SAFE)
"""Algorithms that cannot be advised."""
SHARED: Final = {"goal_ddpg": "goal", "goal_sac": "goal", "goal_tqc": "goal"}
"""Algorithms whose settings are in a file of another name."""
EVALUATION: Final = ("--eval-episodes", "50", "--n-eval-envs", "10")
"""RL Zoo's defaults (5 episodes in one environment) are too few to select a model."""
OURS: Final = {
    **{name: name for name in ("--env", "--seed", "--env-kwargs")},
    **{"--algo": "--zoo", "--eval-env-kwargs": "--env-kwargs"},
    **dict.fromkeys(("-f", "--log-folder"), "--output"),
    **dict.fromkeys(("-n", "--n-timesteps"), "--steps"),
    **dict.fromkeys(("-conf", "--conf-file"), "--config"),
    **dict.fromkeys(("-params", "--hyperparams"), "--set"),
}
"""RL Zoo's arguments that `saver train` sets itself; a second value would override it silently."""


def settings_path(algorithm: str) -> Path:
    """Return the shipped settings of an algorithm.

    An installed package holds them beside this module, a checkout in `zoo_configs/`.

    :param algorithm: a key of `ALGORITHMS` or `STOCK`.
    """
    stem = SHARED.get(algorithm, algorithm.removeprefix(ADVISED))
    installed = Path(__file__).with_name("configs")
    checkout = Path(__file__).resolve().parents[2] / "zoo_configs"
    return (installed if installed.is_dir() else checkout) / f"{stem}.yml"


def algorithm_name(name: str, advised: bool) -> str:
    """Return an algorithm's name in RL Zoo's table.

    :param name: a key of `ALGORITHMS` or `STOCK`, or one of `ON_POLICY`.
    :param advised: whether advice is given, which selects the advised variant of a `STOCK` one.
    :raises UsageError: for an unknown one, or one that cannot be advised.
    """
    known = (*STOCK, *ALGORITHMS, *ON_POLICY)
    if name not in known:
        raise UsageError(f"argument --zoo: {unknown('algorithm', name, known)}")
    if advised and name in ON_POLICY:
        raise UsageError(
            f"argument --advice: {name} learns on policy, from its own actions alone; use one of "
            f"{', '.join((*STOCK, *ALGORITHMS))}"
        )
    return f"{ADVISED}{name}" if advised and name in STOCK else name


def read_settings(path: Path, env_id: str) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Read an environment's entry in a settings file, and the advice given there.

    :param path: a YAML file in RL Zoo's format.
    :param env_id: a registered id.
    :return: hyper-parameters, and arguments of `make_advisor` or None.
    :raises UsageError: for a file that cannot be read or has no entry for the environment.
    """
    with user_mistakes("argument --config"):
        content = read_mapping(path)
        if not all(isinstance(one, dict) for one in content.values()):
            raise ValueError(f"{path} must have one entry per environment")
        advice = content.pop(ADVICE_KEY, {})
        entry = environment_entry(content, env_id, path)
    return entry, entry.get("advisor", advice.get(env_id))


def ready_advice(
    advice: Mapping[str, Any],
    env_id: str,
    env_kwargs: Mapping[str, Any],
    total_steps: int,
    seed: int,
) -> dict[str, Any]:
    """Check advice against the environment, and add the settings of the run.

    :param advice: arguments of `make_advisor`, and `warm_start`.
    :param env_id: the student's environment.
    :param env_kwargs: its keyword arguments.
    :param total_steps: environment steps of the run.
    :param seed: seed of the run.
    :return: the arguments, with `total_steps`, `horizon` and `seed` added where missing.
    :raises ValueError: for teachers, arms, strategy or budget that do not fit.
    :raises TypeError: for an unknown argument.
    """
    from saver_advisors.advising import make_advisor, names_code
    from saver_envs.envs.spaces import action_space, observation_space
    from saver_envs.registration import make_episodes

    episodes = make_episodes(env_id, **env_kwargs)
    run = {"total_steps": total_steps, "horizon": episodes.settings.horizon, "seed": seed}
    given = advice.get("teacher")
    if any(map(names_code, given if isinstance(given, list) else [given])):
        run["n_arms"] = episodes.task.n_arms
    ready = {**run, **advice}
    make_advisor(
        **{name: value for name, value in ready.items() if name != "warm_start"},
        episodes=episodes,
        observation_space=observation_space(episodes),
        action_space=action_space(episodes),
    )
    return ready


def latest_model(output: Path, algorithm: str, env_id: str) -> Path:
    """Find the last model that a run of RL Zoo wrote.

    :param output: RL Zoo's log folder.
    :param algorithm: a name in its table.
    :param env_id: the environment.
    :raises UsageError: if there is none.
    """
    from rl_zoo3.utils import get_latest_run_id

    folder = output / algorithm
    number = get_latest_run_id(str(folder), env_id)
    path = folder / f"{env_id}_{number}" / f"{env_id}.zip"
    if not path.is_file():
        raise UsageError(f"argument --resume: there is no finished or interrupted run in {folder}")
    return path
