"""Scene graphs of any shape, for laws that hold of them all."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from scenegraph.graph import LAYERS, Box, Edge, Node, SceneGraph, Snapshot, Tombstone

numbers = st.floats(-50.0, 50.0).map(lambda x: round(x, 6))
stamps = st.integers(0, 2**62)
shares = st.floats(0.0, 1.0)
printable = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF, exclude_characters="\x7f"), max_size=12)
finite = st.floats(allow_nan=False, allow_infinity=False)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**40), 2**40) | finite | printable,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(printable, inner, max_size=3),
    max_leaves=6,
)
attributes = st.dictionaries(st.from_regex(r"[a-z][a-z_0-9]{0,8}", fullmatch=True), plain, max_size=4)


@st.composite
def boxes(draw: Any) -> Box:
    size = [draw(st.floats(0.0, 5.0)) for _ in range(3)]
    turn = np.array([2.0 + draw(st.floats(-1.0, 1.0)), *(draw(st.floats(-1.0, 1.0)) for _ in range(3))])
    return Box(center=[draw(numbers) for _ in range(3)], size=size, rotation_wxyz=turn / np.linalg.norm(turn))


@st.composite
def graphs(draw: Any, most_nodes: int = 8) -> SceneGraph:
    """Any graph: nodes of all layers, several relations a pair, tombstones, attributes of any JSON kind."""
    ids = draw(st.lists(st.from_regex(r"[a-z][a-z0-9_]{0,10}", fullmatch=True), max_size=most_nodes + 2, unique=True))
    alive, dead = ids[:most_nodes], ids[most_nodes:]
    nodes = []
    for node_id in alive:
        first = draw(stamps)
        nodes.append(
            Node(
                id=node_id,
                layer=draw(st.sampled_from(LAYERS)),
                label=draw(printable),
                position=[draw(numbers) for _ in range(3)],
                box=draw(st.none() | boxes()),
                confidence=draw(shares),
                first_seen_ns=first,
                last_seen_ns=first + draw(st.integers(0, 2**40)),
                attributes=draw(attributes),
            )
        )
    pairs = [(a, b) for a in alive for b in alive if a != b]
    names = st.tuples(st.sampled_from(("on", "near", "in")), st.sampled_from(pairs)) if pairs else st.nothing()
    keys = draw(st.lists(names, max_size=10, unique=True)) if pairs else []
    edges = []
    for relation, (source, target) in keys:
        first = draw(stamps)
        edges.append(
            Edge(
                relation=relation,
                source=source,
                target=target,
                value=draw(st.none() | numbers),
                threshold=draw(st.none() | numbers),
                confidence=draw(shares),
                evidence=tuple(draw(st.lists(stamps | printable, max_size=2))),
                first_seen_ns=first,
                last_seen_ns=first,
                attributes=draw(attributes),
            )
        )
    stones = [
        Tombstone(id=i, became=draw(st.none() | st.sampled_from(alive)) if alive else None, reason="x", stamp_ns=1)
        for i in dead
    ]
    return SceneGraph.from_snapshot(
        Snapshot(revision=draw(st.integers(0, 100)), stamp_ns=draw(stamps), nodes=nodes, edges=edges, tombstones=stones)
    )
