"""Presets lie within each other or apart, and a mapping is refused by name and range."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from rollouts import SPARSE_IDS, begun

from saver_envs.randomization import Choice, LogUniform, Parameter, Uniform
from saver_envs.randomization.distributions import Distribution
from saver_envs.randomization.parameters import COMMON
from saver_envs.randomization.presets import (
    PRESETS,
    Randomization,
    parse_randomization,
    plain_options,
)
from saver_envs.registration import make_episodes, parameters_of, task_and_settings, varied_in

PUSH, WRISTS = "JacoPush-v0", "WristPush-v0"


def of(env_id: str) -> tuple[Parameter, ...]:
    return parameters_of(task_and_settings(env_id, {})[0])


ALL = {one.name: one for env_id in (PUSH, WRISTS) for one in of(env_id)}


def spans(distribution: Distribution) -> list[tuple[float, float]]:
    """The intervals that it draws from."""
    if isinstance(distribution, Choice):
        return [
            one.ends if isinstance(one, Uniform | LogUniform) else (one, one)
            for one in distribution.values
        ]
    return [distribution.ends]


@pytest.mark.parametrize("one", ALL.values(), ids=ALL)
def test_each_parameter_is_consistent(one: Parameter) -> None:
    """All ranges can be simulated; mild is within wide, and held-out is beyond it."""
    for distribution in (one.wide, one.mild, one.held_out):
        if distribution is not None:
            assert one.parse(one.as_json(distribution)) == distribution
    if one.wide is None or one.mild is None:
        assert one.mild is one.held_out is None
        return
    (low, high), (mild_low, mild_high) = one.wide.ends, one.mild.ends
    assert low <= mild_low <= mild_high <= high
    if one.nominal is not None:
        assert one.allows(one.nominal)
        assert mild_low <= one.nominal <= mild_high
    if not one.whole:
        assert mild_high - mild_low < 0.6 * (high - low)
    if one.held_out is not None:
        assert all(end <= low or start >= high for start, end in spans(one.held_out))
    assert one.text
    assert one.text[0].islower() or one.text.split()[0].isupper()


def test_the_third_of_a_range() -> None:
    assert ALL["joint_friction"].mild == Uniform(0.0, 0.05 / 3)
    assert ALL["servo_damping"].mild.ends == pytest.approx((1 - 0.25 / 3, 1 + 0.25 / 3))
    assert ALL["action_delay"].mild == Choice((0, 1))
    # An unnamed middle: the geometric one of logarithms.
    assert ALL["person_stiffness"].mild.ends == pytest.approx(
        (0.9949 * (0.33 / 0.9949) ** (1 / 3), 0.9949 * (3 / 0.9949) ** (1 / 3)), rel=1e-3
    )


@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_every_preset_of_every_id(env_id: str) -> None:
    known = of(env_id)
    assert not parse_randomization("none", known)
    assert parse_randomization(None, known) == parse_randomization("none", known)
    for preset in PRESETS[1:]:
        varied = parse_randomization(preset, known)
        expected = [one.name for one in known if one.wide is not None]
        assert [one.name for one, _ in varied.varied] == expected
    held_out = [one for one in known if one.held_out is not None]
    assert len(held_out) >= 5
    everything = parse_randomization("held-out:all", known)
    assert [one for one, _ in everything.varied] == held_out
    for one in held_out:
        alone = parse_randomization(f"held-out:{one.name}", known)
        assert alone.varied == ((one, one.held_out),)


def test_a_mapping_is_read_in_the_order_of_the_parameters() -> None:
    """So that the same distributions draw the same values, however they are written."""
    mapping = {"sensor_noise": 1.0, "object_size": [0.04, 0.09]}
    known = of(PUSH)
    varied = parse_randomization(mapping, known)
    assert [one.name for one, _ in varied.varied] == ["object_size", "sensor_noise"]
    for same in (dict(reversed(mapping.items())), varied, varied.as_json()):
        assert parse_randomization(same, known) == varied
    assert not parse_randomization({}, known)


@pytest.mark.parametrize("preset", ["wide", "mild", "held-out:all", {"object_size": [0.05, 0.06]}])
def test_drawn_values_lie_within_the_ends(preset: Any) -> None:
    episodes = begun("DualJacoPush-v0", 6, randomization=preset)
    for parameter, distribution in episodes.settings.randomization.varied:
        drawn = episodes.worlds.values[parameter.name]
        low, high = distribution.ends
        assert drawn.shape == (6, parameter.size * (2 if parameter.per_arm else 1))
        assert ((low <= drawn) & (drawn <= high)).all()
        assert len(np.unique(drawn)) > 1 or low == high


NAMES = ", ".join(one.name for one in of(PUSH))
UNKNOWN = f"is not a parameter of this environment; valid names are {NAMES}"
HELD_OUT = ", ".join(one.name for one in of(PUSH) if one.held_out is not None)
NO_RANGE = f"this environment has held-out ranges of {HELD_OUT}, and held-out:all"
NO_PRESET = "must be one of none, mild, wide, held-out:NAME, held-out:all, or a mapping"
WHOLE = "must be a whole number, or a choice of whole numbers"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("wild", f"randomization='wild': {NO_PRESET}"),
        (3, f"randomization=3: {NO_PRESET}"),
        (["wide"], f"randomization=['wide']: {NO_PRESET}"),
        (np.zeros(3), NO_PRESET),
        ({"size": [0.04, 0.05]}, f"'size' {UNKNOWN}"),
        ({"person_mass": 1.0}, f"'person_mass' {UNKNOWN}"),
        ("held-out:size", f"randomization='held-out:size': {NO_RANGE}"),
        ("held-out:table_height", NO_RANGE),
        ("held-out:person_mass", NO_RANGE),
        ({"object_mass": 0}, "object_mass=Choice(values=(0.0,)): must be within 0.001 to 100 kg"),
        ({"object_mass": [0, 1]}, "Uniform(low=0, high=1): must be within 0.001 to 100 kg"),
        ({"object_size": [0.05, 0.2]}, "high=0.2): must be within 0.035 to 0.12 m"),
        ({"object_size": {"choice": [0.05, 0.2]}}, "must be within 0.035 to 0.12 m"),
        ({"max_speed": [0, 1]}, "Uniform(low=0, high=1): must be within 0.05 to 2 m/s"),
        ({"action_delay": [0, 2]}, f"action_delay=Uniform(low=0, high=2): {WHOLE}"),
        ({"action_delay": 0.5}, WHOLE),
        ({"action_delay": 11}, "must be within 0 to 10 actions"),
        ({"object_size": "wide"}, "object_size='wide': must be a number, [low, high]"),
        ({"sensor_noise": -1}, "must be within 0 to 10"),
    ],
)
def test_bad_input(value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_episodes(PUSH, randomization=value)


def test_bad_input_for_people() -> None:
    for value, message in (
        ("held-out:object_size", "this environment has held-out ranges of person_friction"),
        ({"object_size": 0.05}, "valid names are person_body, person_friction"),
        ({"person_body": [0, 1]}, "must be a whole number, or a choice of whole numbers"),
        ({"person_body": 99}, "must be within 0 to "),
        ({"person_mass": 0}, "must be within 0.3 to 3"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            make_episodes(WRISTS, randomization=value)


def test_options_of_a_task_have_the_limits_of_its_parameters() -> None:
    for env_id, options, message in (
        (PUSH, {"table_height": 0.5}, "table_height=0.5: must be -0.02 to 0.05 m"),
        (PUSH, {"finger_friction": -1.0}, "finger_friction=-1.0: must be 0 to 10"),
        (WRISTS, {"person_mass": 5.0}, "person_mass=5.0: must be 0.3 to 3"),
        (WRISTS, {"person_body": 50}, "person_body=50: must be 0 to "),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            make_episodes(env_id, **options)


def test_options_as_json_can_hold_them() -> None:
    given = {"n_arms": 2, "randomization": {"object_size": Uniform(0.04, 0.05), "max_speed": 0.3}}
    plain = plain_options(given)
    expected = {"object_size": {"uniform": [0.04, 0.05]}, "max_speed": 0.3}
    assert plain == {"n_arms": 2, "randomization": expected}
    assert varied_in(PUSH, given) == {"object_size": {"uniform": [0.04, 0.05]}, "max_speed": 0.3}
    whole = parse_randomization("wide", of(PUSH))
    assert plain_options({"randomization": whole})["randomization"] == whole.as_json()
    for options in ({"randomization": "wide"}, {"n_arms": 2}, {}):
        assert plain_options(options) == options
    assert varied_in(PUSH, {}) == {}


def test_common_parameters_come_after_the_tasks() -> None:
    for env_id in (PUSH, WRISTS):
        assert of(env_id)[-len(COMMON) :] == COMMON
    assert isinstance(parse_randomization("wide", COMMON), Randomization)
