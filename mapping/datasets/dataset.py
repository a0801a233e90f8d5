"""What every reader of recorded data offers, and what readers share: time, files and images."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mapping.errors import DatasetError
from mapping.observations import Observation


class Dataset(ABC):
    """A recording on disk. Iterating it yields its observations in order of time, as often as one likes; each is read
    when it is asked for, and none is kept.

    name                   what to call it
    path                   the folder or file
    len(dataset)           how many observations it yields
    skipped                what the last look or iteration left out: reason → how many
    default_voxel_size_m   a voxel size that suits the sensor [m]
    max_range_m            a range beyond which the sensor is not to be trusted [m]
    """

    format: ClassVar[str]
    """One word: `tum`, `pcd`, …"""
    title: ClassVar[str]
    """What to call such a recording in a sentence: `a TUM RGB-D folder`."""
    signs: ClassVar[str]
    """What it is known by."""

    default_voxel_size_m: float = 0.05
    max_range_m: float = 20.0

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.resolve().name or str(path)
        self.skipped: Counter[str] = Counter()

    @classmethod
    @abstractmethod
    def missing(cls, path: Path) -> list[str] | None:
        """What `path` lacks to be read: [] nothing; None when it does not look like this format at all."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def __iter__(self) -> Iterator[Observation]: ...

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {len(self)} observations>"


def natural(path: Path) -> tuple[Any, ...]:
    """A key that sorts `scan_2` before `scan_10`."""
    parts = re.split(r"(\d+)", path.name)
    return tuple(int(part) if part.isdigit() else part for part in parts)


def seconds_to_ns(text: str) -> int:
    """Decimal seconds as text → nanoseconds, exact: a float would lose the last digits of a time since 1970."""
    whole, _, fraction = text.partition(".")
    if not (whole.isdigit() and (fraction.isdigit() or not fraction)):
        return round(float(text) * 1e9)
    return int(whole) * 10**9 + int(fraction[:9].ljust(9, "0"))


def read_text(path: Path) -> str:
    """The whole of a small text file. Raises `DatasetError`."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from None


def read_color(path: Path) -> NDArray[np.uint8]:
    """A colour image (h, w, 3) RGB. Raises `DatasetError`."""
    return _pixels(path, "RGB").astype(np.uint8, copy=False)


def read_depth(path: Path) -> NDArray[np.uint16]:
    """A depth image (H, W) of 16 bits, as stored. Raises `DatasetError`."""
    pixels = _pixels(path, None)
    if pixels.ndim != 2 or pixels.dtype not in (np.uint16, np.int32):
        raise DatasetError(
            f"{path}: expected a depth image of one channel of 16 bits, got {pixels.dtype}{pixels.shape}"
        )
    if pixels.dtype == np.int32 and pixels.size and (int(pixels.min()) < 0 or int(pixels.max()) >= 2**16):
        raise DatasetError(f"{path}: expected depth in 0 … 65535, got {pixels.min()} … {pixels.max()}")
    return pixels.astype(np.uint16, copy=False)


def _pixels(path: Path, mode: str | None) -> NDArray[Any]:
    try:
        with Image.open(path) as image:
            return np.asarray(image if mode is None or image.mode == mode else image.convert(mode))
    except FileNotFoundError:
        raise DatasetError(f"{path}: missing") from None
    except (OSError, SyntaxError, UnidentifiedImageError, ValueError) as error:
        raise DatasetError(f"{path}: not a complete image ({error})") from None
