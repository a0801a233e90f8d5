"""Structure: planes of rooms get the right labels and nodes, and only where something changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from mapping.datasets import open_dataset
from mapping.observations import Scan
from mapping.planes import PlaneMap
from mapping.tsdf import TsdfMap
from reasoning import KnowledgeBase
from reasoning.labelling import PlaneFacts, PlaneRelation, PlaneRules
from scenegraph.graph import SceneGraph
from scenegraph.perception.plane_relations import facing
from scenegraph.perception.structure import Labeller, Structure, no_evidence
from tests.naive_planes import Rectangle, Soup, box
from tests.support.recordings import recording

X, Y, Z = np.eye(3)


@pytest.fixture(scope="module")
def label() -> Labeller:
    with KnowledgeBase() as knowledge:
        rules = PlaneRules.of(knowledge)
    return lambda planes, relations: rules.label(planes, relations).labels


class Home:
    """A surface, its planes, their structure and the graph, updated together."""

    def __init__(self, label: Labeller, seed: int = 0, evidence: Any = no_evidence) -> None:
        self.soup = Soup(seed=seed)
        self.planes = PlaneMap(0.05)
        self.structure = Structure()
        self.graph = SceneGraph()
        self.evidence = evidence
        self.calls: list[tuple[Sequence[PlaneFacts], Sequence[PlaneRelation]]] = []
        self._label = label
        self._now = 0

    def label(self, planes: Sequence[PlaneFacts], relations: Sequence[PlaneRelation]) -> Mapping[int, str]:
        self.calls.append((planes, relations))
        return self._label(planes, relations)

    def add(self, *rectangles: Rectangle) -> None:
        self.follow(self.soup.add_all(rectangles))

    def remove(self, *rectangles: Rectangle) -> None:
        self.follow(np.concatenate([self.soup.remove(r) for r in rectangles]))

    def follow(self, blocks: Any) -> None:
        self._now += 1_000_000_000
        change = self.planes.update(self.soup, blocks)
        changes = self.structure.update(self.planes, change, self.evidence, self.label, self._now)
        self.graph.commit(changes, self._now)
        known = {node.id: node.label for node in self.graph.nodes("structure")}
        assert known == {f"plane_{i}": kind for i, kind in self.structure.labels.items()}
        assert sorted(self.structure.labels) == self.planes.ids

    def label_at(self, rectangle: Rectangle) -> str:
        """The label of the plane in a rectangle's middle."""
        middle = (rectangle.corner + 0.5 * rectangle.u + 0.5 * rectangle.v)[None]
        for plane_id, name in self.structure.labels.items():
            facing_it = self.planes.plane(plane_id).normal @ rectangle.normal > 0.9
            if facing_it and self.planes.near(plane_id, middle, 0.1, 0.05)[0]:
                return name
        return "missing"


def room(x: float = 0.0, y: float = 0.0) -> dict[str, Rectangle]:
    names = ("floor", "ceiling", "south", "north", "west", "east")
    faces = box((x, y, 0.0), (x + 4.0, y + 3.0, 2.5), inwards=True)
    return dict(zip(names, faces, strict=True))


def block(low: tuple[float, float, float], size: tuple[float, float, float], yaw: float = 0.0) -> list[Rectangle]:
    """Furniture: a box's top and sides (its last five faces), turned about its centre."""
    half = np.array(size) / 2.0
    centre = np.array(low) + half
    faces = [face.turned(yaw) for face in box(-half, half)[1:]]
    return [Rectangle(face.corner + centre, face.u, face.v) for face in faces]


def furniture() -> list[Rectangle]:
    table = Rectangle(np.array([1.5, 1.0, 0.74]), 1.4 * X, 0.8 * Y)
    underside = Rectangle(np.array([1.5, 1.0, 0.70]), 0.8 * Y, 1.4 * X)
    shelf_board = Rectangle(np.array([3.6, 1.0, 1.4]), 0.4 * X, 1.2 * Y)
    fridge = block((0.05, 2.3, 0.0), (0.62, 0.65, 1.8))
    wardrobe = block((2.0, 2.4, 0.0), (1.6, 0.58, 2.05))
    return [table, underside, shelf_board, *fridge, *wardrobe]


LABELS = {"floor": "floor", "ceiling": "ceiling", "south": "wall", "north": "wall", "west": "wall", "east": "wall"}


# -- labels ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("yaw", [0.0, 0.3, 0.785, 2.5, 4.0])
def test_a_furnished_room_is_labelled_whichever_way_it_is_turned(label: Labeller, yaw: float) -> None:
    home = Home(label, seed=int(10 * yaw))
    structure = {name: face.turned(yaw) for name, face in room().items()}
    things = [face.turned(yaw) for face in furniture()]
    home.add(*structure.values(), *things)
    assert {name: home.label_at(face) for name, face in structure.items()} == LABELS
    labels = list(home.structure.labels.values())
    assert sorted(labels) == ["ceiling", "floor", *["no_feature"] * (len(labels) - 6), *["wall"] * 4]
    assert len(labels) >= 14


