"""From a seed to a home: rooms are drawn and furnished, and what was placed becomes meshes with their truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from mapping.errors import InvalidParameter
from mapping.geometry import SE3
from mapping.observations import ClassInfo, LabelSpace
from scenegraph.simulation.arrangement import Placed
from scenegraph.simulation.contents import furnish
from scenegraph.simulation.floorplan import WALL_M, FloorPlan, draw_floorplan
from scenegraph.simulation.home import Change, Home, TrueDoor, TrueObject, TrueRoom, TrueWindow
from scenegraph.simulation.shapes import Array, Color
from scenegraph.simulation.structure import TruePlane, build_structure

STRUCTURE_CLASSES = ("wall", "floor", "ceiling", "door", "window")
THING_CLASSES: tuple[str, ...] = (
    "apple", "armchair", "backpack", "ball", "basket", "bathtub", "bed", "bench", "bin", "book", "bottle",
    "bowl", "box", "cabinet", "chair", "clock", "coffee_table", "counter", "cup", "cushion", "desk", "dresser",
    "fridge", "kettle", "keyboard", "lamp", "laptop", "microwave", "mirror", "monitor", "nightstand",
    "office_chair", "orange", "oven", "picture", "pillow", "plant", "plate", "pot", "printer", "shelf", "shoe",
    "sink", "sofa", "speaker", "stool", "table", "teddy_bear", "toaster", "toilet", "towel", "toy_block", "tv",
    "tv_stand", "vase", "wardrobe", "washing_machine",
)  # fmt: skip
CONTAINER_CLASSES = frozenset({"basket", "bathtub", "bin", "bowl", "box", "pot", "sink"})
_STRUCTURE_COLORS: dict[str, Color] = {
    "wall": (190, 190, 180),
    "floor": (150, 120, 90),
    "ceiling": (240, 240, 240),
    "door": (140, 90, 50),
    "window": (150, 200, 240),
}


def simulate_home(seed: int, yaw: float | None = None) -> Home:
    """The home of that seed, always the same, turned in the map by `yaw` [rad], or by an angle of its own."""
    if seed < 0:
        raise InvalidParameter(f"seed: expected a whole number ≥ 0, got {seed!r}")
    rng = np.random.default_rng([seed, 20])
    plan = draw_floorplan(rng)
    placed: list[Placed] = []
    for room in plan.rooms:
        placed.extend(furnish(rng, plan, room))
    own_yaw = float(rng.uniform(-np.pi, np.pi))
    yaw = own_yaw if yaw is None else float(yaw)
    turn = SE3.exp([0.0, 0.0, 0.0, 0.0, 0.0, yaw])
    middle = np.array([plan.width / 2, plan.depth / 2, 0.0])
    T_map_home = SE3(turn.rotation, -(turn @ middle[None])[0] + np.array([*rng.uniform(-1.0, 1.0, 2), 0.0]))
    tints = {r.id: (_tint(rng, (222, 214, 200), 18), _tint(rng, (165, 130, 95), 30)) for r in plan.rooms}
    return assemble(seed, yaw, T_map_home, plan, placed, tints, _numbered(placed))


def _tint(rng: np.random.Generator, base: Color, spread: int) -> Color:
    lighter = rng.integers(-spread, spread + 1)
    r, g, b = (int(c + lighter + rng.integers(-8, 9)) for c in base)
    return r, g, b


def _label_space() -> LabelSpace:
    colors = np.random.default_rng(7).integers(30, 240, (len(THING_CLASSES), 3))
    classes = {
        k + 1: ClassInfo(name=name, kind="stuff", color=_STRUCTURE_COLORS[name])
        for k, name in enumerate(STRUCTURE_CLASSES)
    }
    for k, name in enumerate(THING_CLASSES):
        r, g, b = (int(c) for c in colors[k])
        classes[len(STRUCTURE_CLASSES) + k + 1] = ClassInfo(name=name, kind="thing", color=(r, g, b))
    return LabelSpace(classes=classes)


def _numbered(placed: list[Placed]) -> dict[str, str]:
    """Ids of true things, `cup_2`, by those of what was placed."""
    counts: dict[str, int] = {}
    names: dict[str, str] = {}
    for p in placed:
        counts[p.model.label] = counts.get(p.model.label, 0) + 1
        names[p.id] = f"{p.model.label}_{counts[p.model.label]}"
    return names


def assemble(
    seed: int,
    yaw: float,
    T_map_home: SE3,
    plan: FloorPlan,
    placed: list[Placed],
    tints: Mapping[str, tuple[Color, Color]],
    true_ids: Mapping[str, str],
    change: Change | None = None,
) -> Home:
    """The home of what was placed, whose true ids are `true_ids`, by those of `placed`."""
    label_space = _label_space()
    ids = {info.name: key for key, info in label_space.classes.items()}
    patches = build_structure(plan, dict(tints))
    objects = _true_objects(T_map_home, placed, true_ids)
    names = [h.id for h in plan.holes if h.kind == "window" or h.door in ("ajar", "closed")]
    entities = tuple([o.id for o in objects] + names)
    number = {name: k + 1 for k, name in enumerate(entities)}

    vertices = [(T_map_home @ np.concatenate(patches.vertices))]
    triangles = [np.concatenate(patches.triangles)]
    labels = [np.array([ids[label] for label in patches.labels])]
    entity = [np.array([number.get(name, 0) for name in patches.instances])]
    plane = [np.array(patches.plane_of)]
    color = [np.array(patches.colors)]
    count = len(vertices[0])
    for o in objects:
        n = len(o.triangles)
        vertices.append(o.vertices)
        triangles.append(o.triangles + count)
        labels.append(np.full(n, ids[o.label]))
        entity.append(np.full(n, number[o.id]))
        plane.append(np.full(n, -1))
        color.append(o.colors)
        count += len(o.vertices)
    return Home(
        seed=seed,
        yaw=yaw,
        T_map_home=T_map_home,
        plan=plan,
        placed=tuple(placed),
        tints=tints,
        rooms=tuple(_true_room(T_map_home, plan, k) for k in range(len(plan.rooms))),
        objects=tuple(objects),
        doors=tuple(_true_doors(T_map_home, plan)),
        windows=tuple(_true_windows(T_map_home, plan)),
        structure=tuple(_plane_in_map(T_map_home, p) for p in patches.planes),
        label_space=label_space,
        vertices=np.concatenate(vertices).astype(np.float32),
        triangles=np.concatenate(triangles).astype(np.uint32),
        triangle_class=np.concatenate(labels).astype(np.uint16),
        triangle_entity=np.concatenate(entity).astype(np.int32),
        triangle_plane=np.concatenate(plane).astype(np.int32),
        triangle_color=np.concatenate(color).astype(np.uint8),
        entities=entities,
        change=change,
    )


def _true_objects(T_map_home: SE3, placed: list[Placed], names: Mapping[str, str]) -> list[TrueObject]:
    home_yaw = float(np.arctan2(T_map_home.rotation[1, 0], T_map_home.rotation[0, 0]))
    objects = []
    for p in placed:
        lower, upper = p.model.lower, p.model.upper
        yaw = home_yaw + p.yaw
        objects.append(
            TrueObject(
                id=names[p.id],
                label=p.model.label,
                vertices=T_map_home @ p.to_home(p.model.vertices),
                triangles=p.model.triangles,
                colors=p.model.colors,
                center=(T_map_home @ p.to_home((lower + upper)[None] / 2))[0],
                size=upper - lower,
                rotation_wxyz=np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]),
                yaw=yaw,
                room=p.room,
                support=names[p.support] if p.support else None,
                container=p.model.label in CONTAINER_CLASSES,
            )
        )
    return objects


def _true_room(T_map_home: SE3, plan: FloorPlan, k: int) -> TrueRoom:
    r = plan.rooms[k]
    corners = np.array([[r.x0, r.y0, 0.0], [r.x1, r.y0, 0.0], [r.x1, r.y1, 0.0], [r.x0, r.y1, 0.0]])
    return TrueRoom(r.id, r.kind, (T_map_home @ corners)[:, :2], 0.0, r.height)


def _hole_frame(T_map_home: SE3, plan: FloorPlan, k: int, into_wall: float) -> tuple[Array, Array]:
    hole = plan.holes[k]
    owner, side = hole.rooms[0]
    fixed, _, _ = plan.room(owner).wall(side)
    inward = 1.0 if side in ("south", "west") else -1.0
    along, z, across = (hole.start + hole.end) / 2, (hole.low + hole.high) / 2, fixed - inward * into_wall
    flat = side in ("south", "north")
    center = np.array([along, across, z] if flat else [across, along, z])
    normal = np.array([0.0, inward, 0.0] if flat else [inward, 0.0, 0.0])
    return (T_map_home @ center[None])[0], T_map_home.rotation @ normal


def _true_doors(T_map_home: SE3, plan: FloorPlan) -> Iterator[TrueDoor]:
    for k, hole in enumerate(plan.holes):
        if hole.door is not None:
            center, normal = _hole_frame(T_map_home, plan, k, WALL_M / 2)
            rooms = tuple(owner for owner, _ in hole.rooms)
            yield TrueDoor(hole.id, hole.door, rooms, center, hole.end - hole.start, hole.high - hole.low, normal)


def _true_windows(T_map_home: SE3, plan: FloorPlan) -> Iterator[TrueWindow]:
    for k, hole in enumerate(plan.holes):
        if hole.kind == "window":
            center, normal = _hole_frame(T_map_home, plan, k, 0.02)
            yield TrueWindow(hole.id, hole.rooms[0][0], center, hole.end - hole.start, hole.high - hole.low, normal)


def _plane_in_map(T: SE3, p: TruePlane) -> TruePlane:
    return TruePlane(
        p.id, p.kind, p.source, T @ p.polygon, tuple(T @ ring for ring in p.holes), T.rotation @ p.normal, p.area,
        (T @ p.origin[None])[0], p.axes @ T.rotation.T, p.extent,
    )  # fmt: skip
