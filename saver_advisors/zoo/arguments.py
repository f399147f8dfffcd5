"""`saver train --zoo`: from our arguments to RL Zoo's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes
from saver_advisors.safe_baselines import ALGORITHMS as SAFE
from saver_advisors.zoo.algorithms import ADVISED, ALGORITHMS, STOCK

ADVICE_KEY: Final = "advice"
"""Entry of a settings file, beside those of the environments: what to advise in each of them."""
ANY_ENVIRONMENT: Final = "default"
"""Entry of a settings file for environments without one of their own; RL Zoo's word."""
SHARED: Final = {"goal_ddpg": "goal", "goal_sac": "goal", "goal_tqc": "goal"}
"""Algorithms whose settings are not in a file of their own name."""
EVALUATION: Final = {"--eval-episodes": "50", "--n-eval-envs": "10"}
"""Of RL Zoo's arguments, those whose defaults (5 episodes in one environment) choose by luck."""
OURS: Final = {
    "--algo": "--zoo",
    "--env": "--env",
    "-f": "--output",
    "--log-folder": "--output",
    "-n": "--steps",
    "--n-timesteps": "--steps",
    "--seed": "--seed",
    "-conf": "--config",
    "--conf-file": "--config",
    "-params": "--set",
    "--hyperparams": "--set",
    "--env-kwargs": "--env-kwargs",
    "--eval-env-kwargs": "--env-kwargs",
}
"""RL Zoo's arguments that `saver train` has itself; a second value would silently win."""


