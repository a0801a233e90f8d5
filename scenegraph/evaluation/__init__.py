"""How good the world is: simulated homes mapped through the main path, and figures against their truth.

- `planes.accuracy`: over true planes ≥ 0.5 m² and ≥ 30 % seen, right when a third of what was seen is covered, mostly
  by planes of its label; and over extracted planes that are no structure, right when they are `no_feature`.
- `objects.*`: over things with ≥ 200 pixels in ≥ 3 images; found when a node of its class lies within 0.25 m of its
  centre, one to one. Nodes of things seen less count neither way. `objects.any_class.*`: by place and overlap alone;
  `objects.unconfused.*`: without the things that the segmenter always takes for one other class; `objects.duplicates`:
  share of nodes that are another node of a thing that has its own.
- `lasting.*`, `second_tour.*`: after the home was changed and mapped again; see `second_tour`.
- `rooms.*`: found when a room node overlaps it by half (intersection over union), one to one.
- `doors.*`: doors, doorways and openings between two rooms; found when a node within 0.5 m of its middle, seen from
  above, connects the right rooms, one to one.
- `relations.R.*`: over pairs of which both ends are matched; `recall_all` over all pairs of counted things.
- `semantics.*`: over voxels within a voxel of a surface, whose truth is that of the nearest one; see `semantics`.
"""

from scenegraph.evaluation.graph import CENTRE_M
from scenegraph.evaluation.homes import evaluate, judge, map_home
from scenegraph.evaluation.panoptic import PanopticTally
from scenegraph.evaluation.result import Evaluation, Tally
from scenegraph.evaluation.semantics import SemanticTally
from scenegraph.evaluation.views import ViewLog

__all__ = [
    "CENTRE_M",
    "Evaluation",
    "PanopticTally",
    "SemanticTally",
    "Tally",
    "ViewLog",
    "evaluate",
    "judge",
    "map_home",
]
