"""A user's table of classes as costs in space and on a grid: unknown is never free, and what changed is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mapping.cost import CostGrid, CostMap, CostTable, cost_cloud, semantic_cost
from mapping.errors import InvalidParameter
from mapping.observations import LabelSpace
from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from mapping.semantics import SemanticMap

VOXEL = 0.1
CLASSES = LabelSpace(
    classes={
        1: {"name": "floor"},
        2: {"name": "carpet"},
        3: {"name": "person"},
        4: {"name": "wall"},
        5: {"name": "wall"},
    }
)
TABLE = CostTable({"floor": 0.0, "carpet": 0.3, "person": np.inf, 4: 1.0}, default=0.6, free=0.05, classes=CLASSES)
seeds = st.integers(0, 10_000)


def world(seed: int, n: int = 400, size: int = 12) -> tuple[SemanticMap, OccupancyMap]:
    """Voxels with random classes and random occupancy, independent of each other, about the origin."""
    rng = np.random.default_rng(seed)
    semantics, occupancy = SemanticMap(voxel_size_m=VOXEL), OccupancyMap(VOXEL, 5.0)
    see(semantics, occupancy, rng, n, size)
    return semantics, occupancy


def see(semantics: SemanticMap, occupancy: OccupancyMap, rng: np.random.Generator, n: int, size: int) -> None:
    labelled, seen = (rng.integers(-size, size, (n, 3)) for _ in range(2))
    semantics.integrate((labelled + 0.5) * VOXEL, rng.integers(1, 6, n))
    occupancy.assign((seen + 0.5) * VOXEL, np.where(rng.random(n) < 0.5, 30, -30))


def naive_cost(point: np.ndarray, semantics: SemanticMap, occupancy: OccupancyMap | None) -> tuple[float, bool]:
    """Cost at a point, and whether a surface is there."""
    label = int(semantics.query(point[None])[0][0])
    state = None if occupancy is None else int(occupancy.classify(point[None])[0])
    if state == FREE:
        return TABLE.free, False
    if label:
        return {1: 0.0, 2: 0.3, 3: np.inf, 4: 1.0}.get(label, TABLE.default), True
    return (TABLE.default, True) if state == OCCUPIED else (np.nan, False)


@settings(max_examples=15)
@given(seed=seeds, with_occupancy=st.booleans())
def test_the_cost_in_space_matches_the_naive_twin(seed: int, with_occupancy: bool) -> None:
    semantics, occupancy = world(seed)
    known = occupancy if with_occupancy else None
    points = np.random.default_rng(seed).uniform(-1.3, 1.3, (200, 3))
    expected = [naive_cost(point, semantics, known)[0] for point in points]
    assert np.array_equal(semantic_cost(points, semantics, TABLE, known, reach_m=0.0), expected, equal_nan=True)


@settings(max_examples=10)
@given(
    seed=seeds, with_occupancy=st.booleans(), rule=st.sampled_from(["max", "mean"]), share=st.sampled_from([0.1, 0.6])
)
def test_the_cost_of_columns_matches_the_naive_twin(seed: int, with_occupancy: bool, rule: str, share: float) -> None:
    semantics, occupancy = world(seed, n=300, size=5)
    known = occupancy if with_occupancy else None
    cost = CostMap(semantics, TABLE, band_m=(-0.2, 0.31), rule=rule, occupancy=known, known_share=share, reach_m=0.0)
    cost.update()
    for i, j in np.random.default_rng(seed).integers(-6, 6, (25, 2)):
        here = [naive_cost((np.array([i, j, k]) + 0.5) * VOXEL, semantics, known) for k in range(-2, 3)]
        surfaces = [value for value, solid in here if solid]
        if surfaces:
            expected = max(surfaces) if rule == "max" else np.mean(surfaces)
        else:
            expected = TABLE.free if np.mean([not np.isnan(value) for value, _ in here]) >= share else np.nan
        assert cost.query([[(i + 0.5) * VOXEL, (j + 0.5) * VOXEL]])[0] == pytest.approx(expected, nan_ok=True)


@settings(max_examples=10)
@given(seed=seeds)
def test_following_the_map_is_computing_it_anew(seed: int) -> None:
    semantics, occupancy = world(seed, n=50)
    followed = CostMap(semantics, TABLE, band_m=(-0.5, 0.5), occupancy=occupancy)
    followed.update()
    rng = np.random.default_rng(seed)
    for _ in range(3):
        see(semantics, occupancy, rng, 30, 20)
        followed.update()
    anew = CostMap(semantics, TABLE, band_m=(-0.5, 0.5), occupancy=occupancy)
    anew.update()
    points = rng.uniform(-2.5, 2.5, (300, 2))
    assert np.array_equal(followed.query(points), anew.query(points), equal_nan=True)


def test_only_changed_tiles_within_the_band_are_computed_anew() -> None:
    semantics = SemanticMap(voxel_size_m=VOXEL)
    semantics.integrate([[0.05, 0.05, 0.05], [1.7, 0.05, 0.05]], [1, 1])
    cost = CostMap(semantics, TABLE, band_m=(0.0, 0.5))
    assert len(cost.update()) == 2
    assert len(cost.update()) == 0
    semantics.integrate([[0.05, 0.05, 5.0]], [3])
    assert len(cost.update()) == 0
    semantics.integrate([[1.7, 0.05, 0.35]], [3])
    assert cost.update().blocks.tolist() == [[2, 0, 0]]
    assert cost.query([[1.7, 0.05, 9.0]])[0] == np.inf


def test_layers_with_other_voxels_are_followed_too() -> None:
    semantics, occupancy = SemanticMap(voxel_size_m=0.16), OccupancyMap(0.1, 5.0)
    cost = CostMap(semantics, TABLE, band_m=(0.0, 0.5), occupancy=occupancy)
    cost.update()
    semantics.integrate([[1.5, -0.1, 0.2]], [4])
    cost.update()
    assert cost.query([[1.5, -0.1]])[0] == 1.0
    occupancy.assign([[1.55, -0.15, z] for z in (0.05, 0.15, 0.25, 0.35, 0.45)], -30)
    cost.update()
    assert cost.query([[1.55, -0.15]])[0] == TABLE.free


def test_a_cloud_of_costs_has_all_surfaces() -> None:
    semantics, occupancy = world(11)
    centres, cost = cost_cloud(semantics, TABLE, occupancy)
    assert np.array_equal(centres, occupancy.occupied_centres())
    assert np.array_equal(cost, semantic_cost(centres, semantics, TABLE, occupancy))
    assert {0.3, 1.0, np.inf} <= set(cost.tolist())


def test_unknown_is_not_free() -> None:
    semantics, occupancy = SemanticMap(voxel_size_m=VOXEL), OccupancyMap(VOXEL, 5.0)
    occupancy.assign([[0.05, 0.05, 0.05], [0.25, 0.05, 0.05], [0.25, 0.05, 0.15], [0.25, 0.05, 0.25]], -30)
    cost = CostMap(semantics, TABLE, band_m=(0.0, 0.5), occupancy=occupancy)
    cost.update()
    assert np.isnan(cost.query([[0.05, 0.05]])[0])  # one voxel of five
    assert cost.query([[0.25, 0.05]])[0] == TABLE.free  # three of five
    assert np.isnan(cost.query([[9.0, 9.0]])[0])
    assert np.isnan(semantic_cost([[0.05, 0.05, 0.15]], semantics, TABLE, occupancy))[0]


def test_free_space_seen_through_a_former_thing_is_free() -> None:
    semantics, occupancy = SemanticMap(voxel_size_m=VOXEL), OccupancyMap(VOXEL, 5.0)
    semantics.integrate([[0.05, 0.05, 0.05]], [3])
    assert semantic_cost([[0.05, 0.05, 0.05]], semantics, TABLE, occupancy)[0] == np.inf
    occupancy.assign([[0.05, 0.05, 0.05]], -30)
    assert semantic_cost([[0.05, 0.05, 0.05]], semantics, TABLE, occupancy)[0] == TABLE.free


def test_a_voxel_with_several_finer_classes_costs_what_the_dearest_does() -> None:
    semantics, occupancy = SemanticMap(voxel_size_m=VOXEL / 2), OccupancyMap(VOXEL, 5.0)
    semantics.integrate([[0.02, 0.02, 0.02], [0.07, 0.07, 0.07]], [1, 2])
    occupancy.assign([[0.05, 0.05, 0.05]], [30])
    points = [[0.02, 0.02, 0.02], [0.07, 0.07, 0.07], [0.07, 0.02, 0.02]]
    assert semantic_cost(points, semantics, TABLE, occupancy).tolist() == [0.3, 0.3, 0.3]
    assert semantic_cost(points, semantics, TABLE)[:2].tolist() == [0.0, 0.3]
    cost = CostMap(semantics, TABLE, band_m=(0.0, 0.1), occupancy=occupancy)
    cost.update()
    assert cost.query([[0.05, 0.05]]).tolist() == [0.3]


def test_noise_about_a_labelled_surface_is_taken_for_it_and_what_is_far_from_labels_is_not() -> None:
    semantics, occupancy = SemanticMap(voxel_size_m=VOXEL / 2), OccupancyMap(VOXEL, 5.0)
    semantics.integrate([[0.03, 0.03, 0.08]], [1])
    occupancy.assign([[0.05, 0.05, 0.15], [0.05, 0.05, 0.35]], [30, 30])
    points = [[0.05, 0.05, 0.15], [0.05, 0.05, 0.35]]
    assert semantic_cost(points, semantics, TABLE, occupancy).tolist() == [0.0, TABLE.default]
    assert semantic_cost(points, semantics, TABLE, occupancy, reach_m=0.0).tolist() == [TABLE.default] * 2
    with pytest.raises(InvalidParameter, match="reach_m"):
        CostMap(semantics, TABLE, band_m=(0.0, 0.5), occupancy=occupancy, reach_m=-1.0)


def test_what_was_never_observed_has_a_cost_of_its_own_where_the_table_gives_one() -> None:
    semantics, occupancy = world(5, n=60)
    table = CostTable({1: 1.0}, default=0.5, free=0.05, unknown=7.0)
    bare = CostTable({1: 1.0}, default=0.5, free=0.05)
    points = np.random.default_rng(1).uniform(-3, 3, (300, 3))
    one, other = (semantic_cost(points, semantics, t, occupancy) for t in (table, bare))
    assert np.array_equal(one, np.where(np.isnan(other), 7.0, other))
    maps = [CostMap(semantics, t, band_m=(-0.5, 0.5), occupancy=occupancy) for t in (table, bare)]
    for cost in maps:
        cost.update()
    one, other = (cost.query(points) for cost in maps)
    assert np.isnan(other).any()
    assert np.array_equal(one, np.where(np.isnan(other), 7.0, other))
    assert (maps[0].grid().cost == 7.0).sum() == np.isnan(maps[1].grid().cost).sum() > 0


def test_relabelling_classes_and_table_changes_no_cost() -> None:
    semantics, occupancy = world(7)
    other = SemanticMap(voxel_size_m=VOXEL)
    centres, labels, _ = semantics.voxels()
    renamed = np.array([0, 50, 40, 30, 20, 10], np.uint16)
    other.integrate(centres, renamed[labels])
    table = CostTable({50: 0.0, 40: 0.3, 30: np.inf, 20: 1.0}, default=0.6, free=0.05)
    points = np.random.default_rng(7).uniform(-1.3, 1.3, (500, 3))
    one = semantic_cost(points, semantics, TABLE, occupancy)
    assert np.array_equal(one, semantic_cost(points, other, table, occupancy), equal_nan=True)


# -- grids -----------------------------------------------------------------------------------------------------------


def test_the_grid_is_what_queries_say() -> None:
    semantics, occupancy = world(3)
    cost = CostMap(semantics, TABLE, band_m=(-0.5, 0.5), occupancy=occupancy)
    assert cost.grid().cost.size == 0
    cost.update()
    grid = cost.grid()
    points = np.random.default_rng(0).uniform(-1.6, 1.6, (400, 2))
    assert np.array_equal(grid.query(points), cost.query(points), equal_nan=True)
    assert np.isnan(grid.query([[50.0, 0.0, 1.0]]))[0]


@settings(max_examples=20)
@given(seed=seeds, radius=st.floats(0.1, 0.8))
def test_inflation_matches_the_naive_twin(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.choice([0.0, 0.0, 0.0, 0.4, 1.0, np.inf, np.nan], (9, 6))
    grown = CostGrid(np.zeros(2), VOXEL, cost).inflated(radius).cost
    cells = np.argwhere(~np.isnan(cost))
    for i, j in np.ndindex(cost.shape):
        if np.isnan(cost[i, j]):
            assert np.isnan(grown[i, j])
            continue
        away = np.hypot(*(cells - (i, j)).T) * VOXEL
        near = away < radius * (1 - 1e-9)
        reached = cost[tuple(cells[near].T)] * (1.0 - away[near] / radius)
        assert grown[i, j] == pytest.approx(reached.max(), abs=1e-9)


def served(path: Path) -> tuple[np.ndarray, dict[str, str]]:
    """What map_server makes of a grid in its mode scale (map_io.cpp of Navigation2): −1 unknown, 0 … 100, rows from
    the bottom; and the fields of the YAML file."""
    fields = dict(line.split(": ", 1) for line in path.read_text().splitlines() if not line.startswith("#"))
    pixels = np.asarray(Image.open(path.parent / fields["image"])).astype(float)
    occupied, free = float(fields["occupied_thresh"]), float(fields["free_thresh"])
    share = (255.0 - pixels[..., 0]) / 255.0
    cells = np.rint((share - free) / (occupied - free) * 100.0)
    cells[share >= occupied], cells[share <= free], cells[pixels[..., 1] < 255] = 100, 0, -1
    return cells[::-1], fields


def test_a_grid_is_read_by_map_server(tmp_path: Path) -> None:
    cost = np.array([[0.0, 1.0, 2.0], [np.inf, np.nan, 4.0]])
    grid = CostGrid(np.array([-1.5, 2.0]), 0.05, cost)
    written = grid.write(tmp_path / "cost.png")
    assert written == tmp_path / "cost.yaml"
    cells, fields = served(written)
    assert fields["mode"] == "scale"
    assert (fields["resolution"], fields["origin"]) == ("0.05", "[-1.5, 2, 0.0]")
    assert cells.tolist() == [[0, 100], [25, -1], [50, 99]]  # rows along y, columns along x
    assert CostGrid(np.zeros(2), 0.05, np.empty((0, 0))).write(tmp_path / "none.yaml").exists()
    assert grid.write(tmp_path / "cost.npz") == tmp_path / "cost.npz"
    with np.load(tmp_path / "cost.npz") as arrays:
        assert np.array_equal(arrays["cost"], cost, equal_nan=True)
        assert arrays["corner_m"].tolist() == [-1.5, 2.0]
        assert float(arrays["cell_size_m"]) == 0.05


# -- tables in files -------------------------------------------------------------------------------------------------


def test_a_table_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "costs.json"
    path.write_text('{"costs": {"floor": 0, "person": "never", "lawn": 1}, "default": 0.5, "unknown": 2}')
    table = CostTable.read(path, CLASSES, allow_absent=True)
    assert table.costs == {1: 0.0, 3: np.inf}
    assert (table.default, table.free, table.unknown, table.absent) == (0.5, 0.0, 2.0, ("lawn",))
    with pytest.raises(InvalidParameter, match=r"costs.json: costs: .*'lawn'"):
        CostTable.read(path, CLASSES)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{", "not a JSON file"),
        ("[]", "expected an object"),
        ("{}", "'costs' is missing"),
        ('{"costs": {}}', "'default' is missing"),
        ('{"costs": 3, "default": 0}', "costs: expected an object"),
        ('{"costs": {"floor": "always"}, "default": 0}', r"costs\['floor'\]: .*'always'"),
        ('{"costs": {"floor": null}, "default": 0}', r"costs\['floor'\]"),
        ('{"costs": {"floor": true}, "default": 0}', r"costs\['floor'\]"),
        ('{"costs": {"flor": 1}, "default": 0}', "did you mean 'floor'"),
        ('{"costs": {"floor": 1, "floor": 2}, "default": 0}', "'floor' again"),
        ('{"costs": {}, "default": -1}', "default: "),
        ('{"costs": {}, "default": 0, "unknown": "some"}', "unknown: "),
        ('{"costs": {}, "default": 0, "unknown": null}', "unknown: "),
        ('{"costs": {}, "defualt": 0}', "'defualt'"),
    ],
)
def test_bad_tables_in_files_are_refused_with_the_field(tmp_path: Path, text: str, named: str) -> None:
    (tmp_path / "costs.json").write_text(text)
    with pytest.raises(InvalidParameter, match=named):
        CostTable.read(tmp_path / "costs.json", CLASSES)
    with pytest.raises(InvalidParameter, match="cannot be read"):
        CostTable.read(tmp_path / "none.json", CLASSES)


# -- what is refused -------------------------------------------------------------------------------------------------


def test_names_stand_for_all_classes_that_bear_them() -> None:
    table = CostTable({"wall": 2.0}, default=0.5, classes=CLASSES)
    assert table.of(np.array([0, 1, 4, 5, 900])).tolist() == [0.5, 0.5, 2.0, 2.0, 0.5]
    assert table.costs == {4: 2.0, 5: 2.0}


@pytest.mark.parametrize(
    ("costs", "rest", "named"),
    [
        ({"flor": 1.0}, {"default": 0.0, "classes": CLASSES}, "flor"),
        ({"floor": 1.0}, {"default": 0.0}, "floor"),
        ({"floor": 1.0, 1: 2.0}, {"default": 0.0, "classes": CLASSES}, "once"),
        ({0: 1.0}, {"default": 0.0}, "1 … 65535"),
        ({True: 1.0}, {"default": 0.0}, "1 … 65535"),
        ({1: -1.0}, {"default": 0.0}, r"costs\[1\]"),
        ({1: "much"}, {"default": 0.0}, r"costs\[1\]"),
        ({}, {"default": np.nan}, "default"),
        ({}, {"default": 0.0, "free": -1.0}, "free"),
    ],
)
def test_tables_that_say_nothing_clear_are_refused(costs: dict, rest: dict, named: str) -> None:
    with pytest.raises(InvalidParameter, match=named):
        CostTable(costs, **rest)


def test_a_table_wants_a_default() -> None:
    with pytest.raises(TypeError, match="default"):
        CostTable({1: 0.0})


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"band_m": (1.0, 0.0)}, "band_m"),
        ({"band_m": (0.0, np.inf)}, "band_m"),
        ({"rule": "min"}, "rule"),
        ({"known_share": 0.0}, "known_share"),
    ],
)
def test_cost_maps_that_cannot_be_are_refused(changed: dict, named: str) -> None:
    with pytest.raises(InvalidParameter, match=named):
        CostMap(SemanticMap(voxel_size_m=VOXEL), TABLE, **{"band_m": (0.0, 1.0), **changed})
