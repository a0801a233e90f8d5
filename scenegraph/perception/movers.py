"""Things that move by themselves become object nodes that move."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mapping.moving import GONE_AFTER_S, MovingChange, MovingThings
from scenegraph.graph import Box, GraphChanges, Node, SceneGraph

MOVED_M = 0.05
"""A node whose position changed by so much is looked at anew by whatever asks where it is."""


def move_nodes(
    moving: MovingThings, change: MovingChange, class_name: Callable[[int], str], graph: SceneGraph
) -> tuple[GraphChanges, dict[str, Node | None]]:
    """The changes that bring the graph up to date, and the nodes that are somewhere else now (None: nowhere), by id.

    A node keeps its last pose while its thing is out of sight, until that is gone: then what is seen there is another.
    One that an operator deleted does not come back.
    """
    changes, moved = GraphChanges(), dict[str, Node | None]()
    about = moving.about()
    for thing_id in sorted(change.touched | change.forgotten):
        node_id = f"mover_{thing_id}"
        known = graph.node(node_id) if node_id in graph else None
        thing = about.get(thing_id)
        if thing is None:
            if known is not None:
                changes.delete_node(node_id, f"not seen for {GONE_AFTER_S:g} s")
                moved[node_id] = None
            continue
        if graph.tombstone(node_id) is not None:
            continue
        box = thing.box_at(moving.stamp_ns)
        node = Node(
            id=node_id,
            layer="object",
            label=class_name(thing.label),
            position=box.center,
            box=Box(center=box.center, size=box.size, rotation_wxyz=box.rotation_wxyz),
            confidence=round(thing.label_share * min(1.0, thing.views / 5.0), 3),
            first_seen_ns=thing.first_seen_ns,
            last_seen_ns=thing.last_seen_ns,
            attributes={
                "moving": True,
                "views": thing.views,
                "velocity": thing.motion.velocity[:3].round(3).tolist(),
                "speed": round(float(np.linalg.norm(thing.motion.velocity[:3])), 3),
            },
        )
        changes.put(node)
        if known is None or np.linalg.norm(node.position - known.position) > MOVED_M:
            moved[node_id] = node
    return changes, moved
