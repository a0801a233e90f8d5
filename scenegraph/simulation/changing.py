"""What becomes of a home between two visits: things are taken away, put elsewhere, and brought in."""

from __future__ import annotations

import copyreg
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from mapping.errors import InvalidParameter
from scenegraph.simulation import things
from scenegraph.simulation.arrangement import Arrangement, Maker, Placed
from scenegraph.simulation.assembling import CONTAINER_CLASSES, assemble, simulate_home
from scenegraph.simulation.home import Change, Home

FIXED_CLASSES = frozenset({
    "bathtub", "bed", "bench", "cabinet", "coffee_table", "counter", "desk", "dresser", "fridge", "mirror",
    "nightstand", "oven", "picture", "shelf", "sink", "sofa", "table", "toilet", "tv_stand", "wardrobe",
    "washing_machine",
})  # fmt: skip
"""What stays where it is; all else that bears nothing is loose."""
REMOVED_SHARE = 0.20
MOVED_SHARE = 0.12
ADDED = 5
NEAREST_M, FARTHEST_M = 0.3, 4.0
"""A thing that is put elsewhere ends up so far from where it was."""
_NEW: tuple[Maker, ...] = (
    things.cup, things.bottle, things.book, things.box, things.vase, things.teddy, things.toy_ball, things.small_plant,
    things.table_lamp, things.speaker, things.bowl, things.backpack,
)  # fmt: skip


def change_home(home: Home, seed: int = 0) -> Home:
    """The home as somebody else left it, always the same for a seed; its `change` tells what is different.

    Of the loose things a fifth is removed, others are put upon other furniture or on the floor elsewhere, in the room
    or the next, and some are brought in. Raises `InvalidParameter` on a home that has been changed before.
    """
    if home.change is not None:
        raise InvalidParameter("change_home: this home has been changed before")
    rng = np.random.default_rng([home.seed, seed, 40])
    bearing = {p.support for p in home.placed}
    names = {p.id: o.id for p, o in zip(home.placed, home.objects, strict=True)}
    loose = [p for p in home.placed if p.model.label not in FIXED_CLASSES and p.id not in bearing]
    order = [loose[k] for k in rng.permutation(len(loose))]
    n = round(REMOVED_SHARE * len(loose))
    removed = {p.id for p in order[:n]}
    rooms = _arrangements(home, rng, removed)

    moved: dict[str, Placed] = {}
    for p in order[n:]:
        if len(moved) == round(MOVED_SHARE * len(loose)):
            break
        elsewhere = _put_elsewhere(p, rooms, rng)
        if elsewhere is not None:
            moved[p.id] = elsewhere
    added = list(_bring_in(rooms, rng))
    counts = {label: sum(o.label == label for o in home.objects) for label in {p.model.label for p in added}}
    for p in added:
        counts[p.model.label] += 1
        names[p.id] = f"{p.model.label}_{counts[p.model.label]}"
    change = Change(
        before=home,
        seed=seed,
        removed=frozenset(names[i] for i in removed),
        moved=frozenset(names[i] for i in moved),
        added=frozenset(names[p.id] for p in added),
    )
    placed = [moved.get(p.id, p) for p in home.placed if p.id not in removed] + added
    return assemble(home.seed, home.yaw, home.T_map_home, home.plan, placed, home.tints, names, change)


def _arrangements(home: Home, rng: Generator, removed: set[str]) -> dict[str, Arrangement]:
    """The rooms as they stand, by id, to put more into."""
    rooms = {}
    for room in home.plan.rooms:
        rooms[room.id] = Arrangement(rng, home.plan, room)
        rooms[room.id].things = [p for p in home.placed if p.room == room.id and p.id not in removed]
    return rooms


def _put_elsewhere(p: Placed, rooms: dict[str, Arrangement], rng: Generator) -> Placed | None:
    """The thing at another place, by then its own in `rooms`; None when there is none for it."""
    here = rooms[p.room]
    here.things = [t for t in here.things if t.id != p.id]
    for new in _places(lambda _: p.model, p.support is None, rooms, rng):
        room = rooms[new.room]
        room.things.pop()
        way = float(np.linalg.norm(np.subtract(new.position, p.position)))
        if NEAREST_M <= way <= FARTHEST_M:
            settled = replace(new, id=p.id)
            room.things.append(settled)
            if new.support is not None or room.passable():
                return settled
            room.things.pop()
    here.things.append(p)
    return None


def _bring_in(rooms: dict[str, Arrangement], rng: Generator) -> Iterator[Placed]:
    for k, which in enumerate(rng.permutation(len(_NEW))[:ADDED].tolist()):
        new = next(_places(_NEW[which], False, rooms, rng), None)
        if new is not None:
            settled = replace(new, id=f"{new.room}.new{k}")
            rooms[new.room].things[-1] = settled
            yield settled


def _places(make: Maker, on_floor: bool, rooms: dict[str, Arrangement], rng: Generator) -> Iterator[Placed]:
    """Places for a thing in random order, each the last of its room's things until the next is asked for."""
    if on_floor:
        for name in rng.permutation(sorted(rooms)).tolist() * 3:
            found = rooms[name].on_floor(make)
            if found is not None:
                yield found
        return
    bearers = [
        (name, p.id)
        for name, room in sorted(rooms.items())
        for p in room.things
        if p.model.surfaces and p.model.label in FIXED_CLASSES - CONTAINER_CLASSES
    ]
    for k in rng.permutation(len(bearers)).tolist() * 2:
        name, bearer_id = bearers[k]
        bearer = next(p for p in rooms[name].things if p.id == bearer_id)
        found = rooms[name].upon(make, bearer, margin=0.04)
        if found is not None:
            yield found


def _recipe(home: Home) -> tuple[object, ...]:
    """A home as the call that makes it."""
    if home.change is None:
        return simulate_home, (home.seed, home.yaw)
    return change_home, (home.change.before, home.change.seed)


copyreg.pickle(Home, _recipe)  # type: ignore[arg-type]  # typeshed wants tuples of two known shapes
