"""A building of boxes in a world, measured and told to the rules as mapping would tell it."""

from __future__ import annotations

import dataclasses

import numpy as np

from scenegraph.graph import NodeTable, SceneGraph
from scenegraph.perception.relations import NO_PATH_M, MeasurementChange
from scenegraph.relating import Measured, Things, Thresholds, measure
from scenegraph.world import World
from tests.support.many_boxes import building


def furnished_world(n_rooms: int) -> World:
    """A world of `n_rooms` rooms of a hundred objects each, one of them an oven, whose rules know all measurements."""
    nodes, hierarchy = building(n_rooms)
    nodes = with_an_oven(nodes)
    world = World()
    thresholds = Thresholds.of(world.meaning.knowledge)
    world.graph = SceneGraph.from_tables(nodes, hierarchy)
    world.meaning.remember(world.graph, (), measurements(measure(Things.of(nodes, thresholds), thresholds)), ())
    return world


def with_an_oven(nodes: NodeTable) -> NodeTable:
    """The same nodes, of which the first cabinet is an oven."""
    labels = [*nodes.labels, "oven"]
    label = nodes.label.copy()
    label[np.flatnonzero(label == labels.index("cabinet"))[0]] = len(labels) - 1
    return dataclasses.replace(nodes, labels=tuple(labels), label=label)


def measurements(measured: Measured) -> MeasurementChange:
    """What was measured, named as the rules are told it."""
    ids = measured.things.ids
    put: dict[tuple[str, ...], float] = {}
    for row, (lowest, side) in enumerate(zip(measured.lowest.tolist(), measured.longer_side.tolist(), strict=True)):
        put["lowest", ids[row]] = lowest
        put["longer_side", ids[row]] = side
        put["footing_seen", ids[row]] = 1.0
    columns = (measured.pairs, measured.gap, measured.clear, measured.footprint_overlap, measured.rise,
               measured.structure_between, measured.same_storey)  # fmt: skip
    for (a, b), gap, clear, overlap, rise, between, same in zip(*(c.tolist() for c in columns), strict=True):
        one, two = sorted((ids[a], ids[b]))
        if np.isfinite(gap):
            put["gap", one, two] = gap
            for name in ("path_gap_upper", "path_gap_lower"):
                put[name, one, two] = gap if clear else NO_PATH_M
        if overlap > 0.0:
            put["footprint_overlap", one, two] = overlap
            for (upper, lower), above in zip(((a, b), (b, a)), rise, strict=True):
                if above > 0.0:
                    put["rise", ids[upper], ids[lower]] = above
                    put["structure_between", ids[upper], ids[lower]] = float(between)
                    if not same:
                        put["same_storey", ids[upper], ids[lower]] = 0.0
    for name, pairs, values in (
        ("contact", measured.standing, measured.contact),
        ("footing_inside", measured.inside, measured.footing_inside),
        ("voxels_inside", measured.inside, measured.voxels_inside),
        ("footprint_share", measured.rooms, measured.footprint_share),
    ):
        for (a, b), value in zip(pairs.tolist(), values.tolist(), strict=True):
            put[name, ids[a], ids[b]] = value
    return MeasurementChange(put=put)
