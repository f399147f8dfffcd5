"""Branches run as one, in sequence, in part and placed; weights; backbones."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from saver_envs.perception.backbones import DEVIATION, MEAN, Vgg19Backbone
from saver_envs.perception.device_placement import MultiDeviceNetwork
from saver_envs.perception.network import (
    LIGHT,
    VGG19,
    PoseArchitecture,
    PoseNetwork,
    field_loss,
)
from saver_envs.perception.skeleton import LIMB_NAMES
from saver_envs.perception.weights import KIND, load_network, read_info, save_network
from saver_envs.weights import write_weights

ARMS = ["right_forearm", "left_forearm", "left_upper_arm"]


def pictures(double: bool = False) -> torch.Tensor:
    return torch.randn(2, 3, 64, 96, dtype=torch.float64 if double else torch.float32)


def in_sequence(network: PoseNetwork, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    stages = network.stage1.one_by_one, network.stage2.one_by_one
    return network.run_stages(network.backbone(x), *stages)


def test_shapes_are_the_papers() -> None:
    network = PoseNetwork(LIGHT).eval()
    first, second = network(pictures())
    assert first.shape == second.shape == (2, 13, 3, 8, 12)
    assert network.stage2.layers()[0][0].in_channels == 128 + 39  # 167
    front = [layer.out_channels for layer in Vgg19Backbone().front if hasattr(layer, "kernel_size")
             and hasattr(layer, "out_channels")]  # fmt: skip
    assert front == [64, 64, 128, 128, 256, 256, 256, 256, 512, 512]
    with torch.no_grad():
        assert Vgg19Backbone()(torch.zeros(1, 3, 64, 64)).shape == (1, 128, 8, 8)


@pytest.mark.parametrize("limbs", [None, ARMS])
def test_branches_as_one_equal_branches_in_sequence(limbs: list[str] | None) -> None:
    network = PoseNetwork(LIGHT, limbs).double().eval()
    with torch.no_grad():
        x = pictures(True)
        together, apart = network(x), in_sequence(network, x)
    for one, other in zip(together, apart, strict=True):
        assert torch.allclose(one, other, rtol=0, atol=1e-12)


def test_gradients_as_one_equal_those_in_sequence() -> None:
    network = PoseNetwork(
        PoseArchitecture("light", ((1, 4), (3, 4)), ((1, 4), (3, 4))), ARMS
    ).double()
    network.eval()  # without batch statistics
    x, gradients = pictures(True), []
    for run in (network, partial(in_sequence, network)):
        network.zero_grad()
        sum(stage.pow(2).sum() for stage in run(x)).backward()
        gradients.append([p.grad.clone() for p in network.parameters()])
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, rtol=1e-9, atol=1e-9)


def test_a_branch_depends_on_its_own_weights_alone() -> None:
    network = PoseNetwork(LIGHT, ARMS).eval()
    x = pictures()
    with torch.no_grad():
        before = network(x)[0]
        for weight in network.stage1.branches["left_forearm"].parameters():
            weight.add_(0.1)
        changed = (network(x)[0] - before).abs().amax(dim=(0, 2, 3, 4)) > 0
    assert [limb for limb, one in zip(network.limbs, changed, strict=True) if one] == [
        "left_forearm"
    ]


def test_some_limbs_give_what_all_give_when_stage_2_sees_no_others(tmp_path: Path) -> None:
    whole = PoseNetwork(LIGHT).eval()
    path = tmp_path / "whole.safetensors"
    save_network(whole, path, {}, half=False)
    part = load_network(path, ARMS)
    chosen = torch.tensor(part.limb_indices)
    drop = torch.ones(13, dtype=torch.bool)
    drop[chosen] = False
    x = pictures()
    with torch.no_grad():
        first, second = whole(x, drop)
        own_first, own_second = part(x)
    assert torch.allclose(own_first, first[:, chosen], atol=1e-5)
    assert torch.allclose(own_second, second[:, chosen], atol=1e-5)


@pytest.mark.parametrize("limbs", [None, ARMS])
def test_placed_branches_give_the_same(limbs: list[str] | None) -> None:
    network = PoseNetwork(LIGHT, limbs).eval()
    x = pictures()
    placed = MultiDeviceNetwork(network, ["cpu", "cpu", "cpu"])
    with torch.no_grad():
        for one, other in zip(network(x), placed(x), strict=True):
            assert torch.allclose(one, other, atol=1e-5)
    placed.close()
    with pytest.raises(ValueError, match=r"devices=\[\]: give 1 to"):
        MultiDeviceNetwork(network, [])


def test_loss_counts_where_the_mask_is_one() -> None:
    truth, mask = torch.zeros(2, 3, 3, 4, 5), torch.zeros(2, 3, 4, 5)
    guess = torch.full_like(truth, 2.0)
    assert field_loss([guess], truth, mask) == 0
    mask[0, 1, 2, 3] = 1
    # One cell, three channels of 4 each, two stages, mean over two pictures.
    assert field_loss([guess, guess], truth, mask) == pytest.approx(2 * 3 * 4 / 2)
    assert field_loss([guess], truth, mask, heat_weight=3.0) == pytest.approx((2 + 3) * 4 / 2)


def test_weights_there_and_back(tmp_path: Path) -> None:
    network = PoseNetwork(LIGHT).eval()
    path = tmp_path / "network.safetensors"
    save_network(network, path, {"frames": 3})
    assert path.stat().st_size < 5_000_000
    assert read_info(path)["info"] == {"frames": 3}
    loaded = load_network(path)
    x = pictures()
    with torch.no_grad():
        assert torch.allclose(loaded(x)[1], network(x)[1], atol=2e-2)  # 16 bits
    assert loaded.limbs == LIMB_NAMES


def test_weights_of_other_limbs_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "arms.safetensors"
    save_network(PoseNetwork(LIGHT, ARMS), path, {})
    with pytest.raises(ValueError, match=r"has no branches of head; it has .*left_forearm"):
        load_network(path, ["head", "left_forearm"])
    assert load_network(path).limbs == tuple(name for name in LIMB_NAMES if name in ARMS)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"a": torch.zeros(2)}, path)
    with pytest.raises(ValueError, match="is not a saver-pose file"):
        load_network(path)
    path.write_bytes(b"not a weight file")
    with pytest.raises(ValueError, match=r"other\.safetensors is not a complete"):
        load_network(path)
    broken = PoseNetwork(LIGHT, ARMS)
    with torch.no_grad():
        next(broken.parameters()).fill_(float("nan"))
    save_network(broken, path, {})
    with pytest.raises(ValueError, match="holds values that are not finite"):
        load_network(path)


def test_vgg_takes_torchvisions_weights(tmp_path: Path) -> None:
    source = Vgg19Backbone()
    convs = [layer for layer in source.front if isinstance(layer, torch.nn.Conv2d)]
    places = (0, 2, 5, 7, 10, 12, 14, 16, 19, 21)
    tensors = {}
    for place, layer in zip(places, convs, strict=True):
        tensors[f"features.{place}.weight"] = layer.weight.detach().clone()
        tensors[f"features.{place}.bias"] = layer.bias.detach().clone()
    path = tmp_path / "vgg19.safetensors"
    save_file(tensors, path)
    backbone = Vgg19Backbone()
    backbone.load_front(path)
    x = torch.randn(1, 3, 32, 32)
    with torch.no_grad():
        assert torch.equal(backbone.front(x), source.front(x))
    del tensors["features.21.weight"]
    save_file(tensors, path)
    with pytest.raises(ValueError, match=r"lacks features\.21\.weight"):
        backbone.load_front(path)
    with pytest.raises(ValueError, match=r"must be \.safetensors"):
        backbone.load_front(tmp_path / "vgg19.pth")


def test_vgg_takes_hed_tensors_weights(tmp_path: Path) -> None:
    """Kernels for blue, green, red less a mean give what they give on such a picture."""
    h5py = pytest.importorskip("h5py")
    random = np.random.default_rng(0)
    widths = [(3, 64, 64), (64, 128, 128), (128, 256, 256, 256), (256, 512, 512, 512)]
    with h5py.File(tmp_path / "hed.h5", "w") as file:
        for block, channels in enumerate(widths, start=1):
            for number in range(len(channels) - 1):
                name = "conv2d" if number == 0 else f"conv2d_{number}"
                shape = (3, 3, channels[number], channels[number + 1])
                kernel = random.normal(0, 0.05 if block > 1 else 0.002, shape)
                group = f"block{block}/layers/{name}/vars"
                file[f"{group}/0"] = kernel.astype(np.float32)
                file[f"{group}/1"] = random.normal(0, 0.1, shape[-1]).astype(np.float32)
    backbone = Vgg19Backbone()
    backbone.load_front(tmp_path / "hed.h5")
    rgb = random.random((1, 3, 16, 16)).astype(np.float32)
    mean, deviation = (np.array(v, np.float32)[:, None, None] for v in (MEAN, DEVIATION))
    mine = torch.from_numpy((rgb - mean) / deviation)
    theirs = torch.from_numpy(((rgb - mean) * 255)[:, ::-1].copy())
    with h5py.File(tmp_path / "hed.h5") as file:
        kernel = torch.from_numpy(file["block1/layers/conv2d/vars/0"][()]).permute(3, 2, 0, 1)
        bias = torch.from_numpy(file["block1/layers/conv2d/vars/1"][()])
    with torch.no_grad():
        expected = torch.nn.functional.conv2d(theirs, kernel, bias, padding=1)
        assert torch.allclose(backbone.front[0](mine), expected, atol=1e-4)
        # The layer that VGG16 lacks is an identity after a ReLU.
        layers = [layer for layer in backbone.front if isinstance(layer, torch.nn.Conv2d)]
        positive = torch.rand(1, 256, 8, 8)
        assert torch.equal(layers[7](positive), positive)


def test_unknown_backbones_and_limbs_are_named() -> None:
    with pytest.raises(ValueError, match="backbone='resnet': valid are light, vgg19"):
        PoseArchitecture("resnet", (), ())
    with pytest.raises(ValueError, match="'tail' is none of"):
        PoseNetwork(LIGHT, ["tail"])
    assert json.dumps(VGG19.backbone) == '"vgg19"'


@pytest.mark.slow
def test_onnx_gives_the_same(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    from saver_envs.perception.onnx import OnnxNetwork, export_onnx

    network = PoseNetwork(LIGHT, ARMS).eval()
    export_onnx(network, tmp_path / "arms.onnx", (64, 96))
    exported = OnnxNetwork(tmp_path / "arms.onnx")
    x = torch.randn(1, 3, 64, 96)
    with torch.no_grad():
        expected = network(x)[1].numpy()
    assert np.abs(exported(x.numpy()) - expected).max() < 1e-3
    assert exported.limbs == network.limbs


WIDTH = asdict(LIGHT)
MALFORMED = {
    "many layers": {"architecture": {**WIDTH, "stage1": [[1, 16]] * 20_000}},
    "wide layers": {"architecture": {**WIDTH, "stage2": [[3, 10**9]]}},
    "large kernels": {"architecture": {**WIDTH, "stage1": [[10**6, 16]]}},
    "infinite": {"architecture": {**WIDTH, "stage1": [[1, float("inf")]]}},
    "no layers": {"architecture": {**WIDTH, "stage1": None}},
    "a list": {"architecture": [1]},
    "nothing": {"architecture": None},
    "another entry": {"architecture": {**WIDTH, "depth": 3}},
    "no limbs": {"limbs": None},
    "limbs of a number": {"limbs": 3},
    "unknown limbs": {"limbs": ["tail"]},
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_header_is_refused_before_anything_is_allocated(
    tmp_path: Path, case: str
) -> None:
    network = PoseNetwork(LIGHT, ["head"])
    header = {"architecture": WIDTH, "limbs": ["head"], "info": {}, **MALFORMED[case]}
    path = tmp_path / "malformed.safetensors"
    texts = {name: json.dumps(value) for name, value in header.items()}
    write_weights(path, KIND, network.state_dict(), texts)
    for read in (load_network, read_info):
        with pytest.raises(ValueError, match=r"malformed.safetensors contradicts itself"):
            read(path)
