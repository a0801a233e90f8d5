"""What every simulated home must contain, and that nothing in it is impossible."""

from __future__ import annotations

import inspect
from itertools import combinations

import numpy as np
import pytest
import shapely

from scenegraph.simulation import furniture, simulate_home, things
from scenegraph.simulation.arrangement import overlap
from scenegraph.simulation.driving import FloorGrid
from scenegraph.simulation.floorplan import WALL_M
from scenegraph.simulation.shapes import Model
from tests.support.homes import SEEDS, home

MAKERS = [
    make
    for module in (furniture, things)
    for name, make in inspect.getmembers(module, inspect.isfunction)
    if not name.startswith("_") and name != "pick" and make.__module__ == module.__name__
]
every_home = pytest.mark.parametrize("seed", SEEDS)


@every_home
def test_a_home_has_six_rooms_of_which_two_are_open_plan(seed):
    h = home(seed)
    assert len(h.rooms) >= 6
    kinds = {room.kind for room in h.rooms}
    assert {"kitchen", "living_room", "bedroom", "bathroom", "office", "hallway"} <= kinds
    (opening,) = [door for door in h.doors if door.kind == "opening"]
    assert set(opening.rooms) == {"kitchen", "living_room"}
    assert 2.0 <= opening.width <= 2.5
    assert all(2.4 - 0.2 <= room.ceiling_z - room.floor_z <= 2.7 for room in h.rooms)


@every_home
def test_a_home_has_doors_ajar_closed_and_without_a_leaf(seed):
    assert {"ajar", "closed", "doorway"} <= {door.kind for door in home(seed).doors}


@every_home
def test_a_home_has_many_things_of_many_classes_and_sizes(seed):
    h = home(seed)
    assert len(h.objects) >= 80
    assert len({o.label for o in h.objects}) >= 25
    assert min(o.size.max() for o in h.objects) <= 0.10
    assert max(o.size.max() for o in h.objects) >= 1.5


@every_home
def test_at_least_three_in_ten_things_are_not_aligned_with_the_walls(seed):
    h = home(seed)
    off = np.array([abs((o.yaw - h.yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4) for o in h.objects])
    assert np.mean(off > np.deg2rad(5)) >= 0.3


@every_home
def test_at_least_two_in_ten_things_touch_a_thing_of_another_class_and_some_are_inside_others(seed):
    h = home(seed)
    touching = set()
    for o in h.objects:
        if o.support is not None and h.thing(o.support).label != o.label:
            touching |= {o.id, o.support}
    assert len(touching) >= 0.2 * len(h.objects)
    assert any(o.support is not None and h.thing(o.support).container for o in h.objects)


@every_home
def test_no_thing_runs_into_another_or_through_a_wall(seed):
    h = home(seed)
    rooms = {r.id: shapely.box(r.x0, r.y0, r.x1, r.y1) for r in h.plan.rooms}
    for placed in h.placed:
        assert rooms[placed.room].contains(placed.footprint)
        assert placed.top < h.plan.room(placed.room).height
    for a, b in combinations(h.placed, 2):
        if a.room == b.room and a.footprint.intersects(b.footprint):
            assert not overlap(a.solids, b.solids), (a.model.label, b.model.label)


@every_home
def test_a_robot_gets_into_every_room_and_through_every_door_that_is_not_closed(seed):
    h = home(seed)
    grid = FloorGrid(h.plan, h.placed)
    start = grid.start()
    assert set(grid.order(start)) == {room.id for room in h.rooms}
    for door in h.doors:
        if door.kind == "closed":
            continue
        center = (h.T_map_home.inverse() @ door.center[None])[0, :2]
        normal = (h.T_map_home.rotation.T @ door.normal)[:2]
        for side in (-1, 1):
            spot = center + side * normal * (WALL_M / 2 + 0.35)
            cell = int(np.linalg.norm(grid.points - spot, axis=1).argmin())
            assert np.linalg.norm(grid.points[cell] - spot) < 0.15
            assert np.isfinite(grid.distance(start, cell))


def test_the_same_seed_gives_the_same_home_and_another_seed_another():
    again = simulate_home(3)
    assert np.array_equal(home(3).vertices, again.vertices)
    assert home(3).entities == again.entities
    assert home(4).vertices.shape != again.vertices.shape


def test_a_home_can_be_turned_without_changing_it():
    turned = simulate_home(3, yaw=0.0)
    back = turned.T_map_home.inverse() @ turned.vertices
    assert np.allclose(back, home(3).T_map_home.inverse() @ home(3).vertices, atol=1e-4)


@pytest.mark.parametrize("seed", [0, 7])
def test_the_box_of_a_thing_is_the_tightest_in_its_own_orientation(seed):
    for o in home(seed).objects:
        c, s = np.cos(o.yaw), np.sin(o.yaw)
        local = (o.vertices - o.center) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        assert np.allclose(local.max(axis=0), o.size / 2, atol=1e-9)
        assert np.allclose(local.min(axis=0), -o.size / 2, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 7])
def test_true_planes_bound_the_rooms(seed):
    h = home(seed)
    for room in h.rooms:
        mine = [p for p in h.structure if p.source == room.id]
        assert sorted(p.kind for p in mine) == ["ceiling", "floor", "wall", "wall", "wall", "wall"]
        middle = np.array([*room.footprint.mean(axis=0), (room.floor_z + room.ceiling_z) / 2])
        assert all(p.normal @ middle > p.offset for p in mine)
        floor = next(p for p in mine if p.kind == "floor")
        assert floor.area == pytest.approx(shapely.Polygon(room.footprint).area)


@pytest.mark.parametrize("seed", [0, 7])
def test_the_triangles_of_a_plane_lie_in_it_and_cover_its_area(seed):
    h = home(seed)
    corners = h.vertices.astype(float)[h.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    for k, plane in enumerate(h.structure):
        mine = h.triangle_plane == k
        assert area[mine].sum() == pytest.approx(plane.area, rel=1e-3)
        assert np.allclose(corners[mine] @ plane.normal, plane.offset, atol=1e-5)


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_a_model_stands_on_its_origin_and_its_solids_hold_it(make):
    model: Model = make(np.random.default_rng(5))
    assert np.allclose([*(model.lower + model.upper)[:2], model.lower[2]], 0.0, atol=1e-9)
    assert model.triangles.max() == len(model.vertices) - 1
    assert len(model.colors) == len(model.triangles)
    used = model.vertices[np.unique(model.triangles)]
    held = np.zeros(len(used), dtype=bool)
    for solid in model.solids:
        level = (used[:, 2] >= solid.low - 1e-6) & (used[:, 2] <= solid.high + 1e-6)
        held |= level & shapely.intersects_xy(solid.outline.buffer(1e-4), used[:, 0], used[:, 1])
    assert held.all()
