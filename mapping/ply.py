"""PLY files, as other programs read them: binary, little endian, points or triangles with any properties."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Property: TypeAlias = tuple[str, Array]

_KINDS = {"f4": "float", "f8": "double", "u1": "uchar", "i1": "char", "u2": "ushort", "i2": "short", "u4": "uint",
          "i4": "int"}  # fmt: skip


def vectors(names: Iterable[str], values: Array) -> list[Property]:
    """A property for each column of `values` (N, k)."""
    return [(name, values[:, n]) for n, name in enumerate(names)]


def ply_bytes(properties: Iterable[Property], triangles: Array | None = None, comments: Iterable[str] = ()) -> bytes:
    """A PLY file as bytes.

    properties : name and values (N,) of each property of the vertices; x, y, z first, as float32, as many programs
                 expect. Their dtypes say what stands in the file: 8 to 32 bit integers, 32 and 64 bit floats.
    triangles  : (M, 3) rows of vertices
    comments   : lines for the head of the file; what is not ASCII is escaped as in Python
    """
    columns = [(name, np.asarray(values)) for name, values in properties]
    rows = np.empty(len(columns[0][1]), [(name, values.dtype.newbyteorder("<")) for name, values in columns])
    for name, values in columns:
        rows[name] = values
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {' '.join(line.split())}" for line in comments]
    header += [f"element vertex {len(rows)}"]
    header += [f"property {_KINDS[values.dtype.str[1:]]} {name}" for name, values in columns]
    faces = b""
    if triangles is not None:
        corners = np.empty(len(triangles), [("n", "u1"), ("corners", "<i4", (3,))])
        corners["n"], corners["corners"] = 3, triangles
        faces = corners.tobytes()
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    return "\n".join([*header, "end_header", ""]).encode("ascii", "backslashreplace") + rows.tobytes() + faces
