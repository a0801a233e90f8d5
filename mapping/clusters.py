"""Things without labels: what of the surface stands out of floors and walls, as connected components that last.

Surface voxels that lie on no structural plane are joined to components. Only the components in and about the blocks
that changed are found anew; each takes over the id of the old one with which it shares most voxels, so that a thing
keeps its id while it grows, is cut in two or is joined to another. Level surfaces that carry things (table tops) hang
together with what is below them, not with what stands on them; compare Finman et al., Toward lifelong object
segmentation from change detection, 2013, and, for components that follow a growing map, Tateno et al., Real-time and
scalable incremental segmentation on dense SLAM, IROS 2015.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import MappingError
from mapping.grid import BlockStore, as_points, check_array
from mapping.kernels import clusters as kernels
from mapping.kernels.clusters import LOOSE, NOTHING, RAISED
from mapping.layer import require
from mapping.planes import PlaneMap

Array: TypeAlias = NDArray[Any]
Role: TypeAlias = Literal["structure", "support", "underside"]
"""What a plane is to things: a wall, floor or ceiling, of which they are no part; a level surface on which they stand;
or one that looks down, of a ceiling that nobody called so, or of something whose top and sides are there as well."""

FRONT_M = 0.03
ABOVE_M = 0.025
BEHIND_M = 0.10
"""What lies within FRONT_M (a voxel at least) before a structural plane is of it, for surfaces are noisy, or within
ABOVE_M (half a voxel at least) above a floor, on which low things lie; and what lies within BEHIND_M behind it: the
wall's other side, reflections."""
RIM_M = 0.06
"""The rim of a table top reaches so far down."""
REACH_VOXELS = 1.5
"""Planes go on by so much beyond what is covered of them."""
LEVEL = 0.9
"""A plane that looks up so far (the z of its normal) may carry things."""
LEAST_AREA_M2 = 0.015
LEAST_VOXELS = 8
LEAST_SIDE_M = 0.06
LARGEST_M = 3.0
"""A component is a thing when it has that much surface and voxels, is that long along an axis of the map, three voxels
at least, and two along another, and no longer than LARGEST_M."""

Named: TypeAlias = Callable[[Array], Array]
"""Points (N, 3) [m] → (N,) bool: whether what is there has a name already, and is no cluster."""


@dataclass
class Component:
    """A connected piece of surface: lasting id, observations that touched it, and where it is.

    slots  blocks in which it has voxels;  low, high (3,) [m]: the box about their centres
    """

    id: int
    first_seen_ns: int
    last_seen_ns: int
    views: int = 0
    n_voxels: int = 0
    slots: set[int] = field(default_factory=set)
    low: Array = field(default_factory=lambda: np.zeros(3))
    high: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class ClusterChange:
    """Components that an update touched; those that are not there any more have gone. seen: those in view; merged: lost
    id → the one of which it is a part now; split: new id → the one of which it was a part."""

    touched: frozenset[int] = frozenset()
    seen: frozenset[int] = frozenset()
    merged: Mapping[int, int] = field(default_factory=dict)
    split: Mapping[int, int] = field(default_factory=dict)


