"""Relations of oriented boxes: from what was only boxed (imported, detected, drawn), not mapped voxel by voxel.

The definitions are those of the project's relations document, taken for boxes. What is measured means what
`rules/spatial.pl` says: its thresholds, with a user's overrides, are asked of the knowledge base, and its comparisons
are done here on whole columns, with the same values, thresholds and confidences.

A box is solid: what is under a table is under it only if it lies below the box of its top. Only what the taxonomy calls
a container has an inside. Structure (walls, floors, ceilings, stairs) stands between things and carries them; where the
way between two things is not clear of its inner half, they are not known to be near.

    things.py     what may be related, as columns         thresholds.py  what the rules compare with
    measuring.py  boxes → measurements                    deciding.py    measurements → relations
    following.py  a change of a graph → the relations that then hold, at a cost that is the change's
"""

from __future__ import annotations

from collections.abc import Iterable

from reasoning.knowledge import KnowledgeBase
from scenegraph.graph import EdgeTable, Node, NodeTable
from scenegraph.relating.deciding import RELATIONS, Relations, decide
from scenegraph.relating.following import follow
from scenegraph.relating.measuring import Measured, measure
from scenegraph.relating.things import Things
from scenegraph.relating.thresholds import Thresholds

__all__ = ["RELATIONS", "Measured", "Relations", "Things", "Thresholds", "decide", "follow", "measure", "relate"]


def relate(nodes: NodeTable | Iterable[Node], knowledge: KnowledgeBase | Thresholds) -> EdgeTable:
    """All relations between the boxes of the nodes, in both directions, as the rules derive them.

    Objects are related to objects, to the structure that they stand on and to the room that they are in; an object
    without a box is a point. An edge was seen when the later of its ends was last seen.

        edges = relate(nodes, knowledge)
        graph = SceneGraph.from_tables(nodes, edges)
    """
    table = nodes if isinstance(nodes, NodeTable) else NodeTable.of(nodes)
    thresholds = knowledge if isinstance(knowledge, Thresholds) else Thresholds.of(knowledge)
    return decide(measure(Things.of(table, thresholds), thresholds), thresholds).table(table)
