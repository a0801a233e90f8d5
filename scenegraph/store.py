"""A whole world in one file: its map layers, its graph, and what was told; written whole or not at all.

The file is an SQLite database (`application_id` and `user_version` mark format and version) with two tables:

    document (name, checksum, data)                  JSON, zstd: contents, config, graph, statements, …
    chunk    (layer, field, number, checksum, data)  an array's bytes, C order, at most 16 MiB each, zstd

The graph is in its compact form (`scenegraph.graph.compact`): the document `graph` and the arrays of the layer `graph`.
A file may hold a graph and nothing else; `load_graph` reads no more than the graph from any file.

The document `contents` names all other documents, and of each array the dtype, the shape and the number of its chunks.
The file is written to a sibling, flushed to the disk and renamed over the old one: whatever kills the program or the
machine, a reader finds the old world or the new one. Every row carries a BLAKE2b checksum of its key and its data.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sqlite3
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from scenegraph.errors import InvalidGraphValue, InvariantViolated, StoreCorrupt, StoreError, StoreForeign, StoreTooNew
from scenegraph.graph import SceneGraph, pack, unpack

__all__ = ["FORMAT_VERSION", "WorldParts", "load_graph", "load_world", "save_graph", "save_world"]

FORMAT_VERSION = 4
"""Version of the file format; files of other versions are refused."""

_Description = tuple[str, str, str, tuple[int, ...], int]  # layer, array, dtype, shape, number of chunks
_APPLICATION_ID = 0x53474D31  # "SGM1"
_GRAPH = "graph"
_CHUNK_BYTES = 16 << 20
_SCHEMA = """
CREATE TABLE document (name TEXT PRIMARY KEY, checksum BLOB NOT NULL, data BLOB NOT NULL) STRICT;
CREATE TABLE chunk (layer TEXT, field TEXT, number INTEGER, checksum BLOB NOT NULL, data BLOB NOT NULL,
                    PRIMARY KEY (layer, field, number)) STRICT;
"""


@dataclass(frozen=True, slots=True)
class WorldParts:
    """What a world is made of, as plain values.

    config    : JSON values
    layers    : for each map layer its arrays by name (any shape, numeric or text dtypes)
    graph     : the scene graph with its past
    documents : everything else as JSON values by name: statements, counters, …
    """

    config: dict[str, Any]
    layers: dict[str, dict[str, NDArray[Any]]] = field(default_factory=dict)
    graph: SceneGraph = field(default_factory=SceneGraph)
    documents: dict[str, Any] = field(default_factory=dict)


def save_world(path: str | Path, parts: WorldParts) -> None:
    """Write a world to `path`, replacing what a world was there before, whole or not at all.

    Raises StoreError when it cannot be written (no folder, disk full, a value that is not JSON, an array of objects)
    and StoreForeign when `path` is another kind of file; what was at `path` is then untouched.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise StoreError(f"{path}: the folder {path.parent} does not exist", hint="create it first")
    if path.exists():
        _check_header(path)
    _remove_stale(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}_{threading.get_ident()}.partial")
    try:
        _write(partial, parts)
        _flush(partial)
        os.replace(partial, path)
        _flush(path.parent)
    except (sqlite3.Error, OSError) as error:
        raise StoreError(f"{path}: cannot be written: {error}", hint="check free space and permissions") from error
    finally:
        partial.unlink(missing_ok=True)


def load_world(path: str | Path) -> WorldParts:
    """Read a world that `save_world` wrote.

    Raises StoreForeign when `path` is no stored world, StoreTooNew when a newer program wrote it, StoreCorrupt when it
    is truncated or damaged, StoreError when it cannot be opened.
    """
    return _load(Path(path), only_graph=False)


def save_graph(path: str | Path, graph: SceneGraph) -> None:
    """Write a graph without a map, as `save_world` writes a world, and with the same errors."""
    save_world(path, WorldParts(config={}, graph=graph))


def load_graph(path: str | Path) -> SceneGraph:
    """Read the graph, with its past, that `save_graph` or `save_world` wrote; the errors are those of `load_world`."""
    return _load(Path(path), only_graph=True).graph


# -- writing ----------------------------------------------------------------------------------------------------------


def _write(partial: Path, parts: WorldParts) -> None:
    compressor = zstandard.ZstdCompressor(level=1)
    with contextlib.closing(sqlite3.connect(partial, isolation_level=None)) as database:
        # No journal: nobody sees this file before it is complete, flushed and renamed.
        database.executescript(
            f"PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; "
            f"PRAGMA application_id = {_APPLICATION_ID}; PRAGMA user_version = {FORMAT_VERSION}; {_SCHEMA} BEGIN;"
        )
        arrays_of_graph, graph = pack(parts.graph)
        described = [
            _write_array(database, compressor.compress, layer, name, array)
            for layer, arrays in {**parts.layers, _GRAPH: arrays_of_graph}.items()
            for name, array in arrays.items()
        ]
        documents = {
            "config": _json("config", parts.config),
            _GRAPH: _json(_GRAPH, graph),
            **{f"document:{name}": _json(name, value) for name, value in parts.documents.items()},
        }
        documents["contents"] = _json("contents", {"documents": list(documents), "arrays": described})
        for name, text in documents.items():
            data = compressor.compress(text)
            database.execute("INSERT INTO document VALUES (?, ?, ?)", (name, _checksum(name, data), data))
        database.execute("COMMIT")


def _json(name: str, value: Any) -> bytes:
    try:
        return json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError) as error:
        raise StoreError(f"document {name!r} is not JSON: {error}") from None


