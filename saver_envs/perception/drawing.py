"""Draw skeletons over pictures."""

from __future__ import annotations

import colorsys
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import LIMB_NAMES, LIMBS


def _colour(number: int, name: str) -> tuple[int, ...]:
    hues = {"right": 0.0, "left": 0.52}
    side = name.partition("_")[0]
    hue = hues[side] + 0.02 * (number % 5) if side in hues else 0.15
    return tuple(round(255 * part) for part in colorsys.hsv_to_rgb(hue, 0.85, 1.0))


#: Colour of each limb: the person's right side warm, the left side cold, the head yellow.
LIMB_COLOURS: Final = tuple(_colour(number, name) for number, name in enumerate(LIMB_NAMES))


def draw_poses(
    image: NDArray[np.uint8], poses: Poses, width: int | None = None
) -> NDArray[np.uint8]:
    """Draw skeletons on a copy of a picture.

    :param image: (height, width, 3).
    :param poses: in the picture's pixels.
    :param width: of a line, pixels; ``None``: in proportion to the picture.
    :return: (height, width, 3).
    """
    from PIL import Image, ImageDraw

    line = width or max(2, round(max(image.shape[:2]) / 180))
    picture = Image.fromarray(image).copy()
    pen = ImageDraw.Draw(picture)
    for joints, found in zip(poses.joints, poses.found, strict=True):
        for limb, colour in zip(LIMBS, LIMB_COLOURS, strict=True):
            if found[limb.proximal] and found[limb.distal]:
                ends = (*joints[limb.proximal], *joints[limb.distal])
                pen.line(ends, fill=colour, width=line)
        for x, y in joints[found]:
            pen.ellipse((x - line, y - line, x + line, y + line), fill=(255, 255, 255))
    return np.asarray(picture)
