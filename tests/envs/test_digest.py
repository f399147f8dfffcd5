"""The digest of a world tells worlds apart, and is the same on every machine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from rollouts import ALL_IDS

from saver_envs.digest import MODEL_FIELDS, changed_options, model_digest, plain, world_digest
from saver_envs.registration import make_episodes


def test_every_id_has_its_own() -> None:
    digests = {env_id: world_digest(env_id) for env_id in ALL_IDS}
    assert len(set(digests.values())) == len(ALL_IDS)


@pytest.mark.parametrize(
    "options",
    [
        {"object_mass": 0.2001},
        {"object_friction": 0.51},
        {"object_size": 0.0561},
        {"contested_share": 0.5},
        {"success_threshold": 0.04},
        {"n_arms": 3},
        {"layout": "ring"},
        {"max_speed": 0.4},
        {"max_episode_steps": 60},
        {"rated": True},
        {"control": "joints"},
        {"bounded_observations": True},
    ],
    ids=str,
)
def test_every_option_changes_it(options: Mapping[str, Any]) -> None:
    assert world_digest("DualJacoPush-v0", options) != world_digest("DualJacoPush-v0")


def test_a_default_that_is_given_changes_nothing() -> None:
    given = {"n_arms": 2, "max_episode_steps": 50, "max_speed": 0.5, "object_mass": 0.2}
    assert world_digest("DualJacoPush-v0", given) == world_digest("DualJacoPush-v0")
    assert world_digest("saver_envs:DualJacoPush-v0") == world_digest("DualJacoPush-v0")


@dataclass(frozen=True)
class Range:
    low: float
    high: float


def test_options_may_be_mappings_of_distributions() -> None:
    ranges = {"mass": Range(0.1, 0.3), "size": np.array([0.04, 0.05])}
    expected = {"mass": {"kind": "Range", "low": 0.1, "high": 0.3}, "size": [0.04, 0.05]}
    assert plain(ranges) == expected
    assert changed_options("DualJacoPush-v0", {"layout": "row", "overlap": 0.1}) == {"overlap": 0.1}


def test_last_bits_do_not_matter_but_a_millionth_of_any_value_may() -> None:
    """What another processor's rounding does to every number of the compiled model."""
    model = make_episodes("DualJacoPush-v0").scene.model.__copy__()
    before = model_digest(model)
    generator = np.random.default_rng(0)
    for name in MODEL_FIELDS:
        values = getattr(model, name)
        if values.dtype == np.float64 and values.size:
            values *= 1 + generator.uniform(-1e-14, 1e-14, values.shape)
            values += generator.uniform(-1e-16, 1e-16, values.shape)
    assert model_digest(model) == before
    model.body_mass[-1] *= 1.0001
    assert model_digest(model) != before


@pytest.mark.slow
def test_other_vector_instructions_give_the_same() -> None:
    code = "from saver_envs.digest import world_digest as d; print(d('DualMicoPush-v0'))"
    plainest = {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX"}
    words = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(
        words, env={**os.environ, **plainest}, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == world_digest("DualMicoPush-v0")


def test_a_randomization_counts_by_what_it_means() -> None:
    default = world_digest("JacoPush-v0")
    assert world_digest("JacoPush-v0", {"randomization": "none"}) == default
    held_out = world_digest("JacoPush-v0", {"randomization": "held-out:object_mass"})
    assert held_out != default
    meant = {"object_mass": {"uniform": [0.8, 1.2]}}
    assert world_digest("JacoPush-v0", {"randomization": meant}) == held_out
