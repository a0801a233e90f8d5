"""A colour for each class: the one that its label space gives, else one that its name always has."""

from __future__ import annotations

import colorsys
import zlib
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.observations import ClassInfo, LabelSpace

Array: TypeAlias = NDArray[Any]
Color: TypeAlias = tuple[int, int, int]

UNLABELLED_COLOR: Color = (128, 128, 128)
"""What has no class."""
_GOLDEN = 0.6180339887498949
_SHADES = ((0.85, 0.95), (0.55, 0.95), (0.9, 0.65), (0.55, 0.7))  # saturation and value; none of them is grey


class Palette:
    """The colour of each class id.

    classes : a `LabelSpace`, a mapping from class id to `ClassInfo`, or the infos of classes 1, 2, …; None: no names

    A class without a colour of its own gets one by its name, so that it looks the same in every map and at any time,
    whatever other classes there are; an id without a name gets one by its number. Class 0, no label, is grey.
    """

    def __init__(self, classes: LabelSpace | Mapping[int, ClassInfo] | Iterable[ClassInfo] | None = None) -> None:
        if isinstance(classes, LabelSpace):
            classes = classes.classes
        infos = classes if isinstance(classes, Mapping) else dict(enumerate(classes or (), start=1))
        self._given = {label: info.color or color_of_name(info.name) for label, info in infos.items()}
        self._names = {label: info.name for label, info in infos.items()}

    def of(self, labels: ArrayLike) -> NDArray[np.uint8]:
        """(N, 3) uint8 red, green, blue of class ids (N,)."""
        ids = np.asarray(labels, np.uint16)
        counts = np.bincount(ids, minlength=1)
        table = np.empty((len(counts), 3), np.uint8)
        for label in np.flatnonzero(counts).tolist():
            table[label] = self[label]
        return np.asarray(table[ids])

    def legend(self, labels: ArrayLike) -> tuple[str, ...]:
        """A line `class ID RED GREEN BLUE NAME` for each class among the ids (N,) that has a name, by id."""
        there = np.flatnonzero(np.bincount(np.asarray(labels, np.uint16))).tolist()
        return tuple(
            f"class {label} {' '.join(map(str, self[label]))} {self._names[label]}"
            for label in there
            if label in self._names
        )

    def __getitem__(self, label: int) -> Color:
        """Red, green, blue of one class id."""
        if label == 0:
            return UNLABELLED_COLOR
        return self._given[label] if label in self._given else color_of_name(str(label))


def color_of_name(name: str) -> Color:
    """The colour that a class of this name has where no label space gives one: hues by the golden ratio."""
    mixed = zlib.crc32(name.encode())
    saturation, value = _SHADES[mixed & 3]
    red, green, blue = colorsys.hsv_to_rgb((mixed >> 2) * _GOLDEN % 1.0, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)
