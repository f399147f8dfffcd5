"""Labelled pictures on disk: rendered ones in shards, and any COCO key point file."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import KINECT_V2, Camera, CameraPose
from saver_envs.files import written_whole
from saver_envs.perception.skeleton import COCO_JOINTS, Visibility, from_coco, to_coco
from saver_envs.perception.stage import Labelled, Stage, StageOptions

#: Depth is kept in tenths of a millimetre.
_DEPTH_UNIT: Final = 1e-4
#: Frames from one compiled scene.
FRAMES_PER_STAGE: Final = 20
SPLITS: Final = ("train", "validation", "test")


@dataclass(frozen=True)
class Example:
    """A picture to learn from.

    :param image: (height, width, 3) uint8.
    :param joints: (people, 14, 2) pixels.
    :param annotated: (people, 14) whether the position is known.
    :param boxes: (people, 4) left, top, right, bottom, pixels.
    """

    image: NDArray[np.uint8]
    joints: NDArray[np.float64]
    annotated: NDArray[np.bool_]
    boxes: NDArray[np.float64]


class Dataset(Protocol):
    """Examples by number."""

    def __len__(self) -> int:
        """Return the number of examples."""

    def __getitem__(self, index: int) -> Example:
        """Return one of them."""


def render(
    folder: Path,
    frames: int,
    seed: int,
    options: StageOptions,
    camera: Camera = KINECT_V2,
    with_depth: bool = True,
    shard_size: int = 200,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Render a data set into a folder, or what is missing of it.

    A shard depends on ``seed`` and its number alone, so that a run that was interrupted goes on.

    :param folder: made if need be.
    :param frames: multiple of ``shard_size``.
    :param seed: of the whole.
    :param options: what is in the scenes.
    :param camera: intrinsics.
    :param with_depth: whether depth with the sensor's noise is kept.
    :param shard_size: frames in a file.
    :param progress: told the number of frames after each shard.
    :raises ValueError: where ``frames`` is no multiple of ``shard_size``, or where the folder holds
        other pictures.
    """
    if frames <= 0 or frames % shard_size:
        raise ValueError(f"frames={frames!r}: must be a multiple of {shard_size}")
    folder.mkdir(parents=True, exist_ok=True)
    _check_description(folder, seed, options, camera, with_depth, shard_size)
    for shard in range(frames // shard_size):
        if not (folder / f"{shard:04d}.npz").is_file():
            _render_shard(folder, shard, seed, options, camera, with_depth, shard_size)
        if progress is not None:
            progress(shard_size)


def _check_description(
    folder: Path,
    seed: int,
    options: StageOptions,
    camera: Camera,
    with_depth: bool,
    shard_size: int,
) -> None:
    wanted = {
        "seed": seed,
        "options": asdict(options),
        "camera": asdict(camera),
        "with_depth": with_depth,
        "shard_size": shard_size,
    }
    wanted = json.loads(json.dumps(wanted))
    path = folder / "description.json"
    if not path.is_file():
        path.write_text(json.dumps(wanted, indent=2) + "\n", encoding="utf-8")
    elif json.loads(path.read_text(encoding="utf-8")) != wanted:
        raise ValueError(f"{folder} holds pictures that were rendered otherwise: see {path}")


def _render_shard(
    folder: Path,
    shard: int,
    seed: int,
    options: StageOptions,
    camera: Camera,
    with_depth: bool,
    size: int,
) -> None:
    random = np.random.default_rng([seed, shard])
    found: list[Labelled] = []
    while len(found) < size:
        stage = Stage(random, options, camera)
        try:
            for _ in range(min(FRAMES_PER_STAGE, size - len(found))):
                found.append(stage.frame(depth_noise=with_depth))
        finally:
            stage.close()
    most = max(len(one.pixels) for one in found)

    def padded(values: Sequence[NDArray[Any]], filler: float) -> NDArray[Any]:
        first = values[0]
        table = np.full((len(values), most, *first.shape[1:]), filler, dtype=first.dtype)
        for row, value in enumerate(values):
            table[row, : len(value)] = value
        return table

    content: dict[str, NDArray[Any]] = {
        "people": np.array([len(one.pixels) for one in found]),
        "pixels": padded([one.pixels for one in found], np.nan),
        "visibility": padded([one.visibility for one in found], 0),
        "positions": padded([one.positions for one in found], np.nan),
        "boxes": padded([one.boxes for one in found], 0.0),
        "camera_position": np.stack([one.pose.position for one in found]),
        "camera_rotation": np.stack([one.pose.rotation for one in found]),
    }
    np.save(folder / f"{shard:04d}-rgb.npy", np.stack([one.rgb for one in found]))
    if with_depth:
        depth = np.stack([one.depth for one in found]) / _DEPTH_UNIT
        np.save(folder / f"{shard:04d}-depth.npy", np.rint(depth).astype(np.uint16))
    # The labels come last: a shard without them is rendered anew.
    with written_whole(folder / f"{shard:04d}.npz") as file:
        np.savez(file, allow_pickle=False, **content)


class RenderedDataset:
    """Pictures from :func:`render`; they stay on disk until they are asked for.

    :param folder: that was rendered into.
    :raises FileNotFoundError: where there are none.
    """

    def __init__(self, folder: Path) -> None:
        description = folder / "description.json"
        names = sorted(folder.glob("[0-9]*.npz"))
        if not names or not description.is_file():
            raise FileNotFoundError(f"{folder} holds no rendered pictures")
        camera = json.loads(description.read_text(encoding="utf-8"))["camera"]
        pairs = {name: tuple(camera[name]) for name in ("focal", "centre")}
        self.camera = Camera(**{**camera, **pairs})
        self._shards = []
        for path in names:
            with np.load(path, allow_pickle=False) as content:
                self._shards.append({name: content[name] for name in content.files})
        self._paths = names
        self._size = len(self._shards[0]["people"])
        self._pictures: dict[Path, NDArray[Any]] = {}

    def __len__(self) -> int:
        return self._size * len(self._shards)

    def __getitem__(self, index: int) -> Example:
        """Return a picture; all joints in front of the camera are known, seen or not."""
        labels, row, path = self._place(index)
        people = int(labels["people"][row])
        pixels = labels["pixels"][row, :people]
        known = np.isfinite(pixels).all(axis=-1)
        return Example(
            self._picture(path, "rgb")[row].copy(),
            np.nan_to_num(pixels),
            known,
            labels["boxes"][row, :people],
        )

    def labelled(self, index: int) -> Labelled:
        """Return all that is known about a picture.

        :raises FileNotFoundError: where no depth was kept.
        """
        labels, row, path = self._place(index)
        people = int(labels["people"][row])
        depth = self._picture(path, "depth")[row].astype(np.float32) * np.float32(_DEPTH_UNIT)
        return Labelled(
            rgb=self._picture(path, "rgb")[row].copy(),
            depth=depth,
            pixels=labels["pixels"][row, :people],
            visibility=labels["visibility"][row, :people],
            positions=labels["positions"][row, :people],
            pose=CameraPose(labels["camera_position"][row], labels["camera_rotation"][row]),
            boxes=labels["boxes"][row, :people],
        )

    def visibility(self, index: int) -> NDArray[np.uint8]:
        """Return how the joints (people, 14) of a picture are annotated."""
        labels, row, _ = self._place(index)
        visibility: NDArray[np.uint8] = labels["visibility"][row, : int(labels["people"][row])]
        return visibility

    def _place(self, index: int) -> tuple[dict[str, NDArray[Any]], int, Path]:
        if not 0 <= index < len(self):
            raise IndexError(f"index={index}: there are {len(self)} pictures")
        shard, row = divmod(index, self._size)
        return self._shards[shard], row, self._paths[shard]

    def _picture(self, path: Path, kind: str) -> NDArray[Any]:
        file = path.with_name(f"{path.stem}-{kind}.npy")
        if file not in self._pictures:
            self._pictures[file] = np.load(file, mmap_mode="r", allow_pickle=False)
        return self._pictures[file]


def coco_annotations(dataset: RenderedDataset, count: int | None = None) -> dict[str, Any]:
    """Return key point annotations in COCO's format.

    :param dataset: rendered pictures.
    :param count: of the first so many; all of them where ``None``.
    :return: JSON-able; ``file_name`` is the picture's number with six digits and ``.png``.
    """
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for index in range(len(dataset) if count is None else min(count, len(dataset))):
        example, visibility = dataset[index], dataset.visibility(index)
        height, width = example.image.shape[:2]
        images.append(
            {"id": index, "file_name": f"{index:06d}.png", "height": height, "width": width}
        )
        for person, (joints, seen) in enumerate(zip(example.joints, visibility, strict=True)):
            keypoints = to_coco(joints, seen)
            left, top, right, bottom = (float(edge) for edge in example.boxes[person])
            box = [left, top, right - left, bottom - top]
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": index,
                    "category_id": 1,
                    "keypoints": [round(float(value), 2) for value in keypoints.ravel()],
                    "num_keypoints": int((keypoints[:, 2] > 0).sum()),
                    "bbox": box,
                    # The outline's area is about half of the box's, as COCO's people's is.
                    "area": 0.53 * box[2] * box[3],
                    "iscrowd": 0,
                }
            )
    category = {"id": 1, "name": "person", "keypoints": list(COCO_JOINTS), "skeleton": []}
    return {"images": images, "annotations": annotations, "categories": [category]}


