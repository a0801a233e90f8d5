"""Stairs from bare geometry: flights are measured as they are, called so by rule, and lead from storey to storey."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.planes import PlaneMap
from scenegraph.perception.flights import Flight, inclines, measure
from scenegraph.world import World
from tests.scenegraph.test_storeys import UP, house
from tests.support.scenes import Block, Scene, looking_at, shell

VOXEL_M = 0.05
BLOCK_M = 8 * VOXEL_M


def surface_of(steps: list[tuple[float, float, float, float]], yaw: float, noise_m: float = 0.004) -> PlaneMap:
    """Treads (along, going, height, width) that lead up along x, turned by yaw about the origin, one sample a voxel."""
    random = np.random.default_rng(0)
    points = []
    for along, going, height, width in steps:
        x, y = np.meshgrid(
            np.arange(along - 0.5 * going + 0.02, along + 0.5 * going, VOXEL_M),
            np.arange(-0.5 * width, 0.5 * width, VOXEL_M),
        )
        points.append(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)]))
    local = np.concatenate(points) + random.normal(0.0, noise_m, (sum(map(len, points)), 3))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    cloud = (local @ turn.T).astype(np.float32)
    blocks, owner = np.unique(np.floor(cloud / BLOCK_M).astype(np.int32), axis=0, return_inverse=True)
    planes = PlaneMap(VOXEL_M)
    planes.replace(blocks, cloud, np.broadcast_to(np.float32([0.0, 0.0, 1.0]), cloud.shape), owner.reshape(-1))
    return planes


def flight_in(planes: PlaneMap, blocks: np.ndarray) -> Flight | None:
    points, *_ = planes.samples_in(blocks)
    found = [measure(planes, BLOCK_M, at, uphill) for at, uphill, _ in inclines(points)]
    return max((f for f in found if f is not None), key=lambda f: len(f.heights), default=None)


def blocks_about(reach: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(-reach, reach)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


@given(
    n=st.integers(5, 14),
    rise=st.floats(0.14, 0.22),
    going=st.floats(0.24, 0.34),
    width=st.floats(0.7, 1.4),
    yaw=st.floats(-np.pi, np.pi),
)
@settings(max_examples=40, deadline=None)
def test_a_flight_is_measured_as_it_is(n: int, rise: float, going: float, width: float, yaw: float) -> None:
    planes = surface_of([(going * k, going, rise * (k + 1), width) for k in range(n)], yaw)
    flight = flight_in(planes, blocks_about(14))
    assert flight is not None
    assert len(flight.heights) == n
    assert flight.rise_m == pytest.approx(rise, abs=0.01)
    assert flight.going_m == pytest.approx(going, abs=0.03)
    assert flight.width_m == pytest.approx(width, abs=0.2)
    assert flight.unevenness_m < 0.02
    assert flight.uphill @ [np.cos(yaw), np.sin(yaw)] > np.cos(np.deg2rad(8.0))


@pytest.mark.parametrize(
    "steps",
    [
        [(0.0, 0.3, 0.3 * k, 1.0) for k in range(6)],
        [(0.3 * k, 0.3, 0.75, 1.0) for k in range(6)],
        [(0.3 * k, 0.3, 0.05 * k, 1.0) for k in range(6)],
        [(0.0, 0.3, 0.2, 0.5), (0.3, 0.3, 0.4, 0.5)],
        [(0.3 * k, 0.3, height, 1.0) for k, height in enumerate((0.1, 0.6, 0.2, 0.9, 0.4))],
    ],
    ids=["boards of a shelf", "a table", "a ramp", "two steps", "boxes in a row"],
)
def test_what_is_no_flight_is_none(steps: list[tuple[float, float, float, float]]) -> None:
    flight = flight_in(surface_of(steps, 0.3), blocks_about(14))
    assert flight is None or len(flight.heights) < 4


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """The house of two storeys that `test_storeys` sees with labels, without them."""
    scene = house()
    with World() as world:
        n = 0
        for floor_z in (0.0, UP):
            for x, y in ((1.5, 2.4), (4.0, 2.4)):
                for yaw in np.arange(8) * np.pi / 4:
                    for tilt in (-0.8, 0.0, 0.7):
                        n += 1
                        eye = (x, y, floor_z + 1.3)
                        pose = looking_at(eye, (x + np.cos(yaw), y + np.sin(yaw), eye[2] + tilt))
                        world.integrate(scene.image(pose, n * 100_000_000, labelled=False))
            for x, down in ((1.2, -0.6), (2.4, -0.4), (3.6, -0.2), (1.0, -0.3), (3.0, -0.5), (4.2, 0.1)):
                n += 1
                pose = looking_at((x, 2.6, floor_z + 1.4), (x, 0.4, floor_z + 1.4 + down))
                world.integrate(scene.image(pose, n * 100_000_000, labelled=False))
        for way in (1.0, -1.0):
            for step in range(0, 15, 2):
                n += 1
                eye = (1.0 + 0.225 * step, 0.5, 0.18 * (step + 1) + 1.3)
                target = (eye[0] + way, 0.5 + 0.2 * (step % 4 - 1), eye[2] - 1.3 + 0.5 * way)
                world.integrate(scene.image(looking_at(eye, target), n * 100_000_000, labelled=False))
        yield world


def test_stairs_that_nobody_named_lead_from_storey_to_storey(world: World) -> None:
    [stairs] = world.graph.nodes("structure", label="stairs")
    assert stairs.attributes["rise_m"] == pytest.approx(0.18, abs=0.01)
    assert stairs.attributes["going_m"] == pytest.approx(0.225, abs=0.02)
    assert stairs.attributes["width_m"] == pytest.approx(0.9, abs=0.15)
    assert stairs.attributes["levels"] == 16, "the floor at its foot, and fifteen steps"
    rooms = {e.target for e in world.graph.edges("connects", source=stairs.id)}
    storeys = {world.graph.node(room).attributes["storey"] for room in rooms}
    assert storeys == {1, 2}
    shapes = world.perception.objects.shapes
    things = [shapes[node.id].points for node in world.graph.nodes("object")]
    assert all(world.perception.stairs.holds(points).mean() < 0.1 for points in things), "its steps are no things"


def test_stairs_come_back_from_disk_and_stay_away_when_deleted(world: World, tmp_path: Path) -> None:
    world.save(tmp_path / "house.world")
    with World.load(tmp_path / "house.world") as again:
        assert again.graph == world.graph
        [stairs] = again.graph.nodes("structure", label="stairs")
        assert again.tell(f"delete({stairs.id})", author="me").accepted
        scene, pose = house(), looking_at((2.4, 2.6, 1.4), (2.4, 0.4, 1.0))
        for n in range(16):
            again.integrate(scene.image(pose, 10**11 + n * 100_000_000, labelled=False))
        assert again.graph.nodes("structure", label="stairs") == []


def test_shelves_and_plinths_are_no_stairs() -> None:
    boards = [Block("shelf", (0.2, 2.0, 0.3 + 0.35 * n), (0.35, 1.6, 0.03), 1) for n in range(5)]
    plinth = [
        Block("plinth", (2.0, 2.0, 0.1), (1.2, 1.2, 0.2), 2),
        Block("plinth", (2.0, 2.0, 0.3), (0.6, 0.6, 0.2), 2),
    ]
    piled = [Block("box", (3.4, 1.0 + 0.45 * n, 0.5 * h), (0.4, 0.4, h), 3 + n) for n, h in enumerate((0.3, 0.8, 0.4))]
    scene = Scene((*shell((0.0, 0.0), (4.0, 4.0)), *boards, *plinth, *piled))
    with World() as world:
        for n, angle in enumerate(np.arange(24) * np.pi / 12):
            eye = (2.0 + 1.5 * np.cos(angle), 2.0 + 1.5 * np.sin(angle), 1.8)
            target = (2.0 - 1.6 * np.cos(angle), 2.0 - 1.6 * np.sin(angle), 0.3)
            world.integrate(scene.image(looking_at(eye, target), n * 100_000_000, labelled=False))
        assert world.graph.nodes("structure", label="stairs") == []
