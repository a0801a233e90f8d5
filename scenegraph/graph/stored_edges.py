"""Edges that came as a table: found by relation, source and target without being made, and crossed out one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scenegraph.errors import InvariantViolated
from scenegraph.graph.edge import Edge
from scenegraph.graph.tables import EdgeTable

__all__ = ["StoredEdges"]

Rows = NDArray[np.int32]
_NO_ROWS: Rows = np.empty(0, np.int32)


class StoredEdges:
    """The rows of an edge table, indexed by their ends, less those that were dropped.

    A row costs some 20 bytes here beside what it has in the table; an edge that is asked for is made once and kept.
    Raises InvariantViolated when two rows have the same relation, source and target.
    """

    def __init__(self, table: EdgeTable) -> None:
        self.table = table
        self._code = {name: code for code, name in enumerate(table.relations)}
        self._row_of = _ByEnd(table, table.source, table.target)
        self._by_target = _ByEnd(table, table.target, table.source)
        del self._by_target.key  # looked up from one end only
        self._alive = np.ones(len(table), np.bool_)
        self._left = (
            np.bincount(table.relation, minlength=len(table.relations)) if len(table) else np.zeros(0, np.int64)
        )
        self._made: dict[int, Edge] = {}
        twice = self._row_of.first_repeated()
        if twice is not None:
            edge = table[twice]
            raise InvariantViolated(f"edge {edge.relation}({edge.source}, {edge.target}) is there twice")

    def copy(self) -> Self:
        """Another one that loses rows of its own."""
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._alive, other._left, other._made = self._alive.copy(), self._left.copy(), self._made.copy()
        return other

    def __len__(self) -> int:
        """How many are left."""
        return int(self._left.sum())

    def left(self) -> EdgeTable:
        """The table of those that are left."""
        return self.table if self._alive.all() else self.table.take(np.flatnonzero(self._alive))

    def relations(self) -> list[str]:
        """The relations of those that are left."""
        return [name for name, left in zip(self.table.relations, self._left.tolist(), strict=False) if left]

    def find(self, relation: str, source: int, target: int) -> int:
        """The row of this edge between two rows of nodes, −1 when there is none."""
        code = self._code.get(relation)
        row = -1 if code is None else self._row_of.find(source, code, target)
        return row if row >= 0 and self._alive[row] else -1

    def drop(self, row: int) -> None:
        """Cross out a row."""
        self._alive[row] = False
        self._left[self.table.relation[row]] -= 1
        self._made.pop(row, None)

    def rows_from(self, source: int, relation: str | None) -> Rows:
        """The rows that begin at a row of nodes."""
        return self._rows_at(self._row_of, source, relation)

    def rows_to(self, target: int, relation: str | None) -> Rows:
        """The rows that end at a row of nodes."""
        return self._rows_at(self._by_target, target, relation)

    def rows_at(self, ends: Iterable[int], relations: Iterable[str], *, begins: bool) -> Rows:
        """The rows of some relations that begin, or end, at any of some rows of nodes."""
        index = self._row_of if begins else self._by_target
        rows = np.concatenate([_NO_ROWS, *(index.rows(end) for end in ends)])
        wanted = np.zeros(len(self.table.relations), np.bool_)
        wanted[[self._code[name] for name in relations if name in self._code]] = True
        found: Rows = rows[self._alive[rows] & wanted[self.table.relation[rows]]]
        return found

    def rows_of(self, relation: str | None) -> NDArray[np.integer[Any]]:
        """All rows of a relation."""
        if relation is None:
            return np.flatnonzero(self._alive)
        code = self._code.get(relation)
        return (
            np.flatnonzero(self._alive & (self.table.relation == code)) if code is not None else np.empty(0, np.int32)
        )

    def made(self, rows: NDArray[np.integer[Any]]) -> list[Edge]:
        """The edges of these rows; the same row always gives the same value."""
        numbers = rows.tolist()
        missing = [n for n in numbers if n not in self._made]
        if len(missing) == 1:
            self._made[missing[0]] = self.table[missing[0]]
        elif missing:
            self._made.update(zip(missing, self.table.rows(np.array(missing)), strict=True))
        return [self._made[n] for n in numbers]

    def __iter__(self) -> Iterator[Edge]:
        rows = self.rows_of(None)
        for start in range(0, len(rows), 4096):
            yield from self.made(rows[start : start + 4096])

    def _rows_at(self, index: _ByEnd, end: int, relation: str | None) -> Rows:
        rows = index.rows(end)
        rows = rows[self._alive[rows]]
        if relation is not None:
            rows = rows[self.table.relation[rows] == self._code.get(relation, -1)]
        return rows


class _ByEnd:
    """Rows sorted by one end, then relation, then the other end."""

    def __init__(self, table: EdgeTable, here: NDArray[np.int32], there: NDArray[np.int32]) -> None:
        self._n, self._m = len(table.ids), max(1, len(table.relations))
        if self._n * self._n * self._m >= 1 << 62:
            raise InvariantViolated(f"{self._n} nodes are too many for edges of {self._m} relations")
        key = (here.astype(np.int64) * self._m + table.relation) * self._n + there
        self._order = np.argsort(key, kind="stable").astype(np.int32)
        self._start = np.zeros(self._n + 1, np.int32)
        np.cumsum(np.bincount(here, minlength=self._n), out=self._start[1:])
        self.key = key[self._order]

    def rows(self, end: int) -> Rows:
        return self._order[self._start[end] : self._start[end + 1]] if end < self._n else self._order[:0]

    def find(self, end: int, code: int, other: int) -> int:
        """The row of a key; −1 when there is none."""
        if end >= self._n or other >= self._n:
            return -1
        key = (end * self._m + code) * self._n + other
        at = int(self.key.searchsorted(key))
        return int(self._order[at]) if at < len(self.key) and self.key[at] == key else -1

    def first_repeated(self) -> int | None:
        same = np.flatnonzero(self.key[1:] == self.key[:-1])
        return int(self._order[same[0]]) if len(same) else None
