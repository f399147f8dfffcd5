"""Frozen policies: their networks, cards and files, and the teachers that act with them."""

from saver_advisors.policies.cards import PolicyCard
from saver_advisors.policies.files import (
    WEIGHTS_DIR,
    export_policy,
    load_policy,
    load_teacher,
    read_networks,
    save_policy,
    shipped_policies,
    write_card,
)
from saver_advisors.policies.freezing import networks_from_sb3
from saver_advisors.policies.frozen import PretrainedPolicy, SideBySidePolicy, side_by_side
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.networks import NetworkSpec, PolicyNetworks
from saver_advisors.policies.teacher import Teacher, TeacherGroup

__all__ = [
    "WEIGHTS_DIR",
    "ArmMapping",
    "NetworkSpec",
    "PolicyCard",
    "PolicyNetworks",
    "PretrainedPolicy",
    "SideBySidePolicy",
    "Teacher",
    "TeacherGroup",
    "export_policy",
    "load_policy",
    "load_teacher",
    "networks_from_sb3",
    "read_networks",
    "save_policy",
    "shipped_policies",
    "side_by_side",
    "write_card",
]
