"""Pictures: files as cameras and strangers leave them, and arrays given to the estimator."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzzing import ODD, ODD_ARRAYS, cases, damaged, refusal
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from saver_envs.perception.estimator import PoseEstimator, checked
from saver_envs.perception.parsing import parse
from saver_envs.perception.pictures import read_picture


def encoded(kind: str) -> bytes:
    file = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 256, (12, 17, 3), np.uint8)
    Image.fromarray(noise).save(file, kind)
    return file.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pictures")


@cases(3.0)
@given(
    content=st.sampled_from(["PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP"]).flatmap(
        lambda kind: damaged(encoded(kind))
    )
)
def test_picture_files(folder: Path, content: bytes) -> None:
    path = folder / "picture"
    path.write_bytes(content)
    picture, message = refusal("pictures", lambda: read_picture(path), ValueError, OSError)
    if picture is None:
        assert str(path) in message, message
        return
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[2] == 3


@cases(2.0)
@given(st.one_of(ODD, ODD_ARRAYS))
def test_arrays_as_pictures(image: Any) -> None:
    found, message = refusal("pictures", lambda: checked(image), ValueError, TypeError)
    if found is None:
        assert "picture" in message or "image" in message, message
        return
    assert found.dtype == np.uint8
    assert min(found.shape) > 0


@cases(0.2)
@given(arrays(np.uint8, st.tuples(st.integers(1, 300), st.integers(1, 300), st.just(3))))
def test_pictures_of_any_size(image: np.ndarray) -> None:
    poses = estimator()(image)
    height, width = image.shape[:2]
    known = np.isfinite(poses.joints)
    assert (poses.joints[known] >= 0).all()
    assert (np.where(known, poses.joints, 0.0) <= (width, height)).all()


@cases()
@given(
    arrays(
        np.float32,
        st.tuples(st.just(2), st.just(3), st.integers(1, 8), st.integers(1, 8)),
        elements=st.floats(width=32),
    )
)
def test_fields_of_any_content(fields: np.ndarray) -> None:
    poses, _ = refusal("pictures", lambda: parse(fields, [0, 1]), ValueError)
    if poses is not None:
        assert not np.isinf(poses.joints).any()


def estimator(made: list[PoseEstimator] = []) -> PoseEstimator:  # noqa: B006
    if not made:
        made.append(PoseEstimator.shipped(size=(64, 64)))
    return made[0]
