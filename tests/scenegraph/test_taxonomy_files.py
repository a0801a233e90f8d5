"""Trees of classes of other programs: read alike from every format, refused by line, and told to a world."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from scenegraph.cli import app
from scenegraph.errors import TaxonomyUnreadable
from scenegraph.interop import Taxonomy, read_taxonomy
from scenegraph.world import World

XML = """<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [ <!ENTITY owl "http://www.w3.org/2002/07/owl#" > ]>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:owl="http://www.w3.org/2002/07/owl#"
         xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#" xml:base="http://example.org/home">
  <owl:Class rdf:about="#CoffeeMug"><rdfs:subClassOf rdf:resource="#Mug"/></owl:Class>
  <owl:Class rdf:ID="Mug">
    <rdfs:subClassOf><owl:Class rdf:about="#Cup"/></rdfs:subClassOf>
    <rdfs:subClassOf rdf:resource="&owl;Thing"/>
    <rdfs:subClassOf><owl:Restriction><owl:onProperty rdf:resource="#holds"/></owl:Restriction></rdfs:subClassOf>
  </owl:Class>
  <owl:Class rdf:about="#X17"><rdfs:label xml:lang="de">Kelch</rdfs:label><rdfs:label xml:lang="en">goblet</rdfs:label>
    <rdfs:subClassOf rdf:resource="#Cup"/></owl:Class>
</rdf:RDF>
"""
TURTLE = """@prefix : <http://example.org/home#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
PREFIX owl: <http://www.w3.org/2002/07/owl#>
<http://example.org/home> a owl:Ontology ; rdfs:label "a \\"home\\"; with . marks"@en .
:CoffeeMug a owl:Class ; rdfs:subClassOf :Mug . # a comment
:Mug a owl:Class ;
  rdfs:subClassOf :Cup , owl:Thing , [ a owl:Restriction ; owl:onProperty :holds ; owl:maxCardinality 1 ] ;
  rdfs:comment \"\"\"long
