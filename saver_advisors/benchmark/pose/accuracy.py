"""Measure the accuracy of our network and of BlazePose on rendered test pictures."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.perception.dataset import RenderedDataset, coco_annotations, render
from saver_envs.perception.lifting import DEPTH_TO_CENTRE, depth_at, lift
from saver_envs.perception.metrics import joint_errors, summarise
from saver_envs.perception.parsing import Poses
from saver_envs.perception.rendered_scenes import RenderedSceneOptions
from saver_envs.perception.skeleton import JOINTS, Visibility, to_coco

#: Scenes and seed of each set. People and patterns are held out.
SETS: Final = {
    "test": (RenderedSceneOptions(split="test", people=1, arms=1.0, shadow_share=0.3), 11),
    "occluded": (RenderedSceneOptions(split="test", people=1, arms=1.0, occluding=True), 12),
    "low_light": (RenderedSceneOptions(split="test", people=1, arms=1.0, low_light=True), 13),
    "two_people": (RenderedSceneOptions(split="test", people=2, arms=1.0), 14),
}
#: Scenes and seed for the depth from surface to centre, with people outside the test sets.
CALIBRATION: Final = (RenderedSceneOptions(split="validation", people=1, arms=0.0), 15)
SHARD: Final = 20
#: A model's poses of each picture, and its seconds per picture.
Estimates = tuple[list[Poses], float]


def test_set(name: str, frames: int, cache: Path) -> RenderedDataset:
    """Return a set of pictures, rendering those that are missing.

    :param name: a key of :data:`SETS`, or ``calibration``.
    :param frames: number of pictures, a multiple of 20.
    :param cache: folder of all sets.
    """
    from tqdm import tqdm

    options, seed = CALIBRATION if name == "calibration" else SETS[name]
    folder = cache / f"{name}-{seed}"
    with tqdm(total=frames, desc=f"render {name}", unit="frame", dynamic_ncols=True) as bar:
        render(folder, frames, seed, options, shard_size=SHARD, progress=bar.update)
    return RenderedDataset(folder)


def of_network(estimator: Any, data: RenderedDataset, frames: int) -> Estimates:
    """Run our network on the pictures, one by one.

    :param estimator: a :class:`~saver_envs.perception.estimator.PoseEstimator`.
    :param data: pictures.
    :param frames: number of pictures, from the first.
    """
    pictures = [data[index].image for index in range(frames)]
    estimator(pictures[0])
    began = time.perf_counter()
    poses = [estimator(picture) for picture in pictures]
    return poses, (time.perf_counter() - began) / frames


def of_blazepose(model: Any, data: RenderedDataset, frames: int) -> Estimates:
    """Run BlazePose, which reports all joints of at most one person, on the pictures.

    :param model: a running :class:`~saver_advisors.benchmark.pose.blazepose.BlazePose`.
    :param data: pictures.
    :param frames: number of pictures, from the first.
    """
    joints, seconds = model(np.stack([data[index].image for index in range(frames)]))
    poses = []
    for one in joints:
        if np.isnan(one).any():
            poses.append(Poses.none())
        else:
            # A low visibility means a hidden joint, which still counts as found.
            scores = np.maximum(one[None, :, 2], 0.01)
            poses.append(Poses(one[None, :, :2], scores, scores.mean(axis=1)))
    return poses, seconds


def accuracy(estimates: Estimates, data: RenderedDataset) -> dict[str, Any]:
    """Return the figures of a model on a set.

    :param estimates: of the first pictures.
    :param data: the set.
    :return: JSON-able: ``pck_0.2``, ``error_px`` at 512 x 424, ``error_mm`` (median over wrists and
        hips; an undetected joint counts as infinite, and the median is None if half are
        undetected), ``oks_ap`` and more.
    """
    all_poses, seconds = estimates
    errors, in_space = [], []
    for index, poses in enumerate(all_poses):
        labelled = data.labelled(index)
        found = joint_errors(poses, labelled.pixels, labelled.visibility)
        errors.append(found)
        in_space.append(_errors_in_space(poses, labelled, found.estimate, data))
    summary = summarise(errors)
    apart = np.concatenate(in_space)

    def millimetres(*endings: str) -> float | None:
        chosen = apart[:, [name.endswith(endings) for name in JOINTS]]
        seen = chosen[~np.isnan(chosen)]
        return _finite(1e3 * float(np.median(seen))) if len(seen) else None

    return {
        "pck_0.2": summary.pck,
        "error_px": summary.mean_pixels,
        "error_mm": millimetres("wrist", "hip"),
        "wrist_error_mm": millimetres("wrist"),
        "hip_error_mm": millimetres("hip"),
        "detected": summary.detected,
        "visible_joints": summary.joints,
        "oks_ap": oks_ap(all_poses, data),
        "frames": len(all_poses),
        "frames_per_second": 1.0 / seconds,
        "pck_0.2_by_joint": dict(zip(JOINTS, map(_finite, summary.pck_by_joint), strict=True)),
        "error_mm_by_joint": {name: millimetres(name) for name in JOINTS},
    }


def _errors_in_space(
    poses: Poses, labelled: Any, estimate: NDArray[np.intp], data: RenderedDataset
) -> NDArray[np.float64]:
    """Return errors (people, 14) of visible joints in metres, NaN for hidden joints."""
    apart = np.full(labelled.visibility.shape, np.inf)
    space = lift(poses, labelled.depth, data.camera, labelled.pose)
    for person, match in enumerate(estimate):
        if match >= 0:
            distance = np.linalg.norm(space.positions[match] - labelled.positions[person], axis=-1)
            apart[person] = np.where(np.isfinite(distance), distance, np.inf)
    return np.where(labelled.visibility == Visibility.VISIBLE, apart, np.nan)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def depth_to_centre(data: RenderedDataset) -> dict[str, Any]:
    """Return the depth of the joints' centres behind the surface, measured and in use.

    :param data: labelled pictures with depth.
    :return: JSON-able, millimetres.
    """
    behind: list[list[float]] = [[] for _ in JOINTS]
    for index in range(len(data)):
        labelled = data.labelled(index)
        surface = depth_at(labelled.depth, labelled.pixels)
        _, distance = data.camera.project(labelled.positions, labelled.pose)
        seen = (labelled.visibility == Visibility.VISIBLE) & (surface > 0)
        for person, joint in np.argwhere(seen):
            behind[joint].append(float(distance[person, joint] - surface[person, joint]))
    return {
        name: {"median_mm": 1e3 * float(np.median(found)) if found else None, "used_mm": 1e3 * used}
        for name, found, used in zip(JOINTS, behind, DEPTH_TO_CENTRE.tolist(), strict=True)
    }


def oks_ap(poses: Sequence[Poses], data: RenderedDataset) -> float:
    """Return the average precision over object key point similarity, as COCO defines it.

    :param poses: of the first pictures.
    :param data: the set.
    """
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO()
        truth.dataset = coco_annotations(data, len(poses))
        for one in truth.dataset["annotations"]:
            # Only visible joints count, as in the other figures.
            keypoints = np.array(one["keypoints"]).reshape(-1, 3)
            keypoints[keypoints[:, 2] < Visibility.VISIBLE] = 0
            one["keypoints"] = keypoints.ravel().tolist()
            one["num_keypoints"] = int((keypoints[:, 2] > 0).sum())
        truth.createIndex()
        detections = [
            {
                "image_id": index,
                "category_id": 1,
                "keypoints": to_coco(found.joints[person], found.scores[person]).ravel().tolist(),
                "score": float(found.person_scores[person]),
            }
            for index, found in enumerate(poses)
            for person in range(len(found))
        ]
        if not detections:
            return 0.0
        evaluation = COCOeval(truth, truth.loadRes(detections), "keypoints")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return float(evaluation.stats[0])