class CocoDataset:
    """Pictures with people of a COCO key point file, such as ``person_keypoints_train2017.json``.

    A joint without annotation is unknown, people in a crowd have none that is known: there the
    loss does not count (see :func:`~.fields.loss_mask`).

    :param annotations: the JSON file.
    :param images: folder of the pictures.
    :raises ValueError: where the file has no key points of people.
    """

    def __init__(self, annotations: Path, images: Path) -> None:
        content = json.loads(Path(annotations).read_text(encoding="utf-8"))
        people = [one for one in content.get("annotations", []) if "keypoints" in one]
        if not people or "images" not in content:
            raise ValueError(f"annotations={str(annotations)!r}: holds no key points of people")
        self._folder = Path(images)
        names = {one["id"]: one["file_name"] for one in content["images"]}
        grouped: dict[int, list[dict[str, Any]]] = {}
        for one in people:
            grouped.setdefault(one["image_id"], []).append(one)
        self._pictures = [(names[image], grouped[image]) for image in sorted(grouped)]

    def __len__(self) -> int:
        return len(self._pictures)

    def __getitem__(self, index: int) -> Example:
        """Return a picture with its people."""
        from PIL import Image

        name, people = self._pictures[index]
        with Image.open(self._folder / name) as picture:
            image = np.asarray(picture.convert("RGB"))
        keypoints = np.array([one["keypoints"] for one in people], dtype=np.float64)
        joints = from_coco(keypoints.reshape(len(people), len(COCO_JOINTS), 3))
        left, top, width, height = np.array([one["bbox"] for one in people], dtype=np.float64).T
        return Example(
            image,
            joints[..., :2],
            joints[..., 2] > Visibility.MISSING,
            np.stack([left, top, left + width, top + height], axis=-1),
        )
