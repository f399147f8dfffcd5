"""Cards of shipped policies: JSON in the weight file's header, and a readable copy in Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.policies.networks import NetworkSpec
from saver_envs.validation import NonNegativeFloat, NonNegativeInt, UnitFloat, check_fields

#: The end of a readable card.
USE_AND_LIMITS = (
    "- Intended use: baseline, teacher or start of further training in the environment above, in",
    "  simulation. Not for a robot near people.",
    "- Training data: episodes of that environment, and nothing recorded from people or robots.",
    "- Limits: objects, robots, delays and sensors that differ from the training environment lower",
    "  the success; `saver benchmark worlds` measures by how much.",
    "- Licence: MIT, as the code.",
)


@dataclass(frozen=True)
class PolicyCard:
    """Origin and success rate of a policy.

    :param env_id: the environment in which it was trained.
    :param algorithm: the learner, such as "GoalTD3".
    :param command: the command that trained it.
    :param steps: environment steps of that run.
    :param wall_clock_s: duration of the run in seconds.
    :param seed: of that run.
    :param commit: of the repository, at that run.
    :param success: success rate of the evaluation episodes, 0 to 1.
    :param success_episodes: number of evaluation episodes.
    :param safe_success: rate of success without a collision in the same episodes; None if unknown.
    :param success_2cm: rate of success with every object within 2 cm; None if unknown.
    :param task: the task in words.
    :param env_kwargs: keyword arguments of that environment.
    :param notes: anything else, shown in the readable card.
    :param networks: shapes and activations; filled in by `save_policy`.
    :raises TypeError: for a value of the wrong type.
    :raises ValueError: for a value out of range.
    """

    env_id: str
    algorithm: str
    command: str
    steps: NonNegativeInt
    wall_clock_s: NonNegativeFloat
    seed: int
    commit: str
    success: UnitFloat
    success_episodes: NonNegativeInt = 100
    safe_success: UnitFloat | None = None
    success_2cm: UnitFloat | None = None
    task: str = ""
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    notes: Mapping[str, Any] = field(default_factory=dict)
    networks: NetworkSpec | None = None

    def __post_init__(self) -> None:
        check_fields(self, "card: ")

    @property
    def environment(self) -> str:
        """The environment's id and keyword arguments."""
        return environment_text(self.env_id, self.env_kwargs)

    def to_json(self) -> str:
        """Return the card as JSON, for `from_json`."""
        return json.dumps(asdict(self), sort_keys=True, allow_nan=False)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PolicyCard:
        """Create a card from plain values.

        :param values: the fields by name.
        :raises ValueError: for missing, surplus or ill-typed fields; the message names them.
        """
        known = {one.name for one in fields(cls)}
        surplus = sorted(set(values) - known)
        if surplus:
            raise ValueError(f"card: unknown fields {surplus}; the fields are {sorted(known)}")
        given = dict(values)
        if isinstance(given.get("networks"), Mapping):
            given["networks"] = NetworkSpec.from_dict(given["networks"])
        try:
            return cls(**given)
        except TypeError as error:
            raise ValueError(f"card: {error}") from error

    @classmethod
    def from_json(cls, text: str) -> PolicyCard:
        """Read a card.

        :param text: the result of `to_json`.
        :raises ValueError: for any other text.
        """
        try:
            values = json.loads(text)
        except RecursionError as error:
            raise ValueError(f"card: nested too deeply: {error}") from error
        if not isinstance(values, dict):
            raise ValueError("card: not a JSON object")
        return cls.from_dict(values)


def card_markdown(name: str, card: PolicyCard) -> str:
    """Return the readable card.

    :param name: of the policy.
    :param card: as read from the weight file.
    :return: a Markdown page that ends with a line break.
    """
    spec = card.networks
    if spec is None:
        raise ValueError("card has no networks: read it from a weight file written by save_policy")
    critic = _layers(spec.critic_hidden, spec.activation, spec.critic_layer_norm)
    episodes = f" over {card.success_episodes} episodes" if card.success_episodes else ""
    rows = {
        "environment": f"`{card.environment}`",
        "task": card.task or "not described",
        "success": f"{card.success:.3f}{episodes}",
        "success without a collision": rate_text(card.safe_success),
        "success within 2 cm": rate_text(card.success_2cm),
        "algorithm": card.algorithm,
        "environment steps": f"{card.steps:,}",
        "wall clock": f"{card.wall_clock_s:,.0f} s",
        "seed": str(card.seed),
        "commit": f"`{card.commit}`",
        "inputs": ", ".join(f"{key} ({size})" for key, size in spec.inputs),
        "action size": str(spec.action_size),
        "actor": _layers(spec.actor_hidden, spec.activation, spec.actor_layer_norm) + ", tanh",
        "critics": f"{spec.n_critics} x ({critic})" if spec.n_critics else "none",
        **{str(key): str(value) for key, value in card.notes.items()},
    }
    lines = [f"# {name}", "", "Generated from the weight file by `write_card`; do not edit.", ""]
    lines += ["| | |", "|---|---|"]
    cells = {key: value.replace("|", "\\|").replace("\n", " ") for key, value in rows.items()}
    lines += [f"| {key} | {value} |" for key, value in cells.items()]
    lines += ["", "Trained by:", "", "```", card.command, "```", ""]
    lines += ["Use:", "", "```python", "from saver_advisors.pretrained import load_policy", ""]
    lines += [f'policy = load_policy("{name}")', "action, _ = policy.predict(observation)", "```"]
    return "\n".join([*lines, "", *USE_AND_LIMITS]) + "\n"


def rate_text(rate: float | None) -> str:
    """Format a rate, which older cards may lack."""
    return "-" if rate is None else f"{rate:.3f}"


def _layers(hidden: tuple[int, ...], activation: str, layer_norm: bool) -> str:
    widths = " - ".join(map(str, hidden)) or "linear"
    return f"{widths}, {activation}" + (", LayerNorm" if layer_norm else "")
