"""Binary glTF 2.0 (Khronos Group, `.glb`): what viewers, browsers and modelling programs open.

The file's scene holds one node `map`, which turns z up into glTF's y up; below it one node a layer of the graph, and
below those one node a thing, named `object_12 cup`, with all its fields in `extras`. Things with a box show it; rooms
with a footprint show that at the floor; what has neither is a bare place. A mesh is a node `surface`.
"""

from __future__ import annotations

import colorsys
import json
import struct
import zlib
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mapping.mesh import Mesh
from scenegraph.graph import LAYERS, Node, SceneGraph

__all__ = ["gltf_bytes"]

_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_CODES = {"float32": _FLOAT, "uint32": _UINT, "uint16": _USHORT}
_VERTICES, _INDICES = 34962, 34963  # targets of buffer views
_Z_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # x, y, z, w
_SEE_THROUGH = {"structure": 0.35, "room": 0.2, "storey": 0.1, "building": 0.1}
_LEAST_M = 1e-4  # a box without thickness has no normals


def gltf_bytes(graph: SceneGraph, mesh: Mesh | None = None) -> bytes:
    """The graph, and the surface if there is one, as a `.glb` file. Lengths in metres; boxes thinner than 0.1 mm are
    drawn that thick."""
    file = _File()
    for layer in LAYERS:
        nodes = graph.nodes(layer)
        if nodes:
            file.group(layer, [file.node(_thing(node, file)) for node in nodes])
    if mesh is not None and len(mesh.triangles):
        file.group("surface", [file.node({"name": "surface", "mesh": file.surface(mesh)})])
    return file.written()


def _thing(node: Node, file: _File) -> dict[str, Any]:
    shown = str(node.attributes.get("name") or node.label)
    made: dict[str, Any] = {"name": f"{node.id} {shown}".rstrip(), "extras": node.model_dump(mode="json")}
    footprint = node.footprint
    if node.layer == "room" and footprint is not None:
        floor_z = node.attributes.get("floor_z")
        height = float(floor_z if isinstance(floor_z, int | float) else node.position[2])
        return {**made, "mesh": file.floor(footprint, height, node.label)}
    if node.box is None:
        return {**made, "translation": node.position.tolist()}
    w, x, y, z = node.box.rotation_wxyz.tolist()
    return {
        **made,
        "mesh": file.box(node.label, _SEE_THROUGH.get(node.layer, 1.0)),
        "translation": node.box.center.tolist(),
        "rotation": [x, y, z, w],
        "scale": np.maximum(node.box.size, _LEAST_M).tolist(),
    }


