"""Planes: kernels against their twins, and what a `PlaneMap` promises on surfaces made of rectangles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from mapping.coverage import Coverage, PlaneFrame
from mapping.errors import InvalidParameter, MappingError
from mapping.kernels import planes as kernels
from mapping.kernels import rasters
from mapping.planes import Plane, PlaneMap, extract_planes
from mapping.tsdf import TsdfMap
from tests import naive_planes as naive
from tests.naive_planes import Rectangle, Soup, box

X, Y, Z = np.eye(3)


def cloud(rng: np.random.Generator, n: int = 60) -> tuple[Any, Any]:
    points = rng.normal(size=(n, 3)) * (1.0, 2.0, 0.02) + rng.normal(size=3)
    normals = rng.normal(size=(n, 3)) * 0.1 + Z
    return points.astype(np.float32), (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def mapped(rectangles: list[Rectangle], **options: Any) -> tuple[PlaneMap, Soup]:
    soup, planes = Soup(), PlaneMap(0.05, **options)
    planes.update(soup, soup.add_all(rectangles))
    return planes, soup


def wall(x0: float = 0.0, x1: float = 4.0, holes: tuple[tuple[float, float, float, float], ...] = ()) -> Rectangle:
    """An upright rectangle along x, 2.5 m high, facing −y."""
    return Rectangle(np.array([x0, 0.0, 0.0]), (x1 - x0) * X, 2.5 * Z, holes)


def agree(a: PlaneMap, b: PlaneMap) -> bool:
    """Whether two maps hold the same planes, whatever their ids."""
    found, rest = a.planes(), b.planes()
    for plane in found:
        twins = [
            other for other in rest
            if other.normal @ plane.normal > 0.995
            and abs(other.offset - plane.offset) < 0.03
            and np.linalg.norm(other.centroid - plane.centroid) < 0.15
            and 0.9 < other.area_m2 / plane.area_m2 < 1.1
        ]  # fmt: skip
        if len(twins) != 1:
            return False
        rest.remove(twins[0])
    return not rest


# -- kernels and their twins -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_moments_and_fits_match_the_naive_reference(seed: int) -> None:
    points, normals = cloud(np.random.default_rng(seed))
    sums = np.zeros((2, kernels.MOMENTS))
    plane_of = np.where(np.arange(len(points)) % 7 == 0, -1, 1).astype(np.int32)
    kernels.accumulate(sums, plane_of, points, normals, 1.0)
    on = plane_of == 1
    assert np.allclose(sums[1], naive.moments(points[on], normals[on]), atol=1e-4)
    assert not sums[0].any()

    normal = np.empty(3)
    offset, rms = kernels.fit(sums[1], normal)
    true_normal, true_offset, true_rms = naive.fit(points[on], normals[on])
    assert np.allclose(normal, true_normal, atol=1e-5)
    assert (offset, rms) == pytest.approx((true_offset, true_rms), abs=1e-5)
    assert kernels.misfit(sums[1], normal, offset) == pytest.approx(rms, abs=1e-6)

    kernels.accumulate(sums, plane_of, points, normals, -1.0)
    assert np.allclose(sums, 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_match_agrees_with_the_naive_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, normals = cloud(rng)
    planes = []
    for _ in range(6):
        normal = rng.normal(size=3) * 0.3 + Z
        normal /= np.linalg.norm(normal)
        planes.append((normal, float(normal @ points[rng.integers(len(points))])))
    near = [rng.permutation(6)[: rng.integers(0, 5)] for _ in range(4)]
    place_of = rng.integers(0, 4, len(points))
    first = np.cumsum([0, *map(len, near)])
    plane_of = np.full(len(points), -1, np.int32)
    kernels.match(
        plane_of, points, normals, place_of, first, np.concatenate(near).astype(np.int64),
        np.array([n for n, _ in planes]), np.array([d for _, d in planes]), 0.3, 0.8,
    )  # fmt: skip
    assert plane_of.tolist() == naive.match(points, normals, [near[q] for q in place_of], planes, 0.3, 0.8)


def test_samples_are_counted_per_block_and_plane() -> None:
    rng = np.random.default_rng(0)
    owner = np.sort(rng.integers(0, 9, 200))
    plane_of = rng.integers(-1, 5, 200).astype(np.int32)
    row, plane, n = np.empty((3, 200), np.int64)
    entries = kernels.count_planes(owner, plane_of, row, plane, n)
    found = {(int(r), int(p)): int(m) for r, p, m in zip(row[:entries], plane[:entries], n[:entries], strict=True)}
    pairs = zip(owner.tolist(), plane_of.tolist(), strict=True)
    assert found == naive.counts((o, p) for o, p in pairs if p >= 0)


def test_patches_are_flat_and_take_what_fits() -> None:
    rng = np.random.default_rng(1)
    floor = np.column_stack([rng.uniform(0, 0.4, (80, 2)), 0.005 * rng.standard_normal(80)])
    upright = np.column_stack(
        [rng.uniform(0, 0.4, 60), 0.2 + 0.005 * rng.standard_normal(60), rng.uniform(0.1, 0.4, 60)]
    )
    clutter = rng.uniform(0.0, 0.4, (10, 3))
    points = np.concatenate([floor, upright, clutter]).astype(np.float32)
    directions = rng.normal(size=(10, 3))
    normals = np.concatenate([np.tile(Z, (80, 1)), np.tile(-Y, (60, 1)), directions]).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    patch_of = np.full(150, -1, np.int32)
    moments, place = np.zeros((10, kernels.MOMENTS)), np.zeros(10, np.int64)
    n = kernels.find_patches(patch_of, moments, place, points, normals, np.array([0, 150]), 12, 0.03, 0.9, 12)
    assert n == 2
    assert (patch_of[:80] == 0).mean() > 0.95
    assert (patch_of[80:140] == 1).mean() > 0.95
    for k in range(2):
        assert np.allclose(moments[k], naive.moments(points[patch_of == k], normals[patch_of == k]), atol=1e-5)


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=1, max_size=60), st.integers(1, 3))
@settings(max_examples=60, deadline=None)
def test_coverage_is_a_set_of_cells_that_can_be_taken_back(cells: list[tuple[int, int]], reach: int) -> None:
    coverage = Coverage(PlaneFrame.about(np.zeros(3), Z), 0.1)
    points = np.column_stack([0.1 * (np.array(cells) + 0.5), np.zeros(len(cells))])
    half = len(points) // 2 + 1
    coverage.add(points[:half])
    if len(points) > half:
        coverage.add(points[half:])
    assert coverage.n_covered == len(set(cells))

    asked = np.array([(u, v) for u in range(-10, 11, 3) for v in range(-10, 11, 3)])
    near = coverage.near(0.1 * (asked + 0.5), 0.1 * reach)
    slow = [any(max(abs(u - a), abs(v - b)) <= reach for a, b in cells) for u, v in asked.tolist()]
    assert near.tolist() == slow

    coverage.remove(points[:half])
    assert coverage.n_covered == len(set(cells[half:]))


@given(st.lists(st.booleans(), min_size=36, max_size=36))
@settings(max_examples=80, deadline=None)
def test_traced_borders_enclose_just_the_covered_cells(bits: list[bool]) -> None:
    mask = np.pad(np.array(bits).reshape(6, 6), 1)
    corners, ends = np.empty((400, 2), np.int32), np.empty(400, np.int64)
    n = rasters.trace(mask, corners, ends)
    area, rings = 0.0, np.split(corners, ends[:n])[:n]
    whole = shapely.Polygon()
    for ring in rings:
        polygon = shapely.Polygon(ring)
        signed = polygon.area if polygon.exterior.is_ccw else -polygon.area
        area += signed
        whole = whole.symmetric_difference(polygon)
    assert area == mask.sum()
    assert whole.symmetric_difference(naive.outline(mask)).area == pytest.approx(0.0)


@given(st.lists(st.booleans(), min_size=64, max_size=64))
@settings(max_examples=80, deadline=None)
def test_a_shape_holds_the_covered_cells_whatever_they_look_like(bits: list[bool]) -> None:
    mask = np.array(bits).reshape(8, 8)
    mask[0, 0] = True
    coverage = Coverage(PlaneFrame.about(np.zeros(3), Z), 1.0)
    coverage.add(np.column_stack([np.argwhere(mask) + 0.5, np.zeros(mask.sum())]))
    shape = coverage.shape(1.0, 0.0)
    assert shape.is_valid
    assert {part.geom_type for part in shapely.get_parts(shape)} == {"Polygon"}
    assert shape.contains(naive.outline(mask).buffer(-0.01))
    closed = ndimage.binary_closing(np.pad(mask, 3), np.ones((3, 3)))[3:-3, 3:-3]
    assert shape.symmetric_difference(naive.outline(closed)).area == pytest.approx(0.0, abs=1e-6)


def test_an_island_in_a_hole_is_covered_and_scraps_are_not() -> None:
    mask = np.ones((40, 40), dtype=bool)
    mask[5:35, 5:35] = False
    mask[15:25, 15:25] = True
    mask[8, 8] = True
    coverage = Coverage(PlaneFrame.about(np.zeros(3), Z), 0.05)
    coverage.add(np.column_stack([0.05 * (np.argwhere(mask) + 0.5), np.zeros(mask.sum())]))
    shape = coverage.shape(0.1, 0.0)
    assert shape.area == pytest.approx(0.0025 * (1600 - 900 + 100))
    assert shape.contains(shapely.Point(1.0, 1.0))
    assert not shape.intersects(shapely.Point(0.425, 0.425))


# -- planes of a surface -----------------------------------------------------------------------------------------


@given(st.floats(0.0, 6.28), st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_a_room_turned_by_any_angle_has_six_planes(yaw: float, seed: int) -> None:
    faces = [face.turned(yaw) for face in box((0.3, 0.2, 0.0), (4.3, 3.2, 2.5), inwards=True)]
    soup, planes = Soup(seed=seed), PlaneMap(0.05)
    planes.update(soup, soup.add_all(faces))
    assert len(planes) == 6
    for face in faces:
        offset = float(face.normal @ face.corner)
        close = [p for p in planes.planes() if p.normal @ face.normal > 0.999 and abs(p.offset - offset) < 0.01]
        assert len(close) == 1
        plane = close[0]
        assert plane.area_m2 == pytest.approx(face.area, rel=0.06)
        across = np.stack([face.u / np.linalg.norm(face.u), face.v / np.linalg.norm(face.v)], axis=1)
        assert shapely.Polygon(plane.polygon @ across).area == pytest.approx(face.area, rel=0.06)
        assert plane.rms_m < 0.01


def test_normals_point_into_free_space_and_rings_turn_about_them() -> None:
    planes, _ = mapped([wall()])
    plane = planes.plane(1)
    assert plane.normal @ -Y > 0.999
    edges = np.roll(plane.polygon, -1, axis=0) - plane.polygon
    spin = np.cross(plane.polygon - plane.centroid, edges).sum(axis=0)
    assert spin @ plane.normal > 0.0
    assert (plane.z_min, plane.z_max) == pytest.approx((0.0, 2.5), abs=0.06)
    assert plane.width_m == pytest.approx(4.0, abs=0.11)


def test_both_faces_of_a_wall_are_planes() -> None:
    planes, _ = mapped([wall(), Rectangle(np.array([0.0, 0.12, 0.0]), 2.5 * Z, 4.0 * X)])
    assert len(planes) == 2
    a, b = planes.planes()
    assert a.normal @ b.normal < -0.99


def test_a_doorway_is_a_hole_through_which_segments_pass() -> None:
    planes, _ = mapped([wall(holes=((1.0, 0.0, 1.9, 2.0), (2.6, 0.9, 3.4, 1.8)))])
    (plane,) = planes.planes()
    assert plane.area_m2 == pytest.approx(10.0 - 1.8 - 0.72, rel=0.05)
    assert len(plane.rings) == 2  # the doorway reaches the floor, the window is a hole
    start = np.array([[0.5, -1.0, 1.0], [1.45, -1.0, 1.0], [3.0, -1.0, 1.3], [3.0, -1.0, 0.4], [0.5, -1.0, 1.0]])
    end = start * (1.0, -1.0, 1.0)
    end[4, 1] = -0.5
    assert planes.blocks_segment(start, end, planes.ids).tolist() == [True, False, False, True, False]
    assert not planes.blocks_segment(start, end, []).any()


def test_an_l_shaped_floor_keeps_its_notch() -> None:
    planes, _ = mapped([Rectangle(np.zeros(3), 4.0 * X, 2.0 * Y), Rectangle(2.0 * Y, 2.0 * X, 2.0 * Y)])
    (plane,) = planes.planes()
    outline = shapely.Polygon(plane.polygon[:, :2])
    assert plane.area_m2 == pytest.approx(12.0, rel=0.04)
    assert outline.contains(shapely.Point(1.0, 3.0))
    assert not outline.contains(shapely.Point(3.0, 3.0))


@pytest.mark.parametrize(("gap", "n"), [(0.2, 1), (0.9, 2), (1.5, 2)])
def test_a_gap_parts_coplanar_walls(gap: float, n: int) -> None:
    planes, _ = mapped([wall(0.0, 2.0), wall(2.0 + gap, 5.0)])
    assert len(planes) == n


def test_small_pieces_are_not_told_of() -> None:
    planes, _ = mapped([Rectangle(np.zeros(3), 0.4 * X, 0.3 * Y)])
    assert len(planes) == 0


# -- change ------------------------------------------------------------------------------------------------------


@given(st.permutations(range(10)), st.floats(0.0, 1.5))
@settings(max_examples=5, deadline=None)
def test_the_order_of_updates_does_not_matter(order: list[int], yaw: float) -> None:
    faces = box((0.0, 0.0, 0.0), (4.0, 3.0, 2.5), inwards=True)
    faces += box((1.0, 1.0, 0.7), (2.2, 1.8, 0.75))[1:2] + box((3.0, 0.2, 0.0), (3.8, 0.8, 2.0))[1:4]
    turned = [face.turned(yaw) for face in faces]
    at_once, _ = mapped(turned)
    one_by_one = PlaneMap(0.05)
    again = Soup()
    for k in order:
        one_by_one.update(again, again.add(turned[k]))
    assert agree(one_by_one, at_once)


def test_only_the_blocks_that_changed_are_read() -> None:
    soup, planes = Soup(), PlaneMap(0.05)
    planes.update(soup, soup.add_all(box((0.0, 0.0, 0.0), (6.0, 6.0, 2.5), inwards=True)))
    changed = soup.add(Rectangle(np.array([2.0, 2.0, 0.7]), 1.0 * X, 1.0 * Y))
    before = {i: planes.plane(i) for i in planes.ids}
    change = planes.update(soup, changed)
    assert np.array_equal(soup.asked[-1], changed)
    assert len(change.changed) == 1
    assert all(planes.plane(i) is plane for i, plane in before.items())


def test_an_update_that_changes_nothing_keeps_ids_and_shapes() -> None:
    soup, planes = Soup(), PlaneMap(0.05)
    blocks = soup.add_all(box((0.0, 0.0, 0.0), (4.0, 3.0, 2.5), inwards=True))
    planes.update(soup, blocks)
    before = {p.id: p for p in planes.planes()}
    for _ in range(3):
        change = planes.update(soup, blocks)
        assert not change.deleted
    for plane in planes.planes():
        assert np.allclose(plane.normal, before[plane.id].normal, atol=1e-6)
        assert plane.area_m2 == pytest.approx(before[plane.id].area_m2)
        assert plane.n_points == before[plane.id].n_points


def test_a_surface_that_goes_takes_its_plane_along() -> None:
    table = Rectangle(np.array([1.0, 1.0, 0.7]), 1.0 * X, 1.0 * Y)
    planes, soup = mapped([Rectangle(np.zeros(3), 4.0 * X, 4.0 * Y), table])
    assert len(planes) == 2
    gone = [p.id for p in planes.planes() if p.z_min > 0.5]
    change = planes.update(soup, soup.remove(table))
    assert list(change.deleted) == gone
    assert len(planes) == 1
    with pytest.raises(KeyError):
        planes.plane(gone[0])


def test_planes_that_meet_become_the_older_one_and_part_again() -> None:
    left, middle, right = wall(0.0, 1.5), wall(1.5, 3.0), wall(3.0, 5.0)
    planes, soup = mapped([left, right])
    assert planes.ids == [1, 2]
    change = planes.update(soup, soup.add(middle))
    assert planes.ids == [1]
    assert (change.deleted, change.merged) == ((2,), {2: 1})
    assert planes.plane(1).area_m2 == pytest.approx(12.5, rel=0.05)

    change = planes.update(soup, soup.remove(middle))
    assert len(planes) == 2
    assert 1 in planes
    assert 3 in planes
    assert sum(p.area_m2 for p in planes.planes()) == pytest.approx(8.75, rel=0.05)


def test_samples_and_spread_lie_on_their_plane() -> None:
    planes, _ = mapped([wall()])
    plane = planes.plane(1)
    for points in (planes.samples(1), planes.samples(1, 50), planes.spread(1, 50)):
        assert np.abs(points @ plane.normal - plane.offset).max() < 0.04
    assert len(planes.samples(1)) == plane.n_points
    assert len(planes.samples(1, 50)) <= 50
    assert planes.near(1, planes.spread(1, 50), 0.05, 0.01).all()
    assert not planes.near(1, planes.spread(1, 50) + 0.3 * Y, 0.05, 0.1).any()


def test_a_saved_map_goes_on_where_it_was() -> None:
    left, middle, right = wall(0.0, 1.5), wall(1.5, 3.0), wall(3.0, 5.0)
    planes, soup = mapped([left, right])
    copy = PlaneMap(0.05)
    copy.restore(planes.state())
    assert copy.ids == planes.ids
    for plane in planes.planes():
        twin = copy.plane(plane.id)
        assert np.allclose(twin.normal, plane.normal, atol=1e-6)
        assert twin.n_points == plane.n_points
        assert all(np.allclose(a, b, atol=1e-6) for a, b in zip(twin.rings, plane.rings, strict=True))
    blocks = soup.add(middle)
    assert copy.update(soup, blocks) == planes.update(soup, blocks)
    with pytest.raises(MappingError, match="lack points"):
        copy.restore({k: v for k, v in planes.state().items() if k != "points"})


def test_planes_are_found_in_a_signed_distance_map() -> None:
    tsdf, planes = TsdfMap(voxel_size_m=0.05), PlaneMap(0.05)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(40_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        reach = np.minimum.reduce(
            [2.0 / abs(directions[:, 0]), 1.5 / abs(directions[:, 1]), 1.25 / abs(directions[:, 2])]
        )
    noisy = directions * (reach + 0.01 * rng.standard_normal(len(reach)))[:, None]
    changed = tsdf.integrate(noisy.astype(np.float32), np.eye(4))
    planes.update(tsdf, changed)
    large = sorted((p for p in planes.planes() if p.area_m2 > 1.0), key=lambda p: float(p.normal @ (1, 2, 3)))
    assert [round(float(p.normal @ (1, 2, 3))) for p in large] == [-3, -2, -1, 1, 2, 3]
    assert np.allclose([p.offset for p in large], [-1.25, -1.5, -2.0, -2.0, -1.5, -1.25], atol=0.02)


# -- clouds and bad values ---------------------------------------------------------------------------------------


def test_planes_of_a_cloud_need_no_normals() -> None:
    points = np.concatenate([face.samples(0.03) for face in box((-2.0, -1.5, -1.2), (2.0, 1.5, 1.3), inwards=True)])
    points += np.random.default_rng(0).normal(scale=0.005, size=points.shape)
    found: list[Plane] = extract_planes(points)
    assert len(found) == 6
    assert [p.area_m2 for p in found] == sorted((p.area_m2 for p in found), reverse=True)
    assert all(p.normal @ p.centroid < 0.0 for p in found)  # towards the origin, inside the box
    turned = extract_planes(points, viewpoint=(50.0, 0.0, 0.0))
    assert sum(p.normal[0] > 0.9 for p in turned) == 2


def test_a_cloud_without_planes_has_none() -> None:
    assert extract_planes(np.zeros((0, 3))) == []
    assert extract_planes(np.random.default_rng(0).uniform(-1, 1, (400, 3))) == []
    assert extract_planes(np.full((100, 3), np.nan)) == []


@pytest.mark.parametrize(
    "options", [{"voxel_size_m": 0.0}, {"voxel_size_m": np.nan}, {"voxel_size_m": 0.05, "min_area_m2": -1.0},
                {"voxel_size_m": 0.05, "max_angle_deg": 90.0}, {"voxel_size_m": 0.05, "tolerance_m": 0.0}]
)  # fmt: skip
def test_bad_parameters_are_named(options: dict[str, float]) -> None:
    with pytest.raises(InvalidParameter, match=list(options)[-1]):
        PlaneMap(**options)


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("points", {"points": np.zeros((5, 2))}),
        ("normals", {"points": np.zeros((5, 3)), "normals": np.zeros((4, 3))}),
        ("viewpoint", {"points": np.zeros((5, 3)), "viewpoint": np.zeros((2, 3))}),
    ],
)
def test_bad_clouds_are_named(field: str, arguments: dict[str, Any]) -> None:
    with pytest.raises(InvalidParameter, match=field):
        extract_planes(**arguments)
