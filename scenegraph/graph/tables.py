"""Many nodes and edges as columns: checked as arrays, small in memory, each value made when it is asked for."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from scenegraph.errors import DanglingEdge, InvalidGraphValue, InvariantViolated
from scenegraph.graph.edge import Edge
from scenegraph.graph.node import LAYERS, Box, Layer, Node
from scenegraph.graph.values import Attributes, plain_attributes, valid_identifier

__all__ = ["EdgeTable", "NodeTable"]

V = TypeVar("V", Node, Edge)

_NODE_COLUMNS = (
    *("layer", "label", "position", "boxed", "center", "size", "rotation_wxyz"),
    *("confidence", "first_seen_ns", "last_seen_ns"),
)
_EDGE_COLUMNS = (
    *("relation", "source", "target", "value", "threshold", "confidence"),
    *("first_seen_ns", "last_seen_ns", "evidence_of"),
)
_NO_ATTRIBUTES = Attributes()
_NO_ROTATION = (1.0, 0.0, 0.0, 0.0)


class _Table(Sequence[V]):
    """Rows that are made when asked for."""

    @abstractmethod
    def rows(self, rows: NDArray[np.integer[Any]]) -> list[V]:
        """The values of these rows, in order."""

    @overload
    def __getitem__(self, at: int) -> V: ...
    @overload
    def __getitem__(self, at: slice) -> list[V]: ...
    def __getitem__(self, at: int | slice) -> V | list[V]:
        if isinstance(at, slice):
            return self.rows(np.arange(*at.indices(len(self))))
        return self._row(range(len(self))[at])

    def _row(self, n: int) -> V:
        return self.rows(np.array([n]))[0]

    def __iter__(self) -> Iterator[V]:
        for start in range(0, len(self), 1024):
            yield from self.rows(np.arange(start, min(start + 1024, len(self))))


@dataclass(frozen=True, eq=False)
class NodeTable(_Table[Node]):
    """Nodes by row; a sequence of `Node`. Made by `columns`, which checks, or `of` nodes, which are checked already.

    ids        : all different
    layer      : (n,) uint8, index into `LAYERS`
    label      : (n,) int32, index into `labels`
    position, center, size : (n, 3) float64 [m];  rotation_wxyz : (n, 4)
    boxed      : (n,) whether there is a box; without one, center, size and rotation mean nothing
    confidence : (n,);  first_seen_ns, last_seen_ns : (n,) int64
    attributes : by row, where there are any
    """

    ids: tuple[str, ...]
    layer: NDArray[np.uint8]
    labels: tuple[str, ...]
    label: NDArray[np.int32]
    position: NDArray[np.float64]
    boxed: NDArray[np.bool_]
    center: NDArray[np.float64]
    size: NDArray[np.float64]
    rotation_wxyz: NDArray[np.float64]
    confidence: NDArray[np.float64]
    first_seen_ns: NDArray[np.int64]
    last_seen_ns: NDArray[np.int64]
    attributes: Mapping[int, Attributes] = field(default_factory=dict)

    @classmethod
    def columns(
        cls,
        ids: Iterable[str],
        layers: Layer | Sequence[Layer],
        labels: str | Sequence[str],
        *,
        position: ArrayLike | None = None,
        center: ArrayLike | None = None,
        size: ArrayLike | None = None,
        yaw: ArrayLike | None = None,
        rotation_wxyz: ArrayLike | None = None,
        boxed: ArrayLike = True,
        confidence: ArrayLike = 1.0,
        first_seen_ns: ArrayLike = 0,
        last_seen_ns: ArrayLike | None = None,
        attributes: Mapping[int, Mapping[str, Any]] | None = None,
    ) -> NodeTable:
        """The table of these columns, copied and checked; one value stands for a whole column.

        position is that of the box's centre where it is left out, and the centre that of the position; without `size`
        no node has a box, and `boxed` says which have one. Boxes are turned by `yaw` [rad] or by `rotation_wxyz`.
        Raises InvalidGraphValue, which names the row and the field.
        """
        names = tuple(ids)
        n = len(names)
        middle = None if center is None else _column("center", center, np.float64, (n, 3), names)
        where = middle if position is None else _column("position", position, np.float64, (n, 3), names)
        where, middle = (middle if where is None else where), (where if middle is None else middle)
        if where is None or middle is None:
            raise InvalidGraphValue("NodeTable: position: required, but missing, as is center")
        extent = _column("size", 0.0 if size is None else size, np.float64, (n, 3), names)
        _refuse(names, extent.min(axis=1, initial=0.0) < 0.0, "size", "expected edge lengths ≥ 0", extent)
        has_box = _column("boxed", size is not None and boxed, np.bool_, (n,), names)
        first = _column("first_seen_ns", first_seen_ns, np.int64, (n,), names)
        last = first if last_seen_ns is None else _column("last_seen_ns", last_seen_ns, np.int64, (n,), names)
        _refuse(names, first > last, "first_seen_ns", "expected one no later than last_seen_ns", first)
        layer, layer_names = _coded("layer", layers, n, names)
        for name in layer_names:
            if name not in LAYERS:
                raise InvalidGraphValue(f"NodeTable: layer: expected one of {', '.join(LAYERS)}, got {name!r}")
        label, label_names = _coded("label", labels, n, names)
        _check_ids("NodeTable: id", names)
        if len(set(names)) != n:
            raise InvalidGraphValue("NodeTable: id: expected different ids, got one twice")
        return cls(
            ids=names,
            layer=_frozen(np.array([LAYERS.index(name) for name in layer_names], np.uint8)[layer]),
            labels=label_names,
            label=label,
            position=where,
            boxed=has_box,
            center=middle,
            size=extent,
            rotation_wxyz=_rotations(yaw, rotation_wxyz, n, names),
            confidence=_share("confidence", confidence, n, names),
            first_seen_ns=first,
            last_seen_ns=last,
            attributes=_attributes_by_row(attributes, n),
        )

    @classmethod
    def of(cls, nodes: Iterable[Node], *, different: bool = True) -> NodeTable:
        """The table of these nodes. Raises InvariantViolated when an id is there twice but all must be different."""
        rows = list(nodes)
        names = tuple(node.id for node in rows)
        if different and len(set(names)) != len(names):
            raise InvariantViolated("two nodes have the same id")
        labels = {node.label: None for node in rows}
        code = {label: i for i, label in enumerate(labels)}
        layer = {name: i for i, name in enumerate(LAYERS)}
        boxes = [node.box for node in rows]
        none = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), _NO_ROTATION)
        center, size, rotation = (
            [n if b is None else getattr(b, k) for b in boxes]
            for k, n in zip(("center", "size", "rotation_wxyz"), none, strict=True)
        )
        return cls(
            ids=names,
            layer=_frozen(np.array([layer[node.layer] for node in rows], np.uint8)),
            labels=tuple(labels),
            label=_frozen(np.array([code[node.label] for node in rows], np.int32)),
            position=_matrix([node.position for node in rows], 3),
            boxed=_frozen(np.array([box is not None for box in boxes], np.bool_)),
            center=_matrix(center, 3),
            size=_matrix(size, 3),
            rotation_wxyz=_matrix(rotation, 4),
            confidence=_frozen(np.array([node.confidence for node in rows], np.float64)),
            first_seen_ns=_stamps("first_seen_ns", [node.first_seen_ns for node in rows]),
            last_seen_ns=_stamps("last_seen_ns", [node.last_seen_ns for node in rows]),
            attributes={i: node.attributes for i, node in enumerate(rows) if node.attributes},
        )

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, rows: NDArray[np.integer[Any]]) -> NodeTable:
        """The table of these rows, in this order."""
        columns = {name: _frozen(getattr(self, name)[rows]) for name in _NODE_COLUMNS}
        ids, numbers = self.ids, rows.tolist()
        attributes = {k: self.attributes[n] for k, n in enumerate(numbers) if n in self.attributes}
        return NodeTable(ids=tuple(ids[n] for n in numbers), labels=self.labels, attributes=attributes, **columns)

    def joined(self, other: NodeTable) -> NodeTable:
        """The rows of this table, and then those of another."""
        labels = {label: n for n, label in enumerate(dict.fromkeys((*self.labels, *other.labels)))}
        recode = np.array([labels[label] for label in other.labels], np.int32)
        columns = {
            name: _frozen(np.concatenate([getattr(self, name), getattr(other, name)]))
            for name in _NODE_COLUMNS
            if name != "label"
        }
        return NodeTable(
            ids=(*self.ids, *other.ids),
            labels=tuple(labels),
            label=_frozen(np.concatenate([self.label, recode[other.label]])),
            attributes={**self.attributes, **{len(self) + n: given for n, given in other.attributes.items()}},
            **columns,
        )

    def rows(self, rows: NDArray[np.integer[Any]]) -> list[Node]:
        """The nodes of these rows, in order."""
        numbers, attributes = rows.tolist(), self.attributes
        boxed = self.boxed[rows]
        corners = (_frozen(column[rows]) for column in (self.center, self.size, self.rotation_wxyz))
        boxes: list[Box | None] = [
            *Box.trusted({"center": c, "size": s, "rotation_wxyz": r} for c, s, r in zip(*corners, strict=True))
        ]
        if not boxed.all():
            boxes = [box if has else None for box, has in zip(boxes, boxed.tolist(), strict=True)]
        return Node.trusted(
            {
                "id": self.ids[n],
                "layer": LAYERS[layer],
                "label": self.labels[label],
                "position": position,
                "box": box,
                "confidence": confidence,
                "first_seen_ns": first,
                "last_seen_ns": last,
                "attributes": attributes.get(n, _NO_ATTRIBUTES),
            }
            for n, layer, label, position, box, confidence, first, last in zip(
                numbers,
                self.layer[rows].tolist(),
                self.label[rows].tolist(),
                _frozen(self.position[rows]),
                boxes,
                self.confidence[rows].tolist(),
                self.first_seen_ns[rows].tolist(),
                self.last_seen_ns[rows].tolist(),
                strict=True,
            )
        )


@dataclass(frozen=True, eq=False)
class EdgeTable(_Table[Edge]):
    """Edges by row between the nodes `ids`; a sequence of `Edge`. Made by `columns`, which checks, or `of` edges.

    relation       : (m,) uint16, index into `relations`
    source, target : (m,) int32, index into `ids`
    value, threshold : (m,) float64; NaN where there is none
    confidence     : (m,);  first_seen_ns, last_seen_ns : (m,) int64
    evidence       : the different lists of observations;  evidence_of : (m,) int32, index into them
    attributes     : by row, where there are any
    """

    ids: tuple[str, ...]
    relations: tuple[str, ...]
    relation: NDArray[np.uint16]
    source: NDArray[np.int32]
    target: NDArray[np.int32]
    value: NDArray[np.float64]
    threshold: NDArray[np.float64]
    confidence: NDArray[np.float64]
    first_seen_ns: NDArray[np.int64]
    last_seen_ns: NDArray[np.int64]
    evidence: tuple[tuple[str | int, ...], ...] = ((),)
    evidence_of: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    attributes: Mapping[int, Attributes] = field(default_factory=dict)

    @classmethod
    def columns(
        cls,
        ids: tuple[str, ...],
        relations: str | Sequence[str],
        source: ArrayLike,
        target: ArrayLike,
        *,
        value: ArrayLike = np.nan,
        threshold: ArrayLike = np.nan,
        confidence: ArrayLike = 1.0,
        first_seen_ns: ArrayLike = 0,
        last_seen_ns: ArrayLike | None = None,
        evidence: tuple[str | int, ...] = (),
        attributes: Mapping[int, Mapping[str, Any]] | None = None,
    ) -> EdgeTable:
        """The table of these columns; one value stands for a whole column. `source` and `target` are rows of `ids`.

        Raises InvalidGraphValue, which names the row and the field.
        """
        m = len(np.asarray(source))
        rows = range(m)
        first = _column("first_seen_ns", first_seen_ns, np.int64, (m,), rows)
        last = first if last_seen_ns is None else _column("last_seen_ns", last_seen_ns, np.int64, (m,), rows)
        _refuse(rows, first > last, "first_seen_ns", "expected one no later than last_seen_ns", first)
        relation, names = _coded("relation", relations, m, rows)
        _check_ids("EdgeTable: relation", names)
        ends = [_column(k, v, np.int64, (m,), rows) for k, v in (("source", source), ("target", target))]
        for k, end in zip(("source", "target"), ends, strict=True):
            _refuse(rows, (end < 0) | (end >= len(ids)), k, f"expected a row of the {len(ids)} nodes", end)
        _refuse(rows, ends[0] == ends[1], "target", "expected two different ends", ends[1])
        return cls(
            ids=ids,
            relations=names,
            relation=_frozen(relation.astype(np.uint16)),
            source=_frozen(ends[0].astype(np.int32)),
            target=_frozen(ends[1].astype(np.int32)),
            value=_column("value", value, np.float64, (m,), rows, finite=False),
            threshold=_column("threshold", threshold, np.float64, (m,), rows, finite=False),
            confidence=_share("confidence", confidence, m, rows),
            first_seen_ns=first,
            last_seen_ns=last,
            evidence=(evidence,),
            evidence_of=np.broadcast_to(np.int32(0), m),
            attributes=_attributes_by_row(attributes, m),
        )

    @classmethod
    def of(cls, edges: Iterable[Edge], row_of: Mapping[str, int], ids: tuple[str, ...]) -> EdgeTable:
        """The table of these edges between nodes whose rows are given. Raises DanglingEdge."""
        rows = list(edges)
        code: dict[str, int] = {}
        evidence: dict[tuple[str | int, ...], int] = {}
        try:
            ends = [(row_of[edge.source], row_of[edge.target]) for edge in rows]
        except KeyError as error:
            raise DanglingEdge(f"an edge has an end {error.args[0]!r} that is not a node of the graph") from None
        return cls(
            ids=ids,
            relation=_frozen(np.array([code.setdefault(edge.relation, len(code)) for edge in rows], np.uint16)),
            relations=tuple(code),
            source=_frozen(np.array([a for a, _ in ends], np.int32)),
            target=_frozen(np.array([b for _, b in ends], np.int32)),
            value=_frozen(np.array([np.nan if edge.value is None else edge.value for edge in rows], np.float64)),
            threshold=_frozen(
                np.array([np.nan if edge.threshold is None else edge.threshold for edge in rows], np.float64)
            ),
            confidence=_frozen(np.array([edge.confidence for edge in rows], np.float64)),
            first_seen_ns=_stamps("first_seen_ns", [edge.first_seen_ns for edge in rows]),
            last_seen_ns=_stamps("last_seen_ns", [edge.last_seen_ns for edge in rows]),
            evidence_of=_frozen(
                np.array([evidence.setdefault(edge.evidence, len(evidence)) for edge in rows], np.int32)
            ),
            evidence=tuple(evidence) or ((),),
            attributes={i: edge.attributes for i, edge in enumerate(rows) if edge.attributes},
        )

    def __len__(self) -> int:
        return len(self.source)

    def take(self, rows: NDArray[np.integer[Any]]) -> EdgeTable:
        """The table of these rows, in this order."""
        columns: dict[str, Any] = {name: _frozen(getattr(self, name)[rows]) for name in _EDGE_COLUMNS}
        attributes = (
            {k: self.attributes[n] for k, n in enumerate(rows.tolist()) if n in self.attributes}
            if self.attributes
            else {}
        )
        return replace(self, attributes=attributes, **columns)

    def between(self, ids: tuple[str, ...], row_of: NDArray[np.integer[Any]]) -> EdgeTable:
        """The same edges between nodes in other rows: the node of row n is now that of row `row_of[n]` of `ids`."""
        source, target = (_frozen(row_of[end].astype(np.int32)) for end in (self.source, self.target))
        return replace(self, ids=ids, source=source, target=target)

    def joined(self, other: EdgeTable) -> EdgeTable:
        """The edges of this table, and then those of another between the same nodes."""
        if self.ids is not other.ids and self.ids != other.ids:
            raise InvariantViolated("two tables of edges differ in their nodes")
        relations = {name: n for n, name in enumerate(dict.fromkeys((*self.relations, *other.relations)))}
        evidence = {items: n for n, items in enumerate(dict.fromkeys((*self.evidence, *other.evidence)))}
        recode = np.array([relations[name] for name in other.relations], np.uint16)
        again = np.array([evidence[items] for items in other.evidence], np.int32)
        columns = {
            name: _frozen(np.concatenate([getattr(self, name), getattr(other, name)]))
            for name in _EDGE_COLUMNS
            if name not in ("relation", "evidence_of")
        }
        return EdgeTable(
            ids=self.ids,
            relations=tuple(relations),
            relation=_frozen(np.concatenate([self.relation, recode[other.relation]])),
            evidence=tuple(evidence),
            evidence_of=_frozen(np.concatenate([self.evidence_of, again[other.evidence_of]])),
            attributes={**self.attributes, **{len(self) + n: given for n, given in other.attributes.items()}},
            **columns,
        )

    def rows(self, rows: NDArray[np.integer[Any]]) -> list[Edge]:
        """The edges of these rows, in order."""
        ids, attributes = self.ids, self.attributes
        return Edge.trusted(
            {
                "relation": self.relations[relation],
                "source": ids[source],
                "target": ids[target],
                "value": None if value != value else value,
                "threshold": None if threshold != threshold else threshold,
                "confidence": confidence,
                "evidence": self.evidence[evidence],
                "first_seen_ns": first,
                "last_seen_ns": last,
                "attributes": attributes.get(n, _NO_ATTRIBUTES) if attributes else _NO_ATTRIBUTES,
            }
            for n, relation, source, target, value, threshold, confidence, evidence, first, last in zip(
                rows.tolist(),
                self.relation[rows].tolist(),
                self.source[rows].tolist(),
                self.target[rows].tolist(),
                self.value[rows].tolist(),
                self.threshold[rows].tolist(),
                self.confidence[rows].tolist(),
                self.evidence_of[rows].tolist(),
                self.first_seen_ns[rows].tolist(),
                self.last_seen_ns[rows].tolist(),
                strict=True,
            )
        )

    def _row(self, n: int) -> Edge:
        value, threshold = float(self.value[n]), float(self.threshold[n])
        fields = {
            "relation": self.relations[self.relation[n]],
            "source": self.ids[self.source[n]],
            "target": self.ids[self.target[n]],
            "value": None if value != value else value,
            "threshold": None if threshold != threshold else threshold,
            "confidence": float(self.confidence[n]),
            "evidence": self.evidence[self.evidence_of[n]],
            "first_seen_ns": int(self.first_seen_ns[n]),
            "last_seen_ns": int(self.last_seen_ns[n]),
            "attributes": self.attributes.get(n, _NO_ATTRIBUTES),
        }
        return Edge.trusted([fields])[0]


# -- columns ----------------------------------------------------------------------------------------------------------


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array


def _matrix(rows: list[Any], width: int) -> NDArray[np.float64]:
    return _frozen(np.array(rows, np.float64).reshape(len(rows), width))


def _stamps(name: str, values: list[int]) -> NDArray[np.int64]:
    try:
        return _frozen(np.array(values, np.int64))
    except OverflowError:
        raise InvalidGraphValue(f"{name}: expected a stamp of at most 64 bits, got {max(values, key=abs)}") from None


def _column(
    name: str, given: ArrayLike, dtype: DTypeLike, shape: tuple[int, ...], rows: Sequence[Any], *, finite: bool = True
) -> NDArray[Any]:
    """A read-only column of this shape; one value is repeated without being copied."""
    try:
        array = np.array(given, dtype=dtype)
    except (TypeError, ValueError, OverflowError):
        raise InvalidGraphValue(
            f"{name}: expected {np.dtype(dtype)} of shape {shape}, got {type(given).__name__}"
        ) from None
    if array.shape in ((), shape[1:]) and array.shape != shape:
        array = np.broadcast_to(array, shape)
    elif array.shape != shape:
        raise InvalidGraphValue(f"{name}: expected shape {shape}, got {array.shape}")
    else:
        array.flags.writeable = False
    if array.dtype.kind == "f":
        bad = ~np.isfinite(array) if finite else np.isinf(array)
        _refuse(rows, bad if bad.ndim == 1 else bad.any(axis=1), name, "expected finite numbers", array)
    return array


def _refuse(rows: Sequence[Any], bad: NDArray[np.bool_], name: str, expected: str, got: NDArray[Any]) -> None:
    """Raise for the first row that is bad."""
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InvalidGraphValue(f"row {row} ({rows[row]}): {name}: {expected}, got {got[row].tolist()}")


def _share(name: str, given: ArrayLike, n: int, rows: Sequence[Any]) -> NDArray[np.float64]:
    column = _column(name, given, np.float64, (n,), rows)
    _refuse(rows, (column < 0.0) | (column > 1.0), name, "expected a number from 0 to 1", column)
    return column


def _rotations(
    yaw: ArrayLike | None, rotation_wxyz: ArrayLike | None, n: int, rows: Sequence[Any]
) -> NDArray[np.float64]:
    if yaw is not None and rotation_wxyz is not None:
        raise InvalidGraphValue("yaw: expected either a yaw or rotation_wxyz, got both")
    if yaw is not None:
        half = 0.5 * _column("yaw", yaw, np.float64, (n,), rows)
        turned = np.zeros((n, 4))
        turned[:, 0], turned[:, 3] = np.cos(half), np.sin(half)
        return _frozen(turned)
    if rotation_wxyz is None:
        return np.broadcast_to(np.array(_NO_ROTATION), (n, 4))
    given = _column("rotation_wxyz", rotation_wxyz, np.float64, (n, 4), rows)
    norm = np.linalg.norm(given, axis=1)
    _refuse(rows, np.abs(norm - 1.0) > 1e-2, "rotation_wxyz", "expected a unit quaternion (w, x, y, z)", given)
    return given if (np.abs(norm - 1.0) <= 1e-9).all() else _frozen(given / norm[:, None])


def _coded(
    name: str, given: str | Sequence[str], n: int, rows: Sequence[Any]
) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """Texts as numbers, and what each number stands for."""
    if isinstance(given, str):
        return np.broadcast_to(np.int32(0), n), (given,)
    if len(given) != n:
        raise InvalidGraphValue(f"{name}: expected {n} texts, got {len(given)}")
    code: dict[str, int] = {}
    numbers = [code.setdefault(text, len(code)) for text in given]
    for text in code:
        if not isinstance(text, str):
            raise InvalidGraphValue(f"{name}: expected texts, got {text!r} in row {rows[numbers.index(code[text])]}")
    return _frozen(np.array(numbers, np.int32)), tuple(code)


def _check_ids(field_name: str, names: Iterable[str]) -> None:
    for name in names:
        if not isinstance(name, str) or not valid_identifier(name):
            raise InvalidGraphValue(f"{field_name}: expected [a-z][a-z0-9_]*, at most 128 characters, got {name!r}")


def _attributes_by_row(given: Mapping[int, Mapping[str, Any]] | None, n: int) -> dict[int, Attributes]:
    """Checked as those of a node are."""
    checked: dict[int, Attributes] = {}
    for row, attributes in (given or {}).items():
        if not 0 <= row < n:
            raise InvalidGraphValue(f"attributes: expected rows of 0 … {n - 1}, got {row}")
        try:
            checked[row] = plain_attributes(attributes)
        except ValueError as error:
            raise InvalidGraphValue(f"row {row}: attributes: {error}") from None
    return checked
