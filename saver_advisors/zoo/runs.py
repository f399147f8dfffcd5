"""Load the policy of a run under RL Zoo, without unpickling anything.

RL Zoo and Stable-Baselines3 unpickle parts of these files when they load a model. The policy needs
none of those: its settings are YAML, and torch reads its weights as plain tensors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.utils import ConstantSchedule


class _Loader(yaml.SafeLoader):
    """Plain values, tuples, and the ordered mapping in which RL Zoo wraps them."""


_PYTHON = "tag:yaml.org,2002:python/"
_Loader.add_constructor(
    f"{_PYTHON}object/apply:collections.OrderedDict",
    lambda loader, node: dict(*loader.construct_sequence(node, deep=True)),
)
_Loader.add_constructor(
    f"{_PYTHON}tuple", lambda loader, node: tuple(loader.construct_sequence(node, deep=True))
)


def load_run(path: Path) -> BasePolicy:
    """Load the policy of a run, for prediction.

    :param path: RL Zoo's folder of the run, for its best model, or its last if there is no best;
        or one of the zip files in it.
    :return: the policy, in evaluation mode.
    :raises ValueError: for another path, damaged files, an unknown algorithm, settings that are
        code, or a run whose observations were normalised outside the policy.
    """
    from rl_zoo3 import ALGOS

    from saver_advisors.zoo.algorithms import register_algorithms
    from saver_envs.envs.spaces import action_space, observation_space
    from saver_envs.registration import make_episodes

    model, settings = _files(path)
    register_algorithms()
    arguments, config = _read(settings / "args.yml"), _read(settings / "config.yml")
    algorithm = arguments.get("algo")
    if algorithm not in ALGOS:
        raise ValueError(f"{settings / 'args.yml'}: algo={algorithm!r} is unknown")
    if config.get("normalize"):
        raise ValueError(
            f"{settings}: normalize is on, and RL Zoo pickles its normaliser: play this "
            "model with `python -m saver_advisors.zoo enjoy`"
        )
    policy_arguments = config.get("policy_kwargs", {})
    if not isinstance(policy_arguments, dict):
        raise ValueError(
            f"{settings / 'config.yml'}: policy_kwargs={policy_arguments!r} is code: write "
            "it as names and values"
        )
    policies = ALGOS[algorithm].policy_aliases
    if config.get("policy") not in policies:
        raise ValueError(
            f"{settings / 'config.yml'}: policy={config.get('policy')!r} must be one of "
            f"{', '.join(policies)}"
        )
    env_kwargs = arguments.get("env_kwargs") or config.get("env_kwargs") or {}
    episodes = make_episodes(settings.name, **env_kwargs)
    build: Any = policies[config["policy"]]
    policy: BasePolicy = build(
        observation_space(episodes),
        action_space(episodes),
        ConstantSchedule(0.0),
        **policy_arguments,
    )
    parameters: Any = load_from_zip_file(model, load_data=False, device="cpu")[1]
    try:
        policy.load_state_dict(parameters["policy"])
    except (KeyError, RuntimeError) as error:
        raise ValueError(f"{model} does not hold this policy's weights: {error}") from error
    policy.set_training_mode(False)
    return policy


def _files(path: Path) -> tuple[Path, Path]:
    """Return the zip file of a run's model, and the folder of ``config.yml`` and ``args.yml``."""
    folder = path.parent if path.suffix == ".zip" else path
    settings = [one.parent for one in folder.glob("*/config.yml")]
    if len(settings) == 1:
        best, last = folder / "best_model.zip", folder / f"{settings[0].name}.zip"
        model = path if path.suffix == ".zip" else best if best.is_file() else last
        if model.is_file():
            return model, settings[0]
    raise ValueError(f"{str(path)!r} is neither a run's folder of `saver train` nor of RL Zoo")


def _read(path: Path) -> dict[str, Any]:
    """Read the names and values in one of RL Zoo's files."""
    try:
        values = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    except (OSError, yaml.YAMLError) as error:
        raise ValueError(f"{path} cannot be read as plain values: {error}") from error
    if not isinstance(values, dict):
        raise ValueError(f"{path} must contain names and values")
    return values
