"""Plain values ⇄ bytes in the two encodings of the wire, CBOR and JSON, with arrays in both.

`form_of` reads a Zenoh encoding such as `application/cbor;RgbdImage`. A message without an encoding is looked at: a
JSON message begins with a brace, and no CBOR mapping does.
"""

from __future__ import annotations

import json
from typing import Any, Literal, NoReturn

import numpy as np

from scenegraph.service import cbor
from scenegraph.service.arrays import LIMITS, Budget, Limits, array_form, array_of_form, is_array_form
from scenegraph.service.errors import InvalidMessage

__all__ = ["CBOR", "JSON", "Form", "dumps", "form_of", "loads", "media_type"]

Form = Literal["cbor", "json"]
CBOR: Form = "cbor"
JSON: Form = "json"

_MEDIA: dict[str, Form] = {"application/cbor": "cbor", "application/json": "json", "text/json": "json"}
_UNTOLD = frozenset(("", "zenoh/bytes", "application/octet-stream", "zenoh/string", "text/plain"))


def media_type(form: Form, model: str) -> str:
    """The encoding of a message of this model: `application/cbor;RgbdImage`."""
    return f"application/{form};{model}"


def form_of(encoding: str, data: bytes) -> tuple[Form, str | None]:
    """The form and the model name that an encoding tells, or that the first byte shows. Raises `InvalidMessage`."""
    media, _, model = encoding.partition(";")
    form = _MEDIA.get(media)
    if form is None:
        if media not in _UNTOLD:
            raise InvalidMessage(
                f"expected application/cbor or application/json, got {encoding[:60]!r}", field="encoding"
            )
        form = JSON if data[:64].lstrip()[:1] in (b"{", b"[") else CBOR
    return form, model or None


def dumps(value: Any, form: Form, *, compress: bool = False) -> bytes:
    """`value` as bytes; arrays in the form's own way, compressed by zstd when asked."""
    if form == CBOR:
        return cbor.dumps(value, compress=compress)

    def array(item: Any) -> Any:
        if isinstance(item, np.ndarray):
            return array_form(item, compress=compress, text=True)
        if isinstance(item, np.generic):
            return item.item()
        raise InvalidMessage(f"a {type(item).__name__} cannot be sent")

    try:
        return json.dumps(value, default=array, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()
    except ValueError as error:
        raise InvalidMessage(f"not a JSON value ({error})") from None


def loads(data: bytes, form: Form, limits: Limits = LIMITS) -> Any:
    """The value of `data`, arrays as read-only numpy arrays. Raises `InvalidMessage`, and nothing else."""
    if form == CBOR:
        return cbor.loads(data, limits)
    if len(data) > limits.message_bytes:
        raise InvalidMessage(f"expected at most {limits.message_bytes} bytes, got {len(data)}")
    try:
        value = json.loads(data.decode(), parse_constant=_no_constant, object_pairs_hook=_no_duplicates)
    except InvalidMessage:
        raise
    except RecursionError:
        raise InvalidMessage(f"expected at most {limits.depth} lists and mappings within each other") from None
    except ValueError as error:
        raise InvalidMessage(f"expected JSON ({error})") from None
    return _with_arrays(value, 0, Budget(limits))


def _no_constant(name: str) -> NoReturn:
    raise InvalidMessage(f"expected finite numbers, got {name}")


def _no_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        names = [name for name, _ in pairs]
        raise InvalidMessage(f"the key {next(n for n in names if names.count(n) > 1)[:40]!r} stands twice")
    return result


def _with_arrays(value: Any, depth: int, budget: Budget) -> Any:
    if not isinstance(value, dict | list):
        return value
    if depth >= budget.limits.depth:
        raise InvalidMessage(f"expected at most {budget.limits.depth} lists and mappings within each other")
    budget.spend_values(len(value))
    if isinstance(value, list):
        if not any(isinstance(item, dict | list) for item in value):
            return value
        steps: Any = enumerate(value)
    elif is_array_form(value):
        return array_of_form(value, budget)
    else:
        steps = value.items()
    for step, item in steps:
        if isinstance(item, dict | list):
            try:
                value[step] = _with_arrays(item, depth + 1, budget)
            except InvalidMessage as error:
                raise error.within(str(step)[:40]) from None
    return value
