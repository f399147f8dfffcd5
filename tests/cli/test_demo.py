"""What the demo plays, without playing it."""

from __future__ import annotations

from saver_advisors.cli.demo import players
from saver_advisors.cli.policies import resolve
from saver_advisors.pretrained import shipped_policies


def test_every_shipped_policy_is_played_in_the_environment_that_it_fits() -> None:
    found = players()
    names = [one.policy for one in found]
    assert set(names) >= {*shipped_policies(), "random"}
    for one in found:
        # A policy of other sizes than the environment's would be refused.
        assert resolve(one.policy, one.env_id, one.env_kwargs).predict is not None


def test_each_environment_of_several_arms_has_its_teachers_side_by_side_once() -> None:
    baselines = [one.environment for one in players() if one.policy.startswith("side-by-side:")]
    assert len(baselines) == len(set(baselines))
    assert "DualJacoPush-v0" in baselines
    assert any("n_arms=3" in name for name in baselines)
