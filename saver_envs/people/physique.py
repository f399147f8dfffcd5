"""The shape of a limp person: the exported mesh, fitted to sex, height and body mass index.

The mesh differs in sex and build, but not enough: its heaviest man would weigh 68 kg at 1.75 m. Its
trunk and limbs are therefore made thicker or thinner until the volume is that of the person's mass,
and its arms longer or shorter until they have the published lengths.
"""

from __future__ import annotations

from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.anthropometry import DE_LEVA, Sex
from saver_envs.people.manikin import NEXT_BODY, segment
from saver_envs.people.surface import Appearance, BodyShape

#: Of a whole body with air in the lungs (kg/m^3): people about float.
DENSITY: Final = 1000.0
#: Body mass indices (kg/m^2) of the exported slim and heavy builds, ours.
_SLIM, _HEAVY = 18.5, 30.0
#: How much of a change in girth each segment takes, across (y) and in depth (z); limbs take it
#: alike in all directions. A heavy trunk grows forwards rather than sideways. Ours.
_TRUNK_GIRTH: Final = {"pelvis": (0.7, 1.2), "torso": (0.5, 1.4)}
_ROUND: Final = ("upper_arm", "forearm", "thigh", "shank")
#: Segments that are given the published lengths.
_STRETCHED: Final = ("upper_arm", "forearm")
#: Girths between which the volume is fitted.
_GIRTHS: Final = (0.7, 1.6)


def heaviness_of(bmi: float) -> float:
    """Return which exported build is nearest to a body mass index: 0 slim to 1 heavy."""
    return float(np.clip((bmi - _SLIM) / (_HEAVY - _SLIM), 0.0, 1.0))


class Physique(BodyShape):
    """A body whose volume is that of its mass, and whose arms have the published lengths.

    :param sex: ``female`` or ``male``.
    :param height: metres.
    :param bmi: body mass index, kg/m^2.
    """

    def __init__(self, sex: Sex, height: float, bmi: float) -> None:
        gender = 1.0 if sex == "female" else 0.0
        super().__init__(Appearance(gender, heaviness_of(bmi), height))
        #: kg.
        self.mass = bmi * height**2
        self._stretch_arms(sex, height)
        self.heads = _mirrored(self.heads, self.bodies)
        thickened = self._thickening
        low, high = _GIRTHS
        for _ in range(24):  # to a millionth
            middle = (low + high) / 2
            volume = self._volume(self.vertices + (middle - 1) * thickened)
            low, high = (middle, high) if DENSITY * volume < self.mass else (low, middle)
        #: Factor of the limbs' thickness.
        self.girth = (low + high) / 2
        self.vertices = self.vertices + (self.girth - 1) * thickened

    def _stretch_arms(self, sex: Sex, height: float) -> None:
        """Move vertices and joints so that upper arms and forearms have the published lengths."""
        moved, heads = np.zeros_like(self.vertices), self.heads.copy()
        for side in ("left", "right"):
            shift = np.zeros(3)
            for part in ("upper_arm", "forearm", "hand"):
                body = f"{side}_{part}"
                index, begin = self.bodies.index(body), self.head(body)
                heads[index] = begin + shift
                change = np.tile(shift, (len(self.vertices), 1))
                if part in _STRETCHED:
                    way = self.head(body.replace(part, NEXT_BODY[part])) - begin
                    length = float(np.linalg.norm(way))
                    more = height * DE_LEVA[sex][part].length / length - 1
                    along = (self.vertices - begin) @ way / length**2
                    change += more * np.outer(np.clip(along, 0.0, 1.0), way)
                    shift = shift + more * way
                moved += self.weights[:, index, None] * change
        self.vertices, self.heads = self.vertices + moved, heads

    @cached_property
    def _thickening(self) -> NDArray[np.float64]:
        """(vertices, 3) by how much vertices move for each unit of girth."""
        total = np.zeros_like(self.vertices)
        for index, body in enumerate(self.bodies):
            kind = segment(body)
            if kind in _TRUNK_GIRTH:
                middle = float(np.median(self.owned("torso")[:, 2]))
                aside = (self.vertices - (0, 0, middle)) * (0, *_TRUNK_GIRTH[kind])
            elif kind in _ROUND:
                begin = self.head(body)
                way = self.head(body.replace(kind, NEXT_BODY[kind])) - begin
                way = way / np.linalg.norm(way)
                aside = self.vertices - begin
                aside = aside - np.outer(aside @ way, way)
            else:
                continue
            total += self.weights[:, index, None] * aside
        return total

    def _volume(self, vertices: NDArray[np.float64]) -> float:
        """Return the volume that the surface encloses, m^3."""
        first, second, third = (vertices[self.faces[:, corner]] for corner in range(3))
        return float(np.sum(first * np.cross(second, third))) / 6


def _mirrored(heads: NDArray[np.float64], bodies: tuple[str, ...]) -> NDArray[np.float64]:
    """Return the joints' centres with right ones that mirror the left ones exactly."""
    found = heads.copy()
    for index, body in enumerate(bodies):
        if body.startswith("right_"):
            left = bodies.index(body.replace("right_", "left_"))
            found[index] = heads[left] * (1, -1, 1)
        elif not body.startswith("left_"):
            found[index, 1] = 0.0
    return found
