"""The policies that ship: weights as safetensors, with a card each."""

from saver_advisors.policies.files import load_policy, load_teacher, shipped_policies
from saver_advisors.policies.frozen import side_by_side

__all__ = ["load_policy", "load_teacher", "shipped_policies", "side_by_side"]
