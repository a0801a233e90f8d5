"""The picture shows what is given, where it is, and says what it cannot draw."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenegraph.errors import PictureError
from scenegraph.graph import Box, Edge, GraphChanges, Node, SceneGraph
from scenegraph.picture import draw
from scenegraph.viewpoint import Surface, View

LOW, HIGH = np.array([-1.0, 2.0, 0.0]), np.array([5.0, 6.0, 2.5])
CORNERS = np.array([(x, y, z) for x in (-1.0, 5.0) for y in (2.0, 6.0) for z in (0.0, 2.5)])
SEEN = {"first_seen_ns": 0, "last_seen_ns": 1}


def node(layer: str, number: int, label: str, position: tuple[float, ...], **fields: object) -> Node:
    return Node(id=f"{layer}_{number}", layer=layer, label=label, position=position, **SEEN, **fields)


def home() -> SceneGraph:
    outline = [[0, 3], [4, 3], [4, 5], [0, 5]]
    wall = [[0, 3, 0], [4, 3, 0], [4, 3, 2.4], [0, 3, 2.4]]
    nodes = [
        node("room", 0, "room", (2, 4, 0), attributes={"footprint": outline, "type": "kitchen"}),
        node("room", 1, "room", (2, 5, 0), attributes={"footprint": "unknown"}),
        node("structure", 0, "wall", (2, 3, 1), attributes={"polygon": wall}),
        node("structure", 1, "floor", (2, 4, 0), attributes={"polygon": [wall, wall[:3]]}),
        node("structure", 2, "ceiling", (2, 4, 2.4)),
        node("structure", 3, "door", (2, 3, 1), box=Box(center=(2, 3, 1), size=(0.9, 0.1, 2))),
        node("object", 0, "$x_1$ 椅子\n", (1, 4, 0.5), box=Box.from_yaw((1, 4, 0.5), (0.5, 0.8, 1), 0.4)),
        node("object", 1, "", (3, 4, 0.5)),
        node("agent", 0, "robot", (2, 4, 0), box=Box.from_yaw((2, 4, 0.2), (0.5, 0.5, 0.4), 1.0)),
    ]
    changes = GraphChanges()
    for each in nodes:
        changes.put(each)
    graph = SceneGraph()
    graph.commit(changes, 1)
    return graph


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB")).astype(int)


def has_color(picture: np.ndarray, rgb: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture - rgb).max(axis=2) < 24).sum() > 20)


MAGENTA, BLUE, ORANGE, GREEN = (192, 16, 122), (20, 70, 200), (217, 114, 11), (0, 250, 0)


def test_a_home_is_drawn_with_its_surface_its_truth_and_the_way(tmp_path: Path) -> None:
    grid = np.stack(np.meshgrid(np.arange(0, 4, 0.05), np.arange(3, 5, 0.05)), axis=-1).reshape(-1, 2)
    floor = np.column_stack([grid, np.zeros(len(grid))])
    floor[0] = np.nan
    path = draw(
        home(),
        tmp_path / "home.png",
        points=floor,
        colors=np.tile([0.0, 1.0, 0.0], (len(floor), 1)),
        normals=np.tile([0.0, 0.0, 1.0], (len(floor), 1)),
        trajectory=[[0.5, 3.5], [3.5, 4.5]],
        truth=[("chair", Box(center=(1.1, 4, 0.5), size=(0.5, 0.8, 1)))],
        title="a home",
    )
    picture = pixels(path)
    for color in (MAGENTA, BLUE, ORANGE):
        assert has_color(picture, color), color
    left, right = np.array_split(picture, 2, axis=1)
    for panel in (left, right):  # green floor in both, seen through the room's tint
        assert ((panel[..., 1] > 150) & (panel[..., 0] < 90)).sum() > 5000


def test_what_is_missing_and_what_is_wrong_is_lettered_so(tmp_path: Path) -> None:
    red = (214, 0, 0)
    at, size = (1, 4, 0.5), (0.5, 0.8, 1)
    right = draw(
        home(),
        tmp_path / "right.png",
        truth=[("$x_1$ 椅子\n", Box(center=at, size=size)), ("", Box(center=(3, 4, 0.5), size=size))],
    )
    wrong = draw(home(), tmp_path / "wrong.png", truth=[("cup", Box(center=at, size=size))])
    amount = [int((np.abs(pixels(path) - red).max(axis=2) < 40).sum()) for path in (right, wrong)]
    assert amount[1] > amount[0] + 50


def test_an_empty_world_is_a_picture_too(tmp_path: Path) -> None:
    picture = pixels(draw(SceneGraph(), tmp_path / "empty.png"))
    assert picture.shape[1] > picture.shape[0] > 500
    assert not has_color(picture, MAGENTA)


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    for wrong, message in (
        ({"points": np.zeros((5, 2))}, r"points: expected shape \(N, 3\), got \(5, 2\)"),
        ({"points": np.zeros((5, 3)), "colors": np.zeros((4, 3))}, "colors: expected as many rows as points, 5, got 4"),
        ({"points": np.zeros((5, 3)), "colors": np.zeros(5)}, "colors: expected shape"),
        ({"points": np.zeros((5, 3)), "normals": np.zeros((5, 2))}, "normals: expected shape"),
        ({"trajectory": np.zeros(3)}, "trajectory: expected shape"),
    ):
        with pytest.raises(PictureError, match=message):
            draw(home(), tmp_path / "x.png", **wrong)
    with pytest.raises(PictureError, match="cannot be written"):
        draw(SceneGraph(), tmp_path / "none" / "x.png")
    assert list(tmp_path.iterdir()) == []


def test_from_above_x_goes_right_y_goes_up_and_metres_stay_metres() -> None:
    view = View.from_above(CORNERS)
    origin, right, up, above = view.project([[0, 3, 1], [1, 3, 1], [0, 4, 1], [0, 3, 2]])
    np.testing.assert_allclose((right - origin)[:2], [view.scale, 0], atol=1e-9)
    np.testing.assert_allclose((up - origin)[:2], [0, -view.scale], atol=1e-9)
    np.testing.assert_allclose(above - origin, [0, 0, -1], atol=1e-9)


@pytest.mark.parametrize("make", [View.from_above, View.in_perspective])
def test_everything_in_the_box_is_in_the_picture(make) -> None:  # type: ignore[no-untyped-def]
    view = make(CORNERS)
    points = LOW + np.random.default_rng(0).random((500, 3)) * (HIGH - LOW)
    uvz = view.project(points)
    assert (uvz[:, :2] >= 0).all()
    assert (uvz[:, 0] <= view.width).all()
    assert (uvz[:, 1] <= view.height).all()
    assert (uvz[:, 2] > 0).all()
    rise = view.project([[2, 4, 2]])[0] - view.project([[2, 4, 0]])[0]
    assert rise[1] <= 1e-9  # up in the map is never down in the picture


def test_nearer_samples_hide_farther_ones_like_the_naive_reference() -> None:
    random = np.random.default_rng(3)
    points = LOW + random.random((300, 3)) * (HIGH - LOW)
    colors = random.integers(0, 255, (300, 3), dtype=np.uint8)
    surface = Surface(points, colors, np.zeros((300, 3)), spacing_m=0.05)
    view = View.in_perspective(CORNERS)
    expected = np.tile(np.array([250, 250, 248], np.uint8), (view.height, view.width, 1))
    for i in np.argsort(-view.project(points)[:, 2]):
        u, v, depth = view.project(points[i][None])[0]
        size = int(np.clip(np.ceil(1.3 * 0.05 * view.scale / depth), 1, 9))
        column, row = int(np.floor(u - size / 2 + 0.5)), int(np.floor(v - size / 2 + 0.5))
        expected[max(row, 0) : row + size, max(column, 0) : column + size] = colors[i]
    np.testing.assert_array_equal(view.splat(surface), expected)


def test_a_wall_seen_from_behind_is_left_out() -> None:
    view = View.in_perspective(CORNERS)
    point = (LOW + HIGH)[None] / 2
    towards = view.eye - point
    green = np.array([GREEN], np.uint8)
    seen = view.splat(Surface(point, green, towards / np.linalg.norm(towards), 0.05))
    hidden = view.splat(Surface(point, green, -towards / np.linalg.norm(towards), 0.05))
    assert (seen != hidden).any()
    assert (hidden == [250, 250, 248]).all()


def test_relations_that_are_asked_for_are_drawn(tmp_path: Path) -> None:
    graph, changes = home(), GraphChanges()
    changes.put(Edge(relation="on", source="object_0", target="object_1", **SEEN))
    changes.put(Edge(relation="on", source="object_0", target="structure_1", **SEEN))
    graph.commit(changes, 2)
    violet = (122, 63, 192)
    assert not has_color(pixels(draw(graph, tmp_path / "without.png")), violet)
    assert has_color(pixels(draw(graph, tmp_path / "with.png", relations=("on", "next_to"))), violet)
