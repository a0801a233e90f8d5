"""Numeric arrays on the wire, and the limits that every message must keep.

In CBOR an array is RFC 8746 tag 40, `[shape, typed array, little endian]`. In JSON, and compressed in CBOR, it is
`{"shape": [2, 3], "dtype": "<u2", "codec": "raw|zstd|png|jpeg", "data": bytes or base64 text}`. Every declared size is
checked before memory is taken for it or a decompressor is started.
"""

from __future__ import annotations

import base64
import binascii
import io
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray
from PIL import Image

from scenegraph.service.errors import InvalidMessage

__all__ = [
    "ARRAY_SCHEMA",
    "CODECS",
    "DTYPES",
    "LIMITS",
    "Budget",
    "Limits",
    "array_form",
    "array_of_form",
    "is_array_form",
]

_LITTLE = sys.byteorder == "little"


@dataclass(frozen=True)
class Limits:
    """What one message may hold.

    message_bytes   size as it arrives
    array_elements  elements of one array
    decoded_bytes   all arrays of the message together, decompressed
    values          numbers, texts, lists, … together (an array is one)
    depth           lists and mappings within each other
    """

    message_bytes: int = 64 << 20
    array_elements: int = 1 << 25
    decoded_bytes: int = 256 << 20
    values: int = 2_000_000
    depth: int = 32


LIMITS = Limits()


