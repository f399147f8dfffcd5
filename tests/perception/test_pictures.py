"""Pictures from files: orientation, 16 bits, and sizes that do not fit."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from saver_envs.perception.pictures import MAX_PIXELS, read_picture

ORIENTATION = 0x112


def empty_png(path: Path, width: int, height: int) -> Path:
    """A PNG whose header promises a size, and whose body holds a few bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


@pytest.mark.parametrize("side", [9_000, 13_000, 50_000])
def test_a_large_picture_is_refused_before_memory_is_allocated(tmp_path: Path, side: int) -> None:
    path = empty_png(tmp_path / "large.png", side, side)
    tracemalloc.start()
    with pytest.raises(ValueError, match=rf"large.png is too large .* at most {MAX_PIXELS:,}"):
        read_picture(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10_000_000


@pytest.mark.parametrize(("orientation", "quarter_turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_a_picture_is_upright(tmp_path: Path, orientation: int, quarter_turns: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    image = Image.fromarray(pixels)
    exif = image.getexif()
    exif[ORIENTATION] = orientation
    image.save(tmp_path / "photo.png", exif=exif)
    np.testing.assert_array_equal(
        read_picture(tmp_path / "photo.png"), np.rot90(pixels, quarter_turns)
    )


@given(st.lists(st.integers(0, 65535), min_size=1, max_size=30))
@settings(max_examples=30, deadline=None)
def test_sixteen_bits_of_grey_are_scaled(values: list[int]) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "grey.png"
        Image.fromarray(np.array([values], np.uint16)).save(path)
        read = read_picture(path)
    assert read.shape == (1, len(values), 3)
    np.testing.assert_allclose(read[0, :, 0], np.array(values) / 257, atol=0.5)


def test_other_kinds_become_three_colours(tmp_path: Path) -> None:
    for mode in ("L", "1", "P", "RGBA", "LA"):
        path = tmp_path / f"{mode}.png"
        Image.new(mode, (4, 3)).save(path)
        assert read_picture(path).shape == (3, 4, 3)


def test_what_is_no_picture(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    path.write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"photo.png is not a picture"):
        read_picture(path)
    with pytest.raises(ValueError, match=r"photo.png is truncated"):
        read_picture(empty_png(path, 40, 30))
