"""Frozen policies: their networks, cards and files, and the teachers that act with them."""

from saver_advisors.policies.files import (
    WEIGHTS_DIR,
    load_policy,
    load_teacher,
    save_policy,
    shipped_policies,
)
from saver_advisors.policies.frozen import side_by_side
from saver_advisors.policies.teacher import Teacher

__all__ = [
    "WEIGHTS_DIR",
    "Teacher",
    "load_policy",
    "load_teacher",
    "save_policy",
    "shipped_policies",
    "side_by_side",
]
