"""How good the world is: simulated homes mapped through the main path, and figures against their truth.

- `planes.accuracy`: over true planes ≥ 0.5 m² and ≥ 30 % seen, right when a third of what was seen is covered, mostly
  by planes of its label; and over extracted planes that are no structure, right when they are `no_feature`.
- `objects.*`: over things with ≥ 200 pixels in ≥ 3 images; found when a node of its class lies within 0.25 m of its
  centre, one to one. Nodes of things seen less count neither way.
- `rooms.*`: found when a room node overlaps it by half (intersection over union), one to one.
- `relations.R.*`: over pairs of which both ends are matched; `recall_all` over all pairs of counted things.
- `semantics.*`: over labelled voxels within a voxel of a surface, right when of the class of the nearest true surface.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mapping.observations import RgbdImage
from scenegraph.config import WorldConfig
from scenegraph.graph import Node
from scenegraph.simulation import Home, TruthRecorder, simulate_home
from scenegraph.world import World

__all__ = ["CENTRE_M", "Evaluation", "Tally", "evaluate", "judge", "map_home"]

Array: TypeAlias = NDArray[Any]
CENTRE_M = 0.25
ROOM_OVERLAP = 0.5
PLANE_COVER = 1.0 / 3.0
JUDGED = ("on", "in", "above", "near")


@dataclass
class Tally:
    """Counts that make precision and recall."""

    right: int = 0
    said: int = 0
    true: int = 0

    def add(self, right: int, said: int, true: int) -> None:
        self.right, self.said, self.true = self.right + right, self.said + said, self.true + true

    @property
    def precision(self) -> float:
        return self.right / self.said if self.said else 1.0

    @property
    def recall(self) -> float:
        return self.right / self.true if self.true else 1.0


@dataclass
class Evaluation:
    """Counts over all homes, and the notes on what went wrong."""

    seeds: list[int] = field(default_factory=list)
    tallies: defaultdict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    voxels: Counter[tuple[int, int]] = field(default_factory=Counter)
    image_ms: list[float] = field(default_factory=list)
    uncounted: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def figures(self) -> dict[str, float]:
        """Every figure by name."""
        found: dict[str, float] = {}
        for name, tally in sorted(self.tallies.items()):
            if name.endswith(("accuracy", "recall_all")):
                found[name] = tally.recall
            else:
                found[f"{name}.precision"], found[f"{name}.recall"] = tally.precision, tally.recall
        if self.voxels:
            found["semantics.voxel_accuracy"], found["semantics.miou"] = _voxel_figures(self.voxels)
        if self.image_ms:
            found["image_ms.median"] = float(np.median(self.image_ms))
            found["image_ms.p99"] = float(np.percentile(self.image_ms, 99))
        return {name: round(value, 4) for name, value in found.items()}

    def as_json(self) -> dict[str, Any]:
        return {"seeds": len(self.seeds), "figures": self.figures(), "uncounted": self.uncounted, "notes": self.notes}


def evaluate(
    seeds: int,
    first_seed: int = 0,
    *,
    noise: Literal["none", "realistic"] = "realistic",
    config: WorldConfig | None = None,
    advance: Callable[[], object] | None = None,
) -> Evaluation:
    """Map `seeds` simulated homes, beginning with `first_seed`, and judge each against its truth.

    advance : called after each home
    """
    result = Evaluation()
    for seed in range(first_seed, first_seed + seeds):
        home = simulate_home(seed)
        with World(config) as world:
            recorder, times = map_home(world, home, noise, seed)
            judge(world, home, recorder, result)
        result.seeds.append(seed)
        result.image_ms += times
        if advance is not None:
            advance()
    return result


def map_home(
    world: World, home: Home, noise: Literal["none", "realistic"], seed: int
) -> tuple[TruthRecorder, list[float]]:
    """Take a tour of a home; returns what was truly seen, and the time of each image after the first ten [ms]."""
    recorder = TruthRecorder(home)
    times: list[float] = []
    for observation in home.observe(noise=noise, seed=seed, recorder=recorder):
        started = time.perf_counter()
        world.integrate(observation)
        if isinstance(observation, RgbdImage):
            times.append((time.perf_counter() - started) * 1e3)
    return recorder, times[10:]


def judge(world: World, home: Home, recorder: TruthRecorder, result: Evaluation) -> None:
    """Add one home's counts to `result`."""
    countable = recorder.countable
    result.uncounted += [f"{home.seed}: {o.id}" for o in home.objects if o.id not in countable]
    things = _judge_objects(world, home, countable, result)
    rooms = _judge_rooms(world, home, result)
    _judge_relations(world, home, things | rooms, countable, result)
    _judge_planes(world, home, recorder, result)
    _judge_voxels(world, home, result)