def test_a_leaf_ajar_is_a_door_and_the_side_of_a_cupboard_is_not(label: Labeller) -> None:
    home = Home(label)
    structure = room()
    turn = np.array([np.cos(0.9), np.sin(0.9), 0.0])
    leaf = Rectangle(np.array([1.0, 0.02, 0.01]), 0.9 * turn, 1.98 * Z)
    cupboard = block((2.6, 1.2, 0.0), (0.9, 0.7, 1.9), yaw=0.5)
    home.add(*structure.values(), leaf, *cupboard)
    assert home.label_at(leaf) == "door"
    assert [home.label_at(face) for face in cupboard if abs(face.normal[2]) < 0.1] == ["no_feature"] * 4


def test_labels_on_the_surface_decide_where_shape_does_not(label: Labeller) -> None:
    partition = Rectangle(np.array([1.0, 1.5, 0.0]), 2.0 * X, 1.6 * Z)

    def seen_as(name: str) -> Any:
        def evidence(points: Any) -> dict[str, float]:
            on = (np.abs(points[:, 1] - 1.5) < 0.1).mean()
            return {name: float(on)} if on > 0.5 else {}

        return evidence

    said = {}
    for name in ("wall", "cupboard"):
        home = Home(label, evidence=seen_as(name))
        home.add(*room().values(), partition)
        said[name] = home.label_at(partition)
    assert said == {"wall": "wall", "cupboard": "no_feature"}


def test_a_plane_is_labelled_anew_when_its_evidence_changes(label: Labeller) -> None:
    shares: dict[str, float] = {}
    home = Home(label, evidence=lambda points: shares if points[:, 2].mean() > 0.5 else {})
    top = Rectangle(np.array([1.0, 1.0, 0.7]), 1.2 * X, 0.8 * Y)
    home.add(top)
    assert home.label_at(top) == "floor"
    shares["table"] = 0.9
    for _ in range(5):
        home.follow(np.unique(np.floor(top.samples(0.05) / 0.4).astype(np.int32), axis=0))
    assert home.label_at(top) == "no_feature"


def test_what_is_seen_later_corrects_what_was_said_before(label: Labeller) -> None:
    home = Home(label)
    table = Rectangle(np.array([1.5, 1.0, 0.74]), 1.4 * X, 0.8 * Y)
    home.add(table)
    assert home.label_at(table) == "floor"
    home.add(room()["floor"])
    assert home.label_at(table) == "no_feature"
    assert home.label_at(room()["floor"]) == "floor"


# -- change ------------------------------------------------------------------------------------------------------


def test_only_what_is_about_a_change_is_labelled_anew(label: Labeller) -> None:
    home = Home(label)
    for x in (0.0, 5.0, 10.0, 15.0):
        home.add(*room(x).values())
    home.calls.clear()
    home.add(*block((16.0, 1.0, 0.0), (1.0, 1.0, 0.8)))
    ((planes, relations),) = home.calls
    about = {f.id for f in planes}
    far = {i for i in home.planes.ids if home.planes.plane(i).centroid[0] < 13.0}
    assert not about & far
    assert about >= {i for r in relations for i in r[1:]}


def test_an_update_without_noticeable_change_asks_nothing(label: Labeller) -> None:
    home = Home(label)
    faces = room()
    home.add(*faces.values())
    home.calls.clear()
    revision = home.graph.revision
    home.follow(np.unique(np.floor(faces["floor"].samples(0.05) / 0.4).astype(np.int32), axis=0))
    assert home.calls == []
    assert home.graph.revision == revision


def test_the_last_sight_of_a_plane_is_refreshed_in_steps(label: Labeller) -> None:
    home = Home(label)
    faces = room()
    home.add(*faces.values())
    blocks = np.unique(np.floor(faces["floor"].samples(0.05) / 0.4).astype(np.int32), axis=0)
    first = {n.id: n.first_seen_ns for n in home.graph.nodes("structure")}
    for _ in range(6):
        home.follow(blocks)
    (floor,) = home.graph.nodes("structure", label="floor")
    assert floor.last_seen_ns == 6_000_000_000
    assert floor.first_seen_ns == first[floor.id]


def test_nodes_go_with_their_planes_and_say_what_they_became(label: Labeller) -> None:
    home = Home(label)
    left, middle, right = (
        Rectangle(np.array([x, 0.0, 0.0]), w * X, 2.5 * Z) for x, w in ((0, 1.5), (1.5, 1.5), (3, 2.0))
    )
    home.add(left, right)
    assert len(home.graph.nodes("structure")) == 2
    home.add(middle)
    (node,) = home.graph.nodes("structure")
    assert node.id == "plane_1"
    tombstone = home.graph.tombstone("plane_2")
    assert tombstone is not None
    assert tombstone.became == "plane_1"
    home.remove(left, middle, right)
    assert home.graph.nodes("structure") == []


