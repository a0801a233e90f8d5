"""What an operator states is in the graph and in the answers, and what makes no sense is refused with a reason."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scenegraph.world import World
from tests.support import small_home
from tests.support.small_home import id_of, room_at, stamp

Copy = Callable[[], World]


@pytest.fixture(scope="module")
def world(copy_home: Copy) -> World:
    """One world for all statements that do not get in each other's way."""
    return copy_home()


def tell(world: World, statement: str, **how: str) -> None:
    result = world.tell(statement, author=how.get("author", "ann"), reason=how.get("reason", ""))
    assert result.problem is None, result.problem
    assert result.accepted
    assert result.revision == world.graph.revision


def look_again(world: World, first: int, step: int = 4) -> None:
    """Map on, with times of their own."""
    for n, image in enumerate(small_home.images()[::step]):
        world.integrate(image.model_copy(update={"stamp_ns": stamp(first + n)}))


# -- each form ---------------------------------------------------------------------------------------------------------


def test_a_fact_can_be_asked_for_until_it_is_retracted(world: World) -> None:
    assert world.ask("fact(owner(table, X))").truth != "true"
    tell(world, "fact(owner(table, ann))")
    [row] = list(world.ask("fact(owner(table, X))"))
    assert row["X"] == "ann"
    tell(world, "retract(owner(table, ann))")
    assert world.ask("fact(owner(table, X))").truth != "true"


def test_a_new_name_is_in_the_graph_and_outlives_mapping(copy_home: Copy) -> None:
    world = copy_home()
    oven, room, wall = (
        id_of(world, "oven"),
        room_at(world, small_home.BEDROOM),
        world.graph.nodes("structure", label="wall")[0].id,
    )
    for node, name in ((oven, "old stove"), (room, "guest room"), (wall, "north wall")):
        tell(world, f"rename({node}, '{name}')", reason="sign on the door")
        assert world.graph.node(node).attributes["name"] == name
    look_again(world, 100)
    assert world.graph.node(oven).attributes["name"] == "old stove"
    assert world.graph.node(room).attributes["name"] == "guest room"
    assert world.graph.node(wall).attributes["name"] == "north wall"


def test_an_attribute_is_set_and_can_be_asked_for(world: World) -> None:
    stool = id_of(world, "stool")
    for value, stored in (("red", "red"), ("3", 3), ("2.5", 2.5), ("true", True), ('"a text"', "a text")):
        tell(world, f"set({stool}, color, {value})")
        assert world.graph.node(stool).attributes["color"] == stored


def test_a_room_type_that_was_told_counts_more_than_the_rules(copy_home: Copy) -> None:
    world = copy_home()
    room = room_at(world, small_home.BEDROOM)
    tell(world, f"set({room}, type, study)")
    assert world.graph.node(room).attributes["type"] == "study"
    assert world.ask("in(bed, study)").truth == "true"
    look_again(world, 100, step=9)
    assert world.graph.node(room).attributes["type"] == "study"


def test_things_that_are_one_are_merged_and_stay_so(copy_home: Copy) -> None:
    world = copy_home()
    vase, book = id_of(world, "vase"), id_of(world, "book")
    views = world.graph.node(vase).attributes["views"]
    tell(world, f"merge({vase}, {book})")
    assert book not in world.graph
    assert world.graph.tombstone(book).became == vase  # type: ignore[union-attr]
    assert world.graph.node(vase).attributes["views"] > views  # type: ignore[operator]
    assert not [e for e in world.graph.edges() if book in (e.source, e.target)]
    assert world.ask(f"on(X, {id_of(world, 'table')})").truth == "true"


def test_a_deleted_thing_is_gone_from_graph_and_answers(copy_home: Copy) -> None:
    world = copy_home()
    table, vase = id_of(world, "table"), id_of(world, "vase")
    tell(world, f"delete({vase})", reason="broken")
    assert vase not in world.graph
    assert world.graph.tombstone(vase).reason == "broken"  # type: ignore[union-attr]
    assert {row["X"].label for row in world.ask("on(X, table)")} == {"book"}
    assert all(e.source != vase for e in world.graph.edges("on", target=table))
    look_again(world, 100, step=6)
    assert vase not in world.graph, "an id is given once"


