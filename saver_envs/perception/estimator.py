"""Find the people in pictures with a pose network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from saver_envs.perception.backbones import DEVIATION, MEAN
from saver_envs.perception.fields import AFFINITY_X, STRIDE
from saver_envs.perception.network import PoseNetwork
from saver_envs.perception.parsing import DEFAULT_PARSING, ParsingOptions, Poses, parse
from saver_envs.perception.skeleton import LIMB_NAMES, MIRRORED_LIMBS
from saver_envs.perception.weights import SHIPPED, load_network

#: Height and width that pictures are fitted into for the network.
NETWORK_SIZE: Final = (216, 256)
#: From normalised pictures (n, 3, h, w) to the last stage's fields (n, limbs, 3, h/8, w/8).
RunNetwork = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class PoseEstimator:
    """Finds the people in pictures.

    :param network: trained.
    :param size: height and width, multiples of 8, that pictures are fitted into.
    :param turn: quarter turns, anticlockwise, that bring heads roughly to the top: 2 for the camera
        over the bench, which sees people upside down.
    :param options: of the parsing.
    :param mirror: evaluate the mirrored picture too and average both: better, at twice the cost.
        Needs the mirror image of every limb of the network.
    :param run: replaces the network's own forward pass, such as :class:`~.onnx.OnnxNetwork`.
    :raises ValueError: for a size that is no multiple of 8, or with ``mirror`` for limbs without
        their mirror images.
    """

    def __init__(
        self,
        network: PoseNetwork,
        size: tuple[int, int] = NETWORK_SIZE,
        turn: int = 0,
        options: ParsingOptions = DEFAULT_PARSING,
        mirror: bool = False,
        run: RunNetwork | None = None,
    ) -> None:
        if size[0] % STRIDE or size[1] % STRIDE or min(size) <= 0:
            raise ValueError(f"size={size!r}: height and width must be multiples of {STRIDE}")
        self.network = network.eval()
        self.limbs = network.limb_indices
        self.size = size
        self.turn = turn % 4
        self.options = options
        self._mirrored = _mirrored_rows(self.limbs) if mirror else None
        self._run = run or self._torch

    @staticmethod
    def shipped(limbs: list[str] | None = None, **options: Any) -> PoseEstimator:
        """Return an estimator with the shipped weights; see :meth:`from_file`."""
        return PoseEstimator.from_file(SHIPPED, limbs, **options)

    @staticmethod
    def from_file(path: Path, limbs: list[str] | None = None, **options: Any) -> PoseEstimator:
        """Return an estimator with the weights of a file.

        :param path: see :func:`~.weights.load_network`.
        :param limbs: names; ``None``: all limbs of the file.
        :param options: see :class:`PoseEstimator`.
        """
        return PoseEstimator(load_network(path, limbs), **options)

    def __call__(self, image: NDArray[Any]) -> Poses:
        """Find the people in a picture.

        :param image: (height, width, 3) uint8 of any size, or floats in [0, 1].
        :return: the people, in pixels of the picture.
        :raises ValueError: for another shape or type.
        """
        pixels = checked(image)
        height, width = pixels.shape[:2]
        picture, scale, offset = normalised(np.rot90(pixels, self.turn), self.size)
        poses = parse(self.fields(picture), self.limbs, self.options)
        joints = _turned_back((poses.joints - offset) / scale, self.turn, height, width)
        # Joints in the margins around the picture are dropped.
        inside = np.all((joints >= 0) & (joints <= (width, height)), axis=-1)
        joints = np.where(inside[..., None], joints, np.nan)
        return Poses(joints, np.where(inside, poses.scores, 0.0), poses.person_scores)

    def fields(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network.

        :param picture: (3, h, w) from :func:`normalised`.
        :return: (limbs, 3, h / 8, w / 8).
        """
        if self._mirrored is None:
            return self._run(picture[None])[0]
        plain, mirrored = self._run(np.stack([picture, picture[:, :, ::-1]]))
        back = mirrored[self._mirrored, :, :, ::-1].copy()
        back[:, AFFINITY_X] *= -1
        return 0.5 * (plain + back)

    def _torch(self, pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            fields: Tensor = self.network(torch.from_numpy(pictures).to(device))[1]
        return fields.float().cpu().numpy()


def _mirrored_rows(limbs: Sequence[int]) -> list[int]:
    """Return the row of each limb's mirror image in ``limbs``.

    :raises ValueError: for missing mirror images; the message names them.
    """
    wanted = [int(MIRRORED_LIMBS[limb]) for limb in limbs]
    missing = [LIMB_NAMES[limb] for limb in wanted if limb not in limbs]
    if missing:
        raise ValueError(f"mirror=True: needs the limbs {', '.join(missing)} as well")
    return [limbs.index(limb) for limb in wanted]


def checked(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a picture as (height, width, 3) uint8.

    :param image: (height, width, 3) uint8, or floats in [0, 1].
    :raises ValueError: for another shape or type; the message names it.
    """
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"image of shape {image.shape}: must be (height, width, 3)")
    if image.dtype == np.uint8:
        return image
    if not np.issubdtype(image.dtype, np.floating):
        raise ValueError(f"image of type {image.dtype}: must be uint8, or floats in [0, 1]")
    values = np.nan_to_num(image, nan=0.0, posinf=1.0, neginf=0.0)
    return np.rint(255 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def normalised(
    pixels: NDArray[np.uint8], size: tuple[int, int]
) -> tuple[NDArray[np.float32], float, NDArray[np.float64]]:
    """Fit a picture into the middle of ``size`` and normalise its colours.

    :param pixels: (height, width, 3).
    :param size: new height and width.
    :return: (3, new height, new width), the scale, and the new place (x, y) of the top left corner.
    """
    from PIL import Image

    height, width = pixels.shape[:2]
    scale = min(size[0] / height, size[1] / width)
    new = (max(1, round(width * scale)), max(1, round(height * scale)))
    if new != (width, height):
        picture = Image.fromarray(np.ascontiguousarray(pixels))
        pixels = np.asarray(picture.resize(new, Image.Resampling.BILINEAR))
    left, top = (size[1] - new[0]) // 2, (size[0] - new[1]) // 2
    canvas = np.zeros((3, *size), dtype=np.float32)
    values = pixels.transpose(2, 0, 1).astype(np.float32) / 255.0
    mean, deviation = (np.array(part, np.float32)[:, None, None] for part in (MEAN, DEVIATION))
    canvas[:, top : top + new[1], left : left + new[0]] = (values - mean) / deviation
    return canvas, scale, np.array([left, top], dtype=np.float64)


def _turned_back(
    joints: NDArray[np.float64], turn: int, height: int, width: int
) -> NDArray[np.float64]:
    """Undo ``numpy.rot90(picture, turn)`` for points (..., 2) of a picture of that size."""
    x, y = joints[..., 0], joints[..., 1]
    back = [(x, y), (width - y, x), (width - x, height - y), (y, height - x)]
    return np.stack(back[turn], axis=-1)
