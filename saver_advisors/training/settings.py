"""Settings of a training run, read from and written to YAML and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from saver_advisors.evaluation.protocol import check_selection, training_seed
from saver_advisors.learner.imitation import COLLISION_COST
from saver_advisors.variable_reward.replay import RELABELLINGS
from saver_envs.randomization.presets import plain_options
from saver_envs.validation import (
    FloatBelowOne,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    UnitFloat,
    check_fields,
)

ALGORITHM_NAMES = ("ddpg", "td3", "sac", "tqc", "dagger")

#: Prefixes of the settings' names in messages, as in `--set advice.budget=0`.
_PREFIXES = {"RunConfig": "", "AdviceConfig": "advice.", "StageConfig": "stages."}

Config = TypeVar("Config", "RunConfig", "AdviceConfig", "StageConfig")


@dataclass(frozen=True)
class AdviceConfig:
    """How a run uses its teachers: as advisors, and in other ways that share the budget.

    Fields that ``saver_advisors.advising.make_advisor`` has too are passed to it. The others work
    with every strategy, ``none`` included.

    :param strategy: name, such as ``mc-q``, or "module:Class".
    :param teacher: a shipped policy's name, a weight file, a run's folder, a zip file of SB3,
        "module:function" or "scripted:ID"; or a list with one of those per arm; or "expert", the
        environment's scripted expert, whose arms give way to one another.
    :param budget: environment steps that may be advised.
    :param threshold: threshold of a correcting strategy; None selects the strategy's default.
    :param correcting: the second half of ``early-mc``; None selects its default.
    :param settings: further arguments of the strategy's class.
    :param compare: "noisy" or "noise-free": which student action a correcting strategy evaluates.
    :param twin_minimum: use the smallest of the teacher's critics, otherwise the first.
    :param arms: indices of the arms that may be advised; None means every arm.
    :param bootstrap: use the better of the student's and the teacher's next action in the
        learner's target while the budget lasts (the second half of IBRL; TD3).
    :param demonstration_steps: environment steps at the start in which the teachers control every
        arm and fill a buffer of demonstrations. They are rounded up to whole episodes, and count
        as steps of the run and as advice.
    :param demonstration_fraction: fraction of each batch drawn from that buffer (0.5: RLPD).
    :param cloning_updates: gradient steps that fit the actor to the demonstrations before
        reinforcement learning starts.
    :param warm_start: initialise the student's networks with the teachers' weights, arm by arm.
    :raises TypeError: for a value of the wrong type.
    :raises ValueError: for a value out of range.
    """

    strategy: str
    teacher: str | tuple[str, ...]
    budget: NonNegativeInt
    threshold: NonNegativeFloat | None = None
    correcting: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    compare: str = "noisy"
    twin_minimum: bool = True
    arms: tuple[int, ...] | None = None
    bootstrap: bool = False
    demonstration_steps: NonNegativeInt = 0
    demonstration_fraction: FloatBelowOne = 0.5
    cloning_updates: NonNegativeInt = 0
    warm_start: bool = False

    def __post_init__(self) -> None:
        check_fields(self, "advice.")
        paid = self.demonstration_steps <= self.budget
        wanted = f"at most advice.budget={self.budget}, which pays for them"
        _require(paid, self, "demonstration_steps", wanted)
        possible = self.cloning_updates == 0 or self.demonstration_steps > 0
        wanted = "0 if advice.demonstration_steps is 0: there is nothing to clone"
        _require(possible, self, "cloning_updates", wanted)
        single = not (self.bootstrap and self.teacher == "expert")
        wanted = "false with the teacher 'expert', which keeps plans from step to step"
        _require(single, self, "bootstrap", wanted)
        named = bool(self.teachers) and all(isinstance(one, str) and one for one in self.teachers)
        _require(named, self, "teacher", "a name, or a list of one name per arm")

    @property
    def teachers(self) -> tuple[str, ...]:
        """The names of all teachers."""
        return (self.teacher,) if isinstance(self.teacher, str) else self.teacher


@dataclass(frozen=True)
class StageConfig:
    """A stage of a run with a variable reward; see ``saver_advisors.variable_reward``.

    :param stage: ``teaching``, ``stretching`` or ``exploring``.
    :param until: ``budget``, ``steps N`` (of the stage) or ``success S``; None for the last stage.
    :raises TypeError: for a value of the wrong type.
    """

    stage: str
    until: str | None = None

    def __post_init__(self) -> None:
        check_fields(self, "stages.")


@dataclass(frozen=True)
class RunConfig:
    """Everything that determines the result of a run.

    :param env_id: Gymnasium id.
    :param env_kwargs: keyword arguments of the environment.
    :param train_env_kwargs: further ones for training only, such as easier starts.
    :param n_envs: number of environments stepped together.
    :param algorithm: ``ddpg``, ``td3``, ``sac``, ``tqc``, or ``dagger``: it imitates teachers and
        needs the strategy of that name.
    :param total_steps: environment steps of all environments together, rounded up to a block.
    :param seed: seed of all random numbers of the run; the protocol's seeds of its episodes follow
        from it (``saver_advisors.evaluation.protocol``).
    :param net_arch: widths of the hidden layers of actor and critics.
    :param batch_size: transitions per gradient step.
    :param learning_rate: learning rate of Adam.
    :param final_learning_rate: learning rate at the end of the run, approached linearly during its
        last third; None keeps the learning rate constant.
    :param gamma: discount.
    :param q_min: lower bound of the target critic's values; None derives it from the least reward
        of a step (-1, unless the task has another) and the discount.
    :param tau: Polyak coefficient of the target networks, per update of the actor.
    :param policy_delay: critic updates per actor update (TD3).
    :param target_policy_noise: standard deviation of the target policy smoothing (TD3).
    :param target_noise_clip: bound of that noise (TD3).
    :param buffer_size: capacity of the replay buffer in transitions.
    :param gradient_steps: gradient steps per block of one episode in each environment.
    :param learning_starts: steps without learning, with random actions, or with those of the policy
        that ``start_from`` or a warm start gives.
    :param exploration_noise: standard deviation of the noise on the action scaled to [-1, 1].
    :param random_action_probability: fraction of steps with a uniform action instead.
    :param random_action_steps: mean number of steps for which a uniform action is held.
    :param action_penalty: weight of the mean squared action in the actor's loss (DDPG, TD3).
    :param layer_norm: use LayerNorm in the critics.
    :param achieved_goal_input: give the achieved goal to actor and critics too, for tasks in which
        it holds more than positions.
    :param relabel_probability: probability that a sampled transition gets a hindsight goal.
    :param imitation_weight: weight of imitation in the actor's loss (TD3): of advised actions, or
        of the labels that the strategy ``dagger`` gives.
    :param imitation_filter_start: steps after which the actor imitates only those advised actions
        that the critic prefers to its own (TD3).
    :param per_arm_critics: give each arm's part of the goal its own hindsight goal, reward and
        critic output; the actor maximises their mean (TD3).
    :param shared_arms: use one actor and one set of critics for every arm; each arm has its own
        hindsight goal and reward, and ``batch_size`` transitions are as many samples per arm (TD3).
    :param team_rewards: reward each arm with the mean over all arms' goals instead (TD3, with
        ``shared_arms`` or ``per_arm_critics``).
    :param start_from: folder of a run whose best policy is this run's first, with its normaliser
        and critics but a new replay. The networks must be the same; with ``shared_arms``, they are
        for any number of arms.
    :param contact_cost: weight of steps with ``cost_key`` relative to steps away from the goal, in
        a value of the critics' own (TD3).
    :param cost_limit: steps with ``cost_key`` per episode beyond which that weight, which starts
        at ``contact_cost``, rises, and below which it falls; None keeps it fixed (TD3).
    :param cost_key: the cost that both are about, an entry of ``info``; contact by default.
    :param multiplier_lr: learning rate of that weight, per block (TD3).
    :param stages: stages of a variable reward in their order, or None; for tasks with a constraint.
    :param constraint_relabelling: how the constraint's required value changes in a relabelled
        transition: ``next``, ``future`` or ``keep``; None treats it as the rest of the goal.
    :param constraint_value_weight: weight of the constraint's critic output in the actor's
        objective, in which each arm's has weight 1; for ``per_arm_critics`` with stages.
    :param advice: how teachers are used, or None.
    :param eval_every: environment steps between evaluations.
    :param eval_episodes: episodes per evaluation, without noise and advice.
    :param eval_seed: seed of the first evaluation episode; the others follow consecutively. All are
        selection seeds.
    :param checkpoint_every: environment steps between checkpoints.
    :raises TypeError: for a value of the wrong type.
    :raises ValueError: for a value out of range, or settings that exclude each other.
    """

    env_id: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    train_env_kwargs: dict[str, Any] = field(default_factory=dict)
    n_envs: PositiveInt = 16
    algorithm: str = "td3"
    total_steps: PositiveInt = 1_000_000
    seed: NonNegativeInt = 0
    net_arch: tuple[int, ...] = (256, 256, 256)
    batch_size: PositiveInt = 512
    learning_rate: PositiveFloat = 1e-3
    final_learning_rate: float | None = None
    gamma: FloatBelowOne = 0.98
    q_min: float | None = None
    tau: UnitFloat = 0.01
    policy_delay: PositiveInt = 2
    target_policy_noise: NonNegativeFloat = 0.1
    target_noise_clip: NonNegativeFloat = 0.2
    buffer_size: PositiveInt = 300_000
    gradient_steps: PositiveInt = 40
    learning_starts: NonNegativeInt = 0
    exploration_noise: NonNegativeFloat = 0.15
    random_action_probability: UnitFloat = 0.2
    random_action_steps: PositiveInt = 1
    action_penalty: NonNegativeFloat = 0.1
    layer_norm: bool = True
    achieved_goal_input: bool = False
    relabel_probability: UnitFloat = 0.8
    imitation_weight: NonNegativeFloat = 0.0
    imitation_filter_start: NonNegativeInt = 0
    per_arm_critics: bool = False
    shared_arms: bool = False
    team_rewards: bool = False
    start_from: str | None = None
    contact_cost: NonNegativeFloat = 0.0
    cost_limit: NonNegativeFloat | None = None
    cost_key: str = COLLISION_COST
    multiplier_lr: PositiveFloat = 0.035
    stages: tuple[StageConfig, ...] | None = None
    constraint_relabelling: str | None = None
    constraint_value_weight: NonNegativeFloat = 1.0
    advice: AdviceConfig | None = None
    eval_every: PositiveInt = 20_000
    eval_episodes: PositiveInt = 100
    eval_seed: NonNegativeInt = 10_000
    checkpoint_every: PositiveInt = 50_000

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("env_kwargs", "train_env_kwargs"):
            object.__setattr__(self, name, plain_options(getattr(self, name)))
        if self.algorithm not in ALGORITHM_NAMES:
            raise ValueError(
                f"algorithm={self.algorithm!r} must be one of {ALGORITHM_NAMES}: hindsight goals "
                "and a teacher's actions need an off-policy algorithm"
            )
        training_seed(self.seed)  # raises if it has none
        check_selection(self.eval_seed, self.eval_episodes)
        bootstrap = self.advice is not None and self.advice.bootstrap
        strategy = None if self.advice is None else self.advice.strategy
        if self.algorithm == "dagger" and strategy not in (None, "dagger"):
            raise ValueError(
                f"algorithm='dagger' and advice.strategy={strategy!r}: it imitates labels, which "
                "the strategy 'dagger' gives"
            )
        imitates = self.algorithm == "td3" and self.imitation_weight > 0
        if strategy == "dagger" and not (imitates or self.algorithm == "dagger"):
            raise ValueError(
                f"advice.strategy='dagger' and algorithm={self.algorithm!r}: labels need algorithm="
                "'dagger', or 'td3' with imitation_weight above 0"
            )
        if self.shared_arms and self.algorithm not in ("td3", "dagger"):
            raise ValueError(
                f"shared_arms=True needs algorithm='td3' or 'dagger', not {self.algorithm!r}"
            )
        of_td3 = {
            "advice.bootstrap": bootstrap,
            "per_arm_critics": self.per_arm_critics,
            "contact_cost": self.contact_cost if self.contact_cost > 0 else False,
            "cost_limit": False if self.cost_limit is None else self.cost_limit,
        }
        for name, used in of_td3.items():
            if used is not False and self.algorithm != "td3":
                raise ValueError(f"{name}={used} needs algorithm='td3', not {self.algorithm!r}")
        own = self.shared_arms or self.per_arm_critics
        wanted = "false unless shared_arms or per_arm_critics gives each arm a reward"
        _require(own or not self.team_rewards, self, "team_rewards", wanted)
        known = self.constraint_relabelling in (None, *RELABELLINGS)
        wanted = f"one of {', '.join(RELABELLINGS)}, or null"
        _require(known, self, "constraint_relabelling", wanted)
        last = self.final_learning_rate
        falls = last is None or 0 < last <= self.learning_rate
        wanted = f"positive and at most learning_rate={self.learning_rate}"
        _require(falls, self, "final_learning_rate", wanted)
        if any(type(width) is not int for width in self.net_arch):
            raise TypeError(f"net_arch={self.net_arch} must be a list of whole numbers")
        positive = len(self.net_arch) > 0 and min(self.net_arch) > 0
        _require(positive, self, "net_arch", "widths of one or more layers")

    @property
    def learns_costs(self) -> bool:
        """Whether the critics have a value of the cost."""
        return self.contact_cost > 0 or self.cost_limit is not None

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> RunConfig:
        """Create a configuration from plain values, as YAML and JSON contain them.

        :param values: values by field name; ``advice`` is a mapping or None.
        :return: the configuration, with defaults for missing names.
        :raises ValueError: for unknown or missing names and values out of range, naming them.
        :raises TypeError: for values of the wrong type.
        """
        values = dict(values)
        if isinstance(values.get("advice"), Mapping):
            values["advice"] = _build(AdviceConfig, values["advice"])
        if isinstance(values.get("stages"), (list, tuple)):
            values["stages"] = [_build(StageConfig, one) for one in values["stages"]]
        return _build(cls, values)

    def learning_rate_at(self, steps: int) -> float:
        """Compute the learning rate at a point of the run.

        :param steps: environment steps done.
        :return: the learning rate of Adam.
        """
        if self.final_learning_rate is None:
            return self.learning_rate
        left = min(1.0, 3.0 * max(0.0, 1.0 - steps / self.total_steps))
        return self.final_learning_rate + left * (self.learning_rate - self.final_learning_rate)

    def score(self, rates: Mapping[str, Any]) -> float:
        """Return by what policies of the run are chosen: success, and where contact costs, safety.

        :param rates: of an evaluation: ``success_rate`` and ``safe_success_rate``.
        """
        success: float = rates["success_rate"]
        contact = self.learns_costs and self.cost_key == COLLISION_COST
        return (success + rates["safe_success_rate"]) / 2 if contact else success

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for ``from_mapping``, JSON and YAML."""
        return dict(json.loads(json.dumps(asdict(self))))