text.\"\"\" .
:X17 rdfs:label "Kelch"@de, "goblet"@en ; rdfs:subClassOf :Cup .
[] a owl:AllDisjointClasses ; owl:members ( :Mug :X17 ) .
"""
INDENTED = "cup.n.01\n  mug.n.04\n    coffee mug\n  goblet\n"
CSV = "child,parent\ncoffee mug,Mug\nmug,cup\n\n# of glass\ngoblet,Cup\n"
MUGS = {"coffee_mug": ("mug",), "mug": ("cup",), "goblet": ("cup",)}


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.owl", XML), ("a.rdf", XML), ("a.ttl", TURTLE), ("a.txt", INDENTED), ("a.csv", CSV)],
)
def test_every_format_tells_the_same(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    assert dict(read_taxonomy(tmp_path / name).parents) == MUGS


names = st.text("abcdefgh", min_size=1, max_size=4)


@settings(max_examples=40, deadline=None)
@given(st.lists(names, min_size=2, max_size=12, unique=True), st.data())
def test_what_is_written_is_read(
    tmp_path_factory: pytest.TempPathFactory, classes: list[str], data: st.DataObject
) -> None:
    """Trees in all formats; tables and RDF also where a class has several parents."""
    pairs = [
        (child, classes[data.draw(st.integers(0, n - 1))])
        for n, child in enumerate(classes)
        if n and data.draw(st.booleans())
    ] or [(classes[1], classes[0])]
    folder = tmp_path_factory.mktemp("trees")
    expected = {child: (parent,) for child, parent in pairs}
    head = "@prefix r: <http://www.w3.org/2000/01/rdf-schema#>.\n@prefix : <http://e.org/>.\n"
    (folder / "t.ttl").write_text(head + "".join(f":{a} r:subClassOf :{b}.\n" for a, b in pairs))
    (folder / "t.csv").write_text("".join(f"{a},{b}\n" for a, b in pairs))
    below: dict[str, list[str]] = {}
    for child, parent in pairs:
        below.setdefault(parent, []).append(child)

    def lines(name: str, depth: int) -> list[str]:
        return ["\t" * depth + name, *(line for child in below.get(name, ()) for line in lines(child, depth + 1))]

    roots = [name for name in below if name not in expected]
    (folder / "t.txt").write_text("\n".join(line for root in roots for line in lines(root, 0)))
    for name in ("t.ttl", "t.csv", "t.txt"):
        assert dict(read_taxonomy(folder / name).parents) == expected


def test_parents_are_told_before_what_is_below_them() -> None:
    told = Taxonomy(MUGS).statements()
    assert sorted(told) == ["subclass(coffee_mug, mug)", "subclass(goblet, cup)", "subclass(mug, cup)"]
    assert told.index("subclass(mug, cup)") < told.index("subclass(coffee_mug, mug)")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "a,b\nb,c\nc,a\n", "below themselves: "),
        ("a.csv", "a,b\na,b,c\n", ":2: expected `child,parent`"),
        ("a.csv", "", "no class is below another"),
        ("a.txt", "one\ntwo\n", "no class is below another"),
        ("a.txt", "    one\n  two\n", ":2: 'two' is indented less"),
        ("a.owl", "<rdf>", "not well-formed XML"),
        ("a.owl", "<html/>", "expected RDF/XML"),
        ("a.ttl", ":a :b :c .", ":1: the prefix of ':a' is not declared"),
        ("a.ttl", "<x:a> <x:b> <x:c>", "ends within a statement"),
        ("a.ttl", "<x:a> <x:b> <x:c>\n<x:d> <x:e> <x:f> .", ":2: expected `;`"),
        ("a.ttl", '<x:a> <x:b> "open .', ":1: not Turtle"),
        ("a.pdf", "x", "not a tree of classes"),
    ],
)
def test_what_is_wrong_is_said_with_the_place(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(TaxonomyUnreadable) as caught:
        read_taxonomy(tmp_path / name)
    assert said in str(caught.value)
    assert name in str(caught.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(TaxonomyUnreadable, match="cannot be read"):
        read_taxonomy(tmp_path / "none.csv")


def test_a_world_knows_the_classes_it_was_told(tmp_path: Path) -> None:
    with World() as world:
        for statement in Taxonomy(MUGS).statements():
            assert world.tell(statement, author="operator").accepted
        assert world.ask("subclass(coffee_mug, tableware)").truth == "true"
        assert world.meaning.is_container("goblet")
        refused = world.tell("subclass(cup, coffee_mug)", author="operator")
        assert not refused.accepted
        assert refused.problem is not None
        assert "circle" in refused.problem.message
        world.save(tmp_path / "w.world")
        assert world.tell("retract(subclass(goblet, cup))", author="operator").accepted
        assert world.ask("subclass(goblet, tableware)").truth != "true"
    with World.load(tmp_path / "w.world") as again:
        assert again.ask("subclass(goblet, tableware)").truth == "true"


def test_a_taxonomy_is_told_on_the_command_line(tmp_path: Path) -> None:
    saved, tree = tmp_path / "w.world", tmp_path / "cups.csv"
    with World() as world:
        world.save(saved)

    def run(*words: object) -> Result:
        return CliRunner().invoke(app, [str(word) for word in (*words, "--map", saved)])

    tree.write_text("goblet,cup\ntea glass,glass\n")
    assert run("tell", "--taxonomy", tree).exit_code == 0
    assert run("ask", "subclass(goblet, tableware), subclass(tea_glass, tableware)").exit_code == 0
    tree.write_text("cup,goblet\n")
    refused = run("tell", "--taxonomy", tree)
    assert refused.exit_code == 2
    assert "circle" in refused.stderr
    assert run("tell").exit_code == 2
    assert run("ask", "how many goblets are there?").exit_code == 1, "part of the world was never seen"
    assert run("ask", "the unicorn on the table").exit_code == 2