# -- objects ---------------------------------------------------------------------------------------------------


def _judge_objects(world: World, home: Home, countable: frozenset[str], result: Evaluation) -> dict[str, str]:
    """Match object nodes to things of their class, counted ones first; returns node id → true id."""
    nodes = world.graph.nodes("object")
    counted = [o for o in home.objects if o.id in countable]
    others = [o for o in home.objects if o.id not in countable]
    matched = _assign(nodes, counted)
    aside = _assign([n for n in nodes if n.id not in matched], others)
    result.tallies["objects"].add(len(matched), len(nodes) - len(aside), len(counted))
    found = set(matched.values())
    result.notes += [f"{home.seed}: missed {o.id}" for o in counted if o.id not in found]
    result.notes += [f"{home.seed}: {n.id} is no {n.label}" for n in nodes if n.id not in matched and n.id not in aside]
    return matched


def _assign(nodes: list[Node], things: list[Any]) -> dict[str, str]:
    """One-to-one pairs of a node and a thing of one class within CENTRE_M: as many as can be, then the nearest."""
    if not nodes or not things:
        return {}
    a = np.array([n.position for n in nodes])
    b = np.array([t.center for t in things])
    distance = np.linalg.norm(a[:, None] - b[None], axis=2)
    same = np.array([[n.label == t.label for t in things] for n in nodes])
    allowed = same & (distance <= CENTRE_M)
    rows, columns = linear_sum_assignment(np.where(allowed, distance, 1e3))
    return {nodes[r].id: things[c].id for r, c in zip(rows, columns, strict=True) if allowed[r, c]}


# -- rooms -----------------------------------------------------------------------------------------------------


def _judge_rooms(world: World, home: Home, result: Evaluation) -> dict[str, str]:
    nodes = world.graph.nodes("room")
    outlines = [shapely.Polygon(n.attributes["footprint"]) for n in nodes]
    truths = [shapely.Polygon(r.footprint) for r in home.rooms]
    overlap = np.array([[o.intersection(t).area / o.union(t).area for t in truths] for o in outlines]).reshape(
        len(nodes), len(truths)
    )
    rows, columns = linear_sum_assignment(-overlap)
    matched = {
        nodes[r].id: home.rooms[c].id for r, c in zip(rows, columns, strict=True) if overlap[r, c] >= ROOM_OVERLAP
    }
    result.tallies["rooms"].add(len(matched), len(nodes), len(home.rooms))
    kinds = {r.id: r.kind for r in home.rooms}
    typed = sum(world.graph.node(n).attributes.get("type") == kinds[t] for n, t in matched.items())
    result.tallies["rooms.type_accuracy"].add(typed, len(matched), len(matched))
    result.notes += [f"{home.seed}: missed room {r.id}" for r in home.rooms if r.id not in matched.values()]
    result.notes += [f"{home.seed}: {n.id} is no room" for n in nodes if n.id not in matched]
    return matched


# -- relations -------------------------------------------------------------------------------------------------