def read_mapping(path: Path) -> dict[str, Any]:
    """Read names and values from a file.

    :param path: a YAML file, or a JSON file that ends in ``.json``.
    :return: the content.
    :raises ValueError: for a file that is neither or holds something else; it names the file.
    :raises OSError: for a file that cannot be read.
    """
    import yaml

    try:
        text = path.read_text(encoding="utf-8")
        # YAML 1.1 reads JSON's 1e-05 as text.
        content = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise ValueError(f"{path} is neither YAML nor JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} must contain names and values")
    return content


@contextmanager
def naming(subject: str) -> Iterator[None]:
    """Prefix the messages of errors about wrong values.

    :param subject: the setting or file that is wrong.
    :raises ValueError: as raised within.
    :raises TypeError: as raised within.
    """
    try:
        yield
    except (ValueError, TypeError) as error:
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(f"{subject}: {error}") from error


def _build(cls: type[Config], values: Mapping[str, Any]) -> Config:
    """Create a configuration from names and values, with errors that name the setting."""
    prefix = _PREFIXES[cls.__name__]
    if not isinstance(values, Mapping):
        raise TypeError(f"{prefix.rstrip('.')}: {values!r} must be a mapping of settings")
    types = {f.name: str(f.type) for f in fields(cls)}
    unknown = sorted(str(name) for name in set(values) - set(types))
    if unknown:
        raise ValueError(
            f"unknown {', '.join(prefix + name for name in unknown)}; valid names are "
            f"{', '.join(types)}"
        )
    required = [f.name for f in fields(cls) if f.default is f.default_factory is MISSING]
    missing = [prefix + name for name in required if name not in values]
    if missing:
        raise ValueError(f"{', '.join(missing)} must be given")
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) and "tuple" in types[name] else value
        for name, value in values.items()
    }
    return cls(**given)


def _require(
    condition: bool, config: RunConfig | AdviceConfig | StageConfig, name: str, wanted: str
) -> None:
    if not condition:
        prefix, value = _PREFIXES[type(config).__name__], getattr(config, name)
        raise ValueError(f"{prefix}{name}={value} must be {wanted}")
