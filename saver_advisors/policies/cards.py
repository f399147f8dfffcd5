"""What a shipped policy says about itself: the card in the weight file's header, and its readable
twin.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.policies.networks import NetworkSpec


@dataclass(frozen=True)
class PolicyCard:
    """Where a policy comes from and how good it is.

    :param env_id: the environment in which it was trained
    :param algorithm: the learner, such as "GoalTD3"
    :param command: the command that trained it
    :param steps: environment steps of that run
    :param wall_clock_s: seconds that the run took
    :param seed: of that run
    :param commit: of the repository, at that run
    :param success: share of successful evaluation episodes, 0 to 1
    :param success_episodes: how many episodes `success` was measured over
    :param task: the task in words
    :param env_kwargs: keyword arguments of that environment, where it had any
    :param notes: anything else, shown in the readable card
    :param networks: shapes and activations; filled in by `save_policy`
    :raises ValueError: where a figure is out of range
    """

    env_id: str
    algorithm: str
    command: str
    steps: int
    wall_clock_s: float
    seed: int
    commit: str
    success: float
    success_episodes: int = 100
    task: str = ""
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    notes: Mapping[str, Any] = field(default_factory=dict)
    networks: NetworkSpec | None = None

    def __post_init__(self) -> None:
        for name in ("env_id", "algorithm", "command", "commit", "task"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"card: {name}={getattr(self, name)!r} must be a text")
        for name in ("steps", "success_episodes", "wall_clock_s"):
            value = getattr(self, name)
            if not _is_number(value) or value < 0:
                raise ValueError(f"card: {name}={value!r} must be a number of at least 0")
        if not isinstance(self.env_kwargs, Mapping):
            raise ValueError(f"card: env_kwargs={self.env_kwargs!r} must be a mapping")
        if not _is_number(self.success) or not 0.0 <= self.success <= 1.0:
            raise ValueError(f"card: success={self.success!r} must lie between 0 and 1")

    @property
    def environment(self) -> str:
        """The environment's id, and its keyword arguments where it had any."""
        return environment_text(self.env_id, self.env_kwargs)

    def with_networks(self, spec: NetworkSpec) -> PolicyCard:
        """:return: the same card for networks of these shapes"""
        return replace(self, networks=spec)

    def to_json(self) -> str:
        """:return: the card as JSON, the inverse of `from_json`"""
        values = asdict(self)
        values["networks"] = None if self.networks is None else self.networks.to_dict()
        return json.dumps(values, sort_keys=True, allow_nan=False)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PolicyCard:
        """
        :param values: the fields by name
        :raises ValueError: for missing, surplus or ill-typed fields; the message names them
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
        """
        :param text: what `to_json` returned
        :raises ValueError: where it is no such text
        """
        values = json.loads(text)
        if not isinstance(values, dict):
            raise ValueError("card: not a JSON object")
        return cls.from_dict(values)


def _is_number(value: object) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(float(str(value)))


def card_markdown(name: str, card: PolicyCard) -> str:
    """The readable card.

    :param name: what the policy is called
    :param card: as read from the weight file
    :return: a Markdown page that ends with a line break
    """
    if card.networks is None:
        raise ValueError("card has no networks: read it from a weight file written by save_policy")
    episodes = f" over {card.success_episodes} episodes" if card.success_episodes else ""
    rows = {
        "environment": f"`{card.environment}`",
        "task": card.task or "not described",
        "success": f"{card.success:.3f}{episodes}",
        "algorithm": card.algorithm,
        "environment steps": f"{card.steps:,}",
        "wall clock": f"{card.wall_clock_s:,.0f} s",
        "seed": str(card.seed),
        "commit": f"`{card.commit}`",
        **_network_rows(card.networks),
        **{str(key): str(value) for key, value in card.notes.items()},
    }
    lines = [f"# {name}", "", "Generated from the weight file by `write_card`; do not edit.", ""]
    lines += ["| | |", "|---|---|"]
    lines += [f"| {key} | {_cell(value)} |" for key, value in rows.items()]
    lines += ["", "Trained by:", "", "```", card.command, "```", ""]
    lines += ["Use:", "", "```python", "from saver_advisors.pretrained import load_policy", ""]
    lines += [f'policy = load_policy("{name}")', "action, _ = policy.predict(observation)", "```"]
    return "\n".join(lines) + "\n"


def _network_rows(spec: NetworkSpec) -> dict[str, str]:
    inputs = ", ".join(f"{key} ({size})" for key, size in spec.inputs)
    return {
        "inputs": inputs,
        "action size": str(spec.action_size),
        "actor": _layers(spec.actor_hidden, spec.activation, spec.actor_layer_norm) + ", tanh",
        "critics": (
            f"{spec.n_critics} x "
            f"({_layers(spec.critic_hidden, spec.activation, spec.critic_layer_norm)})"
            if spec.n_critics
            else "none"
        ),
    }


def _layers(hidden: tuple[int, ...], activation: str, layer_norm: bool) -> str:
    widths = " - ".join(map(str, hidden)) or "linear"
    return f"{widths}, {activation}" + (", LayerNorm" if layer_norm else "")


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
