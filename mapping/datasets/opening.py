"""Finding the reader for a folder or file."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from mapping.datasets.carmen import CarmenDataset
from mapping.datasets.dataset import Dataset
from mapping.datasets.pcd import PcdDataset
from mapping.datasets.recorded import RecordedDataset
from mapping.datasets.redwood import RedwoodDataset
from mapping.datasets.threedtk import ThreeDtkDataset
from mapping.datasets.tum import TumDataset
from mapping.errors import DatasetError, InvalidParameter

FORMATS: dict[str, type[Dataset]] = {
    reader.format: reader
    for reader in (RecordedDataset, TumDataset, RedwoodDataset, ThreeDtkDataset, PcdDataset, CarmenDataset)
}
"""Format → reader, in the order in which they are tried."""


def open_dataset(path: str | Path, *, format: str | None = None, **options: Any) -> Dataset:
    """The recording at `path`. `options` are those of its reader, e.g. `poses="odometry"` for 3DTK.

    format   the reader to use; without it the folder is looked at

    Raises `DatasetError` when there is none that reads it, saying which formats were tried and what was missing;
    `InvalidParameter` for an option that the reader does not have.
    """
    path = Path(path)
    if format is not None and format not in FORMATS:
        raise InvalidParameter(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    if not path.exists():
        raise DatasetError(f"{path}: there is no such file or folder")
    candidates = FORMATS if format is None else {format: FORMATS[format]}
    incomplete = []
    for reader in candidates.values():
        missing = reader.missing(path)
        if missing == []:
            return _read(reader, path, options)
        if missing:
            incomplete.append(f"looks like {reader.title}, but lacks {'; '.join(missing)}")
    if incomplete:
        raise DatasetError(f"{path}: {' / '.join(incomplete)}")
    tried = "; ".join(f"{name} ({reader.signs})" for name, reader in candidates.items())
    raise DatasetError(f"{path}: not a recording that can be read; tried {tried}", hint=_inside(path, candidates))


def _read(reader: type[Dataset], path: Path, options: dict[str, Any]) -> Dataset:
    known = [name for name in inspect.signature(reader).parameters if name != "path"]
    for name in options:
        if name not in known:
            raise InvalidParameter(f"{name}: not an option of {reader.format} recordings; those are {', '.join(known)}")
    return reader(path, **options)


def _inside(path: Path, candidates: dict[str, type[Dataset]]) -> str | None:
    """Where to look instead: recordings in the folders below."""
    if not path.is_dir():
        return None
    found = [
        f"{folder.name} ({name})"
        for folder in sorted(child for child in path.iterdir() if child.is_dir())
        for name, reader in candidates.items()
        if reader.missing(folder) == []
    ]
    return f"there are recordings in it: {', '.join(found[:5])}" if found else None
