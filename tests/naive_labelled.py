"""Slow, obvious twins of what comes out of the labelled map, and a plain reader of PLY files."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from mapping.semantics import SemanticMap

Voxel = tuple[int, int, int]


def voxel_of(point: np.ndarray, size: float) -> Voxel:
    i, j, k = (int(np.floor(c / size)) for c in point)
    return i, j, k


def labels_by_voxel(semantics: SemanticMap) -> dict[Voxel, int]:
    """The class of each labelled voxel."""
    centres, labels, _ = semantics.voxels()
    return {voxel_of(c, semantics.voxel_size_m): int(n) for c, n in zip(centres, labels, strict=True)}


def state_at(point: np.ndarray, semantics: SemanticMap, occupancy: OccupancyMap) -> int:
    """0 never observed, 1 empty, 2 a surface without a label, 3 labelled."""
    if int(semantics.query(point[None])[0][0]):
        return 3
    there = int(occupancy.classify(point[None])[0])
    return {OCCUPIED: 2, FREE: 1}.get(there, 0)


def nearest_labels(point: np.ndarray, labels: dict[Voxel, int], size: float, reach: float) -> set[int]:
    """The classes that the nearest labelled voxel may have: several where several are equally near."""
    own = labels.get(voxel_of(point, size))
    if own is not None:
        return {own}
    far = {v: float(np.linalg.norm((np.array(v) + 0.5) * size - point)) for v in labels}
    near = {v: d for v, d in far.items() if d <= reach}
    least = min(near.values(), default=0.0)
    return {labels[v] for v, d in near.items() if d <= least + 1e-9} or {0}


def label_of_cube(low: np.ndarray, n: int, labels: dict[Voxel, int], size: float) -> int:
    """The class that most of the n³ voxels of a cube from corner `low` have, the lowest of several."""
    first = np.rint(low / size).astype(int)
    inside = Counter(labels[v] for v in (tuple(first + step) for step in np.ndindex(n, n, n)) if v in labels)
    most = max(inside.values(), default=0)
    return min((label for label, count in inside.items() if count == most), default=0)


def is_inside(point: np.ndarray, center: np.ndarray, size: np.ndarray, rotation: np.ndarray) -> bool:
    """Whether a point lies in an oriented box."""
    for axis in range(3):
        away = float(np.dot(point - center, rotation[:, axis]))
        if not -size[axis] / 2 <= away < size[axis] / 2:
            return False
    return True


def read_ply(path: str | Path) -> dict[str, np.ndarray]:
    """The properties of the vertices of a binary PLY file, and its triangles as `triangles`."""
    content = Path(path).read_bytes()
    head, _, rest = content.partition(b"end_header\n")
    types = {"float": "<f4", "double": "<f8", "uchar": "u1", "ushort": "<u2", "uint": "<u4", "int": "<i4"}
    layout: list[tuple[str, str]] = []
    counts: dict[str, int] = {}
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    for words in (line.split() for line in lines[2:]):
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[0] == "property" and words[1] != "list":
            layout.append((words[2], types[words[1]]))
    rows: Any = np.frombuffer(rest, np.dtype(layout), counts["vertex"])
    found = {name: rows[name] for name, _ in layout}
    rest = rest[rows.nbytes :]
    if "face" in counts:
        faces = np.frombuffer(rest, [("n", "u1"), ("corners", "<i4", 3)], counts["face"])
        assert (faces["n"] == 3).all()
        found["triangles"], rest = faces["corners"], rest[faces.nbytes :]
    assert not rest
    return found