@pytest.mark.parametrize("layer", ["room", "structure", "agent"])
def test_mapping_goes_on_after_any_node_was_deleted(copy_home: Copy, layer: str) -> None:
    world = copy_home()
    for node in world.graph.nodes(layer):
        tell(world, f"delete({node.id})")
    look_again(world, 100, step=3)
    world.integrate(small_home.robot_at(1.0, 1.0, stamp(200)))
    assert {n.label for n in world.graph.nodes("object")} == {"table", "vase", "book", "oven", "bed", "stool"}


@pytest.mark.parametrize("layer", ["building", "storey", "place"])
def test_what_follows_from_the_map_cannot_be_deleted(world: World, layer: str) -> None:
    result = world.tell(f"delete({world.graph.nodes(layer)[0].id})", author="ann")  # type: ignore[arg-type]
    assert result.problem is not None
    assert layer in result.problem.message


def test_a_deleted_room_leaves_no_ground_from_which_it_comes_back(copy_home: Copy, tmp_path: Path) -> None:
    world = copy_home()
    room, other = room_at(world, small_home.BEDROOM), room_at(world, small_home.KITCHEN)
    tell(world, f"delete({room})")
    assert not world.perception.rooms.shares(np.array([small_home.BEDROOM]), 0.0)
    assert not world.graph.edges("adjacent")
    world = map_on_and_restart(world, tmp_path / "home.world")
    try:
        assert [node.id for node in world.graph.nodes("room")] == [other]
        assert world.ask("in(bed, X), room(X)").truth != "true"
        assert {e.target for e in world.graph.edges("in") if e.target.startswith("room_")} == {other}
        tell(world, "room('bedroom', [[3.3, 0.1], [6.3, 0.1], [6.3, 3.3], [3.3, 3.3]])")
        assert world.ask("in(bed, X), room(X)").truth == "true"
    finally:
        world.close()


def test_a_deleted_plane_and_a_deleted_passage_stay_away(copy_home: Copy, tmp_path: Path) -> None:
    world = copy_home()
    [passage] = [n.id for n in world.graph.nodes("structure") if n.id.startswith("passage_")]
    ceiling = world.graph.nodes("structure", label="ceiling")[0].id
    for node in (passage, ceiling):
        tell(world, f"delete({node})")
    assert not world.graph.edges("connects")
    world = map_on_and_restart(world, tmp_path / "home.world")
    try:
        assert passage not in world.graph
        assert ceiling not in world.graph
        assert not world.graph.edges("connects")
        assert len(world.graph.nodes("room")) == 2
    finally:
        world.close()


def test_a_drawn_room_takes_its_things(copy_home: Copy) -> None:
    world = copy_home()
    tell(world, "room('dining corner', [[0.0, 1.6], [2.0, 1.6], [2.0, 3.4], [0.0, 3.4]])")
    [corner] = [n for n in world.graph.nodes("room") if n.attributes.get("name") == "dining corner"]
    assert room_at(world, (1.0, 2.3)) == corner.id
    assert world.graph.edge("in", id_of(world, "table"), corner.id) is not None
    assert world.graph.edge("in", corner.id, "storey_1") is not None
    assert world.ask(f"in({corner.id}, building)").truth == "true"
    assert world.graph.edge("in", id_of(world, "oven"), room_at(world, (2.5, 0.5))) is not None
    things = [e.source for e in world.graph.edges("in", target=corner.id)]
    assert len(things) == len(set(things))
    look_again(world, 100)
    assert room_at(world, (1.0, 2.3)) == corner.id
    assert world.graph.edge("in", id_of(world, "table"), corner.id) is not None


def map_on_and_restart(world: World, path: Path) -> World:
    """The world after mapping on, a restart, and mapping on."""
    look_again(world, 100)
    world.save(path)
    world.close()
    world = World.load(path)
    look_again(world, 200)
    return world


