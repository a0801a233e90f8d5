"""The semantic floor: which class, and which thing, the map's voxels say they belong to.

Judged are labelled voxels whose centre lies within a voxel of a true surface that was seen; their truth is the class
and thing of the nearest point that exact rays met: the wall behind a mirror is nearer to some voxels of the mirror, but
nobody saw it. `semantics.off_surface` is the share of labelled voxels that are further away from all that was seen.

- `voxel_accuracy`, `miou`: of these voxels, without those of things that the segmenter *always* mistakes for the same
  other class, which no fusion can mend. Mean IoU is over the classes that are there.
- `all_surfaces.voxel_accuracy`, `all_surfaces.miou`: the same against the nearest surface, be it hidden or not.
- `confused.voxel_accuracy`, `confused.voxel_share`: of the voxels of those things, and their share of all voxels.
- `single_view.*`: on the same voxels, what one image said of each, drawn among those that labelled it (see `views`);
  `views_per_voxel.median`: how many there are.
- `labelled`: the share of surface voxels labelled in at least three images that the map labels. Accuracy can be bought
  by saying less: this tells.
- `pq`, `sq`, `rq`, `pq_things`, `pq_stuff`: panoptic quality (see `panoptic`) of the same voxels together with those
  that the map left unlabelled though labelled in at least three images: they belong to no said segment. Things are the
  classes that the label space calls so (a mirror is one). Walls, floors, ceilings, doors and windows are stuff: all of
  a class is one segment of a home. Things with less than 200 pixels in three images, and those always mistaken, are
  void: not missed, and what the map makes of them is not invented. Other things without a voxel are missed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ijk_to_centre, point_to_ijk
from scenegraph.evaluation.panoptic import PanopticTally
from scenegraph.evaluation.views import ViewLog, pack
from scenegraph.simulation import Home, TruthRecorder
from scenegraph.world import World

__all__ = ["Confusion", "SemanticTally", "judge_voxels"]

Array: TypeAlias = NDArray[Any]

SEEN_VIEWS = 3
"""A voxel labelled in so many images should be labelled in the map."""
VIEW_BANDS = ((1, 1), (2, 3), (4, 7), (8, None))


class Confusion(Counter[tuple[int, int]]):
    """How many voxels of a true class were said to be of which."""

    def count(self, true: Array, said: Array) -> None:
        """Add voxels of true and said class ids (N,)."""
        n_classes = int(said.max(initial=0)) + 1
        counts = np.bincount(true.astype(np.int64) * n_classes + said)
        self.update({divmod(pair, n_classes): int(counts[pair]) for pair in np.flatnonzero(counts).tolist()})

    @property
    def accuracy(self) -> float:
        """Share of the voxels that are of the class said; NaN without any."""
        return sum(n for (t, s), n in self.items() if t == s) / self.total() if self else float("nan")

    @property
    def miou(self) -> float:
        """Intersection over union, mean of the classes that are there; NaN without any."""
        true, said = Counter[int](), Counter[int]()
        for (t, s), n in self.items():
            true[t] += n
            said[s] += n
        return float(np.mean([self[c, c] / (true[c] + said[c] - self[c, c]) for c in true])) if self else float("nan")


@dataclass
class SemanticTally:
    """Counts of voxels and segments over all homes.

    said, single_view   voxels by true and said class: of the map, and of one image each
    all_surfaces        by the class of the nearest surface, seen or not
    confused            those of things that are always mistaken
    by_views            for each number of views: how many voxels, right in the map, right in one image
    """

    said: Confusion = field(default_factory=Confusion)
    single_view: Confusion = field(default_factory=Confusion)
    all_surfaces: Confusion = field(default_factory=Confusion)
    confused: Confusion = field(default_factory=Confusion)
    by_views: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    panoptic: PanopticTally = field(default_factory=PanopticTally)
    things: set[int] = field(default_factory=set)
    stuff: set[int] = field(default_factory=set)
    off_surface: int = 0
    seen: int = 0
    seen_and_labelled: int = 0

    def merge(self, other: SemanticTally) -> None:
        """Add the counts of other homes."""
        for mine, theirs in (
            (self.said, other.said),
            (self.single_view, other.single_view),
            (self.all_surfaces, other.all_surfaces),
            (self.confused, other.confused),
        ):
            mine.update(theirs)
        for views, (n, right, right_once) in other.by_views.items():
            self._add_views(views, n, right, right_once)
        self.panoptic.merge(other.panoptic)
        self.things |= other.things
        self.stuff |= other.stuff
        self.off_surface += other.off_surface
        self.seen += other.seen
        self.seen_and_labelled += other.seen_and_labelled

    def figures(self) -> dict[str, float]:
        """Every figure by name, those that there is nothing to tell of left out."""
        if not self.said:
            return {}
        everywhere, things, stuff = (self.panoptic.quality(c) for c in (None, self.things, self.stuff))
        labelled = self.said.total() + self.confused.total()
        found = {
            "voxel_accuracy": self.said.accuracy,
            "single_view.voxel_accuracy": self.single_view.accuracy,
            "miou": self.said.miou,
            "single_view.miou": self.single_view.miou,
            "all_surfaces.voxel_accuracy": self.all_surfaces.accuracy,
            "all_surfaces.miou": self.all_surfaces.miou,
            "confused.voxel_accuracy": self.confused.accuracy,
            "confused.voxel_share": self.confused.total() / labelled,
            "pq": everywhere.pq,
            "sq": everywhere.sq,
            "rq": everywhere.rq,
            "pq_things": things.pq,
            "pq_stuff": stuff.pq,
            "views_per_voxel.median": self._median_views(),
            "labelled": self.seen_and_labelled / self.seen if self.seen else float("nan"),
            "off_surface": self.off_surface / (self.off_surface + labelled),
        }
        return {f"semantics.{name}": value for name, value in found.items() if np.isfinite(value)}

    def accuracy_by_views(self) -> list[dict[str, Any]]:
        """For 1, 2–3, 4–7 and 8 or more views: the share of voxels, and the accuracy of the map and of one image."""
        total = sum(n for n, _, _ in self.by_views.values())
        rows = []
        for low, high in VIEW_BANDS:
            found = [count for views, count in self.by_views.items() if low <= views <= (high or views)]
            if found:
                n, right, right_once = np.sum(found, axis=0).tolist()
                name = f"{low}+" if high is None else f"{low}" if low == high else f"{low}-{high}"
                rows.append(
                    {
                        "views": name,
                        "voxel_share": round(n / total, 4),
                        "voxel_accuracy": round(right / n, 4),
                        "single_view.voxel_accuracy": round(right_once / n, 4),
                    }
                )
        return rows

    def count_views(self, views: Array, true: Array, said: Array, said_once: Array) -> None:
        """Add voxels seen in so many `views` (N,), by their true and said class ids (N,)."""
        voxels = np.bincount(views)
        right, right_once = (np.bincount(views[true == s], minlength=len(voxels)) for s in (said, said_once))
        for n in np.flatnonzero(voxels).tolist():
            self._add_views(n, int(voxels[n]), int(right[n]), int(right_once[n]))

    def _add_views(self, views: int, voxels: int, right: int, right_once: int) -> None:
        before = self.by_views.get(views, (0, 0, 0))
        self.by_views[views] = (before[0] + voxels, before[1] + right, before[2] + right_once)

    def _median_views(self) -> float:
        if not self.by_views:
            return float("nan")
        views = sorted(self.by_views)
        upto = np.cumsum([self.by_views[n][0] for n in views])
        return float(views[int(np.searchsorted(upto, 0.5 * upto[-1]))])


def judge_voxels(
    world: World, home: Home, recorder: TruthRecorder, tally: SemanticTally, views: ViewLog | None = None
) -> list[str]:
    """Add one home's voxels to `tally`; without `views` nothing is told of single images and of unlabelled voxels.

    Returns a note for each segment without a match.
    """
    size = world.map.semantics.voxel_size_m
    ijk, said = _voxels(world, home, views)
    centres = ijk_to_centre(ijk, size)
    confused = np.zeros(len(home.entities) + 1, bool)
    confused[1:] = [name in recorder.confused for name in home.entities]
    triangles, surface = home.renderer.scene.closest(centres)
    main = (np.linalg.norm(centres - surface, axis=1) <= size) & (said > 0) & ~confused[home.triangle_entity[triangles]]
    tally.all_surfaces.count(home.triangle_class[triangles[main]].astype(np.int64), said[main])

    triangles, distance = recorder.surface.closest(centres, 2.0 * size)
    near = distance <= size
    tally.off_surface += int((~near & (said > 0)).sum())
    ijk, centres, said, triangles = ijk[near], centres[near], said[near], triangles[near]
    true, entity = home.triangle_class[triangles].astype(np.int64), home.triangle_entity[triangles]
    plain, labelled = ~confused[entity], said > 0
    main = plain & labelled
    tally.said.count(true[main], said[main])
    tally.confused.count(true[labelled & ~plain], said[labelled & ~plain])
    if views is not None:
        n_views, once = views.query(ijk)
        seen = main & (n_views > 0)
        tally.single_view.count(true[seen], once[seen])
        tally.count_views(n_views[seen], true[seen], said[seen], once[seen])
        enough = n_views >= SEEN_VIEWS
        tally.seen += int(enough.sum())
        tally.seen_and_labelled += int((enough & labelled).sum())

    countable = recorder.countable - recorder.confused
    void = np.zeros(len(home.entities) + 1, bool)
    void[1 : len(home.objects) + 1] = [o.id not in countable for o in home.objects]
    there = np.bincount(entity, minlength=len(void))
    unseen = [(home.class_ids[o.label], o.id) for k, o in enumerate(home.objects, 1) if not void[k] and not there[k]]
    kinds = {class_id: info.kind for class_id, info in home.label_space.classes.items()}
    tally.things |= {c for c, kind in kinds.items() if kind == "thing"}
    tally.stuff |= {c for c, kind in kinds.items() if kind != "thing"}
    instances = world.map.instances.query(centres)
    unmatched = tally.panoptic.add(
        true, entity, said, instances, things=tally.things, void=void[entity], unseen=[c for c, _ in unseen]
    )
    names = {class_id: info.name for class_id, info in home.label_space.classes.items()}
    missed = [home.entities[k - 1] if k else names[c] for c, k in unmatched.missed] + [name for _, name in unseen]
    return [f"{home.seed}: no segment is {name}" for name in missed] + [
        f"{home.seed}: segment {names[c]}{f' {k}' if k else ''} of {n} voxels is none" for c, k, n in unmatched.invented
    ]


def _voxels(world: World, home: Home, views: ViewLog | None) -> tuple[Array, Array]:
    """Voxels (N, 3) and the class (N,), in the home's ids, that the map says each is of; 0 for those that it does not
    label though images did."""
    centres, labels, _ = world.map.semantics.voxels()
    ijk = point_to_ijk(centres, world.map.semantics.voxel_size_m).astype(np.int64)
    of_home = np.array([0, *(home.class_ids.get(c.name, 0) for c in world.labels.classes)])
    said = of_home[labels.astype(np.int64)]
    if views is None:
        return ijk, said
    seen, labelled = views.voxels(SEEN_VIEWS), np.append(np.sort(pack(ijk)), -1)
    unlabelled = seen[labelled[np.searchsorted(labelled[:-1], pack(seen))] != pack(seen)]
    return np.concatenate([ijk, unlabelled]), np.concatenate([said, np.zeros(len(unlabelled), said.dtype)])
