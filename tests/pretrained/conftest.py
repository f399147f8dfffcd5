import pytest
import torch

from saver_advisors.policies.cards import PolicyCard
from saver_advisors.policies.networks import NetworkSpec, PolicyNetworks


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def card() -> PolicyCard:
    return PolicyCard(
        env_id="JacoPush-v0",
        algorithm="GoalTD3",
        command="saver train JacoPush-v0 --seed 3",
        steps=800_000,
        wall_clock_s=1620.5,
        seed=3,
        commit="0123abc",
        success=0.94,
        task="push a cube to its target",
        notes={"relabelling": "future, 80%"},
    )


@pytest.fixture
def networks() -> PolicyNetworks:
    """Random weights of the size of a single-arm teacher's, small."""
    torch.manual_seed(5)
    inputs = (("observation", 28), ("desired_goal", 3))
    made = PolicyNetworks(NetworkSpec(inputs, 3, (16, 12), (10, 9), 2, critic_layer_norm=True))
    made.mean.normal_()
    made.std.uniform_(0.5, 2.0)
    made.clip.fill_(5.0)
    made.action_low.copy_(torch.tensor([-2.0, -1.0, -0.5]))
    return made
