"""Field types of the graph's values: short finite vectors, identifiers, plain attributes; and their common base."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    PlainSerializer,
    PlainValidator,
    StringConstraints,
    ValidationError,
    WithJsonSchema,
)

from scenegraph.errors import InvalidGraphValue, one_line, shown

__all__ = ["Attributes", "Identifier", "Quaternion", "Value", "Vector3", "plain_attributes", "valid_identifier"]

_set_dict = object.__setattr__
_set_fields, _set_extra, _set_private = (
    vars(BaseModel)[f"__pydantic_{name}__"].__set__ for name in ("fields_set", "extra", "private")
)
_IDENTIFIER = re.compile(r"[a-z][a-z0-9_]*")

Identifier = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]*$", max_length=128)]
"""A Prolog atom and a key chunk at once: `[a-z][a-z0-9_]*`."""


def valid_identifier(text: str) -> bool:
    """Whether `text` can be an id or the name of a relation."""
    return len(text) <= 128 and _IDENTIFIER.fullmatch(text) is not None


class Value(BaseModel):
    """A frozen value, compared by content. A bad field raises `InvalidGraphValue` in one line.

    Unknown fields are refused when a program names them and ignored when they are read from the wire, where a newer
    server may have added some.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", arbitrary_types_allowed=True)

    def __init__(self, **fields: Any) -> None:
        unknown = fields.keys() - type(self).model_fields.keys()
        if unknown:
            name = type(self).__name__
            raise InvalidGraphValue(
                f"{name}: no such field: {', '.join(sorted(unknown))}; it has {', '.join(type(self).model_fields)}"
            )
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise InvalidGraphValue(one_line(error, type(self).__name__)) from None

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # values inside values skip the detour above

    @classmethod
    def trusted(cls, many: Iterable[dict[str, Any]]) -> list[Self]:
        """The values of these fields: all of them, checked before and of their final types. Takes the dicts over."""
        values, new, all_fields = [], cls.__new__, set(cls.model_fields)
        for fields in many:
            value = new(cls)
            _set_dict(value, "__dict__", fields)
            _set_fields(value, all_fields)
            _set_extra(value, None)
            _set_private(value, None)
            values.append(value)
        return values

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """The value of a JSON-like mapping (pydantic's `model_validate`), with one-line errors."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise InvalidGraphValue(one_line(error, cls.__name__)) from None

    @classmethod
    def model_validate_json(cls, json_data: str | bytes | bytearray, **options: Any) -> Self:
        """The value of a JSON text (pydantic's `model_validate_json`), with one-line errors."""
        try:
            return super().model_validate_json(json_data, **options)
        except ValidationError as error:
            raise InvalidGraphValue(one_line(error, cls.__name__)) from None


class Attributes(dict[str, Any]):
    """A dict that cannot be changed: a node's or edge's attributes, plain JSON values all the way down.

    To change an attribute, put a new value into the graph: `node.replace(attributes={**node.attributes, "color":
    "red"})`.
    """

    __slots__ = ()

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("attributes of a node or edge are read-only: put a changed node or edge into the graph instead")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = __ior__ = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, _: object) -> Self:
        return self


def _vector(given: Any, length: int) -> NDArray[np.float64]:
    """A read-only float64 copy of `given`, which must be `length` finite numbers."""
    if (
        type(given) is np.ndarray
        and given.dtype == np.float64
        and given.shape == (length,)
        and not given.flags.writeable
    ):
        array = given  # already one of ours, or as good: share it
    else:
        try:
            array = np.array(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"expected {length} numbers, got {shown(given)}") from None
        if array.shape != (length,):
            raise ValueError(f"expected {length} numbers, got shape {array.shape}: {shown(given)}")
        array.flags.writeable = False
    if not all(map(math.isfinite, array.tolist())):
        raise ValueError(f"expected {length} finite numbers, got {array.tolist()}")
    return array


def _vector3(given: Any) -> NDArray[np.float64]:
    return _vector(given, 3)


def _quaternion(given: Any) -> NDArray[np.float64]:
    array = _vector(given, 4)
    norm = math.sqrt(sum(c * c for c in array.tolist()))
    if abs(norm - 1.0) <= 1e-9:
        return array
    if abs(norm - 1.0) > 1e-2:
        raise ValueError(f"expected a unit quaternion (w, x, y, z), got {array.tolist()} of norm {norm:.4g}")
    array = array / norm
    array.flags.writeable = False
    return array


_PLAIN_TYPES = frozenset({type(None), bool, int, str})


def _plain(value: Any, path: str) -> Any:
    """A copy of `value` made of JSON's types only; numpy arrays and numbers become lists and numbers."""
    if type(value) in _PLAIN_TYPES:
        return value
    if isinstance(value, str):
        return str(value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{path}: expected a finite number, got {value}")
        return float(value)
    if isinstance(value, np.ndarray | np.generic):
        kind, plain = value.dtype.kind, value.tolist()
        return plain if kind in "biu" or (kind == "f" and np.isfinite(value).all()) else _plain(plain, path)
    if isinstance(value, dict | Mapping):
        for key in value:
            if not isinstance(key, str):
                raise ValueError(f"{path}: expected names as keys, got {shown(key)}")
        return {key: _plain(item, f"{path}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [
            item
            if type(item) in _PLAIN_TYPES or (type(item) is float and math.isfinite(item))
            else _plain(item, f"{path}[{i}]")
            for i, item in enumerate(value)
        ]
    raise ValueError(f"{path}: expected a JSON value (text, number, truth value, list, mapping), got {shown(value)}")


def plain_attributes(given: Any) -> Attributes:
    """`given` as attributes, copied; raises ValueError when it is not a mapping of plain JSON values."""
    if type(given) is Attributes:
        return given
    if not isinstance(given, dict | Mapping):
        raise ValueError(f"expected a mapping from names to values, got {shown(given)}")
    return Attributes(_plain(given, "attributes"))


def _array_schema(length: int) -> WithJsonSchema:
    return WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": length, "maxItems": length})


_as_list = PlainSerializer(np.ndarray.tolist, return_type=list[float])

Vector3 = Annotated[NDArray[np.float64], PlainValidator(_vector3), _as_list, _array_schema(3)]
"""(3,) float64, finite, read-only; a list on the wire."""

Quaternion = Annotated[NDArray[np.float64], PlainValidator(_quaternion), _as_list, _array_schema(4)]
"""(4,) float64 unit quaternion w, x, y, z, read-only; a list on the wire."""

PlainAttributes = Annotated[
    Attributes,
    PlainValidator(plain_attributes),
    PlainSerializer(dict, return_type=dict[str, Any]),
    WithJsonSchema({"type": "object"}),
]
"""`Attributes`; a JSON object on the wire."""
