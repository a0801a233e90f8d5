"""Flat pieces of a surface, as sums over the samples of each block: what a `PlaneMap` keeps."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.coverage import Coverage, PlaneFrame
from mapping.kernels import planes as kernels

Array: TypeAlias = NDArray[Any]
Key: TypeAlias = tuple[int, int, int]

_SPAN, _HALF = 1 << 20, 1 << 19  # places are numbered within ± 2¹⁹ along each axis
_BESIDE: NDArray[np.int64] = np.array(
    [(i * _SPAN + j) * _SPAN + k for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)], np.int64
)
_CENTRE = slice(13, 14)  # where a place itself stands among those beside it
_TURNED = float(np.cos(np.deg2rad(10.0)))  # a raster turned further than this from where it belongs is made anew
_NO_SLOTS: dict[int, int] = {}


@dataclass(eq=False)
class _Block:
    """Samples (n, 3) float32 [m] and their normals, the slot (n,) of each or −1, and how many are of each slot."""

    points: Array
    normals: Array
    slot_of: NDArray[np.int32]
    counts: dict[int, int]

    ARRAYS: ClassVar = ("points", "normals", "slot_of")


class Surrounding(NamedTuple):
    """Places and those beside them: their codes, and the rows (Q, 27) of these that are in or beside each place."""

    codes: list[int]
    rows: Array


class Pieces:
    """Flat pieces in slots: the samples on each, block by block, with their moments, fitted plane and covered cells.

    cell_size_m : of the rasters [m];  least : samples that a fit needs
    place_shift : neighbours are looked for in places of 2^shift blocks along each axis

    `normal` (P, 3), `offset` (P,) [m] and `moments` (P, 13) are by slot; arrays are replaced when slots are added.
    """

    def __init__(self, cell_size_m: float, *, least: int, place_shift: int) -> None:
        self.cell_size_m = cell_size_m
        self.least = least
        self.place_shift = place_shift
        self.moments = np.zeros((0, kernels.MOMENTS))
        self.normal = np.zeros((0, 3))
        self.offset = np.zeros(0)
        self._coverage: list[Coverage | None] = []
        self._blocks_of: list[dict[Key, None]] = []
        self._free: list[int] = []
        self._blocks: dict[Key, _Block] = {}
        self._places: dict[int, dict[int, int]] = {}

    # -- reading ------------------------------------------------------------------------------------------
    @property
    def used(self) -> list[int]:
        """Slots that hold a piece, ascending."""
        return [slot for slot, coverage in enumerate(self._coverage) if coverage is not None]

    def coverage(self, slot: int) -> Coverage:
        """The covered cells of a piece."""
        coverage = self._coverage[slot]
        assert coverage is not None
        return coverage

    def count(self, slot: int) -> int:
        """Number of samples of a piece."""
        return round(float(self.moments[slot, 0]))

    def blocks(self, slot: int) -> Collection[Key]:
        """The blocks that hold samples of a piece."""
        return self._blocks_of[slot].keys()

    def samples(self, slot: int, at_most: int | None = None) -> Array:
        """Samples (N, 3) float32 [m] of a piece; when thinned to `at_most`, some from each of some blocks."""
        keys = list(self._blocks_of[slot])
        if at_most is not None:
            keys = keys[:: len(keys) // (at_most // 6 + 1) + 1]
        parts = [np.zeros((0, 3), np.float32)]
        for key in keys:
            block = self._blocks[key]
            whole = block.counts[slot] == len(block.points)
            parts.append(block.points if whole else block.points[block.slot_of == slot])
        points = np.concatenate(parts)
        if at_most is not None and len(points) > at_most:
            points = points[np.linspace(0, len(points) - 1, at_most).astype(np.int64)]
        return points

    def samples_in(self, block_ijk: Iterable[Sequence[int]]) -> tuple[Array, Array, Array, Array]:
        """Samples (N, 3) float32 [m] of blocks, their normals (N, 3), the slot (N,) of each or −1, and which block (N,)
        it is of."""
        held = [self._blocks.get((i, j, k)) for i, j, k in block_ijk]
        there = [block for block in held if block is not None]
        if not there:
            return *np.zeros((2, 0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.int64)
        sizes = [0 if block is None else len(block.points) for block in held]
        points, normals, slots = (np.concatenate([getattr(block, name) for block in there]) for name in _Block.ARRAYS)
        return points, normals, slots, np.repeat(np.arange(len(held)), sizes)

    # -- places -------------------------------------------------------------------------------------------
    def place_codes(self, block_ijk: Array) -> NDArray[np.int64]:
        """The place (N,) of each block (N, 3), as a number."""
        i, j, k = ((block_ijk >> self.place_shift).astype(np.int64) + _HALF).T
        return np.asarray((i * _SPAN + j) * _SPAN + k)

    @staticmethod
    def about(codes: NDArray[np.int64]) -> Surrounding:
        """The places (Q,) and all that lie beside them."""
        around = codes[:, None] + _BESIDE
        known, row = np.unique(around, return_inverse=True)
        return Surrounding(known.tolist(), row.reshape(around.shape))

    def nearby(self, places: Surrounding) -> tuple[Array, Array]:
        """Slots of the pieces in or beside each place (Q,), as rows `first` and `candidates` (see `kernels.match`)."""
        return self._gathered(self._held_in(places), places.rows)

    def inside_and_nearby(self, places: Surrounding) -> tuple[Array, Array, Array, Array]:
        """As `nearby`, of the pieces in each place only, then of those in or beside it."""
        held = self._held_in(places)
        return *self._gathered(held, places.rows[:, _CENTRE]), *self._gathered(held, places.rows)

    def _held_in(self, places: Surrounding) -> list[dict[int, int]]:
        return [self._places.get(code, _NO_SLOTS) for code in places.codes]

    def nearby_among(self, codes: NDArray[np.int64], slots: Sequence[Collection[int]]) -> tuple[Array, Array]:
        """As `nearby`, where only the places `codes` (Q,), ascending, hold anything: these slots."""
        around = codes[:, None] + _BESIDE
        row = np.minimum(np.searchsorted(codes, around), len(codes) - 1)
        row[codes[row] != around] = -1
        return self._gathered(slots, row)

    def _gathered(self, slots: Sequence[Collection[int]], neighbours: Array) -> tuple[Array, Array]:
        first = np.cumsum([0, *map(len, slots)])
        held = np.fromiter(chain.from_iterable(slots), np.int64, first[-1])
        size = first[neighbours + 1] - first[neighbours]
        near = np.empty(int(size[neighbours >= 0].sum()), np.int64)
        first_near = np.empty(len(neighbours) + 1, np.int64)
        kernels.gather(first_near, near, neighbours, first, held, np.full(len(self.offset), -1, np.int64))
        return first_near, near

    # -- change -------------------------------------------------------------------------------------------
    def new(self, origin: Array, normal: Array, offset: float) -> int:
        """A slot for a piece without samples yet, on this plane."""
        if not self._free:
            n = len(self.offset)
            more = max(64, n)
            self.moments = np.concatenate([self.moments, np.zeros((more, kernels.MOMENTS))])
            self.normal = np.concatenate([self.normal, np.zeros((more, 3))])
            self.offset = np.concatenate([self.offset, np.zeros(more)])
            self._coverage.extend([None] * more)
            self._blocks_of.extend({} for _ in range(more))
            self._free = list(range(n + more - 1, n - 1, -1))
        slot = self._free.pop()
        self.moments[slot] = 0.0
        self.normal[slot], self.offset[slot] = normal, offset
        self._coverage[slot] = Coverage(PlaneFrame.about(origin, normal), self.cell_size_m)
        return slot

    def release(self, slot: int) -> None:
        """Give up a slot that has no samples any more."""
        self._coverage[slot] = None
        self._free.append(slot)

    def refit(self, slots: Iterable[int]) -> None:
        """Fit planes to the samples of pieces, and turn rasters that have come to lie badly on them."""
        rows = np.array(sorted(slots), np.int64)
        kernels.fit_all(self.moments, rows, self.least, self.normal, self.offset)
        for slot in rows.tolist():
            frame = self.coverage(slot).frame
            if self.normal[slot] @ frame.normal > _TURNED:
                continue
            best = PlaneFrame.about(frame.origin, self.normal[slot])
            if best.normal @ frame.normal < _TURNED:
                turned = Coverage(best, self.cell_size_m)
                points = self.samples(slot)
                if len(points):
                    turned.add(points)
                self._coverage[slot] = turned

    def replace(
        self, keys: Sequence[Key], owner: Array, slot_of: Array, points: Array, normals: Array
    ) -> dict[int, set[Key]]:
        """Set the samples of blocks; returns for each slot the blocks that held samples of it before.

        points, normals : (N, 3) float32 [m];  owner : (N,), ascending, the row of `keys` of each
        slot_of         : (N,) the piece of each, or −1
        """
        before = [self._blocks.pop(key, None) for key in keys]
        old = [block for block in before if block is not None]
        if old:
            gone, towards, slots = (np.concatenate([getattr(block, name) for block in old]) for name in _Block.ARRAYS)
            self._sum(gone, towards, slots, -1)
        self._sum(points, normals, slot_of, 1)

        row, slot, n = np.empty((3, len(points)), np.int64)
        entries = kernels.count_planes(owner, slot_of, row, slot, n)
        counts: list[dict[int, int]] = [{} for _ in keys]
        for r, s, m in zip(row[:entries].tolist(), slot[:entries].tolist(), n[:entries].tolist(), strict=True):
            counts[r][s] = m
        starts = np.searchsorted(owner, np.arange(len(keys) + 1)).tolist()
        held: dict[int, set[Key]] = {}
        for key, block, now, low, high in zip(keys, before, counts, starts[:-1], starts[1:], strict=True):
            if low < high:
                self._blocks[key] = _Block(points[low:high], normals[low:high], slot_of[low:high], now)
            self._note(key, {} if block is None else block.counts, now)
            for s in () if block is None else block.counts:
                held.setdefault(s, set()).add(key)
        return held

    def move(self, old: int, new: int, chosen: Array | None = None) -> None:
        """Give the samples of one slot, or those `chosen` (a mask in the order of `samples`), to another."""
        keys = list(self._blocks_of[old])
        if chosen is not None:
            first = np.cumsum([0, *(self._blocks[key].counts[old] for key in keys)])
            some = np.flatnonzero(chosen)
            in_block = np.searchsorted(first, some, side="right") - 1
            parts = {int(k): some[in_block == k] - first[k] for k in np.unique(in_block)}
        points, normals = [], []
        for k in range(len(keys)) if chosen is None else parts:
            block = self._blocks[keys[k]]
            rows = (block.slot_of == old).nonzero()[0]
            part = rows if chosen is None else rows[parts[k]]
            block.slot_of[part] = new
            before = block.counts
            block.counts = {**before, old: before[old] - len(part), new: before.get(new, 0) + len(part)}
            if block.counts[old] == 0:
                del block.counts[old]
            self._note(keys[k], before, block.counts)
            points.append(block.points[part])
            normals.append(block.normals[part])
        if points:
            moved, towards = np.concatenate(points), np.concatenate(normals)
            self._sum(moved, towards, np.full(len(moved), old, np.int32), -1)
            self._sum(moved, towards, np.full(len(moved), new, np.int32), 1)

    def _note(self, key: Key, before: Collection[int], now: Collection[int]) -> None:
        """Note of which slots a block held samples before, and of which it does now."""
        lost, gained = [s for s in before if s not in now], [s for s in now if s not in before]
        if not (lost or gained):
            return
        s = self.place_shift
        place = (((key[0] >> s) + _HALF) * _SPAN + (key[1] >> s) + _HALF) * _SPAN + (key[2] >> s) + _HALF
        here = self._places.setdefault(place, {})
        for slot in gained:
            here[slot] = here.get(slot, 0) + 1
            self._blocks_of[slot][key] = None
        for slot in lost:
            del self._blocks_of[slot][key]
            here[slot] -= 1
            if not here[slot]:
                del here[slot]
        if not here:
            del self._places[place]

    def _sum(self, points: Array, normals: Array, slot_of: Array, sign: int) -> None:
        """Add samples to (or take them from) the moments and rasters of their pieces."""
        if not len(slot_of):
            return
        kernels.accumulate(self.moments, slot_of, points, normals, float(sign))
        order = np.argsort(slot_of, kind="stable")
        slots, points = slot_of[order], points[order]
        ends = [0, *(np.flatnonzero(slots[1:] != slots[:-1]) + 1).tolist(), len(slots)]
        for low, high in pairwise(ends):
            slot = int(slots[low])
            if slot >= 0:
                coverage = self.coverage(slot)
                (coverage.add if sign > 0 else coverage.remove)(points[low:high])

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Everything as named arrays; pieces are numbered in the order of `used`."""
        used = self.used
        number = np.full(len(self.offset) + 1, -1, np.int32)
        number[used] = np.arange(len(used), dtype=np.int32)
        blocks = list(self._blocks.values())
        frames = [self.coverage(slot).frame for slot in used]
        none = [np.zeros((0, 3), np.float32)]
        return {
            "block_ijk": np.array(list(self._blocks), np.int32).reshape(-1, 3),
            "block_size": np.array([len(block.points) for block in blocks], np.int64),
            "points": np.concatenate([block.points for block in blocks] or none),
            "normals": np.concatenate([block.normals for block in blocks] or none),
            "piece": np.concatenate([number[block.slot_of] for block in blocks] or [np.zeros(0, np.int32)]),
            "normal": self.normal[used],
            "offset": self.offset[used],
            "frame_origin": np.array([frame.origin for frame in frames]).reshape(-1, 3),
            "frame_normal": np.array([frame.normal for frame in frames]).reshape(-1, 3),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Take over what `state` gave, into pieces without samples; slot = number in the state."""
        for k in range(len(state["offset"])):
            self.new(state["frame_origin"][k], state["frame_normal"][k], 0.0)
        n = len(state["offset"])
        self.normal[:n], self.offset[:n] = state["normal"], state["offset"]
        keys: list[Key] = [(i, j, k) for i, j, k in state["block_ijk"].tolist()]
        owner = np.repeat(np.arange(len(keys)), state["block_size"])
        slot_of = np.array(state["piece"], np.int32)
        self.replace(keys, owner, slot_of, np.array(state["points"]), np.array(state["normals"]))
