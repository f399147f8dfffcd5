"""Rendered pictures and their labels; COCO files there and back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from saver_envs.cameras.rgbd import KINECT_V2
from saver_envs.people.postures import TEST_PATTERN, cell_split, random_appearance
from saver_envs.perception.augment import Augmentation, augment
from saver_envs.perception.dataset import (
    CocoDataset,
    Example,
    RenderedDataset,
    coco_annotations,
    render,
)
from saver_envs.perception.rendered_scenes import RenderedSceneOptions
from saver_envs.perception.skeleton import JOINTS, MIRRORED_JOINTS, NECK, Visibility


def test_labels_agree_with_depth(rendered: RenderedDataset) -> None:
    """At a visible joint the picture's depth is the joint's, less some flesh."""
    behind, hidden = [], 0
    for index in range(len(rendered)):
        labelled = rendered.labelled(index)
        _, distance = rendered.camera.project(labelled.positions, labelled.pose)
        for person, joint in np.argwhere(labelled.visibility == Visibility.VISIBLE):
            x, y = labelled.pixels[person, joint].astype(int)
            behind.append(distance[person, joint] - labelled.depth[y, x])
        hidden += int((labelled.visibility == Visibility.OCCLUDED).sum())
    assert len(behind) > 40
    assert 0.0 < np.median(behind) < 0.12
    assert np.mean(np.abs(behind) < 0.2) > 0.9  # at this size an edge may be a pixel off
    assert hidden > 0


def test_projection_of_labels_is_exact(rendered: RenderedDataset) -> None:
    labelled = rendered.labelled(0)
    pixels, _ = rendered.camera.project(labelled.positions, labelled.pose)
    assert np.abs(pixels - labelled.pixels).max() < 1e-9
    outside = (labelled.pixels < 0).any(axis=-1) | (labelled.pixels > (128, 106)).any(axis=-1)
    assert (labelled.visibility[outside] == Visibility.MISSING).all()
    assert (labelled.visibility[~outside] > Visibility.MISSING).all()


def test_heads_are_about_at_the_top(rendered: RenderedDataset) -> None:
    for index in range(len(rendered)):
        pixels = rendered.labelled(index).pixels[0]
        spine = pixels[NECK] - pixels[[8, 11]].mean(axis=0)
        assert spine[1] < 0


def test_the_same_seed_renders_the_same_and_a_run_goes_on(work_folder: Path) -> None:
    options = RenderedSceneOptions(people=1, arms=0.0)
    small = KINECT_V2.scaled(0.125)
    render(work_folder / "a", 2, 3, options, small, with_depth=False, shard_size=1)
    first = RenderedDataset(work_folder / "a")
    (work_folder / "a" / "0001.npz").unlink()  # as if it had been interrupted
    kept = (work_folder / "a" / "0000.npz").stat().st_mtime_ns
    render(work_folder / "a", 2, 3, options, small, with_depth=False, shard_size=1)
    again = RenderedDataset(work_folder / "a")
    assert (work_folder / "a" / "0000.npz").stat().st_mtime_ns == kept
    assert np.array_equal(first[1].joints, again[1].joints)
    assert not np.array_equal(again[0].joints, again[1].joints)
    with pytest.raises(ValueError, match="rendered otherwise"):
        render(work_folder / "a", 2, 4, options, small, with_depth=False, shard_size=1)
    with pytest.raises(ValueError, match="frames=3: must be a multiple of 2"):
        render(work_folder / "b", 3, 3, options, small, shard_size=2)
    with pytest.raises(FileNotFoundError, match="holds no rendered pictures"):
        RenderedDataset(work_folder)
    with pytest.raises(IndexError, match="there are 2"):
        again[2]


@pytest.fixture
def work_folder(tmp_path: Path) -> Path:
    return tmp_path


def test_splits_share_no_body_and_no_test_pattern() -> None:
    random = np.random.default_rng(0)
    for split in ("train", "validation", "test"):
        people = [random_appearance(random, split) for _ in range(60)]
        assert {cell_split(one.gender, one.heaviness) for one in people} == {split}
        patterns = {one.shirt_pattern for one in people}
        assert (TEST_PATTERN in patterns) == (split == "test")


def test_coco_there_and_back(rendered: RenderedDataset, tmp_path: Path) -> None:
    content = coco_annotations(rendered)
    path = tmp_path / "people.json"
    path.write_text(json.dumps(content))
    for image in content["images"]:
        Image.fromarray(rendered[image["id"]].image).save(tmp_path / image["file_name"])
    loaded = CocoDataset(path, tmp_path)
    assert len(loaded) == len(rendered)
    body = [joint for joint, name in enumerate(JOINTS) if name != "neck"]
    for index in range(len(loaded)):
        mine, seen = rendered[index], rendered.visibility(index) > 0
        given = loaded[index]
        assert np.array_equal(given.image, mine.image)
        assert np.array_equal(given.annotated[:, body], seen[:, body])
        both = given.annotated.copy()
        both[:, NECK] = False
        assert np.abs(given.joints - mine.joints)[both].max() < 0.01
        assert np.abs(given.boxes - mine.boxes).max() < 1e-6


def test_real_coco_files_with_crowds_and_nobody_load(tmp_path: Path) -> None:
    Image.new("L", (64, 48), 90).save(tmp_path / "grey.jpg")
    person = {"image_id": 7, "category_id": 1, "bbox": [4, 5, 20, 30], "iscrowd": 0, "id": 1}
    crowd = {**person, "id": 2, "iscrowd": 1, "keypoints": [0] * 51, "num_keypoints": 0}
    known = [10, 10, 2] * 17
    content = {
        "images": [{"id": 7, "file_name": "grey.jpg"}, {"id": 8, "file_name": "missing.jpg"}],
        "annotations": [{**person, "keypoints": known}, crowd],
    }
    (tmp_path / "a.json").write_text(json.dumps(content))
    example = CocoDataset(tmp_path / "a.json", tmp_path)[0]
    assert example.image.shape == (48, 64, 3)
    assert example.annotated.sum(axis=1).tolist() == [14, 0]
    assert example.boxes[0].tolist() == [4, 5, 24, 35]
    (tmp_path / "b.json").write_text(json.dumps({"images": [], "annotations": [person]}))
    with pytest.raises(ValueError, match="holds no key points of people"):
        CocoDataset(tmp_path / "b.json", tmp_path)


def dot_example() -> Example:
    """A dark picture with a bright dot at each of some joints."""
    joints = np.array([[(20.0 + 6 * k, 15.0 + 4 * k) for k in range(14)]])
    image = np.zeros((90, 120, 3), dtype=np.uint8)
    for x, y in joints[0]:
        image[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2] = 255
    return Example(image, joints, np.ones((1, 14), bool), np.array([[10.0, 10.0, 110.0, 80.0]]))


@pytest.mark.parametrize("mirror", [0.0, 1.0])
def test_labels_move_with_the_picture(mirror: float) -> None:
    example = dot_example()
    plain = Augmentation(blur=0.3, noise=0.0, patches=0.0, mirror=mirror)
    random = np.random.default_rng(4)
    bright = []
    for _ in range(8):
        moved = augment(example, (216, 256), random, plain)
        inside = ((moved.joints > 3) & (moved.joints < (253, 213))).all(axis=-1)[0]
        values = moved.image.astype(float)
        for x, y in moved.joints[0][inside].astype(int):
            near = values[y - 1 : y + 2, x - 1 : x + 2].mean()
            bright.append(near > np.median(values[..., 0]) + 20)
    assert np.mean(bright) > 0.95
    turned = moved.joints[0][MIRRORED_JOINTS] if mirror else moved.joints[0]
    # Steps along the line of dots stay equal, whatever the turn and scale.
    steps = np.diff(turned, axis=0)
    assert np.abs(steps - steps[0]).max() < 1e-6


def test_fitting_keeps_proportions() -> None:
    still = Augmentation(rotation=0.0, scale=(1.0, 1.0), shift=0.0, mirror=0.0)
    fitted = augment(dot_example(), (216, 256), np.random.default_rng(0), still)
    scale = 256 / 120
    assert fitted.joints[0, 0] == pytest.approx([20 * scale, (15 - 45) * scale + 108])
    assert fitted.image.shape == (216, 256, 3)


def test_bad_options_are_named() -> None:
    with pytest.raises(ValueError, match="heaviness"):
        replace(random_appearance(np.random.default_rng(0)), heaviness=-1.0)
