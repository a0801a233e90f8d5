"""Triangle meshes, and the one that a signed distance map holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.grid import BLOCK_VOXELS, as_blocks
from mapping.kernels import marching_cubes
from mapping.labelled import labels_near
from mapping.layer import Changed
from mapping.palette import Palette
from mapping.ply import Property, ply_bytes, vectors
from mapping.semantics import SemanticMap

if TYPE_CHECKING:
    from mapping.tsdf import TsdfMap

Array: TypeAlias = NDArray[Any]

_CHUNK = 64  # blocks made at once: bounds the memory to work in


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles.

    vertices   (N, 3) float32 [m] in map
    triangles  (M, 3) int32 rows of vertices, counter-clockwise as seen from free space
    normals    (N, 3) float32, unit, into free space
    colors     (N, 3) uint8 red, green, blue, or None
    labels     (N,) uint16 class ids, 0 unknown, or None
    legend     lines that say what the labels mean, for the head of files
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8] | None = None
    labels: NDArray[np.uint16] | None = None
    legend: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.vertices)
        for name in ("normals", "colors", "labels"):
            values = getattr(self, name)
            if values is not None and len(values) != n:
                raise InvalidParameter(f"{name}: expected a value a vertex ({n}), got {len(values)}")
        if self.triangles.size and not 0 <= int(self.triangles.min()) <= int(self.triangles.max()) < n:
            raise InvalidParameter(f"triangles: expected rows of the {n} vertices, got {int(self.triangles.max())}")

    @property
    def area_m2(self) -> float:
        """Total area of the triangles."""
        a, b, c = (self.vertices[self.triangles[:, n]].astype(np.float64) for n in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)

    def to_open3d(self) -> Any:
        """As `open3d.geometry.TriangleMesh`; labels are left out, for it has no place for them."""
        import open3d

        mesh = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(self.vertices.astype(np.float64)),
            open3d.utility.Vector3iVector(self.triangles),
        )
        mesh.vertex_normals = open3d.utility.Vector3dVector(self.normals.astype(np.float64))
        if self.colors is not None:
            mesh.vertex_colors = open3d.utility.Vector3dVector(self.colors / 255.0)
        return mesh

    def write_ply(self, path: str | Path) -> None:
        """Write a binary PLY file with normals and, where there are any, colours and labels (property `label`)."""
        Path(path).write_bytes(self.ply())

    def ply(self) -> bytes:
        """What `write_ply` writes."""
        columns: list[Property] = [*vectors("xyz", self.vertices), *vectors(("nx", "ny", "nz"), self.normals)]
        if self.colors is not None:
            columns += vectors(("red", "green", "blue"), self.colors)
        if self.labels is not None:
            columns.append(("label", self.labels))
        return ply_bytes(columns, self.triangles, self.legend)

    def colored(self, palette: Palette) -> Mesh:
        """The same mesh with each vertex in the colour of its class, grey without a label."""
        if self.labels is None:
            raise InvalidParameter("labels: expected a mesh with labels, as mesh(labels_from=…) gives")
        return replace(self, colors=palette.of(self.labels), legend=palette.legend(self.labels))


class Labelled(Protocol):
    """What a mesh takes its labels from, such as a `SemanticMap`."""

    def query(self, p_map: ArrayLike) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Class id (N,), 0 where unknown, and confidence (N,) at each point (N, 3) [m]."""