@dataclass(frozen=True)
class ZooRun:
    """What a run under RL Zoo is to be.

    :param algorithm: a key of `ALGORITHMS`, one of `STOCK`, or a safe one
    :param env_id: a registered id
    :param config: the settings file, in RL Zoo's format
    :param output: RL Zoo's log folder
    :param advice: arguments of `make_advisor`, or None
    :param steps: environment steps, the file's where None
    :param seed: of everything random
    :param overrides: hyper-parameters in place of the file's
    :param env_kwargs: arguments of the environment, in training and in evaluation
    :param trained: a model to go on from, or None
    :param more: RL Zoo's own arguments
    """

    algorithm: str
    env_id: str
    config: Path
    output: Path
    advice: Mapping[str, Any] | None = None
    steps: int | None = None
    seed: int = 0
    overrides: Mapping[str, Any] = field(default_factory=dict)
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    trained: Path | None = None
    more: Sequence[str] = ()

    def arguments(self) -> list[str]:
        """The words for RL Zoo's command line."""
        words = ["--algo", self.algorithm, "--env", self.env_id, "--conf-file", str(self.config)]
        words += ["--log-folder", str(self.output), "--seed", str(self.seed), "--num-threads", "1"]
        if self.steps is not None:
            words += ["--n-timesteps", str(self.steps)]
        if self.trained is not None:
            words += ["--trained-agent", str(self.trained)]
        for name, value in EVALUATION.items():
            words += [name, value]
        for name, values in (
            ("--hyperparams", self._hyperparameters()),
            *zip(("--env-kwargs", "--eval-env-kwargs"), self._environments(), strict=True),
        ):
            if values:
                # RL Zoo evaluates what follows the colon: a representation of plain values.
                words += [name, *(f"{key}:{value!r}" for key, value in values.items())]
        return [*words, *self.more]

    def _hyperparameters(self) -> dict[str, Any]:
        advice = {} if self.advice is None else {"advisor": dict(self.advice)}
        return {**self.overrides, **advice}

    def _environments(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arguments of the environment in training and in evaluation.

        RL Zoo 2.9 keeps the file's `env_kwargs` from its evaluations. That is what they are for
        here, easier starts, so it is said in words that do not depend on it: each of them gets its
        default in evaluation.
        """
        from saver_envs.registration import Options

        easier = dict(read_settings(self.config, self.env_id)[0].get("env_kwargs") or {})
        usual = {name: getattr(Options(), name) for name in easier}
        return {**easier, **self.env_kwargs}, {**usual, **self.env_kwargs}


def settings_path(algorithm: str) -> Path:
    """The shipped settings of an algorithm.

    They lie in `zoo_configs/` of a checkout, and beside this module in an installed package.

    :param algorithm: a key of `ALGORITHMS`, or one of `STOCK`
    """
    stem = SHARED.get(algorithm, algorithm.removeprefix(ADVISED))
    installed = Path(__file__).with_name("configs")
    checkout = Path(__file__).resolve().parents[2] / "zoo_configs"
    return (installed if installed.is_dir() else checkout) / f"{stem}.yml"


def algorithm_name(name: str, advised: bool) -> str:
    """The name in RL Zoo's table.

    :param name: a stock or safe algorithm's, or a key of `ALGORITHMS`
    :param advised: whether advice is to be given: a stock algorithm then becomes its advised twin
    :raises UsageError: for an unknown one, or one that cannot be advised
    """
    known = (*STOCK, *ALGORITHMS, *SAFE)
    if name not in known:
        raise UsageError(f"argument --zoo: {unknown('algorithm', name, known)}")
    if advised and name in SAFE:
        raise UsageError(
            f"argument --advice: {name} learns on policy, from its own actions alone; advice works "
            f"with {', '.join((*STOCK, *ALGORITHMS))}"
        )
    return f"{ADVISED}{name}" if advised and name in STOCK else name


def read_settings(path: Path, env_id: str) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """An environment's entry in a settings file, and the advice given there.

    :param path: a YAML file in RL Zoo's format
    :param env_id: a registered id
    :return: hyper-parameters, and arguments of `make_advisor` or None
    :raises UsageError: where the file cannot be read or says nothing about the environment
    """
    import yaml

    with user_mistakes("argument --config"):
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
        except yaml.YAMLError as error:
            raise UsageError(f"argument --config: {path} is no YAML: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(one, dict) for one in content.values()):
        raise UsageError(f"argument --config: {path} must have one entry an environment")
    entry = content.get(env_id, content.get(ANY_ENVIRONMENT))
    if entry is None:
        names = ", ".join(name for name in content if name != ADVICE_KEY)
        raise UsageError(f"argument --config: {path} has no entry for {env_id}; it has {names}")
    advice = entry.get("advisor", content.get(ADVICE_KEY, {}).get(env_id))
    return entry, advice


def check_arguments(more: Sequence[str]) -> None:
    """Refuse RL Zoo's arguments that ours would fight with.

    :param more: what follows `--`
    :raises UsageError: for one of `OURS`
    """
    for word in more:
        name = word.split("=")[0]
        if name in OURS:
            raise UsageError(f"argument {name}: before the -- it is {OURS[name]} of `saver train`")


def ready_advice(
    advice: Mapping[str, Any],
    env_id: str,
    env_kwargs: Mapping[str, Any],
    total_steps: int,
    seed: int,
) -> dict[str, Any]:
    """Advice with what strategies ask about the run, refused where it does not fit.

    :param advice: arguments of `make_advisor`, and `warm_start`
    :param env_id: the student's environment
    :param env_kwargs: its arguments
    :param total_steps: of the run
    :param seed: of the run
    :return: the arguments, with `total_steps`, `horizon` and `seed` where they were not given
    :raises ValueError: where something does not fit
    :raises TypeError: for an argument that there is not
    """
    from saver_advisors.advising import make_advisor
    from saver_envs.envs.spaces import action_space, observation_space
    from saver_envs.registration import make_episodes

    episodes = make_episodes(env_id, **env_kwargs)
    run = {"total_steps": total_steps, "horizon": episodes.settings.horizon, "seed": seed}
    ready = {**run, **advice}
    arguments = {name: value for name, value in ready.items() if name != "warm_start"}
    make_advisor(
        **arguments,
        observation_space=observation_space(episodes),
        action_space=action_space(episodes),
    )
    return ready


def latest_model(output: Path, algorithm: str, env_id: str) -> Path:
    """The last model that a run of RL Zoo left.

    :param output: RL Zoo's log folder
    :param algorithm: a name in its table
    :param env_id: the environment
    :raises UsageError: where there is none
    """
    from rl_zoo3.utils import get_latest_run_id

    folder = output / algorithm
    number = get_latest_run_id(str(folder), env_id)
    path = folder / f"{env_id}_{number}" / f"{env_id}.zip"
    if not path.is_file():
        raise UsageError(f"argument --resume: there is no finished or interrupted run in {folder}")
    return path


def start(run: ZooRun) -> None:
    """Train under RL Zoo.

    :param run: what to do
    """
    from saver_advisors.zoo.manager import train

    own = any(word.split("=")[0] == "--vec-env" for word in run.more)
    train(run.arguments(), **({"vec_env_class": None} if own else {}))
