"""Find the people in a picture or a video, and draw their skeletons."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from typing import Any, Final

from saver_advisors.cli.arguments import add, add_file, add_path, new_file, write_json
from saver_advisors.reporting.errors import UsageError, user_mistakes

EXAMPLES = """\
examples:
  saver pose photo.jpg                                   writes photo-poses.png
  saver pose bench.mp4 --out skeletons.mp4 --turn 2      a camera that sees people upside down
  saver pose photo.jpg --out arms.png --limbs left_forearm right_forearm
  saver pose photo.jpg --out skeletons.png --json joints.json"""

PICTURES: Final = (".png", ".jpg", ".jpeg", ".webp")
VIDEOS: Final = (".mp4", ".mov", ".avi", ".mkv", ".webm")
LOW_SCORE: Final = 0.4
"""Below it a person is uncertain: people in rendered test pictures have 0.5 or more, noise 0.2."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_path(parser, "input", "a picture or a video")
    text = "output with skeletons: a picture, or .mp4 for a video (default: next to the input, "
    add_file(parser, "--out", f"{text}NAME-poses.png or .mp4)", *PICTURES, ".mp4")
    add_weights(parser)
    add(parser, "--limbs", "limbs to detect (default: all 13)", nargs="+", metavar="NAME")
    text = "quarter turns, anticlockwise, that bring heads to the top"
    add(parser, "--turn", text, 0, type=int, choices=range(4))
    text = "write joints (pixels) and confidences of every frame to this file"
    add_file(parser, "--json", text, ".json")


def add_weights(parser: argparse.ArgumentParser) -> None:
    """Declare ``--weights``, the file of a pose network."""
    text = "weights of a network, .safetensors (default: the shipped weights)"
    add_path(parser, "--weights", text)


def run(args: argparse.Namespace) -> int:
    """Estimate poses, draw them, and write the files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """
    kind = args.input.suffix.lower()
    if kind not in PICTURES + VIDEOS:
        raise UsageError(
            f"argument FILE: {str(args.input)!r} must end in {', '.join(PICTURES + VIDEOS)}"
        )
    if not args.input.is_file():
        raise UsageError(f"argument FILE: {str(args.input)!r} does not exist")
    video = kind in VIDEOS
    if args.out is None:
        with user_mistakes("argument --out"):
            name = f"{args.input.stem}-poses{'.mp4' if video else '.png'}"
            args.out = new_file()(str(args.input.with_name(name)))
    if video != (args.out.suffix.lower() == ".mp4"):
        raise UsageError(
            f"argument --out: {str(args.out)!r} must be {'.mp4' if video else 'a picture'}"
        )
    estimator = _estimator(args)
    frames = _video(args, estimator) if video else [_picture(args, estimator)]
    people = sum(len(one["people"]) for one in frames)
    print(f"wrote {args.out}: {people} people in {len(frames)} frames")
    scores = [max((person["score"] for person in one["people"]), default=0.0) for one in frames]
    if (low := sum(score < LOW_SCORE for score in scores)) > len(scores) / 2:
        print(
            f"saver pose: warning: in {low} of {len(scores)} frames no person has a score of "
            f"{LOW_SCORE} or more (the best has {max(scores):.2f}): the joints are uncertain. If "
            "heads are not at the top, try --turn",
            file=sys.stderr,
        )
    if args.json is not None:
        from saver_envs.perception.skeleton import JOINTS

        write_json(args.json, {"kind": "poses", "joints": list(JOINTS), "frames": frames})
    return 0


def _estimator(args: argparse.Namespace) -> Any:
    from saver_envs.perception.estimator import PoseEstimator
    from saver_envs.perception.skeleton import limb_indices
    from saver_envs.perception.weights import SHIPPED

    with user_mistakes("argument --limbs"):
        limb_indices(args.limbs)
    with user_mistakes("argument --weights"):
        return PoseEstimator.from_file(args.weights or SHIPPED, args.limbs, turn=args.turn)


def _picture(args: argparse.Namespace, estimator: Any) -> dict[str, Any]:
    from PIL import Image

    from saver_envs.perception.drawing import draw_poses
    from saver_envs.perception.pictures import read_picture

    with user_mistakes("argument FILE"):
        image = read_picture(args.input)
    poses = estimator(image)
    Image.fromarray(draw_poses(image, poses)).save(args.out)
    return _as_json(poses)


def _video(args: argparse.Namespace, estimator: Any) -> list[dict[str, Any]]:
    import imageio_ffmpeg
    import numpy as np
    from tqdm import tqdm

    from saver_advisors.reporting.video import mp4_writer
    from saver_envs.perception.drawing import draw_poses

    reader = imageio_ffmpeg.read_frames(str(args.input), pix_fmt="rgb24")
    try:
        about = next(reader)
    except (OSError, RuntimeError, StopIteration) as error:
        text = " ".join(str(error).split())[-200:]
        raise UsageError(f"argument FILE: {args.input} is no readable video: {text}") from error
    width, height = about["size"]
    found = []
    total = round(about["fps"] * about["duration"]) or None
    with closing(mp4_writer(args.out, width, height, about["fps"])) as writer:
        for raw in tqdm(reader, total=total, unit="frame", dynamic_ncols=True):
            image = np.frombuffer(raw, np.uint8).reshape(height, width, 3)
            poses = estimator(image)
            writer.send(draw_poses(image, poses))
            found.append(_as_json(poses))
    return found


def _as_json(poses: Any) -> dict[str, Any]:
    """Return poses as JSON, with null for joints that were not found."""
    return {
        "people": [
            {
                "score": round(float(score), 4),
                "joints": [
                    [round(float(x), 2), round(float(y), 2)] if seen else None
                    for (x, y), seen in zip(joints, scores > 0, strict=True)
                ],
                "confidences": [round(float(one), 4) for one in scores],
            }
            for joints, scores, score in zip(
                poses.joints, poses.scores, poses.person_scores, strict=True
            )
        ]
    }
