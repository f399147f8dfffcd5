"""The stretcher: canvas between two poles, with a support for head and neck."""

from __future__ import annotations

import math
from typing import Final

import mujoco
import numpy as np

from saver_envs.people.surface import AVERAGE_MAN, Appearance, BodyShape, Colour
from saver_envs.robots.description import DRAWN_ONLY
from saver_envs.world import draw_box

POLE_RADIUS: Final = 0.016  # m
CANVAS_THICKNESS: Final = 0.012  # m
LENGTH: Final = 1.95  # m, from end to end of the canvas
STRETCHER: Final = "stretcher"  # name of its body, behind the prefix


def add_stretcher(
    spec: mujoco.MjSpec,
    appearance: Appearance = AVERAGE_MAN,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    prefix: str = "",
    width: float = 0.54,
    colour: Colour = (0.86, 0.42, 0.13),
    support: Colour = (0.28, 0.30, 0.33),
) -> None:
    """Add a folding field stretcher, ours, under a person.

    It is flat, so that an arm can be pushed off and onto it.

    :param spec: gets one body with visual geoms: its top is at ``position``'s height, where the
        scene has a table to lie on.
    :param appearance: of the person, whose head the support has to fit.
    :param position: of the point between the person's hip joints, metres.
    :param yaw: turn about z, radians, the person's.
    :param prefix: of the names.
    :param width: metres, between the poles: narrow enough to lie between the arms' bases.
    :param colour: of the canvas.
    :param support: colour of the head's and neck's support.
    """
    shape = BodyShape(appearance)
    body = spec.worldbody.add_body(
        name=prefix + STRETCHER,
        pos=position,
        quat=(math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)),
    )
    ends = shape.vertices[:, 0].min(), shape.vertices[:, 0].max()
    middle = float(np.mean(ends))
    half = LENGTH / 2

    canvas = (half, width / 2, CANVAS_THICKNESS / 2)
    draw_box(body, (middle, 0, 0.001 - CANVAS_THICKNESS / 2), canvas, colour)
    for side in (-1, 1):
        y, z = side * (width / 2 + POLE_RADIUS), -0.5 * POLE_RADIUS
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(middle - half - 0.12, y, z, middle + half + 0.12, y, z),
            size=(POLE_RADIUS, 0, 0),
            rgba=(0.62, 0.63, 0.65, 1),
            **DRAWN_ONLY,
        )
    head = shape.owned("head")
    rise = max(float(np.percentile(head[:, 2], 2)), 0.012)
    crown, nape = float(head[:, 0].min()), float(shape.head("head")[0])
    centre, reach = (crown + nape) / 2 - 0.01, (nape - crown) / 2 + 0.03
    draw_box(body, (centre, 0, rise / 2), (reach, 0.13, rise / 2), support)
    wide = float(np.abs(head[:, 1]).max())
    for side in (-1, 1):
        cushion = (centre, side * (wide + 0.045), 0.055)
        draw_box(body, cushion, (0.7 * reach, 0.028, 0.055), support)