class Budget:
    """What is left of a message's limits while it is being decoded."""

    __slots__ = ("bytes_left", "limits", "values_left")

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.bytes_left = limits.decoded_bytes
        self.values_left = limits.values

    def spend_values(self, count: int) -> None:
        """Account for `count` more values."""
        self.values_left -= count
        if self.values_left < 0:
            raise InvalidMessage(f"expected at most {self.limits.values} values in a message")

    def spend_array(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
        """Account for an array; returns its size in bytes."""
        elements = math.prod(shape)
        if elements > self.limits.array_elements:
            raise InvalidMessage(
                f"expected at most {self.limits.array_elements} elements in an array, got shape {shape}"
            )
        size = elements * dtype.itemsize
        self.bytes_left -= size
        if self.bytes_left < 0:
            raise InvalidMessage(f"expected arrays of at most {self.limits.decoded_bytes} bytes in a message")
        return size


_NAMES = (
    "bool",
    "uint8",
    "int8",
    "uint16",
    "int16",
    "uint32",
    "int32",
    "uint64",
    "int64",
    "float16",
    "float32",
    "float64",
)

DTYPES: dict[str, np.dtype[Any]] = {np.dtype(name).newbyteorder("<").str: np.dtype(name) for name in _NAMES}
"""The dtypes that may travel, by their name on the wire (`<u2`, `|u1`, `|b1`, …)."""

_ALIASES = {"<u1": "|u1", "<i1": "|i1", "<b1": "|b1"}

CODECS = ("raw", "zstd", "png", "jpeg")
_PICTURES = {"png": "PNG", "jpeg": "JPEG"}
_FORM = frozenset(("shape", "dtype", "codec", "data"))
_ZSTD_WINDOW = 1 << 27

ARRAY_SCHEMA: dict[str, Any] = {
    "title": "Array",
    "description": "A numeric array, row by row. In CBOR also RFC 8746 tag 40 [shape, typed array, little endian].",
    "oneOf": [
        {
            "type": "object",
            "required": ["shape", "dtype", "codec", "data"],
            "additionalProperties": False,
            "properties": {
                "shape": {"type": "array", "items": {"type": "integer", "minimum": 0}, "maxItems": 4},
                "dtype": {"enum": sorted(DTYPES)},
                "codec": {"enum": list(CODECS), "description": "png and jpeg: 8-bit grey or RGB; png also 16-bit grey"},
                "data": {"type": "string", "contentEncoding": "base64", "description": "in CBOR a byte string"},
            },
        },
        {"type": "array", "description": "nested lists of numbers, read as the first dtype the field takes"},
    ],
}


def checked_shape(given: Any) -> tuple[int, ...]:
    """`given` as the shape of an array of at most four dimensions."""
    if not isinstance(given, list) or len(given) > 4 or not all(type(n) is int and 0 <= n < 2**32 for n in given):
        raise InvalidMessage(f"expected at most four sizes ≥ 0, got {str(given)[:60]}", field="shape")
    return tuple(given)


def native(array: NDArray[Any]) -> NDArray[Any]:
    """`array` as numba likes it: aligned, in the machine's byte order, contiguous, read-only."""
    array = np.require(array, dtype=array.dtype.newbyteorder("="), requirements=("C", "A"))
    array.setflags(write=False)
    return array


def is_array_form(value: Any) -> bool:
    """Whether `value` is an array in its `{"shape", "dtype", "codec", "data"}` form."""
    return isinstance(value, Mapping) and len(value) == 4 and value.keys() == _FORM


def array_form(array: NDArray[Any], *, compress: bool, text: bool) -> dict[str, Any]:
    """`array` as `{"shape", "dtype", "codec", "data"}`; `data` in base64 when `text`."""
    array = np.asarray(array, order="C")
    name = array.dtype.newbyteorder("<").str
    if name not in DTYPES:
        raise InvalidMessage(f"an array of dtype {array.dtype} cannot be sent: expected one of {', '.join(DTYPES)}")
    data = (array if _LITTLE else array.astype(name)).tobytes()
    codec = "zstd" if compress and len(data) > 256 else "raw"
    if codec == "zstd":
        data = zstandard.ZstdCompressor(level=1).compress(data)
    form = {"shape": list(array.shape), "dtype": name, "codec": codec}
    return {**form, "data": base64.b64encode(data).decode("ascii") if text else data}


def array_of_form(form: Mapping[Any, Any], budget: Budget) -> NDArray[Any]:
    """The array of its `{"shape", "dtype", "codec", "data"}` form, read-only. Raises `InvalidMessage`."""
    shape = checked_shape(form["shape"])
    name = form["dtype"]
    dtype = DTYPES.get(_ALIASES.get(name, name)) if isinstance(name, str) else None
    if dtype is None:
        raise InvalidMessage(f"expected one of {', '.join(DTYPES)}, got {str(name)[:40]!r}", field="dtype")
    codec = form["codec"]
    if codec not in CODECS:
        raise InvalidMessage(f"expected one of {', '.join(CODECS)}, got {str(codec)[:40]!r}", field="codec")
    size = budget.spend_array(shape, dtype)
    data = _bytes_of(form["data"], size if codec == "raw" else None)
    if codec in _PICTURES:
        return _picture(data, codec, shape, dtype)
    if codec == "zstd":
        data = _decompressed(data, size)
    if len(data) != size:
        raise InvalidMessage(f"expected {size} bytes for {name} of shape {list(shape)}, got {len(data)}", field="data")
    array = np.frombuffer(data, dtype=dtype.newbyteorder("<")).reshape(shape)
    if dtype == np.bool_ and size and int(array.view(np.uint8).max()) > 1:
        raise InvalidMessage("expected truth values 0 and 1", field="data")
    return native(array)


def _bytes_of(data: Any, size: int | None) -> bytes:
    if isinstance(data, bytes):
        return data
    if not isinstance(data, str):
        raise InvalidMessage(f"expected bytes, or base64 text, got {type(data).__name__}", field="data")
    if size is not None and len(data) > 4 * (size // 3 + 2):
        raise InvalidMessage(f"expected base64 text of {size} bytes, got {len(data)} characters", field="data")
    try:
        return base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InvalidMessage(f"expected base64 text ({error})", field="data") from None


def _decompressed(data: bytes, size: int) -> bytes:
    try:
        declared = zstandard.frame_content_size(data)
        if declared not in (-1, size):
            raise InvalidMessage(f"expected a zstd frame of {size} bytes, it declares {declared}", field="data")
        if size == 0:
            return b""
        decompressor = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW)
        return decompressor.decompress(data, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise InvalidMessage(f"expected a zstd frame of {size} bytes ({error})", field="data") from None


def _picture(data: bytes, codec: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    modes = {("|u1", 2): ("L",), ("|u1", 3): ("RGB",), ("<u2", 2): ("I;16",)}.get(
        (dtype.newbyteorder("<").str, len(shape))
    )
    if modes is None or (len(shape) == 3 and shape[2] != 3) or (codec == "jpeg" and dtype != np.uint8) or 0 in shape:
        raise InvalidMessage(f"{codec} cannot hold {dtype} of shape {list(shape)}", field="codec")
    try:
        with Image.open(io.BytesIO(data), formats=[_PICTURES[codec]]) as picture:
            if picture.size != (shape[1], shape[0]) or picture.mode not in modes:
                raise InvalidMessage(
                    f"expected a {codec} of {shape[1]}×{shape[0]} pixels, mode {modes[0]}, "
                    f"got {picture.size[0]}×{picture.size[1]}, mode {picture.mode}",
                    field="data",
                )
            array = np.asarray(picture)
    except InvalidMessage:
        raise
    except Exception as error:  # a decoder that is fed garbage may raise anything
        raise InvalidMessage(
            f"expected a {codec} picture ({type(error).__name__}: {str(error)[:80]})", field="data"
        ) from None
    return native(array.astype(dtype, copy=False))
