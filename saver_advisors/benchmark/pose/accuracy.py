"""How well people are found in rendered test pictures: by a network of ours, by BlazePose."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
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

#: Pictures of every set: what is special about it, and the seed. People and patterns are held out.
SETS: Final = {
    "test": (RenderedSceneOptions(split="test", people=1, arms=1.0, shadow_share=0.3), 11),
    "occluded": (RenderedSceneOptions(split="test", people=1, arms=1.0, occluding=True), 12),
    "low_light": (RenderedSceneOptions(split="test", people=1, arms=1.0, low_light=True), 13),
    "two_people": (RenderedSceneOptions(split="test", people=2, arms=1.0), 14),
}
#: From which the depth from surface to centre is measured: other people than the test's.
CALIBRATION: Final = (RenderedSceneOptions(split="validation", people=1, arms=0.0), 15)
SHARD: Final = 20
WRISTS_AND_HIPS: Final = tuple(
    number for number, name in enumerate(JOINTS) if name.endswith(("wrist", "hip"))
)


def test_set(name: str, frames: int, cache: Path) -> RenderedDataset:
    """Return a set of pictures, rendered where it is not there yet.

    :param name: a key of :data:`SETS`, or ``calibration``
    :param frames: multiple of 20
    :param cache: folder
    """
    from tqdm import tqdm

    options, seed = CALIBRATION if name == "calibration" else SETS[name]
    folder = cache / f"{name}-{seed}"
    with tqdm(total=frames, desc=f"render {name}", unit="frame", dynamic_ncols=True) as bar:
        render(folder, frames, seed, options, shard_size=SHARD, progress=bar.update)
    return RenderedDataset(folder)


@dataclass(frozen=True)
class Estimates:
    """What a model said about the pictures of a set, one entry a picture."""

    poses: list[Poses]
    seconds: float


def of_network(estimator: Any, data: RenderedDataset, frames: int) -> Estimates:
    """Run a network of ours on the pictures, one by one.

    :param estimator: a :class:`~saver_envs.perception.estimator.PoseEstimator`
    :param data: pictures
    :param frames: of the first so many
    """
    import time

    pictures = [data[index].image for index in range(frames)]
    estimator(pictures[0])
    began = time.perf_counter()
    poses = [estimator(picture) for picture in pictures]
    return Estimates(poses, (time.perf_counter() - began) / frames)


def of_blazepose(model: Any, data: RenderedDataset, frames: int) -> Estimates:
    """Run BlazePose, which names every joint of the one person it sees, on the same pictures.

    :param model: a running :class:`~saver_advisors.benchmark.pose.blazepose.BlazePose`
    :param data: pictures
    :param frames: of the first so many
    """
    joints, seconds = model(np.stack([data[index].image for index in range(frames)]))
    poses = []
    for one in joints:
        if np.isnan(one).any():
            poses.append(Poses.none())
        else:
            # Its visibility says whether a joint is hidden; all of them count as found.
            scores = np.maximum(one[None, :, 2], 0.01)
            poses.append(Poses(one[None, :, :2], scores, scores.mean(axis=1)))
    return Estimates(poses, seconds)


def accuracy(estimates: Estimates, data: RenderedDataset) -> dict[str, Any]:
    """Return the figures of a model on a set.

    :param estimates: of the first pictures
    :param data: the set
    :return: JSON-able: ``pck_0.2``, ``error_px`` at 512 x 424, ``error_mm`` (median of wrists and
        hips, an undetected one counting as infinite; None where half are), ``oks_ap`` and more
    """
    errors, in_space = [], []
    for index, poses in enumerate(estimates.poses):
        labelled = data.labelled(index)
        found = joint_errors(poses, labelled.pixels, labelled.visibility)
        errors.append(found)
        in_space.append(_errors_in_space(poses, labelled, found.estimate, data))
    summary = summarise(errors)
    apart = np.concatenate(in_space)
    by_joint = {name: _millimetres(apart[:, number]) for number, name in enumerate(JOINTS)}
    return {
        "pck_0.2": summary.pck,
        "error_px": summary.mean_pixels,
        "error_mm": _millimetres(apart[:, WRISTS_AND_HIPS]),
        "wrist_error_mm": _millimetres(apart[:, [JOINTS.index(f"{s}_wrist") for s in _SIDES]]),
        "hip_error_mm": _millimetres(apart[:, [JOINTS.index(f"{s}_hip") for s in _SIDES]]),
        "detected": summary.detected,
        "visible_joints": summary.joints,
        "oks_ap": oks_ap(estimates.poses, data),
        "frames": len(estimates.poses),
        "frames_per_second": 1.0 / estimates.seconds,
        "pck_0.2_by_joint": dict(zip(JOINTS, map(_finite, summary.pck_by_joint), strict=True)),
        "error_mm_by_joint": by_joint,
    }


_SIDES: Final = ("left", "right")


def _errors_in_space(
    poses: Poses, labelled: Any, estimate: NDArray[np.intp], data: RenderedDataset
) -> NDArray[np.float64]:
    """Return errors (people, 14) of visible joints in metres, NaN for hidden ones."""
    apart = np.full(labelled.visibility.shape, np.inf)
    space = lift(poses, labelled.depth, data.camera, labelled.pose)
    for person, match in enumerate(estimate):
        if match >= 0:
            distance = np.linalg.norm(space.positions[match] - labelled.positions[person], axis=-1)
            apart[person] = np.where(np.isfinite(distance), distance, np.inf)
    return np.where(labelled.visibility == Visibility.VISIBLE, apart, np.nan)


def _millimetres(apart: NDArray[np.float64]) -> float | None:
    seen = apart[~np.isnan(apart)]
    return _finite(1e3 * float(np.median(seen))) if len(seen) else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def depth_to_centre(data: RenderedDataset) -> dict[str, Any]:
    """Return how far behind the visible surface joints' centres lie, and what the library uses.

    :param data: labelled pictures with depth
    :return: JSON-able, millimetres
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

    :param poses: of the first pictures
    :param data: the set
    """
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO()
        truth.dataset = coco_annotations(data, len(poses))
        for one in truth.dataset["annotations"]:
            # Only joints that can be seen are looked for, as in the other figures.
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
