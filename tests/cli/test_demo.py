"""What the demo plays, without playing it."""

from __future__ import annotations

from saver_advisors.cli.demo import best_shipped, players
from saver_advisors.cli.policies import resolve
from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.pretrained import shipped_policies


def test_every_shipped_policy_is_played_in_the_environment_that_it_fits() -> None:
    found = players()
    assert {policy for policy, _, _ in found} >= {*shipped_policies(), "random"}
    for one in found:
        # A policy of other sizes than the environment's would be refused.
        resolve(*one)


def test_each_environment_of_several_arms_has_its_teachers_side_by_side_once() -> None:
    baselines = [
        environment_text(*place)
        for policy, *place in players()
        if policy.startswith("side-by-side:")
    ]
    assert len(baselines) == len(set(baselines))
    assert "DualJacoPush-v0" in baselines
    assert any("n_arms=3" in name for name in baselines)


def test_a_video_shows_the_best_shipped_policy_of_each_environment() -> None:
    def measured(policy: str, env: str, success: float, **kwargs: int) -> dict[str, object]:
        return {"policy": policy, "env": env, "env_kwargs": kwargs, "success_rate": success}

    push, three = "DualJacoPush-v0", {"n_arms": 3}
    found = best_shipped(
        [
            measured("dual-jaco-push-advised", push, 0.95),
            measured("dual-jaco-push", push, 0.97),
            measured("side-by-side:jaco-push", push, 0.99),
            measured("triple-jaco-push", push, 0.78, **three),
            measured("jaco-push", "JacoPush-v0", 1.0),
            measured("dual-jaco-pick-and-place", "DualJacoPickAndPlace-v0", 0.95),
            measured("dual-jaco-pick-and-place-advised", "DualJacoPickAndPlace-v0", 0.95),
            measured("wrist-push", "WristPush-v0", 0.98),
        ],
        left_out="WristPush-v0",
    )
    assert [one["policy"] for one in found] == [
        "dual-jaco-push",
        "triple-jaco-push",
        "jaco-push",
        "dual-jaco-pick-and-place",  # of equals the first
    ]