def _write_array(
    database: sqlite3.Connection, compress: Callable[[bytes], bytes], layer: str, name: str, array: NDArray[Any]
) -> _Description:
    array = np.asarray(array)
    if array.dtype.kind not in "biufcSU":
        raise StoreError(f"layer {layer!r}: array {name!r}: expected numbers, truth values or text, got {array.dtype}")
    flat = _bytes_of(np.ascontiguousarray(array))
    starts = range(0, flat.size, _CHUNK_BYTES)
    for number, start in enumerate(starts):
        data = compress(flat[start : start + _CHUNK_BYTES].tobytes())
        key = f"{layer} {name} {number}"
        database.execute("INSERT INTO chunk VALUES (?, ?, ?, ?, ?)", (layer, name, number, _checksum(key, data), data))
    return layer, name, array.dtype.str, array.shape, len(starts)


def _bytes_of(array: NDArray[Any]) -> NDArray[np.uint8]:
    """A contiguous array's memory as bytes; shares it."""
    return array.reshape(-1).view(np.uint8) if array.nbytes else np.empty(0, np.uint8)


def _checksum(key: str, data: bytes) -> bytes:
    digest = hashlib.blake2b(key.encode(), digest_size=16)
    digest.update(data)
    return digest.digest()


def _flush(path: Path) -> None:
    """Wait until a file's, or a folder's, contents are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove_stale(path: Path) -> None:
    """Remove what saves that were killed left beside `path`."""
    for left in path.parent.glob(f".{path.name}.*.partial"):
        process = left.name.removeprefix(f".{path.name}.").partition("_")[0]
        if process.isdigit() and not _runs(int(process)):
            left.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


# -- reading ----------------------------------------------------------------------------------------------------------


def _load(path: Path, *, only_graph: bool) -> WorldParts:
    _check_header(path)
    try:
        with contextlib.closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        ) as database:
            _check_version(path, database)
            return _read(path, database, only_graph)
    except sqlite3.DatabaseError as error:
        raise StoreCorrupt(f"{path}: truncated or damaged: {error}", hint="restore it from a copy") from error


def _check_header(path: Path) -> None:
    """`path` is a file that begins as a stored world does."""
    try:
        with path.open("rb") as file:
            header = file.read(72)
    except OSError as error:
        raise StoreError(f"{path}: cannot be opened: {error.strerror}") from None
    if header[:16] != b"SQLite format 3\0" or header[68:72] != _APPLICATION_ID.to_bytes(4, "big"):
        raise StoreForeign(
            f"{path}: not a stored world",
            hint="a world is stored by `save` or `serve --store`; a graph in a file (exported, joined) has no map to "
            "go on with: it can be asked (`ask --map`), joined again and exported",
        )


def _check_version(path: Path, database: sqlite3.Connection) -> None:
    (version,) = database.execute("PRAGMA user_version").fetchone()
    if version > FORMAT_VERSION:
        raise StoreTooNew(
            f"{path}: format version {version}, but this program reads up to {FORMAT_VERSION}",
            hint="install a newer version of this program",
        )
    if version < FORMAT_VERSION:
        raise StoreForeign(
            f"{path}: format version {version}, but this program reads version {FORMAT_VERSION}",
            hint="what that version kept cannot be converted: map the recording again",
        )


def _read(path: Path, database: sqlite3.Connection, only_graph: bool) -> WorldParts:
    contents = json.loads(_document(path, database, "contents"))
    documents: dict[str, Any] = {
        name: json.loads(_document(path, database, name))
        for name in contents["documents"]
        if not only_graph or name == _GRAPH
    }
    layers: dict[str, dict[str, NDArray[Any]]] = {}
    for layer, name, dtype, shape, n_chunks in contents["arrays"]:
        if not only_graph or layer == _GRAPH:
            array = _read_array(path, database, (layer, name, dtype, shape, n_chunks))
            layers.setdefault(layer, {})[name] = array
    try:
        graph = unpack(layers.pop(_GRAPH, {}), documents.pop(_GRAPH))
    except (InvalidGraphValue, InvariantViolated) as error:
        raise StoreCorrupt(f"{path}: the graph: {error}") from None
    config = documents.pop("config", {})
    return WorldParts(config, layers, graph, {name.removeprefix("document:"): v for name, v in documents.items()})


def _document(path: Path, database: sqlite3.Connection, name: str) -> bytes:
    row = database.execute("SELECT checksum, data FROM document WHERE name = ?", (name,)).fetchone()
    if row is None:
        raise StoreCorrupt(f"{path}: document {name!r} is missing", hint="restore it from a copy")
    return _unpack(path, name, *row)


def _read_array(path: Path, database: sqlite3.Connection, description: _Description) -> NDArray[Any]:
    layer, name, dtype, shape, n_chunks = description
    array = np.empty(tuple(shape), dtype=np.dtype(dtype))
    flat = _bytes_of(array)
    filled = 0
    for number in range(n_chunks):
        row = database.execute(
            "SELECT checksum, data FROM chunk WHERE layer = ? AND field = ? AND number = ?", (layer, name, number)
        ).fetchone()
        if row is None:
            raise StoreCorrupt(f"{path}: layer {layer!r}: array {name!r}: chunk {number} of {n_chunks} is missing")
        text = _unpack(path, f"{layer} {name} {number}", *row)
        flat[filled : filled + len(text)] = np.frombuffer(text, np.uint8)
        filled += len(text)
    return array


def _unpack(path: Path, key: str, checksum: bytes, data: bytes) -> bytes:
    """The stored bytes of one row, checked."""
    if not isinstance(data, bytes) or _checksum(key, data) != checksum:
        raise StoreCorrupt(f"{path}: {key}: its checksum does not match", hint="restore it from a copy")
    return zstandard.ZstdDecompressor().decompress(data)
