"""Changes a labelled picture as cameras, lamps and mountings might, labels included."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.dataset import Example
from saver_envs.perception.skeleton import MIRRORED_JOINTS


@dataclass(frozen=True)
class Augmentation:
    """How much is changed.

    :param rotation: standard deviation, degrees.
    :param scale: smallest and largest, times the scale at which the picture fits.
    :param shift: largest, as a share of the picture's size.
    :param mirror: probability.
    :param blur: largest radius, pixels.
    :param noise: largest standard deviation, of 255.
    :param patches: probability of up to three rectangles of one colour over the picture.
    """

    rotation: float = 14.0
    scale: tuple[float, float] = (0.85, 1.4)
    shift: float = 0.12
    mirror: float = 0.5
    blur: float = 1.6
    noise: float = 14.0
    patches: float = 0.35


def fit(example: Example, size: tuple[int, int]) -> Example:
    """Scale a picture into ``size`` (height, width), unchanged otherwise; for validation."""
    return _warped(example, size, _Move(1.0, 0.0, (0.0, 0.0), False), (0, 0, 0))


def augment(
    example: Example,
    size: tuple[int, int],
    random: np.random.Generator,
    amount: Augmentation = Augmentation(),
) -> Example:
    """Return a changed picture.

    :param example: left as it is.
    :param size: height and width of the new picture.
    :param random: source.
    :param amount: of change.
    """
    move = _Move(
        math.exp(random.uniform(*np.log(amount.scale))),
        math.radians(random.normal(0, amount.rotation)),
        (
            random.uniform(-amount.shift, amount.shift),
            random.uniform(-amount.shift, amount.shift),
        ),
        bool(random.random() < amount.mirror),
    )
    fill = tuple(int(value) for value in random.integers(0, 256, 3))
    moved = _warped(example, size, move, (fill[0], fill[1], fill[2]))
    return Example(_lit(moved.image, random, amount), moved.joints, moved.annotated, moved.boxes)


@dataclass(frozen=True)
class _Move:
    scale: float
    angle: float
    shift: tuple[float, float]
    mirror: bool


def _warped(
    example: Example, size: tuple[int, int], move: _Move, fill: tuple[int, int, int]
) -> Example:
    from PIL import Image

    height, width = size
    old_height, old_width = example.image.shape[:2]
    scale = move.scale * min(height / old_height, width / old_width)
    cosine, sine = scale * math.cos(move.angle), scale * math.sin(move.angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    if move.mirror:
        turn = turn @ np.diag([-1.0, 1.0])
    centre = np.array([width, height]) * (0.5 + np.array(move.shift))
    offset = centre - turn @ np.array([old_width / 2, old_height / 2])
    back = np.linalg.inv(turn)
    # Pillow wants where a new pixel comes from.
    coefficients = np.column_stack([back, -back @ offset]).ravel()
    picture = Image.fromarray(example.image).transform(
        (width, height),
        Image.Transform.AFFINE,
        tuple(coefficients),
        Image.Resampling.BILINEAR,
        fillcolor=fill,
    )
    joints, annotated = example.joints @ turn.T + offset, example.annotated
    if move.mirror:
        joints, annotated = joints[:, MIRRORED_JOINTS], annotated[:, MIRRORED_JOINTS]
    left, top, right, bottom = example.boxes.reshape(-1, 4).T
    corners = np.stack(
        [np.stack([x, y], axis=-1) for x in (left, right) for y in (top, bottom)], axis=1
    )
    moved = corners @ turn.T + offset
    boxes = np.concatenate([moved.min(axis=1), moved.max(axis=1)], axis=-1)
    return Example(np.asarray(picture), joints, annotated, boxes)


def _lit(
    image: NDArray[np.uint8], random: np.random.Generator, amount: Augmentation
) -> NDArray[np.uint8]:
    """Change light, colours and sharpness, add noise and patches."""
    from PIL import Image, ImageFilter

    if random.random() < 0.4:
        radius = random.uniform(0.2, amount.blur)
        image = np.asarray(Image.fromarray(image).filter(ImageFilter.GaussianBlur(radius)))
    values = image.astype(np.float32)
    if random.random() < amount.patches:
        _cover(values, random)
    if random.random() < 0.1:
        values = np.repeat(values.mean(axis=2, keepdims=True), 3, axis=2)
    gain = random.uniform(0.55, 1.5) * random.uniform(0.85, 1.15, 3)
    middle = values.mean()
    contrast = random.uniform(0.7, 1.3)
    values = (middle + contrast * (values - middle)) * gain.astype(np.float32)
    if random.random() < 0.5:
        gamma = math.exp(random.uniform(-0.5, 0.5))
        values = 255 * np.clip(values / 255, 0, 1) ** gamma
    spread = random.uniform(0, amount.noise)
    values = values + spread * random.standard_normal(values.shape, dtype=np.float32)
    return np.clip(values, 0, 255).astype(np.uint8)


def _cover(values: NDArray[np.float32], random: np.random.Generator) -> None:
    height, width = values.shape[:2]
    for _ in range(random.integers(1, 4)):
        tall = random.integers(height // 20, height // 4)
        wide = random.integers(width // 20, width // 4)
        top, left = random.integers(0, height - tall), random.integers(0, width - wide)
        values[top : top + tall, left : left + wide] = random.uniform(0, 255, 3)
