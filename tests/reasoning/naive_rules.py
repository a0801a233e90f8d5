"""The spatial relations as relations.md words them, slow and obvious, over a dict of measurements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Value = float | Literal["unknown"]
Truth = Literal["true", "false", "unknown"]

CONTACT_GAP, SHARE, CLEAR, OVERLAP, FOOTING, VOXELS, ROOM, OWN = 0.03, 0.2, 0.5, 0.2, 0.8, 0.3, 0.5, 0.8


@dataclass
class Measured:
    """A world of numbers: `binary[name, a, b]` (symmetric ones with a < b), `lowest[a]`, `side[a]`."""

    objects: list[str]
    structure: list[str]
    rooms: list[str]
    lowest: dict[str, float]
    side: dict[str, float]
    binary: dict[tuple[str, str, str], Value] = field(default_factory=dict)

    def get(self, name: str, a: str, b: str) -> Value | None:
        return self.binary.get((name, a, b))

    def either(self, name: str, a: str, b: str) -> Value | None:
        return self.binary.get((name, a, b), self.binary.get((name, b, a)))

    def mutual(self, name: str, a: str, b: str) -> Value | None:
        return self.binary.get((name, min(a, b), max(a, b)))


def every(*truths: Truth) -> Truth:
    if "false" in truths:
        return "false"
    return "unknown" if "unknown" in truths else "true"


def compare(value: Value, passes: bool) -> Truth:
    return "unknown" if value == "unknown" else "true" if passes else "false"


def at_least(value: Value, threshold: float) -> Truth:
    return "unknown" if value == "unknown" else "true" if value >= threshold else "false"


def on(world: Measured, a: str, b: str) -> Truth:
    contact = world.get("contact", a, b)
    if contact is None or a == b:
        return "false"
    if a in world.structure:
        lower: Truth = "false"
    elif b in world.structure:
        lower = "true"
    else:
        rise = world.lowest[a] - world.lowest[b]
        lower = "true" if rise > 0 or (rise == 0 and a > b) else "false"
    return every(at_least(contact, SHARE), lower)


def inside(world: Measured, a: str, b: str) -> Truth:
    footing = world.get("footing_inside", a, b)
    if footing is None or a == b:
        return "false"
    voxels = world.get("voxels_inside", a, b)
    return every(at_least(footing, FOOTING), at_least("unknown" if voxels is None else voxels, VOXELS))


def room_of(world: Measured, a: str) -> str | None:
    shares = [(-share, room) for room in world.rooms if (share := world.get("footprint_share", a, room)) is not None]
    share, own = min(((-s, room) for s, room in shares), key=lambda one: (-one[0], one[1]), default=(0.0, None))
    if share < OWN:
        carriers = [(-float(world.get("contact", a, b) or 0), b) for b in world.objects if on(world, a, b) == "true"]
        if carriers and (room := room_of(world, min(carriers)[1])) is not None:
            return room
    return own if share >= ROOM else None


def above(world: Measured, a: str, b: str) -> Truth:
    overlap = world.mutual("footprint_overlap", a, b)
    rise = world.get("rise", a, b)
    if overlap is None or rise is None or a == b:
        return "false"
    between = world.either("structure_between", a, b)
    storey = world.either("same_storey", a, b)
    resting = on(world, a, b)
    return every(
        at_least(overlap, OVERLAP),
        "unknown" if rise == "unknown" else "true" if rise > CONTACT_GAP else "false",
        "true" if between is None else "unknown" if between == "unknown" else "true" if between <= 0 else "false",
        "true" if storey is None else at_least(storey, 1),
        {"true": "false", "false": "true", "unknown": "unknown"}[resting],  # type: ignore[arg-type]
    )


def near(world: Measured, a: str, b: str) -> Truth:
    upper, lower = world.mutual("path_gap_upper", a, b), world.mutual("path_gap_lower", a, b)
    if upper is None or a == b:
        return "false"
    reach = min(1.5, max(0.5, (world.side[a] + world.side[b]) / 2))
    if upper != "unknown" and upper <= reach:
        return "true"
    if lower is not None and lower != "unknown" and lower > reach:
        return "false"
    return "unknown"


def touching(world: Measured, a: str, b: str) -> Truth:
    gap = world.mutual("gap", a, b)
    if gap is None or a == b:
        return "false"
    for contact in (world.get("contact", a, b), world.get("contact", b, a)):
        if contact is not None and contact != "unknown" and contact >= SHARE:
            return "true"
    return "unknown" if gap == "unknown" else "true" if gap <= CONTACT_GAP else "false"


def next_to(world: Measured, a: str, b: str) -> Truth:
    supports = [every(on(world, a, s), on(world, b, s)) for s in [*world.objects, *world.structure]]
    shared: Truth = "true" if "true" in supports else "unknown" if "unknown" in supports else "false"
    between = world.mutual("things_between", a, b)
    free: Truth = "true" if between is None else "unknown" if between == "unknown" else "false" if between else "true"
    return every(near(world, a, b), shared, free)


def stands_on_nothing(world: Measured, a: str, holder: str) -> Truth:
    shares = [world.get("contact", a, b) for b in [*world.objects, *world.structure]]
    if "unknown" in shares:
        return "unknown"
    if any(share is not None and share >= SHARE for share in shares):
        return "false"
    clear = world.get("clear_below", a, holder)
    return "true" if clear is not None and clear != "unknown" and clear >= CLEAR else "unknown"


def attached_to(world: Measured, a: str, b: str) -> Truth:
    share = world.get("side_contact", a, b)
    return "false" if share is None else every(at_least(share, SHARE), stands_on_nothing(world, a, b))


def hanging_from(world: Measured, a: str, b: str) -> Truth:
    share = world.get("top_contact", a, b)
    return "false" if share is None else every(at_least(share, SHARE), stands_on_nothing(world, a, b))


JUDGES = {
    "on": on, "in": inside, "above": above, "near": near, "next_to": next_to, "touching": touching,
    "attached_to": attached_to, "hanging_from": hanging_from,
}  # fmt: skip


def relations(world: Measured) -> dict[Truth, set[tuple[str, str, str]]]:
    """Every pair of every canonical relation, by truth (false left out)."""
    found: dict[Truth, set[tuple[str, str, str]]] = {"true": set(), "unknown": set()}
    things = [*world.objects, *world.structure]
    for name, judge in JUDGES.items():
        for a in things:
            for b in things:
                truth = judge(world, a, b)
                if truth != "false":
                    found[truth].add((name, a, b))
    for a in things:
        room = room_of(world, a)
        if room is not None:
            found["true"].add(("in", a, room))
    return found