def _judge_relations(
    world: World, home: Home, matched: dict[str, str], countable: frozenset[str], result: Evaluation
) -> None:
    known = set(matched.values())
    all_counted = countable | {r.id for r in home.rooms}
    for relation in JUDGED:
        true = {(a, b) for name, a, b in home.relations() if name == relation}
        said = set()
        for edge in world.graph.edges(relation):
            if edge.source in matched and edge.target in matched:
                pair = (matched[edge.source], matched[edge.target])
                said.add(pair if relation != "near" else (min(pair), max(pair)))
        judgeable = {pair for pair in true if known.issuperset(pair)}
        result.tallies[f"relations.{relation}"].add(len(said & judgeable), len(said), len(judgeable))
        everything = {pair for pair in true if all_counted.issuperset(pair)}
        result.tallies[f"relations.{relation}.recall_all"].add(len(said & everything), 0, len(everything))
        result.notes += [f"{home.seed}: missed {relation}{pair}" for pair in sorted(judgeable - said)]
        result.notes += [f"{home.seed}: wrong {relation}{pair}" for pair in sorted(said - judgeable)]


# -- planes ----------------------------------------------------------------------------------------------------


def _judge_planes(world: World, home: Home, recorder: TruthRecorder, result: Evaluation) -> None:
    """Each sample of an extracted plane stands for its share of the plane's area and lies on the nearest true
    surface."""
    covered: defaultdict[int, Counter[str]] = defaultdict(Counter)
    planes = world.map.planes
    names = {info.name: class_id for class_id, info in home.label_space.classes.items()}
    building = [names[name] for name in ("wall", "floor", "ceiling", "door", "window")]
    right = said = 0
    for node in world.graph.nodes("structure"):
        if not node.id.startswith("plane_"):
            continue
        plane = planes.plane(int(node.id.removeprefix("plane_")))
        points = planes.samples(plane.id, 400).astype(np.float64)
        triangles = home.renderer.scene.closest(points)[0]
        truth, classes = home.triangle_plane[triangles], home.triangle_class[triangles]
        facing = np.array([t >= 0 and home.structure[t].normal @ plane.normal > 0.8 for t in truth])
        share = plane.area_m2 / len(points)
        for k, n in zip(*np.unique(truth[facing], return_counts=True), strict=True):
            covered[int(k)][node.label] += n * share
        if facing.mean() < 0.5 and np.isin(classes, building).mean() < 0.5:
            said += 1
            right += node.label == "no_feature"
            if node.label != "no_feature":
                result.notes.append(f"{home.seed}: {node.id} is no {node.label}")
    seen = recorder.plane_seen
    for k, true in enumerate(home.structure):
        if true.id not in recorder.countable_planes:
            continue
        said += 1
        label, area = covered[k].most_common(1)[0] if covered[k] else ("missed", 0.0)
        enough = sum(covered[k].values()) >= PLANE_COVER * true.area * seen[true.id]
        good = enough and label == true.kind
        right += good
        if not good:
            result.notes.append(f"{home.seed}: plane {true.id} is {label if enough else 'missed'}, {area:.1f} m²")
    result.tallies["planes.accuracy"].add(right, said, said)


# -- voxels ----------------------------------------------------------------------------------------------------


def _judge_voxels(world: World, home: Home, result: Evaluation) -> None:
    centres, labels, _ = world.map.semantics.voxels()
    names = {info.name: class_id for class_id, info in home.label_space.classes.items()}
    said = np.array([names.get(c.name, 0) for c in world.labels.classes])[labels.astype(np.int64) - 1]
    triangles, surface = home.renderer.scene.closest(centres)
    near = np.linalg.norm(centres - surface, axis=1) <= world.map.semantics.voxel_size_m
    pairs, counts = np.unique(
        np.stack([home.triangle_class[triangles][near], said[near]], axis=1), axis=0, return_counts=True
    )
    result.voxels.update({(int(t), int(s)): int(n) for (t, s), n in zip(pairs, counts, strict=True)})


def _voxel_figures(voxels: Counter[tuple[int, int]]) -> tuple[float, float]:
    """Accuracy, and the mean over classes of intersection over union."""
    right = Counter({t: n for (t, s), n in voxels.items() if t == s})
    true, said = Counter[int](), Counter[int]()
    for (t, s), n in voxels.items():
        true[t] += n
        said[s] += n
    unions = {c: true[c] + said[c] - right[c] for c in true}
    return sum(right.values()) / sum(true.values()), float(np.mean([right[c] / unions[c] for c in unions]))
