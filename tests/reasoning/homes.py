"""A small home as facts, with the answers that are right for it."""

from __future__ import annotations

from reasoning import Atom, Compound, Term


def fact(name: str, *arguments: Term) -> Compound:
    """A fact; text that begins with a lower-case letter is meant as an atom, `"=..."` as the string after the sign."""
    return Compound(name, tuple([_argument(argument) for argument in arguments]))


def _argument(argument: Term) -> Term:
    if isinstance(argument, str):
        return argument[1:] if argument.startswith("=") else Atom(argument)
    return argument


def thing(node: str, label: str, x: float, y: float, z: float, size: tuple[float, float, float]) -> list[Compound]:
    """An object with its box, as the graph tells it."""
    return [
        fact("node", node, "object"),
        fact("label", node, label),
        fact("position", node, x, y, z),
        fact("size", node, *size),
        fact("yaw", node, 0.0),
        fact("seen", node, 1_000, 2_000),
        fact("measured", "longer_side", node, max(size[:2])),
        fact("measured", "lowest", node, z - size[2] / 2),
        fact("measured", "highest", node, z + size[2] / 2),
        fact("measured", "footing_seen", node, 1.0),
    ]


def pair(a: str, b: str, gap: float, *, lower: Term | None = None, upper: Term | None = None) -> list[Compound]:
    """How far two things are apart, and how far one has to walk from one to the other."""
    a, b = sorted((a, b))
    return [
        fact("measured", "gap", a, b, gap),
        fact("measured", "path_gap_upper", a, b, gap if upper is None else upper),
        fact("measured", "path_gap_lower", a, b, gap if lower is None else lower),
    ]


def small_home() -> list[Compound]:
    """A kitchen (room_1) and a living room (room_2), joined by door_1.

    Kitchen: an oven and a table, on which stand a red cup (cup_1, near the oven) and a book that carries a blue mug
    (mug_1); a chair whose way to the oven leads through unseen space; an apple in a bowl on the table. Living room: a
    sofa and a TV behind the wall that the oven stands against.
    """
    return [
        fact("node", "room_1", "room"),
        fact("node", "room_2", "room"),
        fact("name", "room_2", "=Lounge two"),
        fact("node", "door_1", "structure"),
        fact("label", "door_1", "door"),
        fact("node", "floor_1", "structure"),
        fact("label", "floor_1", "floor"),
        fact("edge", "connects", "door_1", "room_1", 1.0, 0.5, 1.0),
        fact("edge", "connects", "door_1", "room_2", 1.0, 0.5, 1.0),
        *thing("oven_1", "oven", 0.0, 0.0, 0.45, (0.6, 0.6, 0.9)),
        *thing("table_1", "table", 1.2, 0.0, 0.375, (1.4, 0.8, 0.75)),
        *thing("cup_1", "cup", 0.8, 0.0, 0.8, (0.08, 0.08, 0.1)),
        *thing("book_1", "book", 1.4, 0.1, 0.765, (0.2, 0.15, 0.03)),
        *thing("mug_1", "mug", 1.4, 0.1, 0.83, (0.08, 0.08, 0.1)),
        *thing("bowl_1", "bowl", 1.6, -0.2, 0.78, (0.2, 0.2, 0.06)),
        *thing("apple_1", "apple", 1.6, -0.2, 0.79, (0.07, 0.07, 0.07)),
        *thing("chair_1", "chair", 1.0, 1.0, 0.45, (0.45, 0.45, 0.9)),
        *thing("sofa_1", "sofa", 6.0, 0.0, 0.4, (2.0, 0.9, 0.8)),
        *thing("tv_1", "tv", 6.0, 3.0, 1.0, (1.2, 0.1, 0.7)),
        fact("attribute", "cup_1", "color", "red"),
        fact("attribute", "mug_1", "color", "blue"),
        fact("measured", "contact", "cup_1", "table_1", 0.95),
        fact("measured", "contact", "book_1", "table_1", 1.0),
        fact("measured", "contact", "mug_1", "book_1", 0.9),
        fact("measured", "contact", "mug_1", "table_1", 0.05),
        fact("measured", "contact", "bowl_1", "table_1", 1.0),
        fact("measured", "contact", "apple_1", "bowl_1", 0.8),
        fact("measured", "contact", "chair_1", "floor_1", 1.0),
        fact("measured", "contact", "table_1", "floor_1", 1.0),
        fact("measured", "footing_inside", "apple_1", "bowl_1", 1.0),
        fact("measured", "voxels_inside", "apple_1", "bowl_1", 0.6),
        fact("measured", "footing_inside", "mug_1", "bowl_1", 0.1),
        fact("measured", "voxels_inside", "mug_1", "bowl_1", 0.0),
        fact("measured", "footprint_overlap", "mug_1", "table_1", 1.0),
        fact("measured", "rise", "mug_1", "table_1", 0.04),
        fact("measured", "footprint_overlap", "book_1", "table_1", 1.0),
        fact("measured", "rise", "book_1", "table_1", 0.0),
        *pair("cup_1", "oven_1", 0.4),
        *pair("table_1", "oven_1", 0.2),
        *pair("chair_1", "table_1", 0.3),
        *pair("chair_1", "oven_1", 0.45, upper=1e9),
        *pair("tv_1", "oven_1", 0.3, upper=8.0, lower=7.5),
        *pair("cup_1", "mug_1", 0.5),
        *pair("book_1", "mug_1", 0.0),
        *[
            fact("measured", "footprint_share", node, "room_1", 1.0)
            for node in ("oven_1", "table_1", "cup_1", "book_1", "mug_1", "bowl_1", "chair_1")
        ],
        fact("measured", "footprint_share", "apple_1", "room_1", 1.0),
        fact("measured", "footprint_share", "sofa_1", "room_2", 0.9),
        fact("measured", "footprint_share", "sofa_1", "room_1", 0.1),
        fact("measured", "footprint_share", "tv_1", "room_2", 1.0),
    ]
