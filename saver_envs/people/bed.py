"""What a limp person lies on: a bed or a stretcher's deck, which may be slippery or move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco

from saver_envs.robots.description import COLLISION_GROUP
from saver_envs.validation import require, require_kind
from saver_envs.world import TABLE_BIT, draw_box

#: Takes precedence over the person's own friction, which is that of clothes on anything else.
BED_PRIORITY: Final = 2
#: Impedance of the contacts (MuJoCo's solimp): with the default one limbs creep by centimetres.
_FIRM: Final = (0.99, 0.999, 0.001, 0.5, 2.0)
_COLOUR: Final = (0.74, 0.80, 0.84)
#: The drawn bed ends this far below the collision box (m), so that the skin does not cut into it.
_SUNK: Final = 0.004


@dataclass(frozen=True)
class Bed:
    """A flat bed, level, its long side along x.

    :param centre: of the surface, metres; the third number is its height.
    :param length: metres.
    :param width: metres.
    :param thickness: metres.
    :param friction: sliding friction with the person: 0.15 to 0.3 with a slide sheet, about 0.5
        with a bed sheet.
    :param speed: at which the surface conveys along +x, m/s.
    :raises ValueError: for a length that is not positive, or another number out of its range.
    """

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    length: float = 2.1
    width: float = 0.9
    thickness: float = 0.08
    friction: float = 0.5
    speed: float = 0.0

    def __post_init__(self) -> None:
        for name in ("length", "width", "thickness"):
            value = getattr(self, name)
            require_kind(name, value, float)
            require(name, value, value > 0, "above 0 m")
        require_kind("friction", self.friction, float)
        require("friction", self.friction, 0.02 <= self.friction <= 1.5, "0.02 to 1.5")
        require_kind("speed", self.speed, float)
        require("speed", self.speed, abs(self.speed) <= 1.0, "-1 to 1 m/s")

    def under(self, x: float, y: float) -> bool:
        """Return whether the bed is under a point."""
        return (
            abs(x - self.centre[0]) <= self.length / 2 and abs(y - self.centre[1]) <= self.width / 2
        )


def add_bed(spec: mujoco.MjSpec, bed: Bed, name: str = "bed") -> None:
    """Add a bed to the world.

    Its contacts with a person have the bed's friction. The velocity of its surface, which carries
    persons without slip, is in the first three numbers of ``geom_surfacevel``; it may be written
    into a model that was compiled with a speed other than 0.

    :param spec: gets the geom ``name`` that collides, and one that is drawn.
    :param bed: which.
    :param name: of the geom.
    """
    x, y, height = bed.centre
    half = (bed.length / 2, bed.width / 2, bed.thickness / 2)
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(x, y, height - half[2]),
        size=half,
        contype=TABLE_BIT,
        conaffinity=0,
        condim=4,
        priority=BED_PRIORITY,
        solimp=_FIRM,
        friction=(bed.friction, 0.01, 0.001),
        surfacevel=(bed.speed, 0, 0, 0, 0, 0),
        group=COLLISION_GROUP,
    )
    draw_box(spec.worldbody, (x, y, height - half[2] - _SUNK), half, _COLOUR)