def test_a_room_that_was_split_stays_so_and_answers_follow(copy_home: Copy, tmp_path: Path) -> None:
    world = copy_home()
    room = room_at(world, small_home.BEDROOM)
    kitchen = room_at(world, small_home.KITCHEN)
    tell(world, f"split({room}, [[4.0, 1.8], [5.0, 1.8]])")
    by_the_bed, by_the_stool = room_at(world, (4.8, 1.0)), room_at(world, (4.8, 2.6))
    tell(world, f"rename({by_the_stool}, 'dressing room')")
    world = map_on_and_restart(world, tmp_path / "home.world")
    try:
        assert {n.id for n in world.graph.nodes("room")} == {kitchen, by_the_bed, by_the_stool}
        assert (room_at(world, (4.8, 1.0)), room_at(world, (4.8, 2.6))) == (by_the_bed, by_the_stool)
        assert world.graph.node(by_the_bed).label == "bedroom"
        assert "type" not in world.graph.node(by_the_stool).attributes
        assert world.ask("in(stool, 'dressing room')").truth == "true"
        assert world.ask("in(stool, bedroom)").truth == "false"
        assert world.ask("in(bed, bedroom), \\+ in(bed, 'dressing room')").truth == "true"
        assert world.ask("in(stool, building), in(stool, storey)").truth == "true"
        assert world.ask(f"adjacent({by_the_bed}, {by_the_stool})").truth == "true", "nothing stands between"
        assert world.ask(f"leads_to({kitchen}, {by_the_bed})").truth == "true"
    finally:
        world.close()


def test_rooms_that_were_merged_stay_one_and_answers_follow(copy_home: Copy, tmp_path: Path) -> None:
    world = copy_home()
    kitchen, bedroom = room_at(world, small_home.KITCHEN), room_at(world, small_home.BEDROOM)
    tell(world, f"set({kitchen}, type, studio)")
    tell(world, f"merge({kitchen}, {bedroom})")
    assert world.graph.tombstone(bedroom).became == kitchen  # type: ignore[union-attr]
    world = map_on_and_restart(world, tmp_path / "home.world")
    try:
        assert [n.id for n in world.graph.nodes("room")] == [kitchen]
        assert room_at(world, small_home.BEDROOM) == kitchen
        assert world.graph.node(kitchen).attributes["type"] == "studio"
        assert world.ask("in(bed, studio), in(oven, studio)").truth == "true"
        assert not world.graph.edges("adjacent")
        assert not world.graph.edges("connects")
    finally:
        world.close()


def test_an_agent_is_in_the_room_that_was_drawn_about_it(copy_home: Copy) -> None:
    world = copy_home()
    world.integrate(small_home.robot_at(4.8, 2.6, stamp(90)))
    tell(world, f"split({room_at(world, small_home.BEDROOM)}, [[4.0, 1.8], [5.0, 1.8]])")
    [row] = world.ask("in(agent_rob, X), room(X)")
    assert row["X"].id == room_at(world, (4.8, 2.6))


def test_statements_are_kept_with_author_and_reason(copy_home: Copy) -> None:
    world = copy_home()
    tell(world, "fact(tidy(kitchen))", author="operator", reason="saw it")
    [told] = world.statements
    assert (told.kind, told.text, told.author, told.reason) == ("fact", "fact(tidy(kitchen))", "operator", "saw it")
    world.tell("nonsense", author="operator")
    assert world.statements == [told], "what was refused is not kept"


