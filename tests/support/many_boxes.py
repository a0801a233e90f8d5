"""A building of any size, as columns: storeys of rooms of furniture with things on and in it, all of it boxes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenegraph.graph import EdgeTable, NodeTable

ROOM_M = (6.0, 5.0, 2.7)
WALL_M = 0.12
STOREYS = 10
FURNITURE = (  # label, size [m], how many a room of a hundred objects has
    ("table", (1.6, 0.8, 0.75), 3),
    ("shelf", (0.8, 0.35, 1.8), 4),
    ("cabinet", (0.9, 0.5, 0.9), 3),
    ("chair", (0.45, 0.45, 0.9), 10),
    ("crate", (0.5, 0.4, 0.35), 5),
)
SMALL = (
    ("cup", (0.08, 0.08, 0.1)),
    ("book", (0.22, 0.16, 0.03)),
    ("lamp", (0.2, 0.2, 0.4)),
    ("bowl", (0.2, 0.2, 0.08)),
)
_PER_ROOM = sum(count for *_, count in FURNITURE)


def building(n_rooms: int, objects_per_room: int = 100, seed: int = 0) -> tuple[NodeTable, EdgeTable]:
    """Nodes and the edges that are no measurements: rooms in storeys, storeys in one building.

    Each room has a floor and four walls; about a quarter of its objects is furniture, and the rest stands on it or on
    the floor, so that every relation occurs.
    """
    rng = np.random.default_rng(seed)
    storeys = min(STOREYS, n_rooms)
    side = math.ceil(math.sqrt(n_rooms / storeys))
    pitch = np.array([ROOM_M[0] + WALL_M, ROOM_M[1] + WALL_M, ROOM_M[2] + 0.3])
    number = np.arange(n_rooms)
    storey_of, at = number % storeys, number // storeys
    corner = np.stack([at % side, at // side, storey_of], axis=1) * pitch
    size = np.array(ROOM_M)
    height = 0.5 * ROOM_M[2]

    floors = corner + np.array([0.5 * size[0], 0.5 * size[1], -0.05])
    walls = np.concatenate(
        [
            corner + np.array([-0.25 * WALL_M, 0.5 * size[1], height]),
            corner + np.array([size[0] + 0.25 * WALL_M, 0.5 * size[1], height]),
            corner + np.array([0.5 * size[0], -0.25 * WALL_M, height]),
            corner + np.array([0.5 * size[0], size[1] + 0.25 * WALL_M, height]),
        ]
    )
    across = [0.5 * WALL_M, size[1], size[2]], [size[0], 0.5 * WALL_M, size[2]]
    centers, sizes, yaws, labels = _objects(rng, corner, objects_per_room)
    n = len(centers)
    span = corner.max(axis=0) + size
    table = NodeTable.columns(
        [
            *(f"object_{i}" for i in range(n)),
            *(f"room_{i}" for i in range(n_rooms)),
            *(f"floor_{i}" for i in range(n_rooms)),
            *(f"wall_{i}" for i in range(4 * n_rooms)),
            *(f"storey_{i}" for i in range(storeys)),
            "building_1",
        ],
        ["object"] * n + ["room"] * n_rooms + ["structure"] * (5 * n_rooms) + ["storey"] * storeys + ["building"],  # type: ignore[list-item]
        [
            *labels,
            *["room"] * n_rooms,
            *["floor"] * n_rooms,
            *["wall"] * (4 * n_rooms),
            *["storey"] * storeys,
            "building",
        ],
        center=np.concatenate(
            [
                centers,
                corner + 0.5 * size,
                floors,
                walls,
                np.array([[0.5 * span[0], 0.5 * span[1], k * pitch[2] + height] for k in range(storeys)]),
                0.5 * span[None],
            ]
        ),
        size=np.concatenate(
            [
                sizes,
                np.tile(size, (n_rooms, 1)),
                np.tile([size[0], size[1], 0.1], (n_rooms, 1)),
                np.repeat(np.array([across[0], across[0], across[1], across[1]]), n_rooms, axis=0),
                np.tile([span[0], span[1], size[2]], (storeys, 1)),
                span[None],
            ]
        ),
        yaw=np.concatenate([yaws, np.zeros(6 * n_rooms + storeys + 1)]),
        confidence=np.concatenate([rng.uniform(0.5, 1.0, n).round(3), np.ones(6 * n_rooms + storeys + 1)]),
        first_seen_ns=1_000,
        last_seen_ns=2_000 + rng.integers(0, 1_000, n + 6 * n_rooms + storeys + 1),
        attributes={row: {"name": f"room {row - n}"} for row in range(n, n + n_rooms)},
    )
    rooms = n + number
    return table, _hierarchy(table, rooms, n + 6 * n_rooms + storey_of, storeys)


def _hierarchy(table: NodeTable, rooms: NDArray[np.int64], storey: NDArray[np.int64], storeys: int) -> EdgeTable:
    last = len(table) - 1
    levels = np.arange(last - storeys, last)
    lower, upper = np.concatenate([rooms, levels]), np.concatenate([storey, np.full(storeys, last)])
    return EdgeTable.columns(
        table.ids,
        ["in"] * len(lower) + ["contains"] * len(lower),
        np.concatenate([lower, upper]),
        np.concatenate([upper, lower]),
        first_seen_ns=2_000,
    )


def _objects(
    rng: np.random.Generator, corner: NDArray[np.float64], per_room: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Centres, sizes, yaws and labels of what is in the rooms, room after room."""
    n_rooms = len(corner)
    kinds = [(label, size) for label, size, count in FURNITURE for _ in range(count)]
    kinds = kinds[: max(1, min(per_room, _PER_ROOM))]
    n_large, n_small = len(kinds), per_room - min(per_room, len(kinds))
    large = np.tile(np.array([size for _, size in kinds]), (n_rooms, 1, 1)) * rng.uniform(
        0.9, 1.1, (n_rooms, n_large, 1)
    )
    yaw = rng.choice([0.0, 0.5 * np.pi, 0.3], (n_rooms, n_large))
    middle = corner[:, None] + rng.uniform(0.1, 0.9, (n_rooms, n_large, 3)) * ROOM_M
    middle[:, :, 2] = corner[:, None, 2] + 0.5 * large[:, :, 2]

    kind = rng.integers(0, len(SMALL), (n_rooms, n_small))
    small = np.array([size for _, size in SMALL])[kind]
    host = rng.integers(-n_large // 4, n_large, (n_rooms, n_small))  # below 0: on the floor
    room = np.arange(n_rooms)[:, None]
    under, turned = large[room, host], yaw[room, host]
    along = rng.uniform(-0.4, 0.4, (n_rooms, n_small, 2)) * under[:, :, :2]
    c, s = np.cos(turned), np.sin(turned)
    place = middle[room, host] + np.stack(
        [c * along[..., 0] - s * along[..., 1], s * along[..., 0] + c * along[..., 1], np.zeros_like(c)], axis=2
    )
    in_crate = np.array([label == "crate" for label, _ in kinds])[host]
    top = np.where(in_crate, 0.02 - 0.5 * under[:, :, 2], 0.5 * under[:, :, 2])
    place[:, :, 2] += top + 0.5 * small[:, :, 2]
    floor = corner[:, None] + rng.uniform(0.05, 0.95, (n_rooms, n_small, 3)) * ROOM_M
    floor[:, :, 2] = corner[:, None, 2] + 0.5 * small[:, :, 2]
    place = np.where((host < 0)[:, :, None], floor, place)
    turn = rng.uniform(-np.pi, np.pi, (n_rooms, n_small))
    names = np.array([label for label, _ in SMALL])[kind]
    labels = np.concatenate([np.tile([label for label, _ in kinds], (n_rooms, 1)), names], axis=1)
    return (
        np.concatenate([middle, place], axis=1).reshape(-1, 3),
        np.concatenate([large, small], axis=1).reshape(-1, 3),
        np.concatenate([yaw, turn], axis=1).reshape(-1),
        labels.reshape(-1).tolist(),
    )
