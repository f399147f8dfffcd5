"""Run BlazePose's models in their own virtual environment.

This program imports nothing of SAVER. Usage: ``python blazepose_worker.py FOLDER VARIANT`` with the
folder of the ``.tflite`` files. It prints ``{"ready": ...}`` and then reads lines ``IN.npy
OUT.npy``. For each line it reads pictures (n, h, w, 3) uint8, writes (n, 33, 3) pixels and
visibilities, NaN where nobody was detected, and prints a line of JSON with the seconds per picture.

The steps are those of the authors' pipeline for single pictures: a detector on the whole picture
gives the middle of the hips and a point for size and orientation of the person; the landmark model
receives the square that follows from them.
"""

from __future__ import annotations

import importlib
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

DETECTOR_SIZE, LANDMARK_SIZE, LANDMARKS = 224, 256, 33
#: Cells of the detector's maps: (stride, anchors in a cell).
MAPS = ((8, 2), (16, 2), (32, 6))
#: Side of the square relative to the circle around the person.
MARGIN = 1.25
PRESENT = 0.5


class Blaze:
    """Detector and landmark model.

    :param folder: folder of the models.
    :param variant: ``lite``, ``full`` or ``heavy``.
    """

    def __init__(self, folder: Path, variant: str) -> None:
        self.image: Any = importlib.import_module("PIL.Image")
        interpreter: Any = importlib.import_module("ai_edge_litert.interpreter").Interpreter

        def load(path: Path) -> Any:
            model = interpreter(model_content=path.read_bytes(), num_threads=1)
            model.allocate_tensors()
            return model

        self.detector = load(folder / "pose_detection.tflite")
        self.landmark = load(folder / f"pose_landmark_{variant}.tflite")
        self.anchors = np.array(
            [
                ((column + 0.5) * stride, (row + 0.5) * stride)
                for stride, count in MAPS
                for row in range(DETECTOR_SIZE // stride)
                for column in range(DETECTOR_SIZE // stride)
                for _ in range(count)
            ]
        )

    def detect(self, picture: Any) -> tuple[float, Any]:
        """Return the score of the best detection and its two points in pixels of the picture."""
        height, width = picture.shape[:2]
        side = max(height, width)
        canvas = np.zeros((side, side, 3), np.uint8)
        left, top = (side - width) // 2, (side - height) // 2
        canvas[top : top + height, left : left + width] = picture
        small = self.image.fromarray(canvas).resize((DETECTOR_SIZE, DETECTOR_SIZE), 2)
        given = np.asarray(small, np.float32)[None] / 127.5 - 1
        self.detector.set_tensor(self.detector.get_input_details()[0]["index"], given)
        self.detector.invoke()
        boxes, scores = (
            self.detector.get_tensor(one["index"])[0]
            for one in sorted(self.detector.get_output_details(), key=lambda d: -d["shape"][-1])
        )
        best = int(scores[:, 0].argmax())
        score = 1 / (1 + math.exp(-float(np.clip(scores[best, 0], -50, 50))))
        points = boxes[best, 4:8].reshape(2, 2) + self.anchors[best]
        return score, points * side / DETECTOR_SIZE - (left, top)

    def __call__(self, picture: Any) -> Any:
        """Return landmarks (33, 3): x, y in pixels and visibility; NaN without a person."""
        nobody = np.full((LANDMARKS, 3), np.nan)
        score, (hips, outer) = self.detect(picture)
        if score < PRESENT:
            return nobody
        up = outer - hips
        half = MARGIN * float(np.linalg.norm(up))
        if half < 1:
            return nobody
        # The crop's axes in the picture, one pixel of the crop long.
        down = -up / np.linalg.norm(up) * (2 * half / LANDMARK_SIZE)
        right = np.array([down[1], -down[0]])
        axes = np.stack([right, down], axis=1)
        corner = hips - axes @ np.full(2, LANDMARK_SIZE / 2)
        coefficients = np.column_stack([axes, corner]).ravel()
        crop = self.image.fromarray(picture).transform(
            (LANDMARK_SIZE, LANDMARK_SIZE), 0, tuple(coefficients), 2
        )
        model = self.landmark
        model.set_tensor(
            model.get_input_details()[0]["index"], np.asarray(crop, np.float32)[None] / 255
        )
        model.invoke()
        out = {one["name"]: model.get_tensor(one["index"]) for one in model.get_output_details()}
        if float(out["Identity_1"].ravel()[0]) < PRESENT:
            return nobody
        found = out["Identity"].reshape(-1, 5)[:LANDMARKS]
        seen = 1 / (1 + np.exp(-np.clip(found[:, 3], -50, 50)))
        return np.column_stack([found[:, :2] @ axes.T + corner, seen])


def main(folder: str, variant: str) -> None:
    """Process lines until the input ends."""
    model = Blaze(Path(folder), variant)
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        source, target = line.split()
        pictures = np.load(source, allow_pickle=False)
        began = time.perf_counter()
        found = np.stack([model(picture) for picture in pictures])
        seconds = (time.perf_counter() - began) / len(pictures)
        np.save(target, found)
        print(json.dumps({"seconds": seconds}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
