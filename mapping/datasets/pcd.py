"""PCD point clouds (Point Cloud Library), ascii, binary and compressed, with the sensor's pose in VIEWPOINT."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mapping.datasets.dataset import Dataset, natural
from mapping.errors import DatasetError, InvalidParameter
from mapping.geometry import SE3
from mapping.observations import ClassInfo, LabelSpace, Scan

NO_VIEWPOINT = "0 0 0 1 0 0 0"
"""What the library writes when nobody set a viewpoint."""

MAX_HEADER_BYTES = 65536
LABEL_FIELDS = ("label", "labels")


@dataclass(frozen=True)
class Header:
    """What a PCD file says of itself. `columns` is a packed structured type, a sub-array for each field."""

    columns: np.dtype[Any]
    points: int
    viewpoint: str | None
    encoding: str
    data_offset: int

    def T_map_sensor(self, path: Path) -> SE3:
        """VIEWPOINT tx ty tz qw qx qy qz as a pose."""
        try:
            x, y, z, qw, qx, qy, qz = (float(number) for number in (self.viewpoint or "").split())
            return SE3.from_quaternion((qw, qx, qy, qz), (x, y, z))
        except ValueError as error:
            raise DatasetError(
                f"{path}: expected VIEWPOINT tx ty tz qw qx qy qz, got {self.viewpoint!r} ({error})"
            ) from None


def read_header(path: Path) -> Header:
    """The header of a PCD file. Raises `DatasetError`."""
    entries: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            while file.tell() < MAX_HEADER_BYTES:
                line = file.readline(MAX_HEADER_BYTES)
                if not line:
                    break
                key, _, value = line.decode("ascii", errors="replace").strip().partition(" ")
                if key and not key.startswith("#"):
                    entries[key.upper()] = value.strip()
                if key.upper() == "DATA":
                    return Header(
                        columns=_columns(path, entries),
                        points=_points(path, entries),
                        viewpoint=entries.get("VIEWPOINT"),
                        encoding=entries["DATA"].lower(),
                        data_offset=file.tell(),
                    )
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from None
    raise DatasetError(f"{path}: not a PCD file: its header has no DATA line")


def _points(path: Path, entries: dict[str, str]) -> int:
    try:
        points = int(entries["POINTS"]) if "POINTS" in entries else int(entries["WIDTH"]) * int(entries["HEIGHT"])
    except (KeyError, ValueError):
        raise DatasetError(f"{path}: expected POINTS, or WIDTH and HEIGHT, in the header") from None
    if points < 0:
        raise DatasetError(f"{path}: expected POINTS ≥ 0, got {points}")
    return points


def _columns(path: Path, entries: dict[str, str]) -> np.dtype[Any]:
    names = entries.get("FIELDS", entries.get("COLUMNS", "")).split()
    sizes, kinds = entries.get("SIZE", "").split(), entries.get("TYPE", "").split()
    counts = entries.get("COUNT", " ".join("1" for _ in names)).split()
    if not {"x", "y", "z"} <= set(names) or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise DatasetError(
            f"{path}: expected FIELDS with x, y and z and as many SIZE, TYPE and COUNT, "
            f"got {names}, {sizes}, {kinds}, {counts}"
        )
    try:
        return np.dtype(
            [
                (f"{i}:{name}" if name in names[:i] or name == "_" else name, f"<{kind.lower()}{size}", (int(count),))
                for i, (name, kind, size, count) in enumerate(zip(names, kinds, sizes, counts, strict=True))
            ]
        )
    except (TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: expected TYPE F, I or U of SIZE 1, 2, 4 or 8, got {kinds}, {sizes} ({error})"
        ) from None


def read_columns(path: Path) -> tuple[Header, dict[str, NDArray[Any]]]:
    """The header and the columns (N,) by name (fields of several values are left out). Raises `DatasetError`."""
    header = read_header(path)
    if header.encoding == "ascii":
        columns = _read_ascii(path, header)
    elif header.encoding == "binary":
        columns = _split(_read_binary(path, header), header)
    elif header.encoding == "binary_compressed":
        columns = _read_compressed(path, header)
    else:
        raise DatasetError(f"{path}: expected DATA ascii, binary or binary_compressed, got {header.encoding!r}")
    return header, columns


def _split(rows: NDArray[Any], header: Header) -> dict[str, NDArray[Any]]:
    return {
        name: np.ascontiguousarray(rows[name][:, 0])
        for name in header.columns.names or ()
        if header.columns[name].shape == (1,)
    }


def _read_ascii(path: Path, header: Header) -> dict[str, NDArray[Any]]:
    """Columns by position; a line may have more of them than FIELDS names, as some data sets do."""
    position, places = 0, {}
    for name in header.columns.names or ():
        count = header.columns[name].shape[0]
        if count == 1:
            places[name] = position
        position += count
    try:
        with path.open("rb") as file:
            file.seek(header.data_offset)
            wanted = list(places.values())
            table = np.loadtxt(file, dtype=np.float64, usecols=wanted, ndmin=2, max_rows=header.points)
    except (ValueError, OSError) as error:
        raise DatasetError(f"{path}: expected lines of {position} numbers ({error})") from None
    if len(table) < header.points:
        raise DatasetError(f"{path}: truncated: {header.points} points announced, {len(table)} there")
    return {name: table[:, i].astype(header.columns[name].base) for i, name in enumerate(places)}


def _bytes(path: Path, offset: int, count: int) -> bytes:
    with path.open("rb") as file:
        file.seek(offset)
        content = file.read(count)
    if len(content) < count:
        raise DatasetError(f"{path}: truncated: {count} bytes of points announced, {len(content)} there")
    return content


def _read_binary(path: Path, header: Header) -> NDArray[Any]:
    return np.frombuffer(
        _bytes(path, header.data_offset, header.points * header.columns.itemsize), dtype=header.columns
    )


def _read_compressed(path: Path, header: Header) -> dict[str, NDArray[Any]]:
    """LZF of the points turned into a structure of arrays, after two uint32: compressed and full size."""
    packed, full = np.frombuffer(_bytes(path, header.data_offset, 8), dtype="<u4").tolist()
    if full != header.points * header.columns.itemsize:
        expected = header.points * header.columns.itemsize
        raise DatasetError(
            f"{path}: expected {expected} bytes of points after decompression, the file announces {full}"
        )
    try:
        content = lzf_decompress(_bytes(path, header.data_offset + 8, packed), full)
    except ValueError as error:
        raise DatasetError(f"{path}: damaged: {error}") from None
    columns, start = {}, 0
    for name in header.columns.names or ():
        field = header.columns[name]
        if field.shape == (1,):
            columns[name] = np.frombuffer(content, dtype=field.base, count=header.points, offset=start)
        start += field.itemsize * header.points
    return columns


def lzf_decompress(packed: bytes, size: int) -> bytes:
    """Marc Lehmann's LZF, as PCL writes it: literal runs and references back. Raises `ValueError` when damaged."""
    out = bytearray()
    i = 0
    try:
        while i < len(packed):
            control = packed[i]
            i += 1
            if control < 32:
                out += packed[i : i + control + 1]
                i += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[i]
                i += 1
            start = len(out) - ((control & 31) << 8) - packed[i] - 1
            i += 1
            if start < 0:
                raise ValueError("a reference before the beginning")
            length += 2
            chunk = bytes(out[start : start + length])
            out += (chunk * (length // len(chunk) + 1))[:length]  # a reference may reach into what it writes
            if len(out) > size:
                break
    except IndexError:
        raise ValueError("the compressed points end too early") from None
    if len(out) != size:
        raise ValueError(f"expected {size} bytes after decompression, got {len(out)}")
    return bytes(out)


class PcdDataset(Dataset):
    """A folder of PCD scans in order of their numbers, a second apart, or a single file.

    points_in     `world`: the points are in map already and are moved back by VIEWPOINT, as the scans of la3dm want it;
                  `sensor`: they are in the sensor frame, as PCL means it
    label_names   class id → name for files with a label field; `class_1`, … where the name is not given. The label
                  space comes before the first scan
    Raises `DatasetError`, also when no file of several has a VIEWPOINT of its own: then the poses are missing.
    """

    format = "pcd"
    title = "a folder of PCD scans"
    signs = "*.pcd with VIEWPOINT"
    default_voxel_size_m = 0.1
    max_range_m = 20.0

    def __init__(
        self,
        path: Path,
        *,
        points_in: Literal["world", "sensor"] = "world",
        label_names: dict[int, str] | None = None,
        robot: str = "robot",
        sensor: str = "lidar",
    ) -> None:
        super().__init__(path)
        if points_in not in ("world", "sensor"):
            raise InvalidParameter(f"points_in: expected 'world' or 'sensor', got {points_in!r}")
        self._points_in, self._label_names = points_in, label_names or {}
        self._robot, self._sensor = robot, sensor
        self._files = _files(path)
        self._labelled = any(set(LABEL_FIELDS) & set(read_header(file).columns.names or ()) for file in self._files)
        self._label_space: LabelSpace | None = None

    @classmethod
    def missing(cls, path: Path) -> list[str] | None:
        files = _files(path)
        if not files:
            return None
        viewpoints = [read_header(file).viewpoint for file in files]
        without = [file.name for file, viewpoint in zip(files, viewpoints, strict=True) if viewpoint is None]
        if without:
            return [f"VIEWPOINT (the sensor's pose) in the header of {', '.join(without[:3])}"]
        if len(files) > 1 and all(_is_default(viewpoint) for viewpoint in viewpoints):
            return [f"poses: VIEWPOINT is the default ({NO_VIEWPOINT}) in all {len(files)} files"]
        return []

    def __len__(self) -> int:
        return len(self._files) + self._labelled

    def __iter__(self) -> Iterator[LabelSpace | Scan]:
        self.skipped.clear()
        if self._labelled:
            yield self._labels()
        for number, file in enumerate(self._files):
            header, columns = read_columns(file)
            T_map_sensor = header.T_map_sensor(file)
            points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
            known = np.isfinite(points).all(axis=1)
            self.skipped["points that are not finite"] += int((~known).sum())
            points = points[known]
            labels = _label_column(file, columns)
            if self._points_in == "world":
                points = T_map_sensor.inverse() @ points
            yield Scan(
                stamp_ns=number * 10**9,
                robot=self._robot,
                sensor=self._sensor,
                points=points.astype(np.float32),
                T_map_sensor=T_map_sensor,
                labels=None if labels is None else labels[known],
                intensity=columns["intensity"][known].astype(np.float32) if "intensity" in columns else None,
            )

    def _labels(self) -> LabelSpace:
        """All class ids of all files, which have to be looked through for it, once."""
        if self._label_space is None:
            ids = set(self._label_names)
            for file in self._files:
                _, columns = read_columns(file)
                labels = _label_column(file, columns)
                ids |= set() if labels is None else set(np.unique(labels).tolist())
            self._label_space = LabelSpace(
                classes={
                    i: ClassInfo(name=self._label_names.get(i, f"class_{i}"), kind="stuff") for i in sorted(ids - {0})
                }
            )
        return self._label_space


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.suffix.lower() == ".pcd" else []
    return sorted((file for file in path.glob("*.[pP][cC][dD]") if file.is_file()), key=natural)


def _is_default(viewpoint: str | None) -> bool:
    try:
        return [float(number) for number in (viewpoint or "").split()] == [0, 0, 0, 1, 0, 0, 0]
    except ValueError:
        return False


def _label_column(path: Path, columns: dict[str, NDArray[Any]]) -> NDArray[np.uint16] | None:
    for name in LABEL_FIELDS:
        if name in columns:
            labels = columns[name]
            if labels.size and not (labels.min() >= 0 and labels.max() < 2**16):
                raise DatasetError(f"{path}: expected labels in 0 … 65535, got {labels.min()} … {labels.max()}")
            return np.asarray(labels, dtype=np.uint16)
    return None
