"""Graphs of furnished homes whose truth is known, and what several robots would make of one of them."""

from __future__ import annotations

import math

import numpy as np

from mapping.geometry import SE3
from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph
from scenegraph.rigid import moved

CLASSES = {
    "table": (0.7, 0.6, 0.75), "chair": (0.5, 0.5, 0.9), "bed": (0.7, 0.65, 0.5), "sofa": (0.7, 0.5, 0.8),
    "lamp": (0.3, 0.3, 1.5), "plant": (0.4, 0.4, 0.8), "cabinet": (0.6, 0.45, 1.8), "box": (0.5, 0.4, 0.3),
    "bin": (0.3, 0.3, 0.5), "desk": (0.7, 0.5, 0.72), "shelf": (0.6, 0.3, 2.0), "stool": (0.35, 0.35, 0.45),
}  # fmt: skip
"""Small enough for no two in neighbouring slots to overlap by a tenth."""
SMALL = {"cup": (0.08, 0.08, 0.1), "book": (0.2, 0.15, 0.03), "laptop": (0.35, 0.25, 0.2)}
ROOM_M = 4.0
SLOT_M = 1.0


def turned(yaw: float, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> SE3:
    """A motion that keeps what is upright upright."""
    return SE3(SE3.exp((0, 0, 0, 0, 0, yaw)).rotation, (x, y, z))


def furnished(seed: int, rooms: tuple[int, int] = (3, 2)) -> SceneGraph:
    """A home: rooms in a row and column, things in slots of a metre, small things on some of them, walls and floors,
    relations both ways, all seen between 0 and 1000 ns."""
    rng = np.random.default_rng(seed)
    changes = GraphChanges()
    made = 0

    def seen() -> dict[str, int]:
        first = int(rng.integers(0, 500))
        return {"first_seen_ns": first, "last_seen_ns": first + int(rng.integers(0, 500))}

    def join(relation: str, source: str, target: str, back: str) -> None:
        times = {"first_seen_ns": 0, "last_seen_ns": int(rng.integers(1, 1000)), "value": float(rng.random())}
        changes.put(Edge(relation=relation, source=source, target=target, **times))
        changes.put(Edge(relation=back, source=target, target=source, **times))

    def thing(label: str, size: tuple[float, float, float], at: tuple[float, float, float], room: str) -> str:
        nonlocal made
        made += 1
        node_id = f"object_{made}"
        center = (at[0], at[1], at[2] + 0.5 * size[2])
        changes.put(
            Node(
                id=node_id,
                layer="object",
                label=label,
                position=center,
                box=Box.from_yaw(center, size, float(rng.uniform(-math.pi, math.pi))),
                confidence=round(float(rng.uniform(0.5, 1.0)), 3),
                attributes={"voxels": int(rng.integers(10, 500)), "views": int(rng.integers(3, 50))},
                **seen(),
            )
        )
        join("in", node_id, room, "contains")
        return node_id

    changes.put(Node(id="building_1", layer="building", label="building", position=(0, 0, 0), **seen()))
    for i in range(rooms[0]):
        for j in range(rooms[1]):
            room = f"room_{i * rooms[1] + j + 1}"
            x, y = i * ROOM_M, j * ROOM_M
            corners = [[x, y], [x + ROOM_M, y], [x + ROOM_M, y + ROOM_M], [x, y + ROOM_M]]
            middle = (x + 0.5 * ROOM_M, y + 0.5 * ROOM_M)
            changes.put(
                Node(
                    id=room, layer="room", label="room", position=(*middle, 0.0),
                    box=Box(center=(*middle, 1.25), size=(ROOM_M, ROOM_M, 2.5)), confidence=0.9,
                    attributes={"footprint": corners, "floor_z": 0.0, "area_m2": ROOM_M**2}, **seen(),
                )
            )  # fmt: skip
            join("in", room, "building_1", "contains")
            floor = f"plane_{2 * (i * rooms[1] + j)}"
            wall = f"plane_{2 * (i * rooms[1] + j) + 1}"
            changes.put(
                Node(
                    id=floor, layer="structure", label="floor", position=(*middle, 0.0),
                    box=Box(center=(*middle, 0.0), size=(ROOM_M, ROOM_M, 0.02)),
                    attributes={"normal": [0.0, 0.0, 1.0], "offset": 0.0}, **seen(),
                )
            )  # fmt: skip
            changes.put(
                Node(
                    id=wall, layer="structure", label="wall", position=(x, middle[1], 1.25),
                    box=Box(center=(x, middle[1], 1.25), size=(0.02, ROOM_M, 2.5)),
                    attributes={"normal": [1.0, 0.0, 0.0], "offset": x}, **seen(),
                )
            )  # fmt: skip
            slots = [(a, b) for a in range(3) for b in range(3)]
            before = None
            for a, b in rng.permutation(slots)[: int(rng.integers(5, 9))].tolist():
                label = str(rng.choice(list(CLASSES)))
                jitter = rng.uniform(-0.12, 0.12, 2)
                at = (x + 1.0 + a * SLOT_M + jitter[0], y + 1.0 + b * SLOT_M + jitter[1], 0.0)
                lower = thing(label, CLASSES[label], at, room)
                join("on", lower, floor, "supports")
                if before is not None:
                    join("near", lower, before, "near")
                before = lower
                if label in ("table", "desk") and rng.random() < 0.8:
                    small = str(rng.choice(list(SMALL)))
                    upper = thing(small, SMALL[small], (at[0], at[1], CLASSES[label][2]), room)
                    join("on", upper, lower, "supports")
    graph = SceneGraph()
    graph.commit(changes, 1000)
    return graph


def seen_by_another(
    home: SceneGraph, seed: int, *, share: float = 0.8, noise_m: float = 0.03, T_map_home: SE3 | None = None
) -> tuple[SceneGraph, dict[str, str]]:
    """What another robot makes of a home: some of the things, each a little off, under ids and in a map of its own; and
    its ids → those of the home."""
    rng = np.random.default_rng(seed)
    T = T_map_home or SE3.identity()
    kept = [node for node in home if node.layer != "object" or rng.random() < share]
    order = rng.permutation(len(kept)).tolist()
    names: dict[str, str] = {}
    changes = GraphChanges()
    for k in order:
        node = kept[k]
        stem = node.id.rpartition("_")[0]
        name = node.id if node.layer == "building" else f"{stem}_{len(names) + 1}"
        names[node.id] = name
        if node.layer == "object":
            off = SE3(np.eye(3), rng.normal(0.0, noise_m, 3))
            assert node.box is not None
            node = moved(node, off).replace(
                confidence=round(float(rng.uniform(0.5, 1.0)), 3), last_seen_ns=int(rng.integers(1000, 2000))
            )
        changes.put(Node(**{**moved(node, T).__dict__, "id": name}))
    for edge in home.edges():
        if edge.source in names and edge.target in names:
            changes.put(Edge(**{**edge.__dict__, "source": names[edge.source], "target": names[edge.target]}))
    graph = SceneGraph()
    graph.commit(changes, 2000)
    return graph, {name: node_id for node_id, name in names.items()}
