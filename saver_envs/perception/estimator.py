"""Pictures in, people out: a network with what comes before and after it."""

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

#: Height and width that pictures are fitted into before the network looks at them.
NETWORK_SIZE: Final = (216, 256)
#: From normalised pictures (n, 3, h, w) to the last stage's fields (n, limbs, 3, h/8, w/8).
Run = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class PoseEstimator:
    """Finds the people in pictures.

    :param network: trained.
    :param size: height and width, multiples of 8, that pictures are fitted into.
    :param turn: quarter turns, anticlockwise, after which heads are about at the top: 2 for the
        camera over the bench, which sees people upside down.
    :param options: of the parsing.
    :param mirror: look at the picture's mirror image too, and take the mean of both: better, at
        twice the cost. All limbs are needed, or both of every pair.
    :param run: runs the network in another way, such as :class:`~.onnx.OnnxNetwork`.
    :raises ValueError: for a size that is no multiple of 8, or limbs whose mirror images are not
        among them.
    """

    def __init__(
        self,
        network: PoseNetwork,
        size: tuple[int, int] = NETWORK_SIZE,
        turn: int = 0,
        options: ParsingOptions = DEFAULT_PARSING,
        mirror: bool = False,
        run: Run | None = None,
    ) -> None:
        if size[0] % STRIDE or size[1] % STRIDE or min(size) <= 0:
            raise ValueError(f"size={size!r}: height and width must be multiples of {STRIDE}")
        self.network = network.eval()
        self.limbs = network.limb_indices
        self.size = size
        self.turn = turn % 4
        self.options = options
        self._mirrored = _mirrored_places(self.limbs) if mirror else None
        self._run = run or self._torch

    @staticmethod
    def shipped(limbs: list[str] | None = None, **options: Any) -> PoseEstimator:
        """Return an estimator with the weights that ship.

        :param limbs: which limbs, all 13 where ``None``.
        :param options: see :class:`PoseEstimator`.
        """
        return PoseEstimator(load_network(SHIPPED, limbs), **options)

    @staticmethod
    def from_file(path: Path, limbs: list[str] | None = None, **options: Any) -> PoseEstimator:
        """Return an estimator with the weights of a file; see :func:`~.weights.load_network`."""
        return PoseEstimator(load_network(path, limbs), **options)

    def __call__(self, image: NDArray[Any]) -> Poses:
        """Find the people in a picture.

        :param image: (height, width, 3) uint8 of any size, or floats in [0, 1].
        :return: pixels of that picture; nobody in a picture without people.
        :raises ValueError: for another shape or type.
        """
        picture, scale, offset = self.prepare(image)
        fields = self.fields(picture)
        return self.finish(fields, scale, offset, image.shape[:2])

    def prepare(
        self, image: NDArray[Any]
    ) -> tuple[NDArray[np.float32], float, NDArray[np.float64]]:
        """Turn, fit and normalise a picture.

        :return: (3, h, w), the scale, and where its top left corner came to lie (x, y).
        """
        pixels = np.rot90(checked(image), self.turn)
        return normalised(pixels, self.size)

    def fields(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network.

        :param picture: (3, h, w) from :meth:`prepare`.
        :return: (limbs, 3, h / 8, w / 8).
        """
        if self._mirrored is None:
            return self._run(picture[None])[0]
        plain, mirrored = self._run(np.stack([picture, picture[:, :, ::-1]]))
        back = mirrored[self._mirrored, :, :, ::-1].copy()
        back[:, AFFINITY_X] *= -1
        mean: NDArray[np.float32] = 0.5 * (plain + back)
        return mean

    def finish(
        self,
        fields: NDArray[np.float32],
        scale: float,
        offset: NDArray[np.float64],
        shape: tuple[int, int],
    ) -> Poses:
        """Parse fields (limbs, 3, rows, columns) and go back to the given picture's pixels.

        :param fields: of a picture from :meth:`prepare`.
        :param scale: from there.
        :param offset: from there.
        :param shape: height and width of the given picture.
        """
        poses = parse(fields, self.limbs, self.options)
        joints = _turned_back((poses.joints - offset) / scale, self.turn, shape)
        within = (joints >= 0) & (joints <= shape[::-1])
        inside = within[..., 0] & within[..., 1]
        # What lies in the margin beside the picture is not a joint of it.
        joints = np.where(inside[..., None], joints, np.nan)
        scores = np.where(inside, poses.scores, 0.0)
        return Poses(joints, scores, poses.person_scores)

    def _torch(self, pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            fields: Tensor = self.network(torch.from_numpy(pictures).to(device))[1]
        values: NDArray[np.float32] = fields.float().cpu().numpy()
        return values


def _mirrored_places(limbs: Sequence[int]) -> list[int]:
    """Return where the mirror image of each limb is among ``limbs``.

    :raises ValueError: where one is missing; the message says which.
    """
    wanted = [int(MIRRORED_LIMBS[limb]) for limb in limbs]
    missing = [LIMB_NAMES[limb] for limb in wanted if limb not in limbs]
    if missing:
        raise ValueError(f"mirror=True: needs the limbs {', '.join(missing)} as well")
    places = list(limbs)
    return [places.index(limb) for limb in wanted]


def checked(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a picture as (height, width, 3) uint8.

    :raises ValueError: for another shape or type; the message says what was given.
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
    """Fit a picture into the middle of ``size`` and normalise it.

    :param pixels: (height, width, 3).
    :param size: height and width.
    :return: (3, height, width), the scale, and the top left corner's place (x, y).
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
    joints: NDArray[np.float64], turn: int, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Undo ``numpy.rot90(picture, turn)`` for points of it; ``shape`` is that of the picture."""
    height, width = shape
    x, y = joints[..., 0], joints[..., 1]
    if turn == 1:
        return np.stack([width - y, x], axis=-1)
    if turn == 2:
        return np.stack([width - x, height - y], axis=-1)
    if turn == 3:
        return np.stack([y, height - x], axis=-1)
    return joints
