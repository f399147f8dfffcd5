import numpy as np
import pytest
from gymnasium import spaces

from saver_advisors.policies.networks import NetworkSpec, PolicyNetworks
from saver_advisors.policies.teacher import Teacher
from saver_advisors.pretrained import side_by_side


@pytest.fixture
def teacher(networks):
    return Teacher(networks)


def dual(n):
    rng = np.random.default_rng(1)
    sizes = {"observation": 56, "achieved_goal": 7, "desired_goal": 7}
    return {key: rng.normal(size=(n, size)).astype(np.float32) for key, size in sizes.items()}


def test_each_arm_acts_on_its_own_block(teacher):
    observation = dual(4)
    actions, _ = side_by_side(teacher, 2).predict(observation)
    assert actions.shape == (4, 6)
    for arm in range(2):
        own = teacher.act(
            observation["observation"][:, 28 * arm : 28 * arm + 28],
            observation["desired_goal"][:, 3 * arm : 3 * arm + 3],
        )
        np.testing.assert_allclose(actions[:, 3 * arm : 3 * arm + 3], own, rtol=1e-5, atol=1e-6)


def test_a_single_observation(teacher):
    observation = dual(3)
    policy = side_by_side([teacher, teacher], 2)
    batch, _ = policy.predict(observation)
    single, state = policy.predict({key: values[1] for key, values in observation.items()})
    assert single.shape == (6,)
    assert state is None
    np.testing.assert_allclose(single, batch[1], rtol=1e-5, atol=1e-6)


def test_the_other_arm_is_not_seen(teacher):
    observation = dual(2)
    before, _ = side_by_side(teacher, 2).predict(observation)
    observation["observation"][:, 28:] += 1.0
    after, _ = side_by_side(teacher, 2).predict(observation)
    np.testing.assert_array_equal(before[:, :3], after[:, :3])
    assert not np.allclose(before[:, 3:], after[:, 3:])


def test_misfits_are_refused(teacher):
    with pytest.raises(ValueError, match=r"\(4, 56\).*84"):
        side_by_side(teacher, 3).predict(dual(4))
    with pytest.raises(ValueError, match="3 teachers for 2 arms"):
        side_by_side([teacher] * 3, 2)
    with pytest.raises(ValueError, match="deterministic"):
        side_by_side(teacher, 2).predict(dual(1), deterministic=False)


def test_stock_policies_read_the_achieved_goal_too():
    inputs = (("achieved_goal", 3), ("desired_goal", 3), ("observation", 28))
    reader = Teacher(PolicyNetworks(NetworkSpec(inputs, 3, (8,))))
    observation = dual(2)
    before, _ = side_by_side(reader, 2).predict(observation)
    observation["achieved_goal"][:, 3:6] += 1.0
    after, _ = side_by_side(reader, 2).predict(observation)
    np.testing.assert_array_equal(before[:, :3], after[:, :3])
    assert not np.allclose(before[:, 3:], after[:, 3:])
    assert spaces.Box(-1, 1, (6,)).contains(after[0])