# -- each refusal ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("statement", "code", "words"),
    [
        ("", "invalid_statement", "statement"),
        ("rename(object_1", "invalid_statement", "statement"),
        ("rename(object_1, 'x'). halt", "invalid_statement", "statement"),
        ("fact(a). fact(b)", "invalid_statement", "statement"),
        ("fact(a)) , (fact(b)", "invalid_statement", "statement"),
        ("hello", "invalid_statement", "none of those known"),
        ("shell('ls')", "invalid_statement", "none of those known"),
        ("rename(object_1)", "invalid_statement", "none of those known"),
        ("rename(object_1, Name)", "invalid_statement", "variable"),
        ("fact(near(X, oven))", "invalid_statement", "variable"),
        ("fact(owner(_))", "invalid_statement", "variable"),
        ("set(object_1, color, f(x))", "invalid_statement", "names, numbers and texts"),
        ("rename(object_4711, 'x')", "unknown_node", "object_4711"),
        ("set(object_4711, a, 1)", "unknown_node", "object_4711"),
        ("delete(object_4711)", "unknown_node", "object_4711"),
        ("set(room_1, footprint, 3)", "invalid_statement", "footprint is what was measured of room_1"),
        ("set(object_1, moved_ns, 3)", "invalid_statement", "moved_ns"),
        ("merge(object_1, object_4711)", "unknown_node", "object_4711"),
        ("merge(object_1, object_1)", "invalid_statement", "twice"),
        ("merge(object_1, room_1)", "invalid_statement", "room_1"),
        ("merge(room_1, room_1)", "invalid_statement", "twice"),
        ("merge(room_1, object_1)", "invalid_statement", "object_1"),
        ("split(room_4711, [[0, 0], [1, 1]])", "unknown_node", "room_4711"),
        ("split(object_1, [[0, 0], [1, 1]])", "invalid_statement", "object_1"),
        ("split(room_1, [[0, 0]])", "invalid_statement", "two different points"),
        ("split(room_1, [[0, 0], [0, 0]])", "invalid_statement", "two different points"),
        ("split(room_1, [[9, 9], [10, 9]])", "invalid_statement", "does not cut"),
        ("split(room_1, [[0, 0], [1.0e9, 0]])", "invalid_statement", "50 m"),
        ("split(room_1, here)", "invalid_statement", "split"),
        ("room('a', [[0, 0], [1, 0], [1, 1]], storey_7)", "invalid_statement", "storey_7"),
        ("delete(17)", "invalid_statement", "delete"),
        ("rename(true, 'x')", "invalid_statement", "rename"),
        ("room('a', 3)", "invalid_statement", "room"),
        ("room('a', [])", "invalid_statement", "room"),
        ("room('a', [[0, 0], [1, 1]])", "invalid_statement", "room"),
        ("room('a', [[0, 0], [1, x], [1, 1]])", "invalid_statement", "room"),
        ("room('a', [[0, 0], [1.0e9, 0], [1.0e9, 1.0e9]])", "invalid_statement", "room"),
    ],
)
def test_a_statement_that_makes_no_sense_is_refused_and_changes_nothing(
    world: World, statement: str, code: str, words: str
) -> None:
    before, told = world.graph.snapshot(), list(world.statements)
    result = world.tell(statement, author="ann")
    assert not result.accepted
    assert result.problem is not None
    assert result.problem.code == code
    assert words in result.problem.message
    assert result.revision == before.revision
    assert world.graph.snapshot() == before
    assert world.statements == told


def test_a_statement_without_an_author_is_refused(world: World) -> None:
    result = world.tell("fact(tidy(kitchen))", author="")
    assert not result.accepted
    assert "author" in result.problem.message  # type: ignore[union-attr]


def test_an_unknown_node_is_refused_with_the_nearest_name(world: World) -> None:
    result = world.tell("rename(objekt_1, 'x')", author="ann")
    assert result.problem is not None
    assert "object_1" in f"{result.problem.message} {result.problem.hint}"


atoms = st.sampled_from(
    ["object_1", "room_1", "plane_1", "building_1", "agent_rob", "a", "'B c'", "[]", "{}", "''", "'\\n'"]
)
numbers = st.sampled_from(["0", "-1", "3.5", "1.0e300", "123456789012345678901234567890", "inf", "nan", "1r3", "0'a"])
texts = st.sampled_from(['"text"', '""', '"\\x0\\"', "`codes`"])
terms = st.recursive(
    st.one_of(atoms, numbers, texts),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(lambda items: f"[{', '.join(items)}]"),
        st.tuples(
            st.sampled_from(["f", "fact", "+", "dict", "position", "X"]), st.lists(inner, min_size=1, max_size=3)
        ).map(lambda t: f"{t[0]}({', '.join(t[1])})"),
    ),
    max_leaves=6,
)
FORMS = st.sampled_from(["fact/1", "retract/1", "rename/2", "set/3", "room/2", "room/3", "merge/2", "split/2"])


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
)
@given(form=FORMS, arguments=st.lists(terms, min_size=3, max_size=3))
def test_no_statement_breaks_the_world(world: World, form: str, arguments: list[str]) -> None:
    name, arity = form.split("/")
    statement = f"{name}({', '.join(arguments[: int(arity)])})"
    before = world.graph.revision
    result = world.tell(statement, author="ann")
    assert result.accepted == (result.problem is None)
    assert result.revision == world.graph.revision >= before
    if not result.accepted:
        assert world.graph.revision == before
    assert world.ask("bed(X)").truth == "true"
    world.graph.snapshot().model_dump_json()
