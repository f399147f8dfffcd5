"""Where the networks learn: on the CPU or on a GPU."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from saver_envs.modelling.arms import arm_named
from saver_envs.modelling.models import ADVERSARIAL, Training, new_model
from saver_envs.modelling.networks import Device, MLPArchitecture

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")


def learned(name: str, device: Device, sigma: float = 0.0) -> tuple[list[float], np.ndarray]:
    """Validation errors, and joints for a few targets, of a model that saw 500 samples."""
    joints = np.random.default_rng(0).uniform((-1, 2, 3, 0), (1, 3, 4, 1), (500, 4))
    inputs = arm_named("mico").chain.position(joints)
    model = new_model(name, "mico", "ik", architecture=MLPArchitecture(layers=2, width=32))
    # 400 rows: six whole batches an epoch, and a short one.
    training = Training(epochs=4, batch_size=64, sigma=sigma, device=device)
    history = model.fit(inputs, joints, training)
    return history.validation_rmse, model.predict(inputs[:20], joints[:20])


@needs_gpu
@pytest.mark.parametrize("name", ["mlp", *ADVERSARIAL, "conditional"])
def test_a_gpu_learns_what_the_cpu_learns(name: str) -> None:
    errors, joints = learned(name, "cpu")
    same, other = learned(name, "cuda")
    assert same == pytest.approx(errors, rel=1e-3)
    assert other == pytest.approx(joints, abs=5e-3)


@needs_gpu
@pytest.mark.parametrize("name", ["cgan", "dualgan", "flow"])
def test_a_gpu_learns_the_same_from_a_seed_with_noise_too(name: str) -> None:
    errors, _ = learned(name, "cuda", sigma=0.2)
    again, _ = learned(name, "cuda", sigma=0.2)
    assert again == errors
    assert len(set(errors)) == len(errors)
    assert min(errors) < 2 * min(learned(name, "cpu", sigma=0.2)[0])


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_is_refused_where_there_is_none() -> None:
    with pytest.raises(ValueError, match=r"device='cuda': torch .* finds no GPU; use device='cpu'"):
        Training(device="cuda")


def test_an_unknown_device_is_refused() -> None:
    with pytest.raises(ValueError, match="device='tpu': must be one of cpu, cuda"):
        Training(device="tpu")  # type: ignore[arg-type]
