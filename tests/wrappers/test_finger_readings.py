"""Readings of one hand's fingers as those of another hand."""

from __future__ import annotations

import numpy as np
from rollouts import begun

from saver_envs.robots import ROBOTS
from saver_envs.tasks.arm_and_object import ARM_AND_OBJECT
from saver_envs.tasks.layout import Layout
from saver_envs.wrappers.finger_readings import translated_fingers

LAYOUT = Layout(ARM_AND_OBJECT, 2)
POSITIONS = "finger positions"


def test_fingers_read_as_those_of_the_other_hand() -> None:
    jaco, mico = ROBOTS["jaco"], ROBOTS["mico"]
    values = np.random.default_rng(0).normal(size=(3, LAYOUT.size)).astype(np.float32)
    LAYOUT.get(values, POSITIONS)[0] = mico.finger_open
    LAYOUT.get(values, POSITIONS)[1] = mico.finger_closed
    before = values.copy()
    read = translated_fingers(values, LAYOUT, mico, jaco)
    np.testing.assert_allclose(LAYOUT.get(read, POSITIONS)[0], jaco.finger_open, atol=1e-6)
    np.testing.assert_allclose(LAYOUT.get(read, POSITIONS)[1], jaco.finger_closed, atol=1e-6)
    np.testing.assert_array_equal(before, values)
    for part in LAYOUT.parts:
        if part.name not in (POSITIONS, "finger velocities"):
            same = (LAYOUT.get(one, part.name) for one in (read, values))
            np.testing.assert_array_equal(*same)
    back = translated_fingers(read, LAYOUT, jaco, mico)
    np.testing.assert_allclose(back, values, atol=1e-6)


def test_the_locked_hands_of_a_push_read_as_in_training() -> None:
    """What the translation is for: the same constant as in the Jaco's observations."""
    mico, jaco = (
        begun(env_id).observation().observation for env_id in ("DualMicoPush-v0", "DualJacoPush-v0")
    )
    translated = translated_fingers(mico, LAYOUT, ROBOTS["mico"], ROBOTS["jaco"])
    read, usual = (LAYOUT.get(one, POSITIONS) for one in (translated, jaco))
    np.testing.assert_allclose(read, usual, atol=1e-6)
    assert np.abs(LAYOUT.get(mico, POSITIONS) - LAYOUT.get(jaco, POSITIONS)).min() > 0.1
