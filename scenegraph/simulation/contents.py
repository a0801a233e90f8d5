"""What stands in which kind of room, and where."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from scenegraph.simulation import furniture as f
from scenegraph.simulation import things as t
from scenegraph.simulation.arrangement import Arrangement, Maker, Placed
from scenegraph.simulation.floorplan import FloorPlan, RoomPlan, Side

_ATTEMPTS = 40


def furnish(rng: Generator, plan: FloorPlan, room: RoomPlan) -> list[Placed]:
    """Fills a room: the first of several attempts in which all large things find a place and the robot gets through."""
    best = Arrangement(rng, plan, room)
    for _ in range(_ATTEMPTS):
        arrangement = Arrangement(rng, plan, room)
        complete = _LARGE[room.kind](arrangement)
        if arrangement.passable() and (complete or len(arrangement.things) > len(best.things)):
            best = arrangement
            if complete:
                break
    large = len(best.things)
    _SMALL[room.kind](best)
    while not best.passable() and len(best.things) > large:
        last = next(t for t in reversed(best.things) if t.support is None)
        best.remove(last)  # what was strewn about the floor last is in the robot's way
    return best.things


def _longest(a: Arrangement) -> tuple[Side, Side]:
    r = a.room
    return ("south", "north") if r.x1 - r.x0 > r.y1 - r.y0 else ("west", "east")


def _chairs(a: Arrangement, table: Placed, maker: Maker, places: int) -> int:
    """Chairs around a table, drawn up to it, each turned a little."""
    w, d = table.model.upper[0], table.model.upper[1]
    spots = [
        (-w * 0.45, -d - 0.1, np.pi),
        (w * 0.45, -d - 0.1, np.pi),
        (-w * 0.45, d + 0.1, 0.0),
        (w * 0.45, d + 0.1, 0.0),
    ]
    a.rng.shuffle(spots)
    done = 0
    for x, y, turn in spots:
        if done < places and a.before(maker, table, (float(x), float(y)), float(turn), 0.3) is not None:
            done += 1
    return done


def _many(
    a: Arrangement, makers: Sequence[Maker], bearer: Placed | None, yaw: float = np.pi, margin: float = 0.02
) -> None:
    for make in makers:
        a.upon(make, bearer, yaw=yaw, margin=margin)


# -- large things: each returns whether all of them found a place ---------------------------------------------


def _kitchen(a: Arrangement) -> bool:
    counter = a.against_wall(f.counter)
    if counter is None:
        return False
    oven = a.against_wall(f.oven, beside=counter, sides=[_side_of(a, counter)])
    fridge = a.against_wall(f.fridge)
    table = a.on_floor(f.table, margin=0.3, aligned=a.rng.random() < 0.4, inset=0.8)
    if table is None or oven is None or fridge is None:
        return False
    a.against_wall(f.wall_cabinet, beside=counter, height=a.rng.uniform(1.42, 1.5), sides=[_side_of(a, counter)])
    return _chairs(a, table, f.chair, 4) >= 3 and a.against_wall(t.trash_bin, gap=0.05) is not None


def _side_of(a: Arrangement, thing: Placed) -> Side:
    r, (x, y, _) = a.room, thing.position
    distance: dict[Side, float] = {"south": y - r.y0, "north": r.y1 - y, "west": x - r.x0, "east": r.x1 - x}
    return min(distance, key=lambda side: distance[side])


def _living_room(a: Arrangement) -> bool:
    stand = a.against_wall(f.tv_stand)
    if stand is None:
        return False
    sofa = a.before(f.sofa, stand, (0.0, -a.rng.uniform(2.2, 2.8)), np.pi, 0.2, 0.05)
    if sofa is None:
        return False
    low = a.before(f.coffee_table, sofa, (0.0, -0.95), 0.0, 0.25, 0.1)
    chair = a.on_floor(f.armchair, margin=0.1, inset=0.6)
    shelf = a.against_wall(f.shelf)
    ok = low is not None and chair is not None and shelf is not None
    ok = a.against_wall(f.floor_lamp, gap=0.05) is not None and ok
    ok = a.against_wall(f.plant, gap=0.06) is not None and ok
    return a.on_floor(t.basket, margin=0.1) is not None and ok


def _bedroom(a: Arrangement) -> bool:
    bed = a.against_wall(f.bed, yaw=0.0)
    if bed is None:
        return False
    sides = [_side_of(a, bed)]
    stands = [a.against_wall(f.nightstand, beside=bed, sides=sides) for _ in range(2)]
    ok = any(s is not None for s in stands) and a.against_wall(f.wardrobe) is not None
    ok = a.against_wall(f.dresser) is not None and ok
    return a.on_floor(t.basket, margin=0.08) is not None and ok


def _child_room(a: Arrangement) -> bool:
    bed = a.against_wall(f.bed)
    desk = a.against_wall(f.desk)
    if bed is None or desk is None:
        return False
    ok = a.before(f.chair, desk, (0.0, -0.5), np.pi, 0.4) is not None
    ok = a.against_wall(f.shelf) is not None and ok
    return a.on_floor(t.basket, margin=0.1) is not None and ok


def _bathroom(a: Arrangement) -> bool:
    tub = a.against_wall(f.bathtub)
    toilet = a.against_wall(f.toilet)
    sink = a.against_wall(f.washbasin, margin=0.1)
    if tub is None or toilet is None or sink is None:
        return False
    mirror = a.against_wall(f.mirror, beside=sink, height=a.rng.uniform(1.2, 1.3), sides=[_side_of(a, sink)], gap=0.005)
    machine = a.against_wall(f.washing_machine)
    stool = a.on_floor(f.stool, margin=0.05)
    ok = mirror is not None and machine is not None and stool is not None
    return a.against_wall(t.trash_bin, gap=0.05) is not None and ok


def _office(a: Arrangement) -> bool:
    desk = a.against_wall(f.desk)
    if desk is None:
        return False
    ok = a.before(f.office_chair, desk, (0.0, -0.62), np.pi, 0.6) is not None
    ok = a.against_wall(f.shelf) is not None and ok
    ok = a.against_wall(f.cabinet) is not None and ok
    ok = a.on_floor(t.trash_bin) is not None and ok
    ok = a.against_wall(f.plant, gap=0.06) is not None and ok
    return a.against_wall(f.picture, height=a.rng.uniform(1.35, 1.5), gap=0.005) is not None and ok


def _hallway(a: Arrangement) -> bool:
    sides = _longest(a)
    cabinet = a.against_wall(f.cabinet, sides=sides)
    bench = a.against_wall(f.bench, sides=sides)
    ok = cabinet is not None and bench is not None
    ok = a.against_wall(f.plant, gap=0.05) is not None and ok
    return a.against_wall(f.picture, sides=sides, height=a.rng.uniform(1.35, 1.5), gap=0.005) is not None and ok


# -- small things ---------------------------------------------------------------------------------------------


def _of(a: Arrangement, label: str, floor_only: bool = True) -> list[Placed]:
    return [p for p in a.things if p.model.label == label and (p.position[2] < 0.1 or not floor_only)]


def _first(a: Arrangement, label: str) -> Placed | None:
    found = _of(a, label)
    return found[0] if found else None


def _fill_kitchen(a: Arrangement) -> None:
    counter, table, oven = _first(a, "counter"), _first(a, "table"), _first(a, "oven")
    a.upon(t.vessel_sink, counter, yaw=0.05, at=(0.15 if a.rng.random() < 0.5 else 0.85, 0.7))
    a.upon(t.microwave, counter, yaw=0.2, at=(a.rng.uniform(), 0.9))
    _many(a, [t.kettle, t.toaster, t.cup, t.bottle], counter)
    _many(a, [t.pot, t.pot], oven)
    bowl = a.upon(t.bowl, table, at=(0.5, 0.5))
    _many(a, [t.apple, t.orange, t.apple], bowl, margin=0.0)
    _many(a, [t.plate, t.cup, t.plate, t.cup, t.plate, t.bottle, t.cup], table)
    _many(a, [t.box], _first(a, "fridge"))
    _many(a, [t.book], next(iter(_of(a, "chair")), None))


def _fill_living_room(a: Arrangement) -> None:
    stand, sofa, low = _first(a, "tv_stand"), _first(a, "sofa"), _first(a, "coffee_table")
    a.upon(t.tv, stand, yaw=0.05, at=(0.5, 0.5))
    _many(a, [t.speaker, t.speaker], stand, yaw=0.4)
    _many(a, [t.cushion, t.cushion, t.cushion], sofa)
    _many(a, [t.book, t.cup, t.bowl, t.book], low)
    _many(a, [t.cushion], _first(a, "armchair"))
    book = next(iter(_of(a, "book", False)), None)
    a.upon(t.book, book, yaw=0.3)
    _fill_shelf(a, [t.vase, t.small_plant, t.box, t.speaker], 4)
    basket = _first(a, "basket")
    _many(a, [t.toy_ball, t.toy_block, t.toy_block], basket, margin=0.008)
    for make in (t.toy_block, t.toy_ball):
        a.on_floor(make, margin=0.05)


def _fill_shelf(a: Arrangement, makers: Sequence[Maker], books: int) -> None:
    shelf = _first(a, "shelf")
    if shelf is None:
        return
    for make in makers:
        a.upon(make, shelf, level=int(a.rng.integers(1, 5)), yaw=0.5, margin=0.04)
    for _ in range(books):
        a.upon(t.standing_book, shelf, level=int(a.rng.integers(1, 4)), yaw=0.15, margin=0.04)


def _fill_bedroom(a: Arrangement) -> None:
    bed = _first(a, "bed")
    a.upon(t.pillow, bed, yaw=0.25, at=(0.1, 0.95))
    a.upon(t.pillow, bed, yaw=0.25, at=(0.9, 0.95))
    a.upon(t.teddy, bed, yaw=1.0)
    a.upon(t.towel, bed, yaw=1.0)
    for k, stand in enumerate(_of(a, "nightstand")):
        a.upon(t.table_lamp, stand, at=(0.8, 0.8))
        a.upon(t.alarm_clock if k == 0 else t.cup, stand, yaw=0.6, margin=0.01)
    _many(a, [t.vase, t.box, t.book], _first(a, "dresser"), yaw=0.8)
    _many(a, [t.towel], _first(a, "basket"))
    for _ in range(2):
        a.on_floor(t.shoe)


def _fill_child_room(a: Arrangement) -> None:
    bed = _first(a, "bed")
    a.upon(t.pillow, bed, yaw=0.25, at=(0.5, 0.95))
    _many(a, [t.teddy, t.toy_ball], bed)
    _many(a, [t.table_lamp, t.laptop, t.book, t.cup], _first(a, "desk"), yaw=0.6)
    _fill_shelf(a, [t.box, t.teddy, t.small_plant], 4)
    _many(a, [t.toy_ball, t.toy_block], _first(a, "basket"), margin=0.008)
    for make in (t.toy_block, t.backpack):
        a.on_floor(make)


def _fill_bathroom(a: Arrangement) -> None:
    _many(a, [t.towel], _first(a, "stool"), yaw=0.5)
    _many(a, [t.bottle, t.bottle, t.towel, t.cup], _first(a, "washing_machine"))
    _many(a, [t.bottle], _first(a, "toilet"))
    a.on_floor(t.basket, margin=0.06)
    _many(a, [t.towel], _first(a, "basket"), yaw=0.3)


def _fill_office(a: Arrangement) -> None:
    desk = _first(a, "desk")
    a.upon(t.monitor, desk, yaw=0.2, at=(a.rng.uniform(0.3, 0.7), 0.9))
    a.upon(t.keyboard, desk, yaw=0.2, at=(a.rng.uniform(0.3, 0.7), 0.15))
    a.upon(t.laptop, desk, yaw=0.5)
    _many(a, [t.table_lamp, t.cup, t.book], desk)
    _fill_shelf(a, [t.box, t.vase, t.box], 5)
    _many(a, [t.printer, t.small_plant], _first(a, "cabinet"), yaw=0.2)
    a.on_floor(t.backpack)


def _fill_hallway(a: Arrangement) -> None:
    _many(a, [t.vase, t.bowl, t.book], _first(a, "cabinet"))
    _many(a, [t.backpack, t.box], _first(a, "bench"), yaw=0.3)
    for _ in range(4):
        a.against_wall(t.shoe, gap=0.03, yaw=0.5)


_LARGE: dict[str, Callable[[Arrangement], bool]] = {
    "kitchen": _kitchen,
    "living_room": _living_room,
    "bedroom": _bedroom,
    "child_room": _child_room,
    "bathroom": _bathroom,
    "office": _office,
    "hallway": _hallway,
}
_SMALL: dict[str, Callable[[Arrangement], None]] = {
    "kitchen": _fill_kitchen,
    "living_room": _fill_living_room,
    "bedroom": _fill_bedroom,
    "child_room": _fill_child_room,
    "bathroom": _fill_bathroom,
    "office": _fill_office,
    "hallway": _fill_hallway,
}
