"""Shipped policies: weights as safetensors, with a card each."""

from saver_advisors.pretrained.cards import PolicyCard, card_markdown, write_card
from saver_advisors.pretrained.files import (
    WEIGHTS_DIR,
    export_policy,
    load_policy,
    load_teacher,
    read_networks,
    save_policy,
    shipped_policies,
)
from saver_advisors.pretrained.policy import PretrainedPolicy, SideBySidePolicy, side_by_side

__all__ = [
    "WEIGHTS_DIR",
    "PolicyCard",
    "PretrainedPolicy",
    "SideBySidePolicy",
    "card_markdown",
    "export_policy",
    "load_policy",
    "load_teacher",
    "read_networks",
    "save_policy",
    "shipped_policies",
    "side_by_side",
    "write_card",
]
