"""What decides a run's outcome, readable from and writable to YAML and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from saver_advisors.reporting.provenance import write_json_atomic

ALGORITHM_NAMES = ("ddpg", "td3", "sac", "tqc")

ADVISOR_FIELDS = (
    "strategy",
    "teacher",
    "budget",
    "threshold",
    "correcting",
    "settings",
    "compare",
    "twin_minimum",
    "arms",
)

# Numbers of a run, by the range that they lie in.
_POSITIVE = (
    "n_envs",
    "total_steps",
    "batch_size",
    "learning_rate",
    "policy_delay",
    "buffer_size",
    "gradient_steps",
    "eval_every",
    "eval_episodes",
    "checkpoint_every",
)
_NOT_NEGATIVE = (
    "seed",
    "learning_starts",
    "exploration_noise",
    "target_policy_noise",
    "target_noise_clip",
    "action_penalty",
    "imitation_weight",
    "imitation_filter_start",
    "constraint_value_weight",
    "eval_seed",
)
_SHARES = ("random_action_probability", "relabel_probability", "tau")

Config = TypeVar("Config", "RunConfig", "AdviceConfig", "StageConfig")


@dataclass(frozen=True)
class AdviceConfig:
    """What a run takes from teachers: advice, and what else one can do with the same budget.

    The first nine are the arguments of ``saver_advisors.advising.make_advisor``. Those below work
    beside any strategy, ``none`` among them.

    :param strategy: name, e.g. ``mc-q``, or "module:Class"
    :param teacher: a shipped policy's name or a weight file; or a list of those, one an arm
    :param budget: environment steps that may be advised
    :param threshold: of a correcting strategy, its default where None
    :param correcting: the second half of ``early-mc``, its default where None
    :param settings: further arguments of the strategy's class
    :param compare: "noisy" or "noise-free", the student's action that is judged
    :param twin_minimum: a teacher's value is the smallest of its critics', else the first's
    :param arms: which arms may be advised, counted from 0; every arm where None
    :param bootstrap: the learner's target takes the better of the student's next action and the
        teacher's, while the budget lasts (IBRL's second half; TD3)
    :param demonstration_steps: environment steps at the start in which the teachers drive every arm
        into a buffer of demonstrations; they count as steps of the run and as advice, and whole
        episodes are finished
    :param demonstration_fraction: of each batch that is drawn from that buffer (0.5: RLPD)
    :param cloning_updates: gradient steps that fit the actor to the demonstrations before it learns
    :param warm_start: the student's networks start as the teachers', arm by arm
    """

    strategy: str
    teacher: str | tuple[str, ...]
    budget: int
    threshold: float | None = None
    correcting: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    compare: str = "noisy"
    twin_minimum: bool = True
    arms: tuple[int, ...] | None = None
    bootstrap: bool = False
    demonstration_steps: int = 0
    demonstration_fraction: float = 0.5
    cloning_updates: int = 0
    warm_start: bool = False

    def __post_init__(self) -> None:
        _check_types(self, "advice.")
        limit = self.threshold
        _require(limit is None or limit >= 0, "advice.threshold", limit, "0 or more")
        for name in ("budget", "demonstration_steps", "cloning_updates"):
            _require(getattr(self, name) >= 0, f"advice.{name}", getattr(self, name), "0 or more")
        share = self.demonstration_fraction
        _require(0 <= share < 1, "advice.demonstration_fraction", share, "in [0, 1)")
        _require(
            self.demonstration_steps <= self.budget,
            "advice.demonstration_steps",
            self.demonstration_steps,
            f"at most advice.budget={self.budget}, which pays for them",
        )
        _require(
            self.cloning_updates == 0 or self.demonstration_steps > 0,
            "advice.cloning_updates",
            self.cloning_updates,
            "0 where advice.demonstration_steps is 0: there is nothing to clone",
        )
        teachers = (self.teacher,) if isinstance(self.teacher, str) else self.teacher
        named = bool(teachers) and all(isinstance(one, str) and one for one in teachers)
        _require(named, "advice.teacher", self.teacher, "a name, or a list of one name an arm")

    def advisor_arguments(self) -> dict[str, Any]:
        """
        :return: arguments of ``make_advisor``
        """
        return {name: getattr(self, name) for name in ADVISOR_FIELDS}


@dataclass(frozen=True)
class StageConfig:
    """A stage of a run with a variable reward; see ``saver_advisors.variable_reward``.

    :param stage: ``teaching``, ``stretching`` or ``exploring``
    :param until: ``budget``, ``steps N`` (of the stage) or ``success S``; None for the last stage
    """

    stage: str
    until: str | None = None

    def __post_init__(self) -> None:
        _check_types(self, "stages.")


@dataclass(frozen=True)
class RunConfig:
    """All that decides a run's outcome.

    :param env_id: Gymnasium id
    :param env_kwargs: arguments of the environment
    :param train_env_kwargs: further ones in training alone, such as easier starts
    :param n_envs: environments stepped together
    :param algorithm: ``ddpg``, ``td3``, ``sac`` or ``tqc``
    :param total_steps: environment steps, all environments together; a block is finished
    :param seed: of everything random in the run
    :param net_arch: hidden layers of actor and critics
    :param batch_size: transitions a gradient step
    :param learning_rate: of Adam
    :param final_learning_rate: reached at the end of the run, on a straight line through its last
        third; the learning rate all along where None
    :param gamma: discount
    :param q_min: least value of a target critic; where None the return of failing for ever, of the
        environment's least reward (-1, or what its task says) in every step
    :param tau: Polyak step of the targets, for each update of the actor
    :param policy_delay: critic updates for one of the actor (TD3)
    :param target_policy_noise: standard deviation of the target smoothing (TD3)
    :param target_noise_clip: bound on that noise (TD3)
    :param buffer_size: transitions kept
    :param gradient_steps: after each block of one episode an environment
    :param learning_starts: steps with random actions and no learning
    :param exploration_noise: standard deviation on the action scaled to [-1, 1]
    :param random_action_probability: of a uniform action instead
    :param action_penalty: weight of the actions' mean square in the actor's loss (DDPG, TD3)
    :param layer_norm: LayerNorm in the critics
    :param achieved_goal_input: actor and critics read the achieved goal too, for tasks where it
        holds more than positions
    :param relabel_probability: share of sampled transitions with a hindsight goal
    :param imitation_weight: of the actor's loss on advised transitions (TD3)
    :param imitation_filter_start: steps from which on only advised actions are imitated that the
        critic finds better (TD3)
    :param per_arm_critics: give each arm's part of the goal a hindsight goal, a reward and a value
        of its own; the actor maximises the values' mean (TD3)
    :param stages: of a variable reward, in their order, or None; for tasks with a constraint
    :param constraint_relabelling: what becomes of the required value of a relabelled transition:
        ``next``, ``future`` or ``keep``; as every other part of the goal where None
    :param constraint_value_weight: of the constraint's own value in what the actor maximises, each
        arm's weighing 1; for ``per_arm_critics`` with stages
    :param advice: a teacher's advice, or None
    :param eval_every: steps between evaluations
    :param eval_episodes: episodes of an evaluation, without noise and advice
    :param eval_seed: seed of the first of them, the others count up
    :param checkpoint_every: steps between checkpoints
    """

    env_id: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    train_env_kwargs: dict[str, Any] = field(default_factory=dict)
    n_envs: int = 16
    algorithm: str = "td3"
    total_steps: int = 1_000_000
    seed: int = 0
    net_arch: tuple[int, ...] = (256, 256, 256)
    batch_size: int = 512
    learning_rate: float = 1e-3
    final_learning_rate: float | None = None
    gamma: float = 0.98
    q_min: float | None = None
    tau: float = 0.01
    policy_delay: int = 2
    target_policy_noise: float = 0.1
    target_noise_clip: float = 0.2
    buffer_size: int = 300_000
    gradient_steps: int = 40
    learning_starts: int = 0
    exploration_noise: float = 0.15
    random_action_probability: float = 0.2
    action_penalty: float = 0.1
    layer_norm: bool = True
    achieved_goal_input: bool = False
    relabel_probability: float = 0.8
    imitation_weight: float = 0.0
    imitation_filter_start: int = 0
    per_arm_critics: bool = False
    stages: tuple[StageConfig, ...] | None = None
    constraint_relabelling: str | None = None
    constraint_value_weight: float = 1.0
    advice: AdviceConfig | None = None
    eval_every: int = 20_000
    eval_episodes: int = 100
    eval_seed: int = 10_000
    checkpoint_every: int = 50_000

    def __post_init__(self) -> None:
        _check_types(self, "")
        if self.algorithm not in ALGORITHM_NAMES:
            raise ValueError(
                f"algorithm={self.algorithm!r} must be one of {ALGORITHM_NAMES}: goals in "
                "hindsight and a teacher's actions need an off-policy algorithm"
            )
        if self.advice is not None and self.advice.bootstrap and self.algorithm != "td3":
            raise ValueError(f"advice.bootstrap=True needs algorithm='td3', not {self.algorithm!r}")
        if self.per_arm_critics and self.algorithm != "td3":
            raise ValueError(f"per_arm_critics=True needs algorithm='td3', not {self.algorithm!r}")
        self._check_ranges()

    def _check_ranges(self) -> None:
        """
        :raises ValueError: for a value out of its range, naming both
        """
        for name in _POSITIVE:
            _require(getattr(self, name) > 0, name, getattr(self, name), "positive")
        for name in _NOT_NEGATIVE:
            _require(getattr(self, name) >= 0, name, getattr(self, name), "0 or more")
        for name in _SHARES:
            _require(0 <= getattr(self, name) <= 1, name, getattr(self, name), "in [0, 1]")
        if self.constraint_relabelling is not None:
            ways = ("next", "future", "keep")
            known = self.constraint_relabelling in ways
            wanted = f"one of {', '.join(ways)}, or null"
            _require(known, "constraint_relabelling", self.constraint_relabelling, wanted)
        if self.final_learning_rate is not None:
            wanted = f"positive and at most learning_rate={self.learning_rate}"
            within = 0 < self.final_learning_rate <= self.learning_rate
            _require(within, "final_learning_rate", self.final_learning_rate, wanted)
        _require(0 <= self.gamma < 1, "gamma", self.gamma, "in [0, 1)")
        if any(type(width) is not int for width in self.net_arch):
            raise TypeError(f"net_arch={self.net_arch} must be a list of whole numbers")
        positive = len(self.net_arch) > 0 and min(self.net_arch) > 0
        _require(positive, "net_arch", self.net_arch, "widths of one or more layers")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> RunConfig:
        """A configuration from plain values, as YAML and JSON have them.

        :param values: by field name; ``advice`` a mapping or None
        :return: the configuration, with defaults for what is missing
        :raises ValueError: for unknown or missing names and values that cannot be, naming them
        :raises TypeError: for values of the wrong type
        """
        values = dict(values)
        if isinstance(values.get("advice"), Mapping):
            advice = dict(values["advice"])
            for name in ("teacher", "arms"):
                if isinstance(advice.get(name), list):
                    advice[name] = tuple(advice[name])
            values["advice"] = _build(AdviceConfig, advice, "advice.")
        if isinstance(values.get("stages"), (list, tuple)):
            values["stages"] = tuple(
                one if isinstance(one, StageConfig) else _build(StageConfig, one, "stages.")
                for one in values["stages"]
            )
        if isinstance(values.get("net_arch"), list):
            values["net_arch"] = tuple(values["net_arch"])
        return _build(cls, values, "")

    @classmethod
    def from_file(cls, path: str | Path) -> RunConfig:
        """A configuration from a ``.yaml``, ``.yml`` or ``.json`` file.

        :param path: of the file
        :return: the configuration
        :raises ValueError: as ``from_mapping``, or where the file is neither, naming it
        """
        path = Path(path)
        text = path.read_text(encoding="utf-8")
        try:
            values = _parse(path, text)
            if not isinstance(values, Mapping):
                raise ValueError("it must hold names and values")
            return cls.from_mapping(values)
        except (ValueError, TypeError) as error:
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{path}: {error}") from error

    def learning_rate_at(self, steps: int) -> float:
        """The learning rate in a part of the run.

        :param steps: environment steps done
        :return: of Adam
        """
        if self.final_learning_rate is None:
            return self.learning_rate
        left = min(1.0, 3.0 * max(0.0, 1.0 - steps / self.total_steps))
        return self.final_learning_rate + left * (self.learning_rate - self.final_learning_rate)

    def to_mapping(self) -> dict[str, Any]:
        """
        :return: plain values, for ``from_mapping``, JSON and YAML
        """
        values = {**asdict(self), "net_arch": list(self.net_arch)}
        if self.stages is not None:
            values["stages"] = list(values["stages"])
        return values

    def to_file(self, path: str | Path) -> None:
        """Write the configuration for ``from_file``.

        :param path: ending in ``.yaml``, ``.yml`` or ``.json``
        """
        path = Path(path)
        if path.suffix == ".json":
            write_json_atomic(path, self.to_mapping())
            return
        import yaml

        _require(path.suffix in (".yaml", ".yml"), "path", path, "a .yaml, .yml or .json file")
        path.write_text(yaml.safe_dump(self.to_mapping(), sort_keys=False), encoding="utf-8")


def _parse(path: Path, text: str) -> Any:
    """The content of a YAML or JSON file."""
    if path.suffix == ".json":
        return json.loads(text)
    if path.suffix not in (".yaml", ".yml"):
        raise ValueError("the file's name must end in .yaml, .yml or .json")
    import yaml

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(f"it is not YAML: {error}") from error


def _build(cls: type[Config], values: Mapping[str, Any], prefix: str) -> Config:
    """A configuration from names and values, with errors that name what is wrong."""
    known = [f.name for f in fields(cls)]
    unknown = sorted(str(name) for name in set(values) - set(known))
    if unknown:
        raise ValueError(
            f"unknown {', '.join(prefix + name for name in unknown)}; valid names are "
            f"{', '.join(known)}"
        )
    try:
        return cls(**values)
    except TypeError as error:
        if "missing" not in str(error):
            raise
        required = [f.name for f in fields(cls) if f.default is f.default_factory is MISSING]
        missing = [prefix + name for name in required if name not in values]
        raise ValueError(f"{', '.join(missing)} must be given") from error


def _check_types(config: RunConfig | AdviceConfig | StageConfig, prefix: str) -> None:
    """Whole numbers, numbers, names: each where its hint says so."""
    for f in fields(config):
        value = getattr(config, f.name)
        allowed, hint = _EXPECTED[str(f.type)]
        wrong_bool = isinstance(value, bool) and bool not in allowed
        if wrong_bool or not isinstance(value, allowed):
            if isinstance(value, str) and float in allowed:
                hint += "; YAML reads 1e-3 as text, write 1.0e-3"
            raise TypeError(f"{prefix}{f.name}={value!r} must be {hint}")
        if isinstance(value, float):
            _require(math.isfinite(value), prefix + f.name, value, "finite")


_EXPECTED: dict[str, tuple[tuple[type, ...], str]] = {
    "str": ((str,), "a text"),
    "str | None": ((str, type(None)), "a text or null"),
    "int": ((int,), "a whole number"),
    "bool": ((bool,), "true or false"),
    "float": ((float, int), "a number"),
    "float | None": ((float, int, type(None)), "a number or null"),
    "dict[str, Any]": ((dict,), "a mapping"),
    "tuple[int, ...]": ((tuple,), "a list of whole numbers"),
    "tuple[int, ...] | None": ((tuple, type(None)), "a list of whole numbers or null"),
    "str | tuple[str, ...]": ((str, tuple), "a text or a list of texts"),
    "tuple[StageConfig, ...] | None": ((tuple, type(None)), "a list of stages or null"),
    "AdviceConfig | None": ((AdviceConfig, type(None)), "a mapping of advice settings or null"),
}


def _require(condition: bool, name: str, value: Any, wanted: str) -> None:
    if not condition:
        raise ValueError(f"{name}={value} must be {wanted}")
