"""Our own recordings: every observation, exactly as it was, in a folder that grows as it is written.

    recording.json       the header: format, version, name, hints, and the counts once the writing is finished
    observations.jsonl   one observation a line; an array stands there as its place in the other file
    arrays.bin           the arrays, each compressed by Zstandard with a checksum, its bytes sorted by significance

A line is written after its arrays. A recording that was cut off says so, and is read up to there with `partial=True`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import zstandard
from numpy.typing import NDArray
from pydantic import BaseModel

from mapping.datasets.dataset import Dataset, read_text
from mapping.errors import DatasetError, InvalidObservation, InvalidParameter
from mapping.geometry import SE3
from mapping.observations import OBSERVATIONS, Observation

HEADER, LINES, ARRAYS = "recording.json", "observations.jsonl", "arrays.bin"
FORMAT, VERSION = "scenegraph-recording", 1
HINTS = ("default_voxel_size_m", "max_range_m")


class Recorder:
    """Writes a recording; a context manager.

        with Recorder(folder, name="home 7", max_range_m=5.0) as recorder:
            recorder.write(observation)

    The folder must not hold a recording already. `notes` are kept in the header as they are (numbers, text, lists).
    Raises `DatasetError` when the folder cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        name: str | None = None,
        default_voxel_size_m: float = 0.05,
        max_range_m: float = 20.0,
        notes: Mapping[str, Any] | None = None,
    ) -> None:
        self.path = Path(path)
        if (self.path / HEADER).exists():
            raise DatasetError(f"{self.path}: holds a recording already", hint="choose another folder, or remove it")
        self._header = {
            "format": FORMAT,
            "version": VERSION,
            "name": name or self.path.resolve().name,
            "default_voxel_size_m": default_voxel_size_m,
            "max_range_m": max_range_m,
            "notes": dict(notes or {}),
        }
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._write_header(None)
            self._lines = (self.path / LINES).open("w", encoding="utf-8")
            self._arrays = (self.path / ARRAYS).open("wb")
        except OSError as error:
            raise DatasetError(f"{self.path}: cannot be written ({error.strerror})") from None
        self._compressor = zstandard.ZstdCompressor(level=3, write_checksum=True)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def write(self, observation: Observation) -> None:
        """Append one observation."""
        kind = type(observation).__name__
        if kind not in OBSERVATIONS:
            raise InvalidParameter(f"observation: expected one of {', '.join(OBSERVATIONS)}, got {kind}")
        line = json.dumps({kind: self._plain(observation)}, ensure_ascii=False, separators=(",", ":"))
        self._arrays.flush()
        self._lines.write(line + "\n")
        self._lines.flush()
        self._count += 1

    def _plain(self, value: Any) -> Any:
        """`value` as JSON. What JSON does not know becomes an object with one key that begins with `$`."""
        if isinstance(value, BaseModel):
            fields = {name: getattr(value, name) for name in type(value).model_fields}
            return {name: self._plain(field) for name, field in fields.items() if field is not None}
        if isinstance(value, SE3):
            return {"$pose": value.matrix[:3].tolist()}
        if isinstance(value, np.ndarray):
            return {"$array": self._put(value)}
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, tuple):
            return {"$tuple": [self._plain(item) for item in value]}
        if isinstance(value, list):
            return [self._plain(item) for item in value]
        if isinstance(value, Mapping):
            if all(isinstance(key, str) and not key.startswith("$") for key in value):
                return {key: self._plain(item) for key, item in value.items()}
            return {"$items": [[key, self._plain(item)] for key, item in value.items()]}
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        raise InvalidParameter(f"attributes: expected numbers, text, arrays, lists or objects, got {value!r}")

    def _put(self, array: NDArray[Any]) -> list[Any]:
        array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        planes = array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T  # equal high bytes side by side
        content = self._compressor.compress(planes.tobytes())
        offset = self._arrays.tell()
        self._arrays.write(content)
        return [array.dtype.str, list(array.shape), offset, len(content)]

    def _write_header(self, observations: int | None) -> None:
        text = json.dumps({**self._header, "observations": observations}, indent=2, ensure_ascii=False)
        (self.path / HEADER).write_text(text + "\n", encoding="utf-8")

    def close(self) -> None:
        """Finish the recording. May be called again."""
        if not self._lines.closed:
            self._lines.close()
            self._arrays.close()
            self._write_header(self._count)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class RecordedDataset(Dataset):
    """A recording by `Recorder`: what was written, in the order in which it was written.

    partial   read a recording that was cut off up to its last whole observation
    notes     what the writer noted in the header
    Raises `DatasetError`.
    """

    format = "recorded"
    title = "a recording of this program"
    signs = "recording.json"

    def __init__(self, path: Path, *, partial: bool = False) -> None:
        super().__init__(path)
        header = _header(path)
        self.name = str(header.get("name", self.name))
        self.notes: dict[str, Any] = header.get("notes", {})
        for hint in HINTS:
            setattr(self, hint, float(header.get(hint, getattr(self, hint))))
        self._len = self._whole(partial, header.get("observations"))

    @classmethod
    def missing(cls, path: Path) -> list[str] | None:
        if not (path / HEADER).is_file():
            if (path / LINES).is_file() and (path / ARRAYS).is_file():
                return [f"{HEADER} (the header)"]
            return None
        return [name for name in (LINES, ARRAYS) if not (path / name).is_file()]

    def _whole(self, partial: bool, announced: int | None) -> int:
        """How many observations are there in full; raises when some are missing and `partial` is not wanted."""
        size = (self.path / ARRAYS).stat().st_size
        whole, ends = 0, 0
        with (self.path / LINES).open("rb") as file:
            for line in file:
                ends = max(ends, _end_of_arrays(line))
                if not line.endswith(b"\n") or ends > size:
                    break
                whole += 1
            else:
                if announced is None or announced == whole or partial:
                    return whole
        if partial:
            return whole
        expected = "" if announced is None else f" of {announced}"
        raise DatasetError(
            f"{self.path}: the recording was cut off: {whole}{expected} observations are whole",
            hint="read those with partial=True",
        )

    def __len__(self) -> int:
        return self._len

    def __iter__(self) -> Iterator[Observation]:
        with (self.path / LINES).open("rb") as lines, (self.path / ARRAYS).open("rb") as arrays:
            for number, line in zip(range(self._len), lines, strict=False):
                where = f"{self.path}, observation {number}"
                try:
                    [(kind, fields)] = json.loads(line).items()
                    model = OBSERVATIONS[kind]
                    values = {name: _restore(where, arrays, value) for name, value in fields.items()}
                except (ValueError, KeyError, TypeError, AttributeError) as error:
                    raise DatasetError(f"{where}: damaged ({type(error).__name__}: {error})") from None
                try:
                    observation = model(**values)
                except InvalidObservation as error:
                    raise DatasetError(f"{where}: {error}") from None
                yield observation