class _File:
    """A glTF file as it grows: its JSON parts and its one buffer."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._nodes: list[dict[str, Any]] = [{"name": "map", "rotation": _Z_UP, "children": []}]
        self._material_of: dict[tuple[str, float], int] = {}
        self._box_of: dict[tuple[str, float], int] = {}
        self._cube: dict[str, Any] | None = None

    def node(self, fields: dict[str, Any]) -> int:
        self._nodes.append(fields)
        return len(self._nodes) - 1

    def group(self, name: str, children: list[int]) -> None:
        self._nodes[0]["children"].append(self.node({"name": name, "children": children}))

    def box(self, label: str, opacity: float) -> int:
        """The mesh of all boxes of a label: a cube of edge 1 about the origin, which nodes scale."""
        if (label, opacity) not in self._box_of:
            if self._cube is None:
                vertices, normals, triangles = _cube()
                self._cube = {
                    "attributes": {"POSITION": self._array(vertices), "NORMAL": self._array(normals)},
                    "indices": self._array(triangles, _INDICES),
                }
            self._box_of[label, opacity] = self._mesh(label, self._cube, self._material(label, opacity))
        return self._box_of[label, opacity]

    def floor(self, footprint: NDArray[np.float64], height: float, label: str) -> int:
        """The mesh of a polygon (corners (k, 2) [m]) at a height, seen from above and below."""
        pieces = shapely.constrained_delaunay_triangles(shapely.make_valid(shapely.Polygon(footprint)))
        rings = [shapely.get_coordinates(piece)[:3] for piece in shapely.get_parts(pieces)]
        corners = np.concatenate(rings) if rings else np.zeros((3, 2))
        vertices = np.column_stack([corners, np.full(len(corners), height)]).astype(np.float32)
        triangles = np.arange(len(vertices), dtype=np.uint32)
        primitive = {"attributes": {"POSITION": self._array(vertices)}, "indices": self._array(triangles, _INDICES)}
        return self._mesh(label, primitive, self._material(label, _SEE_THROUGH["room"]))

    def surface(self, mesh: Mesh) -> int:
        attributes = {
            "POSITION": self._array(mesh.vertices.astype(np.float32)),
            "NORMAL": self._array(mesh.normals.astype(np.float32)),
        }
        if mesh.colors is not None:
            linear = np.round(65535.0 * _linear(mesh.colors / 255.0)).astype(np.uint16)
            opaque = np.full((len(linear), 1), 65535, np.uint16)
            attributes["COLOR_0"] = self._array(np.hstack([linear, opaque]), normalized=True)
        indices = self._array(mesh.triangles.astype(np.uint32).ravel(), _INDICES)
        self._materials.append({"name": "surface", "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0}})
        return self._mesh("surface", {"attributes": attributes, "indices": indices}, len(self._materials) - 1)

    def written(self) -> bytes:
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "scenegraph"},
            "scene": 0,
            "scenes": [{"name": "scene", "nodes": [0]}],
            "nodes": [{k: v for k, v in node.items() if k != "children" or v} for node in self._nodes],
        }
        parts = {
            "meshes": self._meshes,
            "materials": self._materials,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._buffer)}] if self._buffer else [],
        }
        text = json.dumps(document | {name: part for name, part in parts.items() if part}).encode()
        chunks = _chunk(b"JSON", text, b" ") + (_chunk(b"BIN\0", bytes(self._buffer), b"\0") if self._buffer else b"")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _mesh(self, name: str, primitive: dict[str, Any], material: int) -> int:
        self._meshes.append({"name": name, "primitives": [{**primitive, "material": material}]})
        return len(self._meshes) - 1

    def _material(self, label: str, opacity: float) -> int:
        if (label, opacity) not in self._material_of:
            hue = zlib.crc32(label.encode()) / 2**32
            color = _linear(np.array(colorsys.hls_to_rgb(hue, 0.55, 0.6))).tolist()
            made = {
                "name": label,
                "pbrMetallicRoughness": {"baseColorFactor": [*color, opacity], "metallicFactor": 0},
            }
            self._materials.append(made if opacity == 1.0 else {**made, "alphaMode": "BLEND", "doubleSided": True})
            self._material_of[label, opacity] = len(self._materials) - 1
        return self._material_of[label, opacity]

    def _array(self, values: NDArray[Any], target: int = _VERTICES, *, normalized: bool = False) -> int:
        """An accessor to the values, which are appended to the buffer; all our kinds keep it on 4 bytes."""
        data = np.ascontiguousarray(values)
        self._buffer.extend(b"\0" * (-len(self._buffer) % 4))
        self._views.append({"buffer": 0, "byteOffset": len(self._buffer), "byteLength": data.nbytes, "target": target})
        self._buffer.extend(data.tobytes())
        accessor: dict[str, Any] = {
            "bufferView": len(self._views) - 1,
            "componentType": _CODES[data.dtype.name],
            "count": len(data),
            "type": _TYPES[1 if data.ndim == 1 else data.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if data.dtype == np.float32:
            accessor |= {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()}
        self._accessors.append(accessor)
        return len(self._accessors) - 1


def _chunk(kind: bytes, data: bytes, filler: bytes) -> bytes:
    data += filler * (-len(data) % 4)
    return struct.pack("<I4s", len(data), kind) + data


def _linear(srgb: NDArray[Any]) -> NDArray[Any]:
    """sRGB in 0 … 1 as linear light, which glTF wants (IEC 61966-2-1)."""
    return np.asarray(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4))


def _cube() -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]:
    """Corners (24, 3), normals (24, 3) and triangles (36,) of a cube of edge 1 about the origin, faces outwards."""
    vertices: list[NDArray[np.float64]] = []
    normals: list[NDArray[np.float64]] = []
    triangles: list[int] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = side * np.eye(3)[axis]
            u = np.eye(3)[(axis + 1) % 3]
            v = np.cross(normal, u)
            first = len(vertices)
            vertices += [0.5 * (normal + a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            normals += [normal] * 4
            triangles += [first, first + 1, first + 2, first, first + 2, first + 3]
    return np.array(vertices, np.float32), np.array(normals, np.float32), np.array(triangles, np.uint16)
