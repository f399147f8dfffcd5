"""From keys and a dragged handle to actions of one arm."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_operator import playback

from saver_advisors.viewing.operator import KEYS, Operator
from saver_advisors.viewing.playback import Playback


def operator_of(shown: Playback) -> Operator:
    assert shown.operator is not None
    return shown.operator


def hand(shown: Playback) -> np.ndarray:
    """Where the set-point of the operator's hand is, world frame."""
    points = shown.episodes.scene.to_world(shown.episodes.set_point)
    return points[0, operator_of(shown).arm].copy()


@pytest.mark.parametrize(
    ("env_id", "options"),
    [
        ("JacoPickAndPlace-v0", {}),
        ("DualJacoPickAndPlace-v0", {"arm": 1}),
        ("DualJacoPush-v0", {"arm": 1, "layout": "ring", "policy": "random"}),
    ],
)
def test_a_key_moves_the_hand_by_one_action(env_id: str, options: dict[str, object]) -> None:
    shown = playback(env_id, **{"arm": 0, **options})
    operator = operator_of(shown)
    middle = shown.episodes.worlds.set_points.workspace
    centre = (middle.lower + middle.upper) / 2
    operator.drag(shown.episodes.scene.to_world(centre[None])[0, operator.arm])
    for _ in range(30):
        shown.tick()
    assert not operator.acts
    for key, direction in KEYS.items():
        if direction[2] and "Push" in env_id:
            continue  # the task holds the height
        before = hand(shown)
        shown.press(key)
        assert operator.acts
        shown.tick()
        np.testing.assert_allclose(hand(shown) - before, 0.02 * np.array(direction), atol=1e-9)
        assert not operator.acts


def test_the_target_stays_in_the_workspace() -> None:
    shown = playback(arm=0)
    operator = operator_of(shown)
    workspace = shown.episodes.worlds.set_points.workspace
    operator.drag((9.0, -9.0, 9.0))
    np.testing.assert_allclose(operator.target[:2], [workspace.upper[0, 0], workspace.lower[0, 1]])
    assert operator.target[2] == shown.episodes.worlds.set_points.held_height


def test_only_the_own_arm_is_commanded() -> None:
    shown = playback("DualJacoPickAndPlace-v0", arm=1)
    operator = operator_of(shown)
    others = np.linspace(-0.9, 0.9, 8, dtype=np.float32)[None]
    target = operator.target
    operator.drag(target - np.array([1.0, 0.0, 0.0]))
    operator.grip(is_open=False)
    actions = operator.replace(others)
    np.testing.assert_array_equal(actions[0, :4], others[0, :4])
    assert np.linalg.norm(actions[0, 4:7]) == pytest.approx(1.0)
    assert actions[0, 4] < 0
    assert actions[0, 7] == -1.0
    operator.grip(is_open=True)
    assert operator.replace(others)[0, 7] == 1.0


def test_another_arm_starts_where_its_hand_is() -> None:
    shown = playback("DualJacoPush-v0", arm=0)
    operator = operator_of(shown)
    shown.press("arrowup")
    operator.arm = 1
    assert not operator.acts
    np.testing.assert_allclose(operator.target, hand(shown))


def test_mistakes() -> None:
    with pytest.raises(ValueError, match="arm=1: must be 0 to 0"):
        playback(arm=1)
    with pytest.raises(ValueError, match="control='joints'"):
        playback(arm=0, policy="random", control="joints")
