"""A strict subset of CBOR (RFC 8949) with typed arrays (RFC 8746): plain values ⇄ bytes.

Read here rather than by a general library because every byte comes from strangers: no tags but arrays, no shared or
cyclic references, no big numbers, no duplicate keys; declared lengths are checked against what is there before memory
is taken. Arrays are joined into and cut out of the message with one copy each.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenegraph.service.arrays import (
    LIMITS,
    Budget,
    Limits,
    array_form,
    array_of_form,
    checked_shape,
    is_array_form,
    native,
)
from scenegraph.service.errors import InvalidMessage

__all__ = ["dumps", "loads"]

_ARRAY_TAG = 40
_SELF_DESCRIBED_TAG = 55799
_TYPED = {
    "|u1": 64,
    "<u2": 69,
    "<u4": 70,
    "<u8": 71,
    "|i1": 72,
    "<i2": 77,
    "<i4": 78,
    "<i8": 79,
    "<f2": 84,
    "<f4": 85,
    "<f8": 86,
}
_READ_TYPED: dict[int, np.dtype[Any]] = {
    **{tag: np.dtype(name) for name, tag in _TYPED.items()},
    **{tag: np.dtype(n) for tag, n in ((65, ">u2"), (66, ">u4"), (67, ">u8"), (73, ">i2"), (74, ">i4"), (75, ">i8"))},
    **{tag: np.dtype(n) for tag, n in ((80, ">f2"), (81, ">f4"), (82, ">f8"))},
}
_U16, _U32, _U64 = struct.Struct(">H"), struct.Struct(">I"), struct.Struct(">Q")
_F16, _F32, _F64 = struct.Struct(">e"), struct.Struct(">f"), struct.Struct(">d")
_HEADS = {24: (struct.Struct(">B"), 1), 25: (_U16, 2), 26: (_U32, 4), 27: (_U64, 8)}
_BREAK = object()
_INDEFINITE = -1


# -- writing -------------------------------------------------------------------------------------------------


def dumps(value: Any, *, compress: bool = False) -> bytes:
    """`value` (None, bool, int, float, str, bytes, list, tuple, mapping, array) as CBOR; `compress`: arrays by zstd."""
    parts: list[bytes | memoryview] = []
    _write(value, parts, compress)
    return b"".join(parts)


def _head(major: int, n: int) -> bytes:
    if n < 24:
        return bytes((major << 5 | n,))
    if n < 1 << 8:
        return bytes((major << 5 | 24, n))
    if n < 1 << 16:
        return bytes((major << 5 | 25,)) + _U16.pack(n)
    if n < 1 << 32:
        return bytes((major << 5 | 26,)) + _U32.pack(n)
    return bytes((major << 5 | 27,)) + _U64.pack(n)


def _write(value: Any, parts: list[bytes | memoryview], compress: bool) -> None:
    if isinstance(value, str):
        text = value.encode()
        parts.append(_head(3, len(text)) + text)
    elif value is None:
        parts.append(b"\xf6")
    elif isinstance(value, bool | np.bool_):
        parts.append(b"\xf5" if value else b"\xf4")
    elif isinstance(value, int | np.integer):
        number = int(value)
        if not -(2**64) <= number < 2**64:
            raise InvalidMessage(f"an integer beyond 64 bits cannot be sent: {number:.3g}")
        parts.append(_head(0, number) if number >= 0 else _head(1, -1 - number))
    elif isinstance(value, float | np.floating):
        parts.append(b"\xfb" + _F64.pack(value))
    elif isinstance(value, Mapping):
        parts.append(_head(5, len(value)))
        for key, item in value.items():
            _write(key, parts, compress)
            _write(item, parts, compress)
    elif isinstance(value, list | tuple):
        parts.append(_head(4, len(value)))
        for item in value:
            _write(item, parts, compress)
    elif isinstance(value, np.ndarray):
        _write_array(value, parts, compress)
    elif isinstance(value, bytes):
        parts.append(_head(2, len(value)))
        parts.append(value)
    else:
        raise InvalidMessage(f"a {type(value).__name__} cannot be sent")


def _write_array(array: NDArray[Any], parts: list[bytes | memoryview], compress: bool) -> None:
    tag = _TYPED.get(array.dtype.newbyteorder("<").str)
    if tag is None or (compress and array.nbytes > 256):
        _write(array_form(array, compress=compress or tag is None, text=False), parts, compress)
        return
    little = np.ascontiguousarray(array if sys.byteorder == "little" else array.astype(array.dtype.newbyteorder("<")))
    shape = b"".join(_head(0, n) for n in array.shape)
    parts.append(b"\xd8\x28\x82" + _head(4, array.ndim) + shape + _head(6, tag) + _head(2, array.nbytes))
    parts.append(little.data.cast("B") if array.size else b"")


# -- reading -------------------------------------------------------------------------------------------------


def loads(data: bytes, limits: Limits = LIMITS) -> Any:
    """The one value that `data` holds: plain values, with arrays as read-only numpy arrays. Raises `InvalidMessage`."""
    if len(data) > limits.message_bytes:
        raise InvalidMessage(f"expected at most {limits.message_bytes} bytes, got {len(data)}")
    reader = _Reader(data, Budget(limits))
    try:
        value = reader.value(0)
    except (IndexError, struct.error):
        raise InvalidMessage(f"the message ends too early, after {len(data)} bytes") from None
    if value is _BREAK:
        raise InvalidMessage("expected CBOR, got a stray break at byte 0")
    if reader.position != len(data):
        raise InvalidMessage(f"expected one value, got {len(data) - reader.position} bytes after it")
    return value


class _Reader:
    __slots__ = ("budget", "data", "position")

    def __init__(self, data: bytes, budget: Budget) -> None:
        self.data = data
        self.position = 0
        self.budget = budget

    def head(self) -> tuple[int, int, int]:
        """Major type, additional information and argument of the next item."""
        first = self.data[self.position]
        self.position += 1
        major, info = first >> 5, first & 31
        if info < 24:
            return major, info, info
        if info < 28:
            layout, size = _HEADS[info]
            (n,) = layout.unpack_from(self.data, self.position)
            self.position += size
            return major, info, n
        if info == 31 and major in (2, 3, 4, 5, 7):
            return major, info, _INDEFINITE
        raise InvalidMessage(f"expected CBOR, got byte 0x{first:02x} at {self.position - 1}")

    def value(self, depth: int) -> Any:
        start = self.position
        major, info, n = self.head()
        if major == 0:
            return n
        if major == 1:
            return -1 - n
        if major == 3:
            try:
                return self.chunk(3, n).decode()
            except UnicodeDecodeError as error:
                raise InvalidMessage(f"expected UTF-8 text at byte {start} ({error.reason})") from None
        if major == 2:
            return self.chunk(2, n)
        if major == 7:
            return self.simple(info, n, start)
        if depth >= self.budget.limits.depth:
            raise InvalidMessage(f"expected at most {self.budget.limits.depth} lists and mappings within each other")
        if major == 4:
            return self.sequence(n, depth + 1)
        if major == 5:
            return self.mapping(n, depth + 1)
        return self.tagged(n, depth + 1)

    def chunk(self, major: int, n: int) -> bytes:
        if n == _INDEFINITE:
            pieces = []
            while self.data[self.position] != 0xFF:
                inner, _, size = self.head()
                if inner != major or size == _INDEFINITE:
                    raise InvalidMessage(f"expected a piece of a string at byte {self.position}")
                pieces.append(self.chunk(major, size))
            self.position += 1
            return b"".join(pieces)
        end = self.position + n
        if end > len(self.data):
            raise InvalidMessage(
                f"the message ends too early: {n} bytes declared at byte {self.position}, {len(self.data)} in all"
            )
        piece = self.data[self.position : end]
        self.position = end
        return piece

    def simple(self, info: int, n: int, start: int) -> Any:
        if info == 27:
            return _F64.unpack_from(self.data, start + 1)[0]
        if info == 20 or info == 21:
            return info == 21
        if info == 22 or info == 23:
            return None
        if info == 26:
            return _F32.unpack_from(self.data, start + 1)[0]
        if info == 25:
            return _F16.unpack_from(self.data, start + 1)[0]
        if n == _INDEFINITE:
            return _BREAK
        raise InvalidMessage(f"simple value {n} at byte {start} means nothing here")

    def room(self, n: int, each: int) -> None:
        if n * each > len(self.data) - self.position:
            raise InvalidMessage(f"the message ends too early: {n} items declared at byte {self.position}")
        self.budget.spend_values(n * each)

    def sequence(self, n: int, depth: int) -> list[Any]:
        if n != _INDEFINITE:
            self.room(n, 1)
        items: list[Any] = []
        try:
            while len(items) != n:
                item = self.value(depth)
                if item is _BREAK:
                    if n == _INDEFINITE:
                        return items
                    raise InvalidMessage("a stray break")
                if n == _INDEFINITE:
                    self.budget.spend_values(1)
                items.append(item)
        except InvalidMessage as error:
            raise error.within(str(len(items))) from None
        return items

    def mapping(self, n: int, depth: int) -> Any:
        if n != _INDEFINITE:
            self.room(n, 2)
        result: dict[str | int, Any] = {}
        while len(result) != n:
            key = self.value(depth)
            if key is _BREAK and n == _INDEFINITE:
                break
            if type(key) is not str and type(key) is not int:
                raise InvalidMessage(f"expected text or numbers as keys, got {type(key).__name__}")
            if key in result:
                raise InvalidMessage(f"the key {str(key)[:40]!r} stands twice")
            try:
                item = self.value(depth)
                if item is _BREAK:
                    raise InvalidMessage("a stray break")
            except InvalidMessage as error:
                raise error.within(str(key)[:40]) from None
            if n == _INDEFINITE:
                self.budget.spend_values(2)
            result[key] = item
        return array_of_form(result, self.budget) if is_array_form(result) else result

    def tagged(self, tag: int, depth: int) -> Any:
        if tag in _READ_TYPED:
            return native(self.typed(tag))
        if tag == _SELF_DESCRIBED_TAG and depth == 1:
            return self.value(depth)
        if tag != _ARRAY_TAG:
            raise InvalidMessage(f"tag {tag} means nothing here: expected tag 40, an array of numbers")
        if self.head()[::2] != (4, 2):
            raise InvalidMessage("tag 40: expected [shape, typed array]")
        shape = checked_shape(self.value(depth))
        major, _, inner = self.head()
        if major != 6 or inner not in _READ_TYPED:
            raise InvalidMessage("tag 40: expected a typed array (tags 64 to 86 of RFC 8746) as the second item")
        array = self.typed(inner)
        if array.size != np.prod(shape, dtype=np.int64):
            raise InvalidMessage(f"tag 40: shape {list(shape)} does not fit {array.size} elements")
        return native(array.reshape(shape))

    def typed(self, tag: int) -> NDArray[Any]:
        """The typed array whose tag was read: a view of the message."""
        dtype = _READ_TYPED[tag]
        major, _, size = self.head()
        if major != 2 or size == _INDEFINITE:
            raise InvalidMessage(f"tag {tag}: expected a byte string of known length")
        if size > len(self.data) - self.position:
            raise InvalidMessage(
                f"the message ends too early: {size} bytes declared at byte {self.position}, {len(self.data)} in all"
            )
        if size % dtype.itemsize:
            raise InvalidMessage(f"tag {tag}: expected whole elements of {dtype.itemsize} bytes, got {size} bytes")
        self.budget.spend_array((size // dtype.itemsize,), dtype)
        array = np.frombuffer(self.data, dtype=dtype, count=size // dtype.itemsize, offset=self.position)
        self.position += size
        return array
