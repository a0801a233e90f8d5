"""A world that was saved comes back the same: graph, answers, identities; a file that is not whole is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scenegraph.errors import StoreCorrupt, StoreError, StoreForeign
from scenegraph.world import World
from tests.support import small_home
from tests.support.small_home import id_of, stamp

Copy = Callable[[], World]
GOALS = ("on(X, table), near(X, book)", "in(X, kitchen)", "near(oven, bed)", "\\+ on(bed, table)", "left_of(X, oven)")


def answers(world: World, goal: str) -> tuple[object, ...]:
    found = world.ask(goal, robot="rob")
    rows = sorted(str(sorted((k, getattr(v, "id", v)) for k, v in row.items())) for row in found)
    return found.truth, rows, None if found.problem is None else found.problem.code


@pytest.fixture(scope="module")
def again(copy_home: Copy) -> World:
    return copy_home()


def test_the_graph_is_the_same(home: World, again: World) -> None:
    assert again.graph.snapshot() == home.graph.snapshot()
    past = stamp(10)
    assert again.graph.as_of(past).snapshot().nodes == home.graph.as_of(past).snapshot().nodes


@pytest.mark.parametrize("goal", GOALS)
def test_answers_are_the_same(home: World, again: World, goal: str) -> None:
    assert answers(again, goal) == answers(home, goal)


def test_places_are_the_same(home: World, again: World) -> None:
    assert repr(again.where("near the oven")) == repr(home.where("near the oven"))


def test_every_layer_is_the_same(home: World, again: World) -> None:
    points = np.random.default_rng(0).uniform((-0.2, -0.2, -0.2), (6.6, 3.6, 2.6), (3000, 3))
    assert np.array_equal(again.map.occupancy.classify(points), home.map.occupancy.classify(points))
    assert np.array_equal(again.map.tsdf.query(points), home.map.tsdf.query(points), equal_nan=True)
    assert np.array_equal(again.map.semantics.query(points)[0], home.map.semantics.query(points)[0])
    assert np.array_equal(again.map.instances.query(points), home.map.instances.query(points))
    assert again.map.planes.ids == home.map.planes.ids
    for number in home.map.planes.ids:
        one, two = again.map.planes.plane(number), home.map.planes.plane(number)
        assert np.allclose(one.normal, two.normal)
        assert one.area_m2 == pytest.approx(two.area_m2)
    assert again.status()["facts"] == home.status()["facts"]


def test_relations_of_a_world_that_comes_back_see_its_space_and_its_structure(home: World, again: World) -> None:
    points = np.random.default_rng(1).uniform((0.0, 0.0, 0.0), (6.4, 3.4, 2.4), (500, 3))
    before, after = home.perception.building, again.perception.building
    assert before.seen_free(points).any()
    assert np.array_equal(after.seen_free(points), before.seen_free(points))
    assert [after.between(p, q) for p, q in zip(points[::2], points[1::2], strict=True)] == [
        before.between(p, q) for p, q in zip(points[::2], points[1::2], strict=True)
    ]
    assert after.storey(0.5) == before.storey(0.5) == 1


def test_mapping_goes_on_with_the_same_ids(copy_home: Copy) -> None:
    world = copy_home()
    before = {n.id: n.label for layer in ("object", "room") for n in world.graph.nodes(layer)}
    walls = {n.id for n in world.graph.nodes("structure", label="wall")}
    for n, image in enumerate(small_home.images()[::5]):
        world.integrate(image.model_copy(update={"stamp_ns": stamp(100 + n)}))
    assert {n.id: n.label for layer in ("object", "room") for n in world.graph.nodes(layer)} == before
    assert walls <= {n.id for n in world.graph.nodes("structure")}
    assert world.graph.node(id_of(world, "oven")).last_seen_ns > stamp(99)
    assert world.ask("on(vase, table)").truth == "true"


def test_a_reloaded_world_and_one_that_never_stopped_agree(copy_home: Copy) -> None:
    """After the same further images, whether loaded once or twice."""
    one, two = copy_home(), copy_home()
    for n, image in enumerate(small_home.images()[::6]):
        later = image.model_copy(update={"stamp_ns": stamp(200 + n)})
        one.integrate(later)
        two.integrate(later)
    assert one.graph.snapshot() == two.graph.snapshot()


def test_what_was_told_comes_back(copy_home: Copy, tmp_path: Path) -> None:
    world = copy_home()
    oven = id_of(world, "oven")
    assert world.tell("fact(hot(stove))", author="ann", reason="felt it").accepted
    assert world.tell("fact(broken(lamp))", author="ann").accepted
    assert world.tell("retract(broken(lamp))", author="ann").accepted
    assert world.tell(f"rename({oven}, 'the old oven')", author="ann").accepted
    world.save(tmp_path / "told.world")
    with World.load(tmp_path / "told.world") as back:
        assert back.ask("fact(hot(stove))").truth == "true"
        assert back.ask("fact(broken(lamp))").truth != "true"
        assert back.graph.node(oven).attributes["name"] == "the old oven"
        assert [(s.text, s.author, s.reason) for s in back.statements] == [
            (s.text, s.author, s.reason) for s in world.statements
        ]
        back.integrate(small_home.images()[0].model_copy(update={"stamp_ns": stamp(300)}))
        assert back.graph.node(oven).attributes["name"] == "the old oven"


def test_a_drawn_room_comes_back(copy_home: Copy, tmp_path: Path) -> None:
    world = copy_home()
    result = world.tell("room('pantry', [[0.0, 0.0], [1.5, 0.0], [1.5, 1.0], [0.0, 1.0]])", author="ann")
    assert result.accepted, result.problem
    [pantry] = [n.id for n in world.graph.nodes("room") if n.attributes.get("name") == "pantry"]
    world.save(tmp_path / "drawn.world")
    with World.load(tmp_path / "drawn.world") as back:
        assert back.perception.rooms.shares(np.array([[0.7, 0.5]]), 0.0) == {pantry: 1.0}
        for n, image in enumerate(small_home.images()[:16:4]):
            back.integrate(image.model_copy(update={"stamp_ns": stamp(400 + n)}))
        assert back.graph.node(pantry).attributes["name"] == "pantry"


def test_an_empty_world_comes_back(tmp_path: Path) -> None:
    with World() as world:
        world.save(tmp_path / "empty.world")
    with World.load(tmp_path / "empty.world") as back:
        assert len(back.graph) == 0
        back.integrate(small_home.SCENE.label_space)
        assert back.integrate(small_home.images()[0])


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(home_file: Path, tmp_path: Path, share: float) -> None:
    whole = home_file.read_bytes()
    cut = tmp_path / "cut.world"
    cut.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(StoreError) as caught:
        World.load(cut)
    assert str(cut) in str(caught.value)


def test_a_file_with_a_flipped_byte_is_refused_or_harmless(home_file: Path, tmp_path: Path) -> None:
    whole = home_file.read_bytes()
    for at in np.linspace(100, len(whole) - 100, 7).astype(int):
        broken = bytearray(whole)
        broken[at] ^= 0xFF
        (tmp_path / "broken.world").write_bytes(broken)
        with pytest.raises(StoreCorrupt):
            World.load(tmp_path / "broken.world").close()


def test_foreign_and_missing_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(StoreForeign):
        World.load(tmp_path / "picture.png")
    with pytest.raises((StoreError, FileNotFoundError)):
        World.load(tmp_path / "nothing.world")


def test_saving_over_a_file_keeps_it_whole(copy_home: Copy, home_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "twice.world"
    world = copy_home()
    world.save(path)
    world.integrate(small_home.robot_at(1.0, 1.0, stamp(500)))
    world.save(path)
    with World.load(path) as back:
        assert back.graph.snapshot() == world.graph.snapshot()
    assert [p.name for p in tmp_path.iterdir()] == ["twice.world"], "nothing else is left behind"
