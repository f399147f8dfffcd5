"""Where parts lie is declared once; everything else follows from it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rollouts import begun, cubes_of, objects_of

from saver_envs.tasks.layout import Layout, Part

PARTS = st.lists(
    st.builds(
        Part,
        name=st.text("abcdefgh", min_size=1, max_size=6),
        size=st.integers(1, 5),
        unit=st.just("m"),
        scale=st.sampled_from([1.0, 0.5, 2.0]),
        shared=st.booleans(),
    ),
    min_size=1,
    max_size=6,
    unique_by=lambda part: part.name,
)


@given(parts=PARTS, n_arms=st.integers(1, 4), n=st.integers(1, 3), seed=st.integers(0, 99))
def test_what_is_joined_can_be_got_back(parts: list[Part], n_arms: int, n: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    layout = Layout(tuple(parts), n_arms)
    values = {
        part.name: random.normal(size=(n, part.size) if part.shared else (n, n_arms, part.size))
        for part in parts
    }
    vector = layout.join(values)
    assert vector.shape == (n, layout.size)
    assert layout.size == n_arms * layout.block + layout.shared
    for part in parts:
        np.testing.assert_allclose(layout.get(vector, part.name), values[part.name] * part.scale)
    for arm in range(n_arms):
        seen = layout.of_agent(vector, arm)
        assert seen.shape == (n, layout.block + layout.shared)
        np.testing.assert_array_equal(seen[:, : layout.block], layout.blocks(vector)[:, arm])
        np.testing.assert_array_equal(seen[:, layout.block :], layout.tail(vector))


def test_parts_are_views() -> None:
    layout = Layout((Part("a", 2, "m"), Part("b", 1, "m", shared=True)), 2)
    vector = np.zeros((1, 5))
    layout.get(vector, "a")[:, 1] = 7
    layout.get(vector, "b")[:] = 9
    assert vector.tolist() == [[0, 0, 7, 7, 9]]


def test_velocities_are_displacements_of_an_action() -> None:
    """SPEC 2: linear and angular velocities of an observation are times 0.04 s."""
    episodes = begun("JacoPush-v0", 1, control="joints")
    episodes.simulation.qvel[0, cubes_of(episodes).dof[0]] = [0, 0, 0, 0, 0, 9]
    episodes._read()
    objects, arms = objects_of(episodes), episodes.simulation.arm_state()
    layout, seen = episodes.task.observation_layout, episodes.observation().observation
    expected = {
        "object linear velocity": objects.linear_velocity,
        "object angular velocity": objects.angular_velocity,
        "gripper linear velocity": arms.tool_velocity,
    }
    assert np.abs(objects.angular_velocity).max() > 1
    for name, velocity in expected.items():
        np.testing.assert_allclose(layout.get(seen, name), 0.04 * velocity, rtol=1e-6)


def test_an_unknown_part_is_named() -> None:
    with pytest.raises(KeyError, match=r"no part 'c'; the parts are \['a'\]"):
        Layout((Part("a", 2, "m"),), 1).get(np.zeros(2), "c")
