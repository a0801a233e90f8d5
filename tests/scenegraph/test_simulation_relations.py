"""The relations that truly hold in a home: their laws, and cases worked out by hand."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from scenegraph.simulation import TrueObject, simulate_home
from scenegraph.simulation.adjoining import _nearest
from scenegraph.simulation.floorplan import WALL_M
from scenegraph.simulation.relations import _body, _inside, _rise, near_distance, surface_gap
from scenegraph.simulation.shapes import Shape
from scenegraph.simulation.things import bowl, cup
from scenegraph.simulation.ways import WayAround
from tests.support.homes import home

SEEDS = (2, 9)
two_homes = pytest.mark.parametrize("seed", SEEDS)


def pairs(seed, name):
    return {(a, b) for relation, a, b in home(seed).relations() if relation == name}


def put(model, x, y, z, yaw=0.0, container=False):
    c, s = np.cos(yaw), np.sin(yaw)
    vertices = model.vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [x, y, z]
    return _body(
        TrueObject(
            id=model.label, label=model.label, vertices=vertices, triangles=model.triangles, colors=model.colors,
            center=np.array([x, y, z + model.upper[2] / 2]), size=model.upper - model.lower,
            rotation_wxyz=np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]), yaw=yaw, room="room", support=None,
            container=container,
        )
    )  # fmt: skip


def block(w, d, h):
    return Shape("block").box((-w / 2, w / 2), (-d / 2, d / 2), (0.0, h)).model()


@two_homes
def test_on_is_acyclic_and_holds_where_things_were_put(seed):
    graph = nx.DiGraph(pairs(seed, "on"))
    assert nx.is_directed_acyclic_graph(graph)
    assert {(o.id, o.support) for o in home(seed).objects if o.support} <= pairs(seed, "on")


@two_homes
def test_every_thing_is_in_the_one_room_it_was_put_in(seed):
    h = home(seed)
    rooms = {room.id for room in h.rooms}
    inside = sorted((a, b) for a, b in pairs(seed, "in") if b in rooms)
    assert inside == sorted((o.id, o.room) for o in h.objects)


@two_homes
def test_what_was_put_into_a_container_is_in_it(seed):
    h = home(seed)
    put_into = {(o.id, o.support) for o in h.objects if o.support and h.thing(o.support).container}
    assert put_into
    assert put_into <= pairs(seed, "in")


@two_homes
def test_nothing_is_on_and_above_the_same_thing_or_in_what_is_in_it(seed):
    assert not pairs(seed, "on") & pairs(seed, "above")
    inside = pairs(seed, "in")
    assert not {(b, a) for a, b in inside} & inside
    above = pairs(seed, "above")
    assert not {(b, a) for a, b in above} & above


@two_homes
def test_near_names_each_pair_once_and_what_bears_a_thing_is_near_it(seed):
    near = pairs(seed, "near")
    assert all(a < b for a, b in near)
    assert {(min(a, b), max(a, b)) for a, b in pairs(seed, "on")} <= near


@two_homes
def test_what_is_next_to_another_is_near_it_and_what_bears_a_thing_touches_it(seed):
    assert pairs(seed, "next_to") <= pairs(seed, "near")
    assert {(min(a, b), max(a, b)) for a, b in pairs(seed, "on")} <= pairs(seed, "touching")
    assert not {(min(a, b), max(a, b)) for a, b in pairs(seed, "on")} & pairs(seed, "next_to")


@two_homes
def test_what_was_hung_on_a_wall_is_fixed_to_a_wall_of_its_room_and_rests_on_nothing(seed):
    h = home(seed)
    walls = {plane.id: plane.source for plane in h.structure if plane.kind == "wall"}
    hung = {o.id for o in h.objects if o.support is None and o.vertices[:, 2].min() > 0.3}
    fixed = {a for a, b in pairs(seed, "attached_to") if b in walls}
    assert hung
    assert hung == fixed
    assert all(h.thing(a).room == walls[b] for a, b in pairs(seed, "attached_to") if b in walls)
    assert not fixed & {a for a, _ in pairs(seed, "on")}


@two_homes
def test_nothing_stands_between_things_next_to_each_other_and_something_does_between_some_near_ones(seed):
    h = home(seed)
    bearers = {o.id: o.support for o in h.objects}
    together = {(a, b) for a, b in pairs(seed, "near") if bearers[a] is not None and bearers[a] == bearers[b]}
    parted = together - pairs(seed, "next_to")
    assert parted
    assert together - parted
    shelves = {o.id for o in h.objects if o.label == "shelf"}
    for a, b in pairs(seed, "next_to"):
        if bearers[a] in shelves and bearers[a] == bearers[b]:  # on one board
            assert abs(h.thing(a).vertices[:, 2].min() - h.thing(b).vertices[:, 2].min()) < 0.05


def test_relations_do_not_change_when_the_home_is_turned():
    assert simulate_home(9, yaw=0.7).relations() == home(9).relations()


def test_near_does_not_reach_through_a_wall():
    h = home(2)
    values = h.relation_values
    apart = [(a, b) for name, a, b in values if name == "near" and h.thing(a).room != h.thing(b).room]
    for a, b in apart:
        rooms = {h.thing(a).room, h.thing(b).room}
        assert any(rooms <= set(door.rooms) and door.kind != "closed" for door in h.doors)


def test_a_gap_between_blocks_is_what_it_is_by_hand():
    a = put(block(0.4, 0.4, 0.4), 0.0, 0.0, 0.0)
    assert surface_gap(a, put(block(0.2, 0.2, 0.2), 0.8, 0.0, 0.1), 0.5) == pytest.approx(0.5, abs=1e-4)
    assert surface_gap(a, put(block(0.2, 0.2, 0.2), 0.0, 0.0, 0.7), 0.3) == pytest.approx(0.3, abs=1e-4)
    turned = put(block(0.2, 0.2, 0.2), 0.8, 0.0, 0.1, yaw=np.pi / 4)
    assert surface_gap(a, turned, 0.46) == pytest.approx(0.6 - 0.1 * np.sqrt(2), abs=1e-4)


def test_the_line_between_two_things_joins_their_nearest_points_the_highest_of_them():
    rng = np.random.default_rng(3)
    for _ in range(10):
        a = put(block(*rng.uniform(0.1, 0.8, 3)), 0.0, 0.0, 0.0)
        b = put(block(*rng.uniform(0.1, 0.8, 3)), *rng.uniform(0.9, 1.5, 2), rng.uniform(0.0, 0.5), rng.uniform(0, 3))
        p, q = _nearest(a, b)
        assert np.linalg.norm(p - q) <= surface_gap(a, b, 3.0) + 0.0101
        assert a.scene.distance(p[None])[0] + b.scene.distance(q[None])[0] < 1e-4
        assert min(p[2], q[2]) >= min(a.upper[2], b.upper[2]) - 0.03, "upright sides are as near all the way up"


def test_near_distance_is_half_the_sum_of_the_longer_sides_within_bounds():
    small, large, huge = (put(block(w, 0.05, 0.1), 0, 0, 0) for w in (0.1, 1.4, 2.8))
    assert near_distance(small, small) == 0.5
    assert near_distance(small, large) == pytest.approx(0.75)
    assert near_distance(large, huge) == 1.5


def test_a_way_leads_around_the_edge_of_a_door():
    h = home(2)
    ways = WayAround(h)
    door = next(d for d in h.doors if d.kind == "doorway")
    n, along = door.normal, np.array([-door.normal[1], door.normal[0], 0.0])
    edge = door.width / 2
    floor = door.center * [1, 1, 0]
    for beyond in (0.1, 0.2):
        a = floor + n * (WALL_M / 2 + 0.2) + along * (edge + beyond) + [0, 0, 0.5]
        b = floor - n * (WALL_M / 2 + 0.2) + along * (edge + beyond) + [0, 0, 0.9]
        flat = 2 * np.hypot(0.2, beyond) + WALL_M
        assert ways.length(a[None], b[None], 1.5) == pytest.approx(np.hypot(flat, 0.4), abs=5e-3)
    a, b = floor + n * 0.4 + [0, 0, 0.5], floor - n * 0.4 + [0, 0, 1.0]
    assert ways.length(a[None], b[None], 1.5) == pytest.approx(np.hypot(0.8, 0.5), abs=1e-6)


def test_no_way_leads_through_a_closed_door():
    h = home(2)
    door = next(d for d in h.doors if d.kind == "closed" and len(d.rooms) == 2)
    a, b = door.center + door.normal * 0.3, door.center - door.normal * 0.3
    assert WayAround(h).length(a[None], b[None], 1.0) > 1.0


def test_a_cup_is_in_a_bowl_but_not_in_the_space_beneath_a_table():
    rng = np.random.default_rng(1)
    thing = cup(rng)
    assert _inside(put(thing, 0.02, 0.0, 0.013), put(bowl(rng), 0.0, 0.0, 0.0, container=True)) >= 0.8
    shape = Shape("table").box((-0.5, 0.5), (-0.5, 0.5), (0.7, 0.75))
    for x in (-0.45, 0.45):
        for y in (-0.45, 0.45):
            shape.box((x - 0.05, x + 0.05), (y - 0.05, y + 0.05), (0.0, 0.7))
    table = put(shape.model(), 0.0, 0.0, 0.0)
    assert _inside(put(thing, 0.0, 0.0, 0.001), table) == 0.0
    assert _rise(table, put(block(0.1, 0.2, 0.3), 0.0, 0.0, 0.001)) == pytest.approx(0.7 - 0.301, abs=1e-4)


def test_a_compartment_closed_on_four_sides_is_an_interior():
    shelf = Shape("shelf").open_box((-0.4, 0.4), (-0.2, 0.2), (0.0, 0.5), 0.02, open_front=True).model()
    inside, before = put(block(0.1, 0.1, 0.1), 0.0, 0.0, 0.021), put(block(0.1, 0.1, 0.1), 0.0, -0.4, 0.021)
    assert _inside(inside, put(shelf, 0.0, 0.0, 0.0)) == 1.0
    assert _inside(before, put(shelf, 0.0, 0.0, 0.0)) == 0.0