class ClusterMap:
    """Components of the surface samples in which a `PlaneMap` looked for planes.

    voxel_size_m  of the surface [m]
    """

    def __init__(self, voxel_size_m: float) -> None:
        self.voxel_size_m = require("voxel_size_m", voxel_size_m, 0.0, 100.0, "m")
        self.components: dict[int, Component] = {}
        self._store = BlockStore({"code": "u1", "component": "i4"}, voxel_size_m)
        self._roles: dict[int, Role] = {}
        self._next_id = 1
        self._marked = np.zeros(64, np.bool_)
        self._seen = np.zeros((0, 512), np.bool_)
        self._waiting: dict[tuple[int, int, int], None] = {}

    def __len__(self) -> int:
        return len(self.components)

    def is_thing(self, component: Component) -> bool:
        """Whether a component has the size of a thing."""
        if component.n_voxels < max(LEAST_VOXELS, LEAST_AREA_M2 / self.voxel_size_m**2):
            return False
        _, middle, longest = np.sort(component.high - component.low).tolist()
        size = self.voxel_size_m  # sides reach from middle to middle of voxels
        return bool(middle > 0.5 * size and max(LEAST_SIDE_M - size, 1.5 * size) < longest <= LARGEST_M - size)

    # -- change -------------------------------------------------------------------------------------------
    def assign(self, planes: PlaneMap, roles: Mapping[int, Role | None]) -> None:
        """Note what planes are to things; where that is new, the next update looks again."""
        for plane_id, role in roles.items():
            if self._roles.get(plane_id) == role:
                continue
            if role is None:
                del self._roles[plane_id]
            else:
                self._roles[plane_id] = role
            if plane_id in planes and self._store.n_blocks:
                self._wait(planes.blocks_of(plane_id))

    def forget_planes(self, plane_ids: Iterable[int]) -> None:
        """Planes that are no more."""
        for plane_id in plane_ids:
            self._roles.pop(plane_id, None)

    def look_again(self, points: ArrayLike) -> None:
        """Have the next update look at the clusters at points (N, 3) [m] again."""
        self._wait(self._store.block_ijk[np.unique(self._cells_near(points) >> 9)])

    def _wait(self, block_ijk: Array) -> None:
        self._waiting.update(dict.fromkeys(map(tuple, block_ijk.tolist())))

    def update(
        self, planes: PlaneMap, moved: Array, stamp_ns: int, *, found: bool, named: Named | None = None,
        in_view: Array | None = None, views: int = 1,
    ) -> ClusterChange:  # fmt: skip
        """Look at the blocks `moved` (K, 3) whose surface is not as it was, and at those that wait.

        found    whether surface where no cluster is founds one; otherwise what is known is followed
        named    what has a name
        in_view  blocks (L, 3) of which something was seen; default `moved`
        views    how many images without labels this is worth
        """
        blocks = np.asarray(moved, np.int32).reshape(-1, 3)
        if self._waiting:
            self._wait(blocks)
            blocks = np.array(list(self._waiting), np.int32).reshape(-1, 3)
            self._waiting = {}
        if not found:
            blocks = blocks[self._store.find(blocks) >= 0] if self._store.n_blocks else blocks[:0]
        change = ClusterChange()
        if len(blocks):
            codes = self._codes(planes, blocks, named)
            kept = codes.any(axis=1) | (self._store.find(blocks) >= 0)
            change = self._follow(self._store.allocate(blocks[kept]), codes[kept], stamp_ns)
        return replace(change, seen=self._see(moved if in_view is None else in_view, stamp_ns, views))

    def _see(self, block_ijk: Array, stamp_ns: int, views: int) -> frozenset[int]:
        """Note that the components in blocks (K, 3) are in view; returns their ids."""
        if not self.components:
            return frozenset()
        slots = self._store.find(block_ijk)
        kernels.find(self._store.fields["component"], slots[slots >= 0], self._marked)
        in_view = frozenset(self._take_marked().tolist())
        for component_id in in_view:
            component = self.components[component_id]
            component.views += views
            component.last_seen_ns = max(component.last_seen_ns, stamp_ns)
        return in_view

    def _codes(self, planes: PlaneMap, blocks: Array, named: Named | None) -> NDArray[np.uint8]:
        """(K, 512) what the voxels of blocks (K, 3) are."""
        points, _, ids, owner = planes.samples_in(blocks)
        given = np.full(len(points), LOOSE, np.uint8)
        for plane_id in np.unique(ids).tolist():
            role = self._roles.get(plane_id)
            if role is not None:
                given[ids == plane_id] = RAISED if role == "support" else NOTHING
        near = self._with_role(planes.ids_near(blocks), "structure", "support")
        loose = np.flatnonzero(given == LOOSE)
        if near and len(loose):
            given[loose] = self._beside(planes, near, points[loose])
        if named is not None:
            rest = np.flatnonzero(given != NOTHING)
            given[rest[named(points[rest])]] = NOTHING
        codes = np.zeros((len(blocks), 512), np.uint8)
        kernels.enter(codes, points, owner, given, blocks, 1.0 / self.voxel_size_m)
        return codes

    def _beside(self, planes: PlaneMap, ids: list[int], points: Array) -> NDArray[np.uint8]:
        """What samples (N, 3) are that are on no plane of `ids`, but may be beside one."""
        given = np.full(len(points), LOOSE, np.uint8)
        normals, offsets = planes.equations(ids)
        above = points @ normals.T.astype(np.float32) - offsets.astype(np.float32)
        front, over = max(self.voxel_size_m, FRONT_M), max(0.5 * self.voxel_size_m, ABOVE_M)
        reach = REACH_VOXELS * self.voxel_size_m
        for k in sorted(range(len(ids)), key=lambda k: self._roles[ids[k]] != "structure"):
            structural = self._roles[ids[k]] == "structure"
            before = over if normals[k, 2] > LEVEL else front
            top, bottom = (before, -BEHIND_M) if structural else (planes.tolerance_m, -RIM_M)
            rows = np.flatnonzero((above[:, k] >= bottom) & (above[:, k] <= top) & (given == LOOSE))
            if len(rows):
                there = planes.near(ids[k], points[rows], reach, np.inf)
                given[rows[there]] = NOTHING if structural else RAISED
        return given

    def _follow(self, slots: Array, codes: Array, stamp_ns: int) -> ClusterChange:
        store = self._store
        code, component = store.fields["code"], store.fields["component"]
        cells, lost = np.empty(512 * len(slots), np.int64), np.empty(512 * len(slots), np.int32)
        n = int(kernels.replace(code, component, slots, codes, cells, lost))
        if not n:
            return ClusterChange()
        cells, lost = cells[:n], lost[:n]
        self._marked[lost] = True
        self._marked[0] = False
        kernels.touch(store.table, store.block_ijk, code, component, cells, self._marked)
        old = np.flatnonzero(self._marked)
        among = set(np.unique(cells >> 9).tolist()).union(*(self.components[i].slots for i in old.tolist()))
        around = np.sort(np.fromiter(among, np.int64, len(among)))
        cells, of = np.empty(512 * len(around), np.int64), np.empty(512 * len(around), np.int32)
        n = int(kernels.collect(code, component, around, self._marked, cells, of))
        self._marked[old] = False
        cells, of = cells[:n], of[:n]
        label = np.empty(n, np.int64)
        n_found = int(kernels.connect(store.table, store.block_ijk, code, component, cells, label))
        return self._name(cells, of, label, n_found, old, stamp_ns)

    def _take_marked(self) -> Array:
        marked = np.flatnonzero(self._marked)
        self._marked[marked] = False
        return marked

    def _name(self, cells: Array, of: Array, label: Array, n_found: int, old: Array, stamp_ns: int) -> ClusterChange:
        """Give the voxels `cells` (n,), of the old components `of`, the ids of the components `label` found in them."""
        pair, shared = np.unique(label << 32 | of, return_counts=True)
        new, known = pair >> 32, pair & 0xFFFFFFFF
        order = np.lexsort((known, -shared))
        order = order[known[order] > 0]
        id_of = np.zeros(n_found, np.int64)
        heir: dict[int, int] = {}
        parents: list[tuple[int, int]] = []  # pairs that share voxels, and where one has found another partner
        for k, component_id in zip(new[order].tolist(), known[order].tolist(), strict=True):
            if not id_of[k] and component_id not in heir:
                id_of[k], heir[component_id] = component_id, k
            else:
                parents.append((k, component_id))
        before = {i: self.components.pop(i) for i in old.tolist()}
        fresh = np.flatnonzero(id_of == 0)
        id_of[fresh] = self._next_id + np.arange(len(fresh))
        self._next_id += len(fresh)
        if self._next_id > len(self._marked):
            self._marked = np.zeros(2 * self._next_id, np.bool_)
        self._store.fields["component"][cells >> 9, cells & 511] = id_of[label]
        self._measure(cells, label, id_of, before, stamp_ns)
        merged, split = dict[int, int](), dict[int, int]()
        for k, component_id in parents:
            if component_id not in heir:
                merged.setdefault(component_id, int(id_of[k]))
            elif id_of[k] not in before:
                split.setdefault(int(id_of[k]), component_id)
        for lost, kept in merged.items():
            self._join(before[lost], self.components[kept])
        for part, whole in split.items():
            self.components[part].views = before[whole].views
        return ClusterChange(frozenset({*before, *id_of.tolist()}), merged=merged, split=split)

    def _measure(
        self, cells: Array, label: Array, id_of: Array, before: Mapping[int, Component], stamp_ns: int
    ) -> None:
        """Describe the components that were found anew."""
        order = np.argsort(label, kind="stable")
        first = np.searchsorted(label[order], np.arange(len(id_of)))
        cells = cells[order]
        local = cells & 511
        ijk = (self._store.block_ijk[cells >> 9] << 3) + np.stack([local >> 6, local >> 3 & 7, local & 7], axis=1)
        if len(cells):
            low, high = np.minimum.reduceat(ijk, first), np.maximum.reduceat(ijk, first)
        for k, (component_id, own) in enumerate(zip(id_of.tolist(), np.split(cells >> 9, first[1:]), strict=False)):
            known = before.get(component_id)
            begun, last, views = (
                (stamp_ns, stamp_ns, 0) if known is None else (known.first_seen_ns, known.last_seen_ns, known.views)
            )
            self.components[component_id] = Component(
                component_id, begun, last, views, len(own), set(own.tolist()),
                (low[k] + 1.0) * self.voxel_size_m, (high[k] + 1.0) * self.voxel_size_m,
            )  # fmt: skip

    @staticmethod
    def _join(lost: Component, kept: Component) -> None:
        kept.first_seen_ns = min(kept.first_seen_ns, lost.first_seen_ns)
        kept.last_seen_ns = max(kept.last_seen_ns, lost.last_seen_ns)
        kept.views = max(kept.views, lost.views)

    # -- what is there ------------------------------------------------------------------------------------
    def surface(self, component_id: int, planes: PlaneMap) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The surface samples (N, 3) [m] of a component, and their normals (N, 3)."""
        slots = np.array(sorted(self.components[component_id].slots), np.int64)
        points, normals, _, owner = planes.samples_in(self._store.block_ijk[slots])
        mine = self._components_at(points, slots[owner]) == component_id
        return points[mine], normals[mine]

    def carriers(self, component_id: int, planes: PlaneMap) -> list[int]:
        """The level planes that look up, ascending, on which a component may stand."""
        near = self.planes_near(component_id, planes, "structure", "support")
        return [i for i, up in zip(near, planes.equations(near)[0][:, 2].tolist(), strict=True) if up > LEVEL]

    def role(self, plane_id: int) -> Role | None:
        """What a plane is to things."""
        return self._roles.get(plane_id)

    def planes_near(self, component_id: int, planes: PlaneMap, *roles: Role) -> list[int]:
        """The planes with one of these roles, ascending, of which something is beside a component."""
        slots = np.array(sorted(self.components[component_id].slots), np.int64)
        return self._with_role(planes.ids_near(self._store.block_ijk[slots]), *roles)

    def _with_role(self, plane_ids: list[int], *roles: Role) -> list[int]:
        return [i for i in plane_ids if self._roles.get(i) in roles]

    def _components_at(self, points: Array, slots: Array) -> Array:
        """The component (N,) of samples (N, 3) of the blocks `slots` (N,)."""
        ijk = np.floor(points * (1.0 / self.voxel_size_m) - kernels.HALF).astype(np.int64)
        within = np.clip(ijk - (self._store.block_ijk[slots].astype(np.int64) << 3), 0, 7)
        return np.asarray(self._store.fields["component"][slots, within[:, 0] << 6 | within[:, 1] << 3 | within[:, 2]])

    def covered(self, points: ArrayLike) -> dict[int, int]:
        """Of which components points (N, 3) [m] and a voxel about them cover how many voxels."""
        if not self._store.n_blocks:
            return {}
        cells = self._cells_near(points)
        ids, counts = np.unique(self._store.fields["component"][cells >> 9, cells & 511], return_counts=True)
        return dict(zip(ids.tolist(), counts.tolist(), strict=True))

    def _cells_near(self, points: ArrayLike) -> Array:
        store = self._store
        if len(self._seen) < store.n_blocks:
            self._seen = np.zeros((len(store.fields["code"]), 512), np.bool_)
        return np.asarray(
            kernels.cells_near(
                store.table, store.fields["code"], as_points(points), 1.0 / self.voxel_size_m, self._seen
            )
        )

    # -- state --------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """Everything that makes this map, as named arrays; what planes are is told anew."""
        rows = [(c.id, c.first_seen_ns, c.last_seen_ns, c.views) for c in self.components.values()]
        return {
            **self._store.state(),
            "components": np.array(rows, np.int64).reshape(-1, 4),
            "next_id": np.array(self._next_id),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Array], voxel_size_m: float) -> Self:
        """The map that `state` described; raises `MappingError` where that is incomplete."""
        missing = [name for name in ("components", "next_id") if name not in state]
        if missing:
            raise MappingError(f"the saved clusters lack {', '.join(missing)}")
        made = cls(voxel_size_m)
        made._store.restore(state)
        made._next_id = int(state["next_id"])
        made._marked = np.zeros(2 * made._next_id + 64, np.bool_)
        rows = check_array(state, "components", np.int64, (len(state["components"]), 4))
        slots, local = np.nonzero(made._store.used("component"))
        ids, label = np.unique(made._store.used("component")[slots, local], return_inverse=True)
        before = {i: Component(i, first, last, views) for i, first, last, views in rows.tolist()}
        made._measure(slots << 9 | local, label, ids, before, 0)
        return made