class IncrementalMesh:
    """The zero surface of a signed distance map by marching cubes, kept block by block and renewed where it changed.

    `update` makes the pieces of those blocks anew that changed, or that have a neighbour that did; `mesh` puts pieces
    together, each vertex once, also across the borders of blocks. The result is the same whatever the steps in which
    the map changed.
    """

    def __init__(self, tsdf: TsdfMap) -> None:
        self.tsdf = tsdf
        self._revision = -1
        self._pieces = np.zeros((0, 4), np.int64)  # of each slot: first vertex, vertices, first triangle, triangles
        self._n_vertices = self._n_triangles = 0  # rows in use, those of pieces that were replaced included
        self._vertices = np.empty((0, 6), np.float32)
        self._edges = np.empty(0, np.int16)
        self._corners = np.empty((0, 3), np.int32)
        self._scratch: tuple[Array, Array, Array] | None = None

    @property
    def memory_bytes(self) -> int:
        """Bytes held by the pieces, room to grow and to work included."""
        arrays = (self._pieces, self._vertices, self._edges, self._corners, *(self._scratch or ()))
        return sum(array.nbytes for array in arrays)

    def update(self) -> Changed:
        """Follow the map; returns the blocks whose piece was made anew, of those that have or had a surface."""
        tsdf = self.tsdf
        slots = tsdf.changed_near(self._revision)
        self._revision = tsdf.revision
        more = tsdf.store.n_blocks - len(self._pieces)
        if more:
            self._pieces = np.concatenate([self._pieces, np.zeros((more, 4), np.int64)])
        pieces = self._pieces
        with_surface = pieces[slots, 3] > 0
        for first in range(0, len(slots), _CHUNK):
            self._renew(slots[first : first + _CHUNK])
        if self._n_triangles > 2 * int(pieces[:, 3].sum()) + 65_536:
            self._tidy()
        with_surface |= pieces[slots, 3] > 0
        return Changed(tsdf.block_ijk[slots[with_surface]], tsdf.block_size_m)

    def _renew(self, slots: Array) -> None:
        """Make the pieces of `slots` anew, at most _CHUNK at a time."""
        if self._scratch is None:
            shapes = (((_CHUNK, 3 * BLOCK_VOXELS, 6), np.float32), ((_CHUNK, 3 * BLOCK_VOXELS), np.int16))
            most = BLOCK_VOXELS * marching_cubes.MOST_TRIANGLES
            vertices, edges = (np.empty(shape, dtype) for shape, dtype in shapes)
            self._scratch = vertices, edges, np.empty((_CHUNK, most, 3), np.int32)
        store = self.tsdf.store
        counts = np.empty((len(slots), 2), np.int64)
        marching_cubes.mesh_blocks(
            store.table, store.fields["distance"], store.fields["weight"], store.voxel_size_m, self.tsdf.max_jump_m,
            as_blocks(store.block_ijk[slots]), *self._scratch, counts,
        )  # fmt: skip
        ends = counts.cumsum(axis=0) + np.array([self._n_vertices, self._n_triangles])
        self._n_vertices, self._n_triangles = ends[-1].tolist()
        self._vertices = _grown(self._vertices, self._n_vertices)
        self._edges = _grown(self._edges, self._n_vertices)
        self._corners = _grown(self._corners, self._n_triangles)
        pieces = np.stack([ends - counts, counts], axis=2).reshape(-1, 4)
        marching_cubes.keep_pieces(self._vertices, self._edges, self._corners, pieces, *self._scratch)
        self._pieces[slots] = pieces

    def _tidy(self) -> None:
        """Let go of pieces that were replaced."""
        for field, column in ((("_vertices", "_edges"), 0), (("_corners",), 2)):
            first, count = self._pieces[:, column], self._pieces[:, column + 1]
            ends = count.cumsum()
            rows = np.arange(int(ends[-1])) + np.repeat(first - (ends - count), count)
            for name in field:
                setattr(self, name, getattr(self, name)[rows])
            self._pieces[:, column] = ends - count
        self._n_vertices, self._n_triangles = len(self._edges), len(self._corners)

    def mesh(self, block_ijk: ArrayLike | None = None, *, labels_from: Labelled | None = None) -> Mesh:
        """The pieces of the blocks (K, 3) asked for (default all) as one mesh, as of the last `update`.

        A triangle belongs to the block of its cube's first voxel, so that the meshes of disjoint sets of blocks make up
        the whole. labels_from: what gives the labels of the vertices; of a `SemanticMap`, a vertex without a label gets
        that of the nearest voxel that has one, not farther than a voxel of the signed distances.
        """
        tsdf, pieces = self.tsdf, self._pieces
        if block_ijk is None:
            slots = np.flatnonzero(pieces[:, 3])
        else:
            found = np.unique(tsdf.store.find(as_blocks(block_ijk)))
            slots = found[(found >= 0) & (found < len(pieces))]
            slots = slots[pieces[slots, 3] > 0]
        blocks = as_blocks(tsdf.block_ijk)
        touched = np.zeros(len(pieces) + 1, np.bool_)  # and one row for what is not there, at −1
        for side in range(8):
            touched[tsdf.store.find(blocks[slots] + np.array(marching_cubes.corner_offset(side), np.int32))] = True
        sources = np.flatnonzero(touched[:-1])
        sizes = np.where(touched[:-1], pieces[:, 1], 0)
        rows = np.empty((int(sizes.sum()), 6), np.float32)
        marching_cubes.gather_pieces(self._vertices, pieces, sources, rows)
        counts = pieces[slots, 3]
        triangles = np.empty((int(counts.sum()), 3), np.int32)
        marching_cubes.weld(
            tsdf.store.table, blocks, slots, pieces, self._edges, self._corners, sizes.cumsum() - sizes,
            counts.cumsum() - counts, triangles,
        )  # fmt: skip
        used = np.zeros(len(rows), np.bool_)  # an edge may cross the surface and every cube about it be incomplete
        used[triangles] = True
        triangles = (used.cumsum(dtype=np.int32) - np.int32(1))[triangles]
        rows = rows[used]
        vertices, normals = rows[:, :3].copy(), rows[:, 3:].copy()
        colors = tsdf.colors_at(vertices) if tsdf.has_color else None
        labels = None if labels_from is None else _labels(labels_from, vertices, tsdf.voxel_size_m)
        return Mesh(vertices, triangles, normals, colors, labels)


def _grown(array: Array, n: int) -> Array:
    """The array, with room for at least n rows."""
    if n <= len(array):
        return array
    room = np.empty((max(n, 2 * len(array)), *array.shape[1:]), array.dtype)
    room[: len(array)] = array
    return room


def _labels(source: Labelled, vertices: Array, reach_m: float) -> NDArray[np.uint16]:
    """The label of each vertex; of semantic voxels, that of the nearest within reach."""
    if isinstance(source, SemanticMap):
        return labels_near(vertices, source, reach_m)[0]
    return np.array(source.query(vertices)[0], np.uint16)


def extract_mesh(tsdf: TsdfMap, *, labels_from: Labelled | None = None) -> Mesh:
    """The whole zero surface of a signed distance map, each vertex once."""
    pieces = IncrementalMesh(tsdf)
    pieces.update()
    return pieces.mesh(labels_from=labels_from)
