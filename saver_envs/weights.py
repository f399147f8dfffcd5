"""The weight file of all networks: safetensors with a card and a checksum in its header.

Reading executes nothing: a safetensors file holds numbers, and the card is JSON.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from saver_envs.files import written_whole

Header = dict[str, str]
Shapes = Mapping[str, Tensor]
"""Tensors by name whose shape and dtype a file must have; on the device ``meta`` they need no
memory.
"""

_DTYPES = {torch.float16: "F16", torch.float32: "F32", torch.float64: "F64", torch.int64: "I64"}


def write_weights(
    path: str | Path, kind: str, tensors: Mapping[str, Tensor], header: Mapping[str, str]
) -> None:
    """Write a weight file, either as a whole or not at all.

    :param path: of the file; its folder must exist.
    :param kind: what the file holds, such as ``saver-policy``.
    :param tensors: by name.
    :param header: further text, such as a card as JSON.
    :raises OSError: when it cannot be written; an older file is then intact.
    """
    whole = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    metadata = {**header, "format": f"{kind}-2"}
    metadata["sha256"] = _checksum(whole, metadata)
    with written_whole(path) as file:
        file.write(to_bytes(whole, metadata))


def read_header(path: str | Path, kind: str) -> Header:
    """Read the header of a weight file; the checksum is not verified.

    :param path: of the file.
    :param kind: what the file must hold, such as ``saver-policy``.
    :return: the entries by name.
    :raises ValueError: if the file is damaged or of another kind; the message names it.
    """
    with _opened(path, kind) as (_, header):
        return header


def read_weights(
    path: str | Path,
    kind: str,
    shapes: Callable[[Header], Shapes | None] | None = None,
    *,
    half: bool = False,
    may_be_infinite: Collection[str] | None = (),
) -> tuple[Header, dict[str, Tensor]]:
    """Read and verify a weight file.

    Shapes and dtypes are compared before a tensor is read.

    :param path: of the file.
    :param kind: what the file must hold, such as ``saver-policy``.
    :param shapes: returns the expected tensors for a header; any are accepted if it is None or
        returns None.
    :param half: whether the file may hold 16-bit floats where others are expected.
    :param may_be_infinite: names of tensors in which only NaN is an error; with None, no values are
        checked.
    :return: the header and the tensors by name.
    :raises ValueError: if the file is damaged, inconsistent or of another kind; the message names
        it and says what is wrong.
    """
    with _opened(path, kind) as (file, header):
        names = list(file.keys())
        if shapes is not None:
            slices = {name: file.get_slice(name) for name in names}
            found = {
                name: (one.get_dtype(), tuple(one.get_shape())) for name, one in slices.items()
            }
            _check_shapes(path, found, header, shapes, half)
        tensors = {name: file.get_tensor(name) for name in names}
    if header.pop("sha256", None) != _checksum(tensors, header):
        raise ValueError(f"{path} is damaged: its checksum does not match")
    if may_be_infinite is not None:
        check_finite(path, tensors, may_be_infinite)
    return header, tensors


def check_finite(
    where: str | Path, tensors: Mapping[str, Tensor], may_be_infinite: Collection[str] = ()
) -> None:
    """Check that tensors hold numbers.

    :param where: the file, for the message.
    :param tensors: by name.
    :param may_be_infinite: names of tensors in which only NaN is an error.
    :raises ValueError: for a value that is not finite; the message names file and tensor.
    """
    for name, value in tensors.items():
        valid = ~value.isnan() if name in may_be_infinite else value.isfinite()
        if not valid.all():
            raise ValueError(f"{where}: {name} holds values that are not finite")


@contextmanager
def _opened(path: str | Path, kind: str) -> Iterator[tuple[Any, Header]]:
    """Open a file of this kind, with its header."""
    try:
        with safe_open(path, framework="pt") as file:
            header: Header = dict(file.metadata() or {})
            if header.get("format") != f"{kind}-2":
                raise ValueError(f"{path} is not a {kind} file: its header does not say {kind!r}")
            yield file, header
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is not a complete safetensors file: {error}") from error


def _check_shapes(
    path: str | Path,
    found: Mapping[str, tuple[str, tuple[int, ...]]],
    header: Header,
    shapes: Callable[[Header], Shapes | None],
    half: bool,
) -> None:
    try:
        expected = shapes(header)
    except (LookupError, TypeError, ValueError, ArithmeticError, RuntimeError) as error:
        raise ValueError(f"{path} contradicts itself: {error}") from error
    if expected is None:
        return
    if set(expected) != set(found):
        names = sorted(set(expected) ^ set(found))
        raise ValueError(f"{path} contradicts itself: tensors {names} are missing or surplus")
    for name, value in expected.items():
        dtype, shape = found[name]
        wanted = [_DTYPES[value.dtype]] + ["F16"] * (half and value.is_floating_point())
        if dtype not in wanted or shape != tuple(value.shape):
            raise ValueError(
                f"{path} contradicts itself: {name} is {dtype} {shape}, but the header asks for "
                f"{' or '.join(wanted)} {tuple(value.shape)}"
            )


def _checksum(tensors: Mapping[str, Tensor], header: Mapping[str, str]) -> str:
    """Hash header and tensors, with names, dtypes and shapes."""
    digest = hashlib.sha256(json.dumps(dict(header), sort_keys=True).encode())
    for name, value in sorted(tensors.items()):
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        digest.update(value.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()
