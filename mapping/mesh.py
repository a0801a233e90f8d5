"""Triangle meshes, and the one that a signed distance map holds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.errors import InvalidParameter
from mapping.grid import BLOCK_VOXELS, as_blocks, new_table
from mapping.kernels import marching_cubes

if TYPE_CHECKING:
    from mapping.tsdf import TsdfMap

Array: TypeAlias = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles.

    vertices   (N, 3) float32 [m] in map
    triangles  (M, 3) int32 rows of vertices, counter-clockwise as seen from free space
    normals    (N, 3) float32, unit, into free space
    colors     (N, 3) uint8 red, green, blue, or None
    labels     (N,) uint16 class ids, 0 unknown, or None
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32]
    colors: NDArray[np.uint8] | None = None
    labels: NDArray[np.uint16] | None = None

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
        columns: list[tuple[str, str, str, Array]] = [
            (name, "float", "<f4", self.vertices[:, n]) for n, name in enumerate("xyz")
        ]
        columns += [(name, "float", "<f4", self.normals[:, n]) for n, name in enumerate(("nx", "ny", "nz"))]
        if self.colors is not None:
            columns += [(name, "uchar", "u1", self.colors[:, n]) for n, name in enumerate(("red", "green", "blue"))]
        if self.labels is not None:
            columns.append(("label", "ushort", "<u2", self.labels))
        rows = np.empty(len(self.vertices), [(name, dtype) for name, _, dtype, _ in columns])
        for name, _, _, values in columns:
            rows[name] = values
        faces = np.empty(len(self.triangles), [("n", "u1"), ("corners", "<i4", (3,))])
        faces["n"], faces["corners"] = 3, self.triangles
        header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
        header += [f"property {kind} {name}" for name, kind, _, _ in columns]
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
        with Path(path).open("wb") as file:
            file.write("\n".join(header).encode("ascii"))
            file.write(rows.tobytes())
            file.write(faces.tobytes())


def extract_mesh(tsdf: TsdfMap) -> Mesh:
    """The zero surface of a signed distance map by marching cubes: each vertex once, with normal and colour."""
    blocks = as_blocks(tsdf.block_ijk)
    fields = tsdf.store.fields
    field = (tsdf.store.table, fields["distance"], fields["weight"])
    numbers = np.empty((len(blocks), BLOCK_VOXELS, 3), np.int32)
    counts = np.empty(len(blocks), np.int64)

    # Both kernels run twice: to count, so that each block knows where its output begins, and to write.
    number = partial(marching_cubes.number_vertices, *field, tsdf.voxel_size_m, tsdf.max_jump_m, blocks)
    number(np.zeros(len(blocks), np.int64), numbers, np.empty((0, 3), np.float32), counts)
    vertices = np.empty((int(counts.sum()), 3), np.float32)
    number(np.cumsum(counts) - counts, numbers, vertices, counts)

    rows = new_table(blocks, len(blocks), len(blocks))
    join = partial(marching_cubes.join_triangles, *field, blocks, rows, numbers)
    join(np.zeros(len(blocks), np.int64), np.empty((0, 3), np.int32), counts)
    triangles = np.empty((int(counts.sum()), 3), np.int32)
    join(np.cumsum(counts) - counts, triangles, counts)

    used = np.zeros(len(vertices), np.bool_)  # an edge may cross the surface and every cube about it be incomplete
    used[triangles] = True
    triangles = (np.cumsum(used, dtype=np.int32) - 1)[triangles]
    vertices = vertices[used]
    normals = np.empty_like(vertices)
    marching_cubes.sum_normals(vertices, triangles, normals)
    return Mesh(vertices, triangles, normals, _colors(tsdf, vertices))


def _colors(tsdf: TsdfMap, vertices: NDArray[np.float32]) -> NDArray[np.uint8] | None:
    """The colour of the voxel that holds each vertex; None where the map has none."""
    if not tsdf.has_color:
        return None
    slots, local = tsdf.store.locate(vertices)
    fine = tsdf.store.fields["color"][slots, local]
    return np.asarray(fine >> 8, dtype=np.uint8)
