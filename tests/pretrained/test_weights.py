"""The weight file that all networks share."""

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from saver_envs.weights import read_header, read_weights, write_weights

TENSORS = {"a": torch.arange(6, dtype=torch.float32).reshape(2, 3), "b": torch.tensor(3)}
SHAPES = {name: value.to("meta") for name, value in TENSORS.items()}


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "w.safetensors"
    write_weights(path, "toy", TENSORS, {"card": '{"seed": 3}'})
    return path


def test_tensors_and_header_come_back(path):
    header, tensors = read_weights(path, "toy", lambda header: SHAPES)
    assert header["card"] == read_header(path, "toy")["card"] == '{"seed": 3}'
    assert all(torch.equal(tensors[name], value) for name, value in TENSORS.items())


def test_every_flipped_bit_is_detected(path):
    whole = path.read_bytes()
    read_weights(path, "toy", may_be_infinite=None)
    for place in range(len(whole)):
        for bit in range(8):
            flipped = bytearray(whole)
            flipped[place] ^= 1 << bit
            path.write_bytes(flipped)
            with pytest.raises(ValueError, match=r"w\.safetensors"):
                read_weights(path, "toy", may_be_infinite=None)


def test_a_file_without_a_checksum_is_refused(tmp_path):
    path = tmp_path / "old.safetensors"
    save_file(TENSORS, path, metadata={"format": "toy-2"})
    with pytest.raises(ValueError, match="checksum does not match"):
        read_weights(path, "toy")
    for metadata in (None, {"format": "toy-1"}):
        save_file(TENSORS, path, metadata=metadata)
        with pytest.raises(ValueError, match="is not a toy file"):
            read_weights(path, "toy")


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        ({"a": SHAPES["a"]}, "'b'.* missing or surplus"),
        ({**SHAPES, "a": torch.empty(3, 2)}, r"a is F32 \(2, 3\).*\(3, 2\)"),
        ({**SHAPES, "a": SHAPES["a"].double()}, "a is F32 .*asks for F64"),
    ],
)
def test_unexpected_shapes_are_named(path, shapes, message):
    with pytest.raises(ValueError, match=message):
        read_weights(path, "toy", lambda header: shapes)


def test_values_must_be_finite(tmp_path):
    path = tmp_path / "nan.safetensors"
    write_weights(path, "toy", {"a": torch.tensor([torch.inf])}, {})
    with pytest.raises(ValueError, match="a holds values that are not finite"):
        read_weights(path, "toy")
    read_weights(path, "toy", may_be_infinite=["a"])
    with safe_open(path, "pt") as file:
        assert len(file.metadata()["sha256"]) == 64
