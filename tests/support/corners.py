"""A tour that is over at once: a corner of one home's kitchen, again and again."""

from __future__ import annotations

from functools import cache

from scenegraph.simulation import Tour
from tests.support.homes import home


@cache
def kitchen_corner(seed: int, images: int) -> Tour:
    """So many images of few places in the kitchen of that home: enough for things to be believed."""
    tour = Tour(home(seed), images_per_room=1)
    kitchen = next(room.id for room in home(seed).rooms if room.kind == "kitchen")
    places = tuple(step for step in tour.steps if step.room == kitchen)[:2]
    tour.steps = (images * places)[:images]
    return tour
