"""Read and write labelled pictures: rendered pictures in shards, and COCO key point files."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_envs.cameras.rgbd import KINECT_V2, Camera, CameraPose
from saver_envs.files import written_whole
from saver_envs.perception.rendered_scenes import (
    LabelledPicture,
    RenderedScene,
    RenderedSceneOptions,
)
from saver_envs.perception.skeleton import COCO_JOINTS, Visibility, from_coco, to_coco

#: Unit in which depth is stored (m).
_DEPTH_UNIT: Final = 1e-4
#: Number of pictures from one compiled scene.
FRAMES_PER_SCENE: Final = 20
#: Labels with one row for each person, and the filler for scenes with fewer people than others.
_FILLERS: Final = {"pixels": np.nan, "visibility": 0, "positions": np.nan, "boxes": 0.0}


@dataclass(frozen=True)
class Example:
    """A labelled picture for training.

    :param image: (height, width, 3) uint8.
    :param joints: (people, 14, 2) pixels.
    :param annotated: (people, 14) whether the position is known.
    :param boxes: (people, 4) left, top, right, bottom, pixels.
    """

    image: NDArray[np.uint8]
    joints: NDArray[np.float64]
    annotated: NDArray[np.bool_]
    boxes: NDArray[np.float64]


class PoseDataset(Protocol):
    """A sequence of examples."""

    def __len__(self) -> int:
        """Return the number of examples."""

    def __getitem__(self, index: int) -> Example:
        """Return an example."""


def differing_settings(path: Path, settings: dict[str, Any]) -> list[str]:
    """Compare settings with those that a file records, or record them in a new file.

    :param path: JSON file.
    :param settings: JSON-able.
    :return: names of the settings that differ from the file's, sorted.
    """
    settings = json.loads(json.dumps(settings))
    if not path.is_file():
        path.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
        return []
    recorded = json.loads(path.read_text(encoding="utf-8"))
    return sorted(name for name in settings if recorded.get(name) != settings[name])


def render(
    folder: Path,
    frames: int,
    seed: int,
    options: RenderedSceneOptions,
    camera: Camera = KINECT_V2,
    with_depth: bool = True,
    shard_size: int = 200,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Render the missing part of a data set into a folder.

    A shard depends only on ``seed`` and its number, so an interrupted run can continue.

    :param folder: created if it does not exist.
    :param frames: number of pictures, a multiple of ``shard_size``.
    :param seed: seed of the data set.
    :param options: contents of the scenes.
    :param camera: intrinsics.
    :param with_depth: store depth with the sensor's noise.
    :param shard_size: number of pictures in a file.
    :param progress: called with the number of pictures after each shard.
    :raises ValueError: if ``frames`` is no multiple of ``shard_size``, or if the folder holds
        pictures with other settings.
    """
    if frames <= 0 or frames % shard_size:
        raise ValueError(f"frames={frames!r}: must be a multiple of {shard_size}")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "description.json"
    description = {
        "seed": seed,
        "options": asdict(options),
        "camera": asdict(camera),
        "with_depth": with_depth,
        "shard_size": shard_size,
    }
    if differing_settings(path, description):
        raise ValueError(f"{folder} holds pictures that were rendered otherwise: see {path}")
    for shard in range(frames // shard_size):
        labels = folder / f"{shard:04d}.npz"
        if not labels.is_file():
            random = np.random.default_rng([seed, shard])
            pictures: list[LabelledPicture] = []
            while len(pictures) < shard_size:
                count = min(FRAMES_PER_SCENE, shard_size - len(pictures))
                with closing(RenderedScene(random, options, camera)) as scene:
                    pictures += [scene.frame(depth_noise=with_depth) for _ in range(count)]
            _write_shard(labels, pictures, with_depth)
        if progress is not None:
            progress(shard_size)


def _write_shard(path: Path, pictures: Sequence[LabelledPicture], with_depth: bool) -> None:
    most = max(len(one.pixels) for one in pictures)
    labels = {
        "people": np.array([len(one.pixels) for one in pictures]),
        "camera_position": np.stack([one.pose.position for one in pictures]),
        "camera_rotation": np.stack([one.pose.rotation for one in pictures]),
    }
    for name, filler in _FILLERS.items():
        values = [getattr(one, name) for one in pictures]
        shape = (len(values), most, *values[0].shape[1:])
        labels[name] = np.full(shape, filler, dtype=values[0].dtype)
        for row, value in zip(labels[name], values, strict=True):
            row[: len(value)] = value
    np.save(_picture_file(path, "rgb"), np.stack([one.rgb for one in pictures]))
    if with_depth:
        depth = np.stack([one.depth for one in pictures]) / _DEPTH_UNIT
        np.save(_picture_file(path, "depth"), np.rint(depth).astype(np.uint16))
    # The labels come last: a shard without labels is rendered again.
    with written_whole(path) as file:
        np.savez(file, allow_pickle=False, **labels)


def _picture_file(labels: Path, kind: str) -> Path:
    return labels.with_name(f"{labels.stem}-{kind}.npy")


class RenderedDataset:
    """Pictures from :func:`render`, which are read from the disk when they are used.

    :param folder: the folder that :func:`render` wrote.
    :raises FileNotFoundError: if the folder holds no rendered pictures.
    """

    def __init__(self, folder: Path) -> None:
        description = folder / "description.json"
        self._paths = sorted(folder.glob("[0-9]*.npz"))
        if not self._paths or not description.is_file():
            raise FileNotFoundError(f"{folder} holds no rendered pictures")
        camera = json.loads(description.read_text(encoding="utf-8"))["camera"]
        pairs = {name: tuple(camera[name]) for name in ("focal", "centre")}
        self.camera = Camera(**{**camera, **pairs})
        self._shards = []
        for path in self._paths:
            with np.load(path, allow_pickle=False) as content:
                self._shards.append(dict(content))
        self._size = len(self._shards[0]["people"])
        self._pictures: dict[Path, NDArray[Any]] = {}

    def __len__(self) -> int:
        return self._size * len(self._shards)

    def __getitem__(self, index: int) -> Example:
        """Return a picture; all joints in front of the camera are annotated, visible or not."""
        labels = self._labels(index)
        pixels = labels["pixels"]
        known = np.isfinite(pixels).all(axis=-1)
        return Example(self._picture(index, "rgb"), np.nan_to_num(pixels), known, labels["boxes"])

    def labelled(self, index: int) -> LabelledPicture:
        """Return a picture with its depth and all labels.

        :raises FileNotFoundError: if no depth was stored.
        """
        shard, row = self._place(index)
        content = self._shards[shard]
        return LabelledPicture(
            rgb=self._picture(index, "rgb"),
            depth=self._picture(index, "depth").astype(np.float32) * np.float32(_DEPTH_UNIT),
            pose=CameraPose(content["camera_position"][row], content["camera_rotation"][row]),
            **self._labels(index),
        )

    def visibility(self, index: int) -> NDArray[np.uint8]:
        """Return the visibility (people, 14) of the joints of a picture."""
        return self._labels(index)["visibility"]

    def _place(self, index: int) -> tuple[int, int]:
        if not 0 <= index < len(self):
            raise IndexError(f"index={index}: there are {len(self)} pictures")
        return divmod(index, self._size)

    def _labels(self, index: int) -> dict[str, NDArray[Any]]:
        shard, row = self._place(index)
        content = self._shards[shard]
        people = int(content["people"][row])
        return {name: content[name][row, :people] for name in _FILLERS}

    def _picture(self, index: int, kind: str) -> NDArray[Any]:
        shard, row = self._place(index)
        file = _picture_file(self._paths[shard], kind)
        if file not in self._pictures:
            self._pictures[file] = np.load(file, mmap_mode="r", allow_pickle=False)
        return self._pictures[file][row].copy()


def coco_annotations(dataset: RenderedDataset, count: int | None = None) -> dict[str, Any]:
    """Return key point annotations in COCO's format.

    :param dataset: rendered pictures.
    :param count: number of pictures, from the first; ``None``: all.
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
        for joints, seen, edges in zip(example.joints, visibility, example.boxes, strict=True):
            keypoints = to_coco(joints, seen)
            left, top, right, bottom = edges.tolist()
            box = [left, top, right - left, bottom - top]
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": index,
                    "category_id": 1,
                    "keypoints": [round(float(value), 2) for value in keypoints.ravel()],
                    "num_keypoints": int((keypoints[:, 2] > 0).sum()),
                    "bbox": box,
                    # An outline covers about half of its box, as in COCO.
                    "area": 0.53 * box[2] * box[3],
                    "iscrowd": 0,
                }
            )
    category = {"id": 1, "name": "person", "keypoints": list(COCO_JOINTS), "skeleton": []}
    return {"images": images, "annotations": annotations, "categories": [category]}


class CocoDataset:
    """Pictures with people of a COCO key point file, such as ``person_keypoints_train2017.json``.

    A joint without annotation is unknown, and so are all joints of a crowd: the loss does not count
    there (see :func:`~.fields.loss_mask`).

    :param annotations: the JSON file.
    :param images: folder of the pictures.
    :raises ValueError: if the file has no key points of people.
    """

    def __init__(self, annotations: Path, images: Path) -> None:
        content = json.loads(Path(annotations).read_text(encoding="utf-8"))
        people = [one for one in content.get("annotations", []) if "keypoints" in one]
        if not people or "images" not in content:
            raise ValueError(f"annotations={str(annotations)!r}: holds no key points of people")
        self._folder = Path(images)
        names = {one["id"]: one["file_name"] for one in content["images"]}
        grouped: defaultdict[int, list[dict[str, Any]]] = defaultdict(list)
        for one in people:
            grouped[one["image_id"]].append(one)
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
