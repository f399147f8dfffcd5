"""Draw pictures of the pose networks: ``python -m tools.pose_pictures`` in the repository's root.

Writes into ``docs/images/perception``:

- ``photographs.jpg``, two photographs that scikit-image ships: left the network of ours, right
  BlazePose;
- ``test.jpg``, held-out rendered pictures;
- ``bench.mp4``, a person on the bench whose arm is pushed, for ``saver pose``.

Needs scikit-image, and BlazePose as ``saver benchmark pose --peers`` installs it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mujoco
import numpy as np
from PIL import Image

from saver_advisors.benchmark.pose.accuracy import test_set
from saver_advisors.benchmark.pose.blazepose import BlazePose
from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, RgbdCamera
from saver_envs.files import cache_folder
from saver_envs.people.manikin import add_manikin
from saver_envs.people.stretcher import add_stretcher
from saver_envs.perception.drawing import draw_poses
from saver_envs.perception.estimator import PoseEstimator
from saver_envs.perception.parsing import Poses
from saver_envs.perception.weights import SHIPPED

OUTPUT = Path("docs/images/perception")
COLUMNS, ROWS = 4, 3
SECONDS, FPS = 6.0, 15
PUSH = (0.0, -28.0, 0.0)  # N, on the left hand, for the middle third of the video


def main() -> None:
    """Write the pictures and the video."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0] if __doc__ else None)
    parser.add_argument("--weights", type=Path, default=SHIPPED)
    parser.add_argument("--peer-cache", type=Path, default=cache_folder("peers"))
    parser.add_argument("--cache", type=Path, default=cache_folder("pose"))
    args = parser.parse_args()
    OUTPUT.mkdir(parents=True, exist_ok=True)
    estimator = PoseEstimator.from_file(args.weights)
    with BlazePose("heavy", args.peer_cache) as peer:
        _photographs(estimator, peer).save(OUTPUT / "photographs.jpg", quality=88)
    _test_pictures(estimator, args.cache).save(OUTPUT / "test.jpg", quality=85)
    _video(OUTPUT / "bench.mp4")


def _photographs(estimator: PoseEstimator, peer: BlazePose) -> Image.Image:
    from skimage import data

    rows = []
    for photo in (data.astronaut(), np.repeat(data.camera()[..., None], 3, axis=2)):
        joints, _ = peer(photo[None])
        theirs = Poses.none()
        if not np.isnan(joints).any():
            theirs = Poses(joints[..., :2], np.ones((1, joints.shape[1])), np.ones(1))
        pair = (draw_poses(photo, estimator(photo)), draw_poses(photo, theirs))
        rows.append(np.concatenate(pair, axis=1))
    return Image.fromarray(np.concatenate(rows))


def _test_pictures(estimator: PoseEstimator, cache: Path) -> Image.Image:
    data = test_set("test", 100, cache)
    chosen = np.linspace(0, 99, COLUMNS * ROWS).astype(int)
    tiles = [draw_poses(data[int(k)].image, estimator(data[int(k)].image)) for k in chosen]
    lines = [np.concatenate(tiles[k : k + COLUMNS], axis=1) for k in range(0, len(tiles), COLUMNS)]
    whole = Image.fromarray(np.concatenate(lines))
    return whole.resize((whole.width // 2, whole.height // 2), Image.Resampling.LANCZOS)


def _video(path: Path) -> None:
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.visual.headlight.ambient = (0.35, 0.35, 0.35)
    spec.worldbody.add_light(pos=(0.3, 0.5, 2.5), dir=(0, -0.15, -1), diffuse=(0.6, 0.6, 0.6))
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(3, 3, 0.1), rgba=(0.75, 0.72, 0.66, 1)
    )
    add_manikin(spec, position=(0.35, 0.0, 0.0))
    add_stretcher(spec, position=(0.35, 0.0, 0.0))
    KINECT_V2.add_to(spec, "kinect", BENCH_POSE)
    model = spec.compile()
    data = mujoco.MjData(model)
    hand = model.body("left_hand").id
    camera = RgbdCamera(model, "kinect")
    mujoco.mj_step(model, data, 1000)
    writer: Any = imageio_ffmpeg.write_frames(
        str(path), (KINECT_V2.width, KINECT_V2.height), fps=FPS, macro_block_size=2
    )
    writer.send(None)
    for frame in range(int(SECONDS * FPS)):
        pushed = 1 / 3 <= frame / (SECONDS * FPS) < 2 / 3
        data.xfrc_applied[hand, :3] = PUSH if pushed else 0.0
        mujoco.mj_step(model, data, round(1 / FPS / model.opt.timestep))
        mujoco.mj_forward(model, data)
        writer.send(np.ascontiguousarray(camera.capture(data)[0]))
    writer.close()
    camera.close()


if __name__ == "__main__":
    main()
