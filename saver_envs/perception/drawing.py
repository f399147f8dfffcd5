"""Skeletons drawn over pictures."""

from __future__ import annotations

import colorsys
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import LIMBS

#: A colour a limb: the person's right side warm, the left side cold, head and neck yellow.
LIMB_COLOURS: Final = tuple(
    tuple(
        round(255 * part)
        for part in colorsys.hsv_to_rgb(
            0.15 if not limb.name.startswith(("left", "right"))
            else (0.0 if limb.name.startswith("right") else 0.52) + 0.02 * (number % 5),
            0.85,
            1.0,
        )
    )
    for number, limb in enumerate(LIMBS)
)  # fmt: skip


def draw_poses(
    image: NDArray[np.uint8], poses: Poses, width: int | None = None
) -> NDArray[np.uint8]:
    """Return a picture with people's skeletons over it.

    :param image: (height, width, 3), left as it is.
    :param poses: in its pixels.
    :param width: of a line, pixels; by the picture's size where ``None``.
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
