"""Read pictures of people from files: upright, 8 bits per colour, of a bounded size."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_PIXELS: Final = 64_000_000
"""Largest picture, in pixels: 192 MB in memory, and many times the detail that the network sees."""


def read_picture(path: str | Path) -> NDArray[np.uint8]:
    """Read a picture, turned as its EXIF orientation says.

    :param path: of a file that Pillow reads.
    :return: (height, width, 3). 16-bit grey is scaled to 8 bits.
    :raises ValueError: for a file that is not a picture or is truncated, or a picture of more than
        ``MAX_PIXELS``, before memory is allocated for it.
    :raises OSError: if the file cannot be read.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    bombs = (Image.DecompressionBombError, Image.DecompressionBombWarning)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            opened = Image.open(path)  # reads the header alone
        with opened as file:
            width, height = file.size
            if width * height > MAX_PIXELS:
                raise Image.DecompressionBombError(f"{width} x {height} pixels")
            upright = ImageOps.exif_transpose(file)
            if upright.mode.startswith("I"):  # 16 bits of grey, which `convert` would clip at 255
                grey = np.asarray(upright).astype(np.float64) / 257.0
                return np.stack(3 * [np.rint(grey.clip(0, 255)).astype(np.uint8)], axis=-1)
            return np.asarray(upright.convert("RGB"))
    except bombs as error:
        raise ValueError(f"{path} is too large ({error}): at most {MAX_PIXELS:,} pixels") from error
    except (UnidentifiedImageError, SyntaxError) as error:
        raise ValueError(f"{path} is not a picture: {error}") from error
    except OSError as error:
        if error.filename is not None:
            raise
        raise ValueError(f"{path} is truncated or damaged: {error}") from error