def test_a_restored_structure_goes_on_where_it_was(label: Labeller) -> None:
    home = Home(label)
    home.add(*room().values(), *furniture())
    other = Home(label)
    other.soup, other.graph, other._now = home.soup, home.graph, home._now
    other.planes.restore(home.planes.state())
    other.structure.restore(home.structure.document(), other.planes, other.graph)
    assert other.structure.labels == home.structure.labels
    revision = other.graph.revision
    other.follow(np.unique(np.floor(room()["floor"].samples(0.05) / 0.4).astype(np.int32), axis=0))
    assert other.calls == []
    assert other.graph.revision == revision
    other.add(*block((0.5, 0.5, 0.0), (1.0, 0.6, 0.9)))
    assert {name: other.label_at(face) for name, face in room().items()} == LABELS


def test_planes_that_could_not_be_labelled_are_labelled_next_time(label: Labeller) -> None:
    home = Home(label)
    home.add(*room().values())
    answer, home._label = home._label, _out_of_time
    table = Rectangle(np.array([1.5, 1.0, 0.74]), 1.4 * X, 0.8 * Y)
    with pytest.raises(TimeoutError):
        home.add(table)
    home._label = answer
    home.add(*block((3.0, 2.0, 0.0), (0.9, 0.9, 0.9)))
    assert home.label_at(table) == "no_feature"


def _out_of_time(_: Sequence[PlaneFacts], __: Sequence[PlaneRelation]) -> Mapping[int, str]:
    raise TimeoutError


# -- nodes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("yaw", [0.0, 0.4, 2.0])
def test_a_node_tells_where_its_plane_lies(label: Labeller, yaw: float) -> None:
    home = Home(label)
    structure = {name: face.turned(yaw) for name, face in room(1.0, 2.0).items()}
    home.add(*structure.values())
    assert len(home.graph.nodes("structure")) == 6
    for face in structure.values():
        middle = face.corner + 0.5 * (face.u + face.v)
        (node,) = [n for n in home.graph.nodes("structure") if np.allclose(n.position, middle, atol=0.06)]
        assert node.box is not None
        assert node.box.contains(face.samples(0.3), margin_m=0.06).all()
        assert sorted(node.box.size)[1:] == pytest.approx(sorted(np.linalg.norm([face.u, face.v], axis=1)), abs=0.15)
        assert sorted(node.box.size)[0] < 0.1
        assert node.box.rotation[2, 2] == pytest.approx(1.0, abs=1e-3)  # upright: its size in z is its height
        assert np.allclose(node.attributes["normal"], face.normal, atol=0.02)
        assert node.attributes["area_m2"] == pytest.approx(face.area, rel=0.06)
        ring = np.array(node.attributes["polygon"][0])
        assert np.abs(ring @ face.normal - face.normal @ face.corner).max() < 0.03


@pytest.mark.parametrize(
    ("normal", "expected"),
    [((0, 0, 1), "up"), ((0, 0.1, -0.99), "down"), ((1, 0, 0.1), "side"), ((0.7, 0, 0.7), "oblique")],
)
def test_a_plane_faces_one_way(normal: tuple[float, ...], expected: str) -> None:
    n = np.array(normal)
    assert facing(n / np.linalg.norm(n)) == expected


# -- real scans --------------------------------------------------------------------------------------------------


def test_the_corridor_of_the_3dtk_scans_is_labelled_without_semantics(label: Labeller) -> None:
    """Three real scans; where floor, ceiling and walls are was read off plots of the raw points.

    The corridor runs along x; in the frame of the first scan its floor lies some 0.5 m below the scanner, its ceiling
    2 m above, its right wall at y = −0.95 m.
    """
    tsdf, planes, structure = TsdfMap(voxel_size_m=0.05), PlaneMap(0.05), Structure()
    raw = []
    for scan in open_dataset(recording("3dtk_dat_lidar_odometry")):
        if not isinstance(scan, Scan):
            continue
        assert scan.T_map_sensor is not None
        p_map = scan.T_map_sensor @ scan.points
        raw.append(p_map[np.linalg.norm(scan.points, axis=1) < 15.0])
        change = planes.update(tsdf, tsdf.integrate(scan.points, scan.T_map_sensor))
        structure.update(planes, change, no_evidence, label, scan.stamp_ns)
    points = np.concatenate(raw)
    x, y, z = points.T
    inside = (x > 1.0) & (x < 5.0)
    probes = {
        "floor": inside & (np.abs(y) < 0.7) & (z < -0.38) & (z > -0.75),
        "ceiling": inside & (np.abs(y) < 0.9) & (z > 1.75),
        "wall": inside & (y < -0.85) & (y > -1.05) & (z > -0.2) & (z < 1.6),
    }
    for name, chosen in probes.items():
        some = points[chosen][::20]
        assert len(some) > 200
        on = {kind: np.zeros(len(some), dtype=bool) for kind in ("floor", "ceiling", "wall", "door", "no_feature")}
        for plane_id, kind in structure.labels.items():
            on[kind] |= planes.near(plane_id, some, 0.05, 0.06)
        known = np.any(list(on.values()), axis=0)
        assert known.mean() > 0.85
        assert on[name][known].mean() > (0.8 if name == "ceiling" else 0.95), name  # lamps hang from the ceiling
