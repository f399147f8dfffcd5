"""Appearance of the manikin: shape, skin, hair and clothes, as MuJoCo skins."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.validation import require, require_share
from saver_envs.world import add_picture, give_texture

Colour = tuple[float, float, float]
Pattern = Literal["plain", "stripes", "checks", "mottled"]

ASSET: Final = Path(__file__).parent / "assets" / "manikin" / "body.npz"
#: Stature of the exported bodies (m).
EXPORTED_STATURE: Final = 1.75
STATURE_RANGE: Final = (1.40, 2.10)
#: Lengths in the file are in tenths of a millimetre, weights in 255ths.
_LENGTH_UNIT, _WEIGHT_UNIT = 1e-4, 1 / 255
#: How far clothes and hair stand off the skin (m).
_STANDOFF: Final = {"hair": 0.010, "shirt": 0.007, "trousers": 0.006, "shoes": 0.006}
#: Width and height of a cloth's texture (pixels), and how much cloth it covers (m).
_TEXTURE_SIZE, _TEXTURE_COVERS = 64, 0.16


@dataclass(frozen=True)
class Appearance:
    """What a person looks like. Colours are red, green, blue in [0, 1].

    :param gender: 0 is a man's body, 1 a woman's, between them a mixture.
    :param heaviness: 0 slim, 0.5 average, 1 heavy.
    :param stature: metres, 1.4 to 2.1.
    :param skin: colour.
    :param hair: colour.
    :param bald: whether the scalp is bare.
    :param shirt: colour.
    :param shirt_pattern: plain, stripes, checks or mottled, with ``shirt_second``.
    :param shirt_second: the pattern's second colour.
    :param sleeves: none, short or long.
    :param trousers: colour.
    :param trousers_pattern: as the shirt's.
    :param trousers_second: the pattern's second colour.
    :param trouser_legs: short or long.
    :param shoes: colour, ``None`` for bare feet.
    :raises ValueError: for a number out of its range.
    """

    gender: float = 0.0
    heaviness: float = 0.5
    stature: float = EXPORTED_STATURE
    skin: Colour = (0.80, 0.60, 0.49)
    hair: Colour = (0.16, 0.11, 0.08)
    bald: bool = False
    shirt: Colour = (0.24, 0.36, 0.50)
    shirt_pattern: Pattern = "plain"
    shirt_second: Colour = (0.85, 0.85, 0.82)
    sleeves: Literal["none", "short", "long"] = "short"
    trousers: Colour = (0.20, 0.21, 0.25)
    trousers_pattern: Pattern = "plain"
    trousers_second: Colour = (0.35, 0.36, 0.40)
    trouser_legs: Literal["short", "long"] = "long"
    shoes: Colour | None = (0.13, 0.12, 0.12)

    def __post_init__(self) -> None:
        require_share("gender", self.gender)
        require_share("heaviness", self.heaviness)
        least, most = STATURE_RANGE
        fits = least <= self.stature <= most
        require("stature", self.stature, fits, f"between {least} and {most} m")


AVERAGE_MAN: Final = Appearance()


class BodyShape:
    """A body on its back, in the manikin's frame (see :mod:`saver_envs.people.manikin`), metres.

    It is a mixture of the exported bodies.

    :param appearance: gives gender, heaviness and stature.
    """

    def __init__(self, appearance: Appearance) -> None:
        content = _file()
        names = [str(name) for name in content["shape_names"]]
        share = np.zeros(len(names))
        heaviness, woman = appearance.heaviness, appearance.gender
        slim, heavy = max(0.0, 1 - 2 * heaviness), max(0.0, 2 * heaviness - 1)
        for gender, part in (("man", 1 - woman), ("woman", woman)):
            for build, amount in (("slim", slim), ("average", 1 - slim - heavy), ("heavy", heavy)):
                share[names.index(f"{build}_{gender}")] = part * amount
        unit = _LENGTH_UNIT * appearance.stature / EXPORTED_STATURE
        change = np.tensordot(share[1:], content["shape_change"].astype(float), axes=1)
        weights = content["weights"].astype(float) * _WEIGHT_UNIT
        #: (vertices, 3).
        self.vertices = unit * (content["shape"] + change)
        #: (triangles, 3) indices of vertices.
        self.faces = content["faces"].astype(np.intp)
        #: (triangles,) indices into ``parts``.
        self.face_part = content["face_part"].astype(np.intp)
        #: Names of the parts of the surface.
        self.parts = tuple(str(name) for name in content["parts"])
        #: (vertices, bodies) how much each body moves a vertex; rows sum to 1.
        self.weights = weights / weights.sum(axis=1, keepdims=True)
        #: Names of the bodies.
        self.bodies = tuple(str(name) for name in content["bodies"])
        #: (bodies, 3) the joints' centres, at which bodies begin.
        self.heads = unit * np.tensordot(share, content["heads"].astype(float), axes=1)
        #: (3,).
        self.nose = unit * np.tensordot(share, content["noses"].astype(float), axes=1)

    def normals(self) -> NDArray[np.float64]:
        """Return the vertices' normals (vertices, 3), outwards, of length 1."""
        corners = self.vertices[self.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = np.zeros_like(self.vertices)
        for corner in range(3):
            np.add.at(total, self.faces[:, corner], across)
        return total / np.linalg.norm(total, axis=1, keepdims=True)

    def head(self, body: str) -> NDArray[np.float64]:
        """(3,) where a body begins."""
        return self.heads[self.bodies.index(body)]

    def owned(self, body: str) -> NDArray[np.float64]:
        """(some, 3) the vertices that a body moves most."""
        most = self.weights.argmax(axis=1) == self.bodies.index(body)
        return self.vertices[most]


@lru_cache(maxsize=1)
def _file() -> dict[str, NDArray[Any]]:
    with np.load(ASSET, allow_pickle=False) as content:
        return {name: content[name] for name in content.files}


def add_skins(spec: mujoco.MjSpec, shape: BodyShape, appearance: Appearance, prefix: str) -> None:
    """Add skins and clothes to the bodies of a specification.

    :param spec: gets textures, materials and skins.
    :param shape: the body.
    :param appearance: colours and cut.
    :param prefix: of the bodies' names, and of the new names.
    """
    layers = np.array([_layer(part, appearance) for part in shape.parts])[shape.face_part]
    normals = shape.normals()
    for layer in np.unique(layers).tolist():
        name = f"{prefix}{layer}"
        _add_material(spec, name, layer, appearance)
        chosen = layers == layer
        used, faces = np.unique(shape.faces[chosen], return_inverse=True)
        # The rim stays on the skin, so that no gap is visible.
        rim = np.isin(used, np.unique(shape.faces[~chosen]))
        lift = np.where(rim, 0.0, _STANDOFF.get(layer, 0.0))
        vertices = shape.vertices[used] + lift[:, None] * normals[used]
        weights = shape.weights[used]
        moved = [np.flatnonzero(weights[:, body] > 0) for body in range(len(shape.bodies))]
        at_work = [body for body, rows in enumerate(moved) if len(rows)]
        skin = spec.add_skin(name=name, material=name)
        skin.vert = vertices.astype(np.float32).ravel()
        skin.face = faces.astype(np.int32).ravel()
        # Cloth runs around the body: along it, and across it as seen from above.
        skin.texcoord = (vertices[:, :2] / _TEXTURE_COVERS).astype(np.float32).ravel()
        skin.bodyname = [prefix + shape.bodies[body] for body in at_work]
        skin.bindpos = shape.heads[at_work].astype(np.float32).ravel()
        skin.bindquat = np.tile([1, 0, 0, 0], len(at_work)).astype(np.float32)
        skin.vertid = [moved[body].astype(np.int32) for body in at_work]
        skin.vertweight = [weights[moved[body], body].astype(np.float32) for body in at_work]


def _layer(part: str, appearance: Appearance) -> str:
    """Return what covers a part of the body: skin, hair, lips, eyes, shirt, trousers or shoes."""
    covered = {
        "face": "skin",
        "hand": "skin",
        "hair": "skin" if appearance.bald else "hair",
        "sleeve": "skin" if appearance.sleeves == "none" else "shirt",
        "long_sleeve": "shirt" if appearance.sleeves == "long" else "skin",
        "long_trousers": "trousers" if appearance.trouser_legs == "long" else "skin",
        "shank": "trousers" if appearance.trouser_legs == "long" else "skin",
        "shoe": "skin" if appearance.shoes is None else "shoes",
    }
    return covered.get(part, part)


def _colour(layer: str, appearance: Appearance) -> Colour:
    red, green, blue = appearance.skin
    colours: dict[str, Colour] = {
        "brows": appearance.hair,
        "lips": (0.85 * red, 0.62 * green, 0.66 * blue),
        "eyes": (0.30, 0.25, 0.22),
    }
    return colours[layer] if layer in colours else getattr(appearance, layer)


def _add_material(spec: mujoco.MjSpec, name: str, layer: str, appearance: Appearance) -> None:
    material = spec.add_material(name=name, specular=0.12, shininess=0.15)
    colour = _colour(layer, appearance)
    pattern: Pattern = getattr(appearance, f"{layer}_pattern", "plain")
    if pattern == "plain":
        material.rgba = (*colour, 1)
        return
    share, second = _pattern(pattern)[..., None], getattr(appearance, f"{layer}_second")
    add_picture(spec, name, (1 - share) * np.array(colour) + share * np.array(second))
    give_texture(material, name)


def _pattern(pattern: Pattern) -> NDArray[np.float64]:
    """Return the share (size, size) of the second colour."""
    rows, columns = np.indices((_TEXTURE_SIZE, _TEXTURE_SIZE)) % (_TEXTURE_SIZE // 4)
    along = (rows < _TEXTURE_SIZE // 8).astype(np.float64)
    across = (columns < _TEXTURE_SIZE // 8).astype(np.float64)
    if pattern == "stripes":
        return along
    if pattern == "checks":
        return 0.5 * along + 0.5 * across
    if pattern == "mottled":
        random = np.random.default_rng(0)
        spots = random.random((_TEXTURE_SIZE // 4, _TEXTURE_SIZE // 4)) > 0.5
        return np.kron(spots, np.ones((4, 4))).astype(np.float64)
    raise ValueError(f"pattern={pattern!r}: valid are plain, stripes, checks and mottled")
