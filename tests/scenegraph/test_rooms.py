"""Rooms from free ground and walls: doors and wide openings part them, corridors stay whole, ids last."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from mapping.layer import Changed
from mapping.occupancy import OccupancyMap
from mapping.planes import Plane
from reasoning.knowledge import KnowledgeBase
from reasoning.terms import Atom, Compound, Var
from scenegraph.errors import InvalidStatement
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.perception import told_rooms
from scenegraph.perception.rooms import Rooms

Rectangle = tuple[float, float, float, float]
"""x0, y0, x1, y1 [m]."""
FREE_EVIDENCE, OCCUPIED_EVIDENCE = -20, 20
BUILDING = "building_1"


def wall(
    number: int, x0: float, y0: float, x1: float, y1: float, z: tuple[float, float] = (0.0, 2.4)
) -> tuple[str, Plane]:
    along = np.array([x1 - x0, y1 - y0])
    length = float(np.linalg.norm(along))
    u = np.array([*along / length, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    normal = np.cross(u, up)
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z[0] + z[1])])
    ring = np.array([[x0, y0, z[0]], [x1, y1, z[0]], [x1, y1, z[1]], [x0, y0, z[1]]])
    return "wall", plane(
        number, normal, middle, ring, length, (length, z[1] - z[0], 0.01), np.stack([u, up, normal], axis=1)
    )


def floor(number: int, x0: float, y0: float, x1: float, y1: float, z: float = 0.0) -> tuple[str, Plane]:
    ring = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), z])
    return "floor", plane(number, np.array([0.0, 0.0, 1.0]), middle, ring, x1 - x0, (x1 - x0, y1 - y0, 0.01), np.eye(3))


def ceiling(number: int, x0: float, y0: float, x1: float, y1: float, z: float) -> tuple[str, Plane]:
    return "ceiling", floor(number, x0, y0, x1, y1, z)[1]


def plane(
    number: int,
    normal: np.ndarray,
    middle: np.ndarray,
    ring: np.ndarray,
    width: float,
    size: Sequence[float],
    axes: np.ndarray,
) -> Plane:
    return Plane(
        id=number, normal=normal, offset=float(normal @ middle), centroid=middle, rings=(ring,),
        area_m2=size[0] * size[1],
        z_min=float(ring[:, 2].min()), z_max=float(ring[:, 2].max()), width_m=width, box_center=middle, box_axes=axes,
        box_size=np.array(size), n_points=1000, rms_m=0.003,
    )  # fmt: skip


class Home:
    """Rooms that watch a ground plan being explored, and the graph that they write."""

    def __init__(self) -> None:
        self.occupancy = OccupancyMap(voxel_size_m=0.05, max_range_m=10.0)
        self.rooms = Rooms()
        self.graph = SceneGraph()
        founded = GraphChanges()
        times = {"first_seen_ns": 0, "last_seen_ns": 0}
        founded.put(Node(id=BUILDING, layer="building", label="building", position=(0, 0, 0), **times))
        self.graph.commit(founded, 0)
        self.now = 0

    def see(
        self,
        *free: Rectangle,
        structure: Sequence[tuple[str, Plane]] = (),
        z: tuple[float, float] = (0.9, 2.1),
        evidence: int = FREE_EVIDENCE,
    ) -> set[str]:
        """Space over rectangles of ground, free at standing height, and planes. Returns the rooms that changed."""
        self.now += 1
        seen = [np.empty((0, 3), np.int32)]
        for x0, y0, x1, y1 in free:
            low, high = np.array([x0, y0, z[0]]), np.array([x1, y1, z[1]])
            centres = np.stack(
                np.meshgrid(*(np.arange(a + 0.025, b, 0.05) for a, b in zip(low, high, strict=True)), indexing="ij"),
                axis=-1,
            ).reshape(-1, 3)
            self.occupancy.assign(centres, evidence)
            seen.append(np.unique(np.floor(centres / 0.4).astype(np.int32), axis=0))
        changed_blocks = Changed(np.unique(np.concatenate(seen), axis=0), self.occupancy.block_size_m)
        changes, changed = self.rooms.update(self.occupancy, changed_blocks, structure, self.graph, self.now)
        self.commit(changes)
        return changed

    def commit(self, changes: GraphChanges) -> None:
        self.rooms.storeys.write(changes, BUILDING, self.graph, self.now)
        self.graph.commit(changes, self.now)

    def draw(self, name: str, outline: list[list[float]], storey: str | None = None) -> set[str]:
        return self.tell(told_rooms.draw, name, outline, storey)

    def tell(self, form: Callable[..., tuple[GraphChanges, set[str]]], *given: object) -> set[str]:
        self.now += 1
        changes, touched = form(self.rooms, *given, self.graph, self.now)
        self.commit(changes)
        return touched

    def restart(self) -> None:
        state = self.rooms.state()
        self.rooms = Rooms()
        self.rooms.restore({name: np.array(array) for name, array in state.items()}, self.graph)

    @property
    def nodes(self) -> dict[str, Node]:
        return {node.id: node for node in self.graph.nodes("room")}

    @property
    def ids(self) -> list[str]:
        return sorted(self.nodes)

    def at(self, x: float, y: float, z: float = 0.0) -> str | None:
        shares = self.rooms.shares(np.array([[x, y]]), z)
        return max(shares, default=None)

    def area(self, room: str) -> float:
        return float(self.nodes[room].attributes["area_m2"])


TWO_WALLS = [
    floor(1, 0, 0, 8, 4),
    wall(2, 0, 0, 8, 0),
    wall(3, 0, 4, 8, 4),
    wall(4, 0, 0, 0, 4),
    wall(5, 8, 0, 8, 4),
    wall(6, 4, 0, 4, 4),
]
LEFT, RIGHT = (0.1, 0.1, 3.9, 3.9), (4.1, 0.1, 7.9, 3.9)
DOORWAY = (3.8, 1.5, 4.2, 2.4)


def test_two_rooms_with_a_door_between_them_are_two() -> None:
    home = Home()
    home.see(LEFT, RIGHT, DOORWAY, structure=TWO_WALLS)
    assert len(home.ids) == 2
    assert home.at(2.0, 2.0) != home.at(6.0, 2.0)
    for room in home.ids:
        assert home.area(room) == pytest.approx(16.0, rel=0.12)
        node = home.nodes[room]
        assert node.attributes["storey"] == 1
        assert node.attributes["floor_z"] == 0.0


def test_an_open_plan_pair_with_an_opening_of_2_2_m_between_rooms_of_4_m_is_two() -> None:
    stubs = [wall(6, 4, 0, 4, 0.9), wall(7, 4, 3.1, 4, 4)]
    home = Home()
    home.see((0.1, 0.1, 7.9, 3.9), structure=[*TWO_WALLS[:5], *stubs])
    assert len(home.ids) == 2
    assert home.at(1.5, 2.0) != home.at(6.5, 2.0)
    border = [x for x in np.arange(2.0, 6.0, 0.1) if home.at(float(x), 2.0) != home.at(float(x) + 0.1, 2.0)]
    assert len(border) == 1
    assert abs(border[0] - 4.0) < 0.3, "they meet in the opening"


def test_one_room_with_a_stub_of_wall_stays_one() -> None:
    home = Home()
    home.see((0.1, 0.1, 7.9, 3.9), structure=[*TWO_WALLS[:5], wall(6, 4, 0, 4, 0.6)])
    assert len(home.ids) == 1


def test_a_room_full_of_furniture_shadows_is_one() -> None:
    """Ground that furniture hid from view belongs to the room around it."""
    home = Home()
    home.see((0.1, 0.1, 3.9, 1.2), (0.1, 1.8, 3.9, 3.9), (0.1, 0.1, 1.4, 3.9), structure=TWO_WALLS)
    assert len(home.ids) == 1
    assert home.at(2.5, 1.5) == home.ids[0]


def test_a_beam_through_a_window_makes_no_room() -> None:
    home = Home()
    home.see(LEFT, (8.0, 2.0, 12.0, 2.1), structure=TWO_WALLS)
    assert len(home.ids) == 1
    assert home.at(10.0, 2.0) is None


SOLID = {"z": (0.0, 2.4), "evidence": OCCUPIED_EVIDENCE}
"""What fills space from the floor to the ceiling."""
ABOUT_BOTH = [(-0.1, -0.1, 8.1, 0.1), (-0.1, 3.9, 8.1, 4.1), (-0.1, -0.1, 0.1, 4.1), (7.9, -0.1, 8.1, 4.1)]
BETWEEN = [(3.9, 0.1, 4.1, 1.5), (3.9, 2.4, 4.1, 3.9)]


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0], [1, 2, 0]])
def test_walls_that_nobody_called_so_part_rooms_whatever_was_seen_first(order: list[int]) -> None:
    home = Home()
    home.see(structure=[floor(1, 0, 0, 8, 4)])
    home.see(*ABOUT_BOTH, *BETWEEN, **SOLID)  # type: ignore[arg-type]
    for n in order:
        home.see((LEFT, RIGHT, DOORWAY)[n])
    assert len(home.ids) == 2
    assert home.at(2.0, 2.0) != home.at(6.0, 2.0)
    for room in home.ids:
        assert home.area(room) == pytest.approx(16.0, rel=0.15)
    home.restart()
    home.see(LEFT, RIGHT, DOORWAY, (1.0, 1.0, 2.0, 2.0))
    assert len(home.ids) == 2


def test_tall_furniture_before_a_wall_parts_nothing_and_stands_in_the_room() -> None:
    """Wardrobes on both sides leave a narrow way through a room: no neck, for the walls behind them are known."""
    home = Home()
    home.see(LEFT, structure=[*TWO_WALLS[:4], wall(6, 4, 0, 4, 4)])
    before = home.area(home.ids[0])
    home.see((1.5, 0.1, 2.5, 0.7), (1.5, 3.3, 2.5, 3.9), **SOLID)  # type: ignore[arg-type]
    home.see((*LEFT[:2], 1.5, 3.9), (1.5, 0.7, 2.5, 3.3), (2.5, 0.1, 3.9, 3.9))
    assert len(home.ids) == 1
    assert home.area(home.ids[0]) == pytest.approx(before, rel=0.02)
    assert home.at(2.0, 0.4) == home.ids[0]


def test_ground_that_ends_without_a_wall_ends_where_it_was_seen() -> None:
    home = Home()
    home.see(LEFT, structure=[floor(1, 0, 0, 8, 4)])
    assert home.area(home.ids[0]) == pytest.approx(3.9**2, rel=0.02)
    assert home.at(4.1, 2.0) is None


def test_a_corridor_with_three_doors_stays_one() -> None:
    corridor = (0.1, 0.1, 8.9, 1.4)
    behind = [(0.1, 1.6, 2.9, 4.4), (3.1, 1.6, 5.9, 4.4), (6.1, 1.6, 8.9, 4.4)]
    doors = [(x, 1.3, x + 0.9, 1.7) for x in (1.0, 4.0, 7.0)]
    walls = [
        floor(1, 0, 0, 9, 4.5), wall(2, 0, 0, 9, 0), wall(3, 0, 1.5, 9, 1.5), wall(4, 0, 4.5, 9, 4.5),
        wall(5, 0, 0, 0, 4.5),
        wall(6, 3, 1.5, 3, 4.5), wall(7, 6, 1.5, 6, 4.5), wall(8, 9, 0, 9, 4.5),
    ]  # fmt: skip
    home = Home()
    home.see(corridor, *behind, *doors, structure=walls)
    assert len(home.ids) == 4
    assert len({home.at(x, 0.7) for x in np.arange(0.3, 8.8, 0.3)}) == 1
    assert len({home.at(x, 3.0) for x in (1.5, 4.5, 7.5)}) == 3


def test_an_l_shaped_room_of_even_width_is_one() -> None:
    home = Home()
    home.see((0.1, 0.1, 5.9, 2.4), (0.1, 0.1, 2.4, 5.9), structure=[floor(1, 0, 0, 6, 6)])
    assert len(home.ids) == 1


def test_ids_last_when_more_is_seen() -> None:
    home = Home()
    home.see((0.1, 0.1, 2.0, 3.9), structure=TWO_WALLS)
    first = home.at(1.0, 2.0)
    home.see((2.0, 0.1, 3.9, 3.9))
    assert home.at(1.0, 2.0) == home.at(3.0, 2.0) == first
    home.see(RIGHT, DOORWAY)
    second = home.at(6.0, 2.0)
    assert home.at(1.0, 2.0) == first != second
    for _ in range(3):
        home.see(LEFT, RIGHT, DOORWAY)
    assert home.ids == sorted([first, second])  # type: ignore[list-item]
    assert home.nodes[first].first_seen_ns == 1  # type: ignore[index]


def test_a_wall_that_is_found_later_parts_a_room_and_the_larger_part_keeps_its_id() -> None:
    home = Home()
    home.see((0.1, 0.1, 4.9, 3.9), (4.9, 0.1, 7.9, 3.9), structure=TWO_WALLS[:5])
    [whole] = home.ids
    home.see(structure=[wall(6, 5, 0, 5, 4)])
    assert len(home.ids) == 2
    assert home.at(2.0, 2.0) == whole
    [other] = set(home.ids) - {whole}
    home.rooms.forget_planes([6])
    home.see((4.0, 0.1, 6.0, 3.9), structure=[wall(5, 8, 0, 8, 3.5)])
    assert home.ids == [whole], "and has it still when the wall was none"
    assert home.graph.tombstone(other).became == whole  # type: ignore[union-attr]


def test_what_is_not_touched_stays_as_it_is() -> None:
    """A change in one room writes nothing about a room far away."""
    far = (20.1, 0.1, 23.9, 3.9)
    home = Home()
    home.see(LEFT, far, structure=[*TWO_WALLS, wall(7, 20, 0, 20, 4), wall(8, 20, 0, 24, 0)])
    before = home.nodes[home.at(22.0, 2.0)]  # type: ignore[index]
    changed = home.see(RIGHT)
    assert before.id not in changed
    assert home.nodes[before.id] == before


UPSTAIRS = [floor(11, 0, 0, 8, 4, z=2.7), wall(12, 4, 0, 4, 4, z=(2.7, 5.1))]


def test_two_storeys_are_two() -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS)
    home.see(LEFT, structure=UPSTAIRS, z=(3.6, 4.8))
    assert len(home.ids) == 2
    assert home.at(2.0, 2.0, 0.4) != home.at(2.0, 2.0, 3.1)
    assert sorted(home.nodes[r].attributes["storey"] for r in home.ids) == [1, 2]


def test_storeys_lie_between_building_and_rooms() -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS)
    home.see(LEFT, structure=UPSTAIRS, z=(3.6, 4.8))
    storeys = {n.id: n for n in home.graph.nodes("storey")}
    assert {i: n.attributes["floor_z"] for i, n in storeys.items()} == {"storey_1": 0.0, "storey_2": 2.7}
    for room in home.ids:
        [up] = home.graph.edges("in", source=room)
        assert up.target == f"storey_{home.nodes[room].attributes['storey']}"
        assert home.graph.edge("contains", up.target, room) is not None
    for storey in storeys:
        [up] = home.graph.edges("in", source=storey)
        assert up.target == BUILDING
        assert home.graph.edge("contains", BUILDING, storey) is not None


def test_a_landing_halfway_up_the_stairs_is_no_storey() -> None:
    home = Home()
    home.see(LEFT, structure=[*TWO_WALLS, floor(20, 1, 1, 2.2, 2.2, z=1.5)])
    assert [n.id for n in home.graph.nodes("storey")] == ["storey_1"]


def test_rooms_and_storeys_are_as_high_as_their_ceilings() -> None:
    home = Home()
    home.see(LEFT, RIGHT, DOORWAY, structure=TWO_WALLS)
    left, right = home.at(2.0, 2.0), home.at(6.0, 2.0)
    assert "ceiling_z" not in home.nodes[left].attributes, "none was seen"  # type: ignore[index]
    footprints = {room: node.attributes["footprint"] for room, node in home.nodes.items()}
    home.see(structure=[ceiling(30, 0, 0, 4, 4, 2.5)])
    home.see(structure=[ceiling(31, 4, 0, 8, 4, 2.3)])
    for room, height in ((left, 2.5), (right, 2.3)):
        node = home.nodes[room]  # type: ignore[index]
        assert (node.attributes["ceiling_z"], node.attributes["height_m"]) == (height, height)
        assert node.box.size[2] == pytest.approx(height)  # type: ignore[union-attr]
    assert {room: node.attributes["footprint"] for room, node in home.nodes.items()} == footprints
    assert home.graph.node("storey_1").attributes["height_m"] in (2.3, 2.5)


def test_ground_under_the_open_sky_is_a_room_outdoors_in_no_storey() -> None:
    home = Home()
    garden = (4.1, 0.1, 9.9, 3.9)
    home.see(LEFT, garden, DOORWAY, structure=TWO_WALLS[:4] + TWO_WALLS[5:])
    inside, outside = home.at(2.0, 2.0), home.at(7.0, 2.0)
    assert inside != outside
    assert all("outdoors" not in node.attributes for node in home.nodes.values()), "nobody looked up"
    home.see(garden, z=(3.3, 4.2))
    assert all("outdoors" not in node.attributes for node in home.nodes.values()), "a hall may be as high"
    home.see(garden, z=(5.0, 6.0))
    home.see((4.1, 0.1, 10.9, 3.9))
    assert home.nodes[outside].attributes["outdoors"] is True  # type: ignore[index]
    assert "outdoors" not in home.nodes[inside].attributes  # type: ignore[index]
    assert home.graph.edge("in", outside, "storey_1") is None  # type: ignore[arg-type]
    assert home.graph.edge("in", inside, "storey_1") is not None  # type: ignore[arg-type]


def test_a_hall_whose_ceiling_was_not_seen_is_not_outdoors() -> None:
    home = Home()
    hall = (4.1, 0.1, 9.9, 3.9)
    home.see(LEFT, hall, DOORWAY, structure=TWO_WALLS[:4] + TWO_WALLS[5:])
    home.see(hall, z=(5.0, 6.0))
    home.see((9.9, 0.1, 10.0, 3.9), z=(0.0, 7.0), evidence=OCCUPIED_EVIDENCE)
    home.see((4.1, 0.1, 9.9, 4.9))
    inside = home.at(7.0, 2.0)
    assert inside is not None
    assert "outdoors" not in home.nodes[inside].attributes, "its wall is as high as the sky was seen"
    assert home.graph.edge("in", inside, "storey_1") is not None


def test_without_a_floor_there_is_no_room() -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS[1:])
    assert home.ids == []
    assert home.at(2.0, 2.0) is None


@pytest.mark.parametrize(
    ("told", "kind", "reason"), [(None, "outdoors", "open_sky"), ("terrace", "terrace", "told"), ("no bed", None, None)]
)
def test_what_lies_under_the_sky_is_outdoors_whatever_stands_there(
    told: str | None, kind: str | None, reason: str | None
) -> None:
    with KnowledgeBase() as rules:
        room, bench = Atom("room_1"), Atom("object_1")
        outside = told != "no bed"
        facts = [
            Compound("node", (room, Atom("room"))),
            Compound("node", (bench, Atom("object"))),
            Compound("label", (bench, Atom("stool"))),
            Compound("measured", (Atom("footprint_share"), bench, room, 1.0)),
            Compound("attribute", (room, Atom("outdoors"), Atom("true" if outside else "false"))),
        ]
        if told is not None and outside:
            facts.append(Compound("attribute", (room, Atom("type"), Atom(told))))
        rules.update(put=facts)
        answers = rules.call(Compound("room_type", (room, Var("Type"), Var("Reason"))))
        assert [(str(a["Type"]), str(a["Reason"])) for a in answers] == ([(kind, reason)] if kind else [])
        assert rules.ask("in(X, outdoors)").truth == ("true" if kind == "outdoors" else "false" if told else "unknown")


# -- rooms that an operator draws, splits and merges -------------------------------------------------------------------


def test_a_drawn_room_survives_mapping_on() -> None:
    home = Home()
    home.see((0.1, 0.1, 7.9, 3.9), structure=TWO_WALLS[:5])
    [old] = home.ids
    touched = home.draw("office", [[4.0, 0.0], [8.0, 0.0], [8.0, 4.0], [4.0, 4.0]])
    office = home.at(6.0, 2.0)
    assert office not in (None, old)
    assert touched == {old, office}
    assert home.at(2.0, 2.0) == old
    assert home.nodes[office].attributes["name"] == "office"  # type: ignore[index]
    assert home.area(office) == pytest.approx(16.0, rel=0.1)  # type: ignore[arg-type]
    for _ in range(3):
        home.see((0.1, 0.1, 7.9, 3.9), structure=[wall(5, 8, 0, 8, 3.5 + 0.2 * home.now)])
    assert home.at(6.0, 2.0) == office
    assert home.at(2.0, 2.0) == old
    assert home.ids == sorted([old, office])  # type: ignore[list-item]


def test_a_drawn_room_takes_the_place_of_one_that_it_covers() -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS)
    [old] = home.ids
    home.draw("hall", [[-0.5, -0.5], [4.5, -0.5], [4.5, 4.5], [-0.5, 4.5]])
    assert old not in home.ids
    assert home.graph.tombstone(old).became == home.at(2.0, 2.0)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "outline",
    [
        [[0.0, 0.0], [1.0, 0.0]],
        [[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]],
        [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
        [["a", "b"], ["c", "d"], ["e", "f"]],
        [],
        [[0.0, 0.0], [float("nan"), 1.0], [1.0, 1.0]],
        [[0.0, 0.0], [1e9, 0.0], [1e9, 1e9], [0.0, 1e9]],
    ],
)
def test_an_outline_that_is_no_room_is_refused(outline: list[list[float]]) -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS)
    before = home.nodes
    with pytest.raises(InvalidStatement, match="room"):
        home.draw("bad", outline)
    assert home.nodes == before


def test_a_room_cannot_be_drawn_before_a_floor_is_known() -> None:
    with pytest.raises(InvalidStatement, match="no floor"):
        Home().draw("office", [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


def test_rooms_come_back_from_their_state() -> None:
    home = Home()
    home.see(LEFT, RIGHT, DOORWAY, structure=TWO_WALLS)
    home.draw("office", [[4.0, 0.0], [8.0, 0.0], [8.0, 4.0], [4.0, 4.0]])
    ids, office = home.ids, home.at(6.0, 2.0)
    home.restart()
    assert home.at(6.0, 2.0) == office
    home.see(LEFT, RIGHT, DOORWAY)
    assert home.ids == ids
    home.see((10.1, 0.1, 13.9, 3.9))
    assert home.at(12.0, 2.0) not in (None, *ids), "a number is given once"


def test_rooms_come_back_from_a_state_that_knows_less() -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS)
    new = ("sky", "tall", "ceilings", "ceiling_sizes", "ceiling_corners", "outlined")
    old = {name: array for name, array in home.rooms.state().items() if not name.endswith(new)}
    home.rooms = Rooms()
    home.rooms.restore(old, home.graph)
    assert home.at(2.0, 2.0) == home.ids[0]


ONE_LARGE = (0.1, 0.1, 7.9, 3.9)


def map_on(home: Home) -> None:
    """See everything again, with walls that wobble, before and after a restart."""
    for n in range(4):
        home.see(ONE_LARGE, structure=[wall(5, 8, 0, 8, 3.4 + 0.2 * (n % 3))])
        if n == 1:
            home.restart()


def test_a_room_is_split_along_a_line_and_stays_so() -> None:
    home = Home()
    home.see(ONE_LARGE, structure=TWO_WALLS[:5])
    [whole] = home.ids
    touched = home.tell(told_rooms.split, whole, [[5.0, 1.0], [5.0, 1.5]])
    assert home.at(2.0, 2.0) == whole, "the larger part stays what it was"
    other = home.at(7.0, 2.0)
    assert touched == {whole, other}
    assert home.area(whole) == pytest.approx(20.0, rel=0.12)
    assert home.area(other) == pytest.approx(12.0, rel=0.12)  # type: ignore[arg-type]
    border = [x for x in np.arange(2.0, 7.0, 0.1) if home.at(float(x), 2.0) != home.at(float(x) + 0.1, 2.0)]
    assert border == pytest.approx([5.0], abs=0.11)
    map_on(home)
    assert home.ids == sorted([whole, other])  # type: ignore[list-item]
    assert (home.at(2.0, 2.0), home.at(7.0, 2.0)) == (whole, other)


def test_merged_rooms_stay_one() -> None:
    home = Home()
    home.see(LEFT, RIGHT, DOORWAY, structure=TWO_WALLS)
    left, right = home.at(2.0, 2.0), home.at(6.0, 2.0)
    assert home.tell(told_rooms.merge, right, left) == {left, right}
    assert home.ids == [right]
    assert home.graph.tombstone(left).became == right  # type: ignore[arg-type, union-attr]
    assert home.at(2.0, 2.0) == home.at(4.0, 3.5) == home.at(6.0, 2.0) == right
    assert home.area(right) == pytest.approx(32.0, rel=0.1)  # type: ignore[arg-type]
    for n in range(4):
        home.see(LEFT, RIGHT, DOORWAY, structure=[wall(6, 4, 0, 4, 3.6 + 0.2 * (n % 3))])
        if n == 1:
            home.restart()
    assert home.ids == [right]


def test_what_is_split_can_be_merged_again() -> None:
    home = Home()
    home.see(ONE_LARGE, structure=TWO_WALLS[:5])
    [whole] = home.ids
    area = home.area(whole)
    _, other = sorted(home.tell(told_rooms.split, whole, [[3.0, 0.5], [5.0, 3.5]]))
    home.tell(told_rooms.merge, whole, other)
    assert home.ids == [whole]
    assert home.area(whole) == pytest.approx(area, rel=0.02)


def test_rooms_that_were_split_take_the_ground_that_is_seen_beside_them() -> None:
    home = Home()
    home.see((0.1, 0.1, 5.0, 3.9), structure=TWO_WALLS[:5])
    [whole] = home.ids
    home.tell(told_rooms.split, whole, [[2.0, 1.0], [2.0, 1.5]])
    home.see((5.0, 0.1, 7.9, 3.9))
    assert home.at(7.0, 2.0) == home.at(4.0, 2.0) == whole
    assert len(home.ids) == 2
    assert home.area(whole) == pytest.approx(24.0, rel=0.12)


def test_a_drawn_room_keeps_its_outline_where_more_is_seen() -> None:
    home = Home()
    home.see((0.1, 0.1, 4.0, 3.9), structure=TWO_WALLS[:5])
    home.draw("den", [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    den = home.at(2.0, 2.0)
    home.see((4.0, 0.1, 7.9, 3.9))
    assert home.at(6.0, 2.0) not in (den, None)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ([[9.0, 0.0], [9.0, 4.0]], "does not cut"),
        ([[0.1, 0.0], [0.1, 4.0]], "does not cut"),
        ([[1.0, 1.0], [1.0, 1.0]], "two different points"),
        ([[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]], "two different points"),
        ([[0.0, float("inf")], [1.0, 1.0]], "no points"),
        ([["a", "b"], ["c", "d"]], "no points"),
        ([[1e12, 0.0], [1e12, 1.0]], "50 m"),
    ],
)
def test_a_line_that_cuts_nothing_is_refused(line: list[list[float]], words: str) -> None:
    home = Home()
    home.see(ONE_LARGE, structure=TWO_WALLS[:5])
    before = home.nodes
    with pytest.raises(InvalidStatement, match=words):
        home.tell(told_rooms.split, home.ids[0], line)
    assert home.nodes == before


def test_a_line_cuts_only_the_wing_of_a_room_that_it_touches() -> None:
    home = Home()
    home.see((0.1, 0.1, 1.9, 5.9), (0.1, 0.1, 7.9, 1.9), (6.1, 0.1, 7.9, 5.9), structure=[floor(1, 0, 0, 8, 6)])
    [whole] = home.ids
    home.tell(told_rooms.split, whole, [[0.5, 4.0], [1.5, 4.0]])
    assert len(home.ids) == 2
    assert home.at(7.0, 5.0) == home.at(1.0, 1.0) == whole != home.at(1.0, 5.0)


def test_rooms_apart_are_not_merged() -> None:
    home = Home()
    home.see(LEFT, (10.1, 0.1, 13.9, 3.9), structure=[*TWO_WALLS, wall(7, 10, 0, 10, 4)])
    near, far = home.at(2.0, 2.0), home.at(12.0, 2.0)
    with pytest.raises(InvalidStatement, match="m apart"):
        home.tell(told_rooms.merge, near, far)
    home.see(LEFT, structure=UPSTAIRS, z=(3.6, 4.8))
    with pytest.raises(InvalidStatement, match="different storeys"):
        home.tell(told_rooms.merge, near, home.at(2.0, 2.0, 3.1))


def test_a_room_is_drawn_on_the_storey_that_is_named() -> None:
    home = Home()
    home.see(LEFT, structure=TWO_WALLS)
    home.see(LEFT, structure=UPSTAIRS, z=(3.6, 4.8))
    corner = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
    home.draw("nursery", corner, "storey_2")
    home.draw("pantry", corner)
    names = {(n.attributes["name"], n.attributes["storey"]) for n in home.nodes.values() if "name" in n.attributes}
    assert names == {("nursery", 2), ("pantry", 1)}
    with pytest.raises(InvalidStatement, match="storey_3"):
        home.draw("attic", corner, "storey_3")
