"""Augment labelled pictures: geometry, light, colours, noise and patches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.dataset import Example
from saver_envs.perception.skeleton import MIRRORED_JOINTS


@dataclass(frozen=True)
class Augmentation:
    """Strength of the augmentation.

    :param rotation: standard deviation, degrees.
    :param scale: smallest and largest, relative to the scale at which the picture fits.
    :param shift: largest, as a fraction of the picture's size.
    :param mirror: probability.
    :param blur: largest radius, pixels.
    :param noise: largest standard deviation, of 255.
    :param patches: probability of one to three rectangles of one colour over the picture.
    """

    rotation: float = 14.0
    scale: tuple[float, float] = (0.85, 1.4)
    shift: float = 0.12
    mirror: float = 0.5
    blur: float = 1.6
    noise: float = 14.0
    patches: float = 0.35


def augment(
    example: Example,
    size: tuple[int, int],
    random: np.random.Generator,
    amount: Augmentation = Augmentation(),
) -> Example:
    """Return a changed copy of a picture and its labels.

    :param example: the picture.
    :param size: height and width of the new picture.
    :param random: source.
    :param amount: strength of the augmentation.
    """
    scale = math.exp(random.uniform(*np.log(amount.scale)))
    angle = math.radians(random.normal(0, amount.rotation))
    shift = random.uniform(-amount.shift, amount.shift, 2)
    mirror = bool(random.random() < amount.mirror)
    fill = random.integers(0, 256, 3)
    height, width = size
    old_height, old_width = example.image.shape[:2]
    scale *= min(height / old_height, width / old_width)
    cosine, sine = scale * math.cos(angle), scale * math.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    joints, annotated = example.joints, example.annotated
    if mirror:
        turn = turn @ np.diag([-1.0, 1.0])
        joints, annotated = joints[:, MIRRORED_JOINTS], annotated[:, MIRRORED_JOINTS]
    centre = np.array([width, height]) * (0.5 + shift)
    offset = centre - turn @ np.array([old_width / 2, old_height / 2])
    left, top, right, bottom = example.boxes.reshape(-1, 4).T
    corners = np.stack(
        [np.stack([x, y], axis=-1) for x in (left, right) for y in (top, bottom)], axis=1
    )
    moved = corners @ turn.T + offset
    boxes = np.concatenate([moved.min(axis=1), moved.max(axis=1)], axis=-1)
    image = _relit(_warped(example.image, size, turn, offset, fill), random, amount)
    return Example(image, joints @ turn.T + offset, annotated, boxes)


def _warped(
    image: NDArray[np.uint8],
    size: tuple[int, int],
    turn: NDArray[np.float64],
    offset: NDArray[np.float64],
    fill: NDArray[np.int64],
) -> NDArray[np.uint8]:
    """Move each point x of a picture to ``turn @ x + offset`` in a picture of ``size``."""
    from PIL import Image

    # Pillow expects the map from new pixels to old pixels.
    back = np.linalg.inv(turn)
    picture = Image.fromarray(image).transform(
        size[::-1],
        Image.Transform.AFFINE,
        tuple(np.column_stack([back, -back @ offset]).ravel()),
        Image.Resampling.BILINEAR,
        fillcolor=tuple(fill.tolist()),
    )
    return np.asarray(picture)


def _relit(
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
    """Paint one to three rectangles of one colour."""
    height, width = values.shape[:2]
    for _ in range(random.integers(1, 4)):
        tall = random.integers(height // 20, height // 4)
        wide = random.integers(width // 20, width // 4)
        top, left = random.integers(0, height - tall), random.integers(0, width - wide)
        values[top : top + tall, left : left + wide] = random.uniform(0, 255, 3)