def _header(path: Path) -> dict[str, Any]:
    try:
        header = json.loads(read_text(path / HEADER))
        if header["format"] != FORMAT:
            raise DatasetError(f"{path / HEADER}: expected format {FORMAT!r}, got {header['format']!r}")
        if header["version"] != VERSION:
            raise DatasetError(
                f"{path / HEADER}: version {header['version']} is not known; this program reads {VERSION}"
            )
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path / HEADER}: damaged ({type(error).__name__}: {error})") from None
    return dict(header)


def _end_of_arrays(line: bytes) -> int:
    """Where the last array that a line names ends in the file of arrays."""
    end = 0

    def note(value: dict[str, Any]) -> dict[str, Any]:
        nonlocal end
        if "$array" in value:
            *_, offset, length = value["$array"]
            end = max(end, offset + length)
        return value

    try:
        json.loads(line, object_hook=note)
    except (ValueError, TypeError):
        return 0  # a cut line is found by its missing end, a damaged one when it is read
    return end


def _restore(where: str, arrays: Any, value: Any) -> Any:
    if isinstance(value, list):
        return [_restore(where, arrays, item) for item in value]
    if not isinstance(value, dict):
        return value
    if "$pose" in value:
        matrix = np.array(value["$pose"], dtype=np.float64)
        return SE3(matrix[:, :3], matrix[:, 3])
    if "$array" in value:
        return _array(where, arrays, *value["$array"])
    if "$tuple" in value:
        return tuple(_restore(where, arrays, item) for item in value["$tuple"])
    if "$items" in value:
        return {key: _restore(where, arrays, item) for key, item in value["$items"]}
    return {key: _restore(where, arrays, item) for key, item in value.items()}


def _array(where: str, arrays: Any, dtype: str, shape: list[int], offset: int, length: int) -> NDArray[Any]:
    kind = np.dtype(dtype)
    size = int(np.prod(shape, dtype=np.int64)) * kind.itemsize
    arrays.seek(offset)
    content = arrays.read(length)
    if len(content) < length:
        raise DatasetError(f"{where}: truncated: {ARRAYS} ends before byte {offset + length}")
    try:
        planes = zstandard.ZstdDecompressor().decompress(content, max_output_size=size)
    except zstandard.ZstdError as error:
        raise DatasetError(f"{where}: damaged: the array at byte {offset} does not decompress ({error})") from None
    if len(planes) != size:
        raise DatasetError(f"{where}: damaged: expected {size} bytes for {dtype}{shape}, got {len(planes)}")
    flat = np.ascontiguousarray(np.frombuffer(planes, dtype=np.uint8).reshape(kind.itemsize, -1).T)
    return np.asarray(flat.view(kind).reshape(shape))
