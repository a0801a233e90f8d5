"""A home is mapped, left to others, and mapped again: do things keep their ids, and do those that have gone go?

- `second_tour.objects.*`: precision and recall, over what counts on either tour and is there at the end.
- `lasting.ghosts`: share of object nodes that stand where a thing was that was removed or moved away, although its
  place was looked at again; `lasting.removed_noticed`: of the things that have gone from such places, those without a
  node there.
- `lasting.moved_keep_id`, `lasting.stayed_keep_id`: of the things that had a node after the first tour and count on the
  second, those that have it still, where they are now; `lasting.added_new_id`: of the things that were brought in and
  found, those that did not get the id of another.
- `objects.duplicates`, `second_tour.objects.duplicates`: share of object nodes that are another node of a thing that
  has its own.
"""

from __future__ import annotations

import numpy as np

from mapping.geometry import CameraIntrinsics
from scenegraph.evaluation.graph import CENTRE_M, judge_objects
from scenegraph.evaluation.result import Evaluation
from scenegraph.graph import Node
from scenegraph.simulation import CAMERA, Home, Rendered, TrueObject, TruthRecorder, change_home
from scenegraph.simulation.noise import Noise
from scenegraph.simulation.shapes import Array
from scenegraph.world import World

__all__ = ["SecondLook", "take_second_tour"]

LOOKED_IMAGES = 3
LOOKED_SHARE = 0.5
"""The place of a thing is looked at again when this share of its surface is seen through in so many images …"""
LOOKED_RANGE_M = 5.0
"""… from no farther than this."""
THROUGH_M = 0.01
SAMPLES = 60
PAUSE_S = 3600.0


class SecondLook(TruthRecorder):
    """What was truly seen of a changed home, and which places of things that have gone were looked at again."""

    def __init__(self, home: Home) -> None:
        super().__init__(home)
        assert home.change is not None, "a home that has changed"
        before = home.change.before
        self._gone = sorted(home.change.removed | home.change.moved)
        rng = np.random.default_rng(0)
        self._points = np.stack([_on_surface(before.thing(i), rng) for i in self._gone])
        self._images = np.zeros(len(self._gone), np.int64)

    def record(self, rendered: Rendered) -> None:
        super().record(rendered)
        through = _seen_through(self._points.reshape(-1, 3), rendered, CAMERA).reshape(len(self._gone), -1)
        self._images += through.mean(axis=1) >= LOOKED_SHARE

    @property
    def looked_at(self) -> frozenset[str]:
        """Ids of the things that have gone from places that were looked at again."""
        return frozenset(i for i, n in zip(self._gone, self._images.tolist(), strict=True) if n >= LOOKED_IMAGES)


def _on_surface(thing: TrueObject, rng: np.random.Generator) -> Array:
    """SAMPLES points (n, 3) spread evenly over the surface of a thing."""
    a, b, c = np.moveaxis(thing.vertices[thing.triangles], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    which = rng.choice(len(area), SAMPLES, p=area / area.sum())
    u, v = rng.random((2, SAMPLES, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    return np.asarray(a[which] + u * (b[which] - a[which]) + v * (c[which] - a[which]))


def _seen_through(points: Array, rendered: Rendered, camera: CameraIntrinsics) -> Array:
    """Whether an image sees farther than each point (n, 3) of the map."""
    x, y, z = (rendered.T_map_camera.inverse() @ points).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    inside = (z > 0.1) & (z < LOOKED_RANGE_M) & (u > 0) & (v > 0) & (u < camera.width - 1) & (v < camera.height - 1)
    depth = np.zeros(len(points))
    depth[inside] = rendered.depth[np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)]
    return np.asarray(inside & (depth > z + THROUGH_M))


def take_second_tour(
    world: World,
    home: Home,
    first: TruthRecorder,
    before: dict[str, str],
    noise: Noise,
    seed: int,
    result: Evaluation,
) -> None:
    """Map the home once more as it is after a change, and count what became of the nodes.

    first    what was seen on the first tour;  before  node id → true id after it
    """
    changed = change_home(home, seed)
    assert changed.change is not None
    look = SecondLook(changed)
    start_ns = world.graph.stamp_ns + round(PAUSE_S * 1e9)
    for observation in changed.observe(noise=noise, seed=seed, recorder=look, start_ns=start_ns):
        world.integrate(observation)
    judge_second_tour(world, changed, first, look, before, result)


def judge_second_tour(
    world: World, changed: Home, first: TruthRecorder, look: SecondLook, before: dict[str, str], result: Evaluation
) -> dict[str, str]:
    """Add the counts of one home to `result`; returns node id → true id after the second tour."""
    change = changed.change
    assert change is not None
    there = {o.id for o in changed.objects}
    countable = (first.countable & there - change.moved) | look.countable
    after = judge_objects(world, changed, countable, result, "second_tour.objects", confused=look.confused)
    node_before = {true: node for node, true in before.items()}
    node_after = {true: node for node, true in after.items()}

    nodes = [n for n in world.graph.nodes("object") if n.id not in after]
    gone = [i for i in sorted(look.looked_at) if i in node_before]
    ghosts = {i: ghost for i in gone if (ghost := _ghost(change.before.thing(i), nodes)) is not None}
    result.count("lasting.ghosts", len(set(ghosts.values())), len(world.graph.nodes("object")))
    result.count("lasting.removed_noticed", len(gone) - len(ghosts), len(gone))
    seed = changed.seed
    for thing, node in ghosts.items():
        result.notes.append(f"{seed}: {node} stands where {thing} was")
    for name, things in (
        ("lasting.moved_keep_id", change.moved & look.countable),
        ("lasting.stayed_keep_id", look.countable - change.moved - change.added),
    ):
        known = [i for i in sorted(things) if i in node_before]
        lost = [i for i in known if node_after.get(i) != node_before[i]]
        result.count(name, len(known) - len(lost), len(known))
        result.notes += [
            f"{seed}: {i} ({name.split('.')[1].split('_')[0]}) was {node_before[i]} and is {node_after.get(i)}"
            for i in lost
        ]
    added = [i for i in sorted(change.added & look.countable) if i in node_after]
    taken = [i for i in added if node_after[i] in before]
    result.count("lasting.added_new_id", len(added) - len(taken), len(added))
    result.notes += [f"{seed}: {i} (added) is {node_after[i]}, which was {before[node_after[i]]}" for i in taken]
    return after


def _ghost(thing: TrueObject, nodes: list[Node]) -> str | None:
    """The node of the thing's class where it was, if any."""
    near = [n for n in nodes if n.label == thing.label and np.linalg.norm(n.position - thing.center) <= CENTRE_M]
    return min(near, key=lambda n: float(np.linalg.norm(n.position - thing.center))).id if near else None
