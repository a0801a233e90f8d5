"""The one suite that every map layer passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from mapping.collision import spheres_are_free
from mapping.elevation import ElevationMap, ExtendedElevationMap, HeightMap
from mapping.errors import InvalidParameter, MappingError
from mapping.esdf import EsdfMap
from mapping.geometry import SE3
from mapping.grid import BLOCK_VOXELS, ijk_to_centre, join_ijk
from mapping.kernels import (
    collision,
    esdf,
    hashing,
    marching_cubes,
    mend_classes,
    mend_crossings,
    nearest,
    occupancy,
    sites,
    surface,
    tsdf,
    visibility,
)
from mapping.layer import Changed, MapLayer
from mapping.multilevel import MultiLevelMap
from mapping.occupancy import OccupancyMap
from mapping.packed import PackedLayer
from mapping.points import PointMap
from mapping.semantics import SemanticMap
from mapping.sensors import LidarModel
from mapping.surfels import SurfelMap
from mapping.tsdf import TsdfMap
from tests.support.rooms import SMALL_CAMERA, TOUR, Room

VOXEL_SIZE = 0.1
LIDAR = LidarModel.even(24, -0.5, 0.5, 180)


@dataclass(frozen=True)
class Case:
    """How to build a layer, feed it observation n, and read it as numbers with NaN for unknown."""

    name: str
    make: Callable[..., MapLayer]
    feed: Callable[[Any, int], Changed]
    read: Callable[[Any, np.ndarray], np.ndarray]
    bad: dict[str, Any]
    tolerance: float = 0.0


def beams(layer: Any, n: int) -> Changed:
    return layer.integrate(Room().scan(TOUR[n], 400, seed=n), TOUR[n])


def image(layer: Any, n: int) -> Changed:
    return layer.integrate_image(Room().depth(TOUR[n], SMALL_CAMERA), SMALL_CAMERA, TOUR[n])


def colored_image(layer: Any, n: int) -> Changed:
    depth = Room().depth(TOUR[n], SMALL_CAMERA)
    color = np.random.default_rng(n).integers(1, 255, (*depth.shape, 3)).astype(np.uint8)
    return layer.integrate_image(depth, SMALL_CAMERA, TOUR[n], color)


def feed_source(layer: EsdfMap, n: int) -> Changed:
    image(layer.source, n)
    return layer.update()


def range_image(layer: Any, n: int) -> Changed:
    rays = LIDAR.rays().reshape(-1, 3) @ TOUR[n].rotation.T.astype(np.float32)
    ranges = Room().cast(TOUR[n].translation, rays).reshape(LIDAR.shape).astype(np.float32)
    return layer.integrate_range_image(ranges, LIDAR, TOUR[n])


def many_beams(layer: SurfelMap, n: int) -> Changed:
    return layer.integrate(Room().scan(TOUR[n], 8000, seed=n), TOUR[n])


def bright_beams(layer: PointMap, n: int) -> Changed:
    points = Room().scan(TOUR[n], 400, seed=n)
    color = np.random.default_rng(n).integers(0, 255, points.shape).astype(np.uint8)
    return layer.integrate(points, TOUR[n], intensity=points[:, 0], color=color)


def votes(layer: SemanticMap, n: int) -> Changed:
    points = TOUR[n] @ Room().scan(TOUR[n], 400, seed=n)
    return layer.integrate(points, np.where(points[:, 2] < 0.0, 3, 8))


def sector(layer: Any, n: int) -> Changed:
    """A third of the room, another one for scans 0, 3 and 6: only where scans overlap does their order matter."""
    points = TOUR[n] @ Room().scan(TOUR[n], 400, seed=n)
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) % 1.0
    return layer.integrate(points[(3.0 * turn).astype(int) == n // 3 % 3], SE3.identity())


def value(layer: MapLayer, points: np.ndarray) -> np.ndarray:
    return layer.query(points)


def confidence(layer: SemanticMap, points: np.ndarray) -> np.ndarray:
    return layer.query(points)[1]


CASES = [
    Case("occupancy of beams", OccupancyMap, beams, value, {"max_range_m": -1.0, "hit": 2.0, "lowest": "low"}),
    Case("occupancy of images", OccupancyMap, image, value, {"miss": float("nan"), "highest": 0.1}),
    Case("tsdf of beams", TsdfMap, beams, value, {"truncation_m": 0.01, "max_weight": 0.0}, 1e-5),
    Case("tsdf of images", TsdfMap, image, value, {"truncation_m": 5.0, "weighting": "none"}, 1e-5),
    Case("tsdf of coloured images", TsdfMap, colored_image, value, {"max_range_m": float("inf")}, 1e-5),
    Case(
        "tsdf of range images",
        lambda **rest: TsdfMap(carve=False, **rest),
        range_image,
        value,
        {"depth_noise": -0.1},
        1e-5,
    ),
    Case(
        "esdf of occupancy",
        lambda voxel_size_m, **rest: EsdfMap(OccupancyMap(voxel_size_m), rest.pop("truncation_m", 0.5), **rest),
        feed_source,
        value,
        {"truncation_m": 0.0, "source": 3},
    ),
    Case(
        "esdf of tsdf",
        lambda voxel_size_m, **rest: EsdfMap(TsdfMap(voxel_size_m), rest.pop("truncation_m", 0.5), **rest),
        feed_source,
        value,
        {"truncation_m": True},
        1e-4,
    ),
    Case("points of beams", PointMap, bright_beams, value, {"max_points": 1.5, "max_range_m": -1.0}),
    Case("points of coloured images", PointMap, colored_image, value, {"max_points": 257}),
    Case("surfels of beams", SurfelMap, many_beams, value, {"min_points": 2, "max_range_m": 0.0}, 1e-4),
    Case("surfels of coloured images", SurfelMap, colored_image, value, {"min_points": float("nan")}, 1e-4),
    Case("semantics", SemanticMap, votes, confidence, {"memory": -1.0}, 1e-5),
    Case("height map", HeightMap, beams, value, {"max_range_m": 0.0, "above_sensor_m": float("nan")}, 1e-5),
    Case("elevation map", ElevationMap, beams, value, {"range_sigma_m": -1.0, "least_sigma_m": 0.0}, 1e-5),
    Case("elevation map of images", ElevationMap, image, value, {"tilt_sigma_rad": float("inf")}, 1e-3),
    Case("extended elevation map", ExtendedElevationMap, beams, value, {"robot_height_m": 0.0}, 1e-5),
    Case("multi-level map", MultiLevelMap, sector, value, {"gap_m": -1.0, "most_patches": 0}, 1e-5),
]


@pytest.fixture(params=CASES, ids=lambda case: case.name)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


def fed(case: Case, order: tuple[int, ...]) -> MapLayer:
    layer = case.make(voxel_size_m=VOXEL_SIZE)
    for n in order:
        case.feed(layer, n)
    return layer


def voxels(layer: MapLayer, blocks: np.ndarray) -> np.ndarray:
    if layer.block_size_m == layer.voxel_size_m:
        return ijk_to_centre(blocks, layer.voxel_size_m)
    local = np.tile(np.arange(BLOCK_VOXELS), len(blocks))
    return ijk_to_centre(join_ijk(np.repeat(blocks, BLOCK_VOXELS, axis=0), local), layer.voxel_size_m)


def snapshot(layer: MapLayer) -> dict[tuple[int, ...], bytes]:
    """What each block holds, bit by bit."""
    if isinstance(layer, OccupancyMap):
        return {
            tuple(block): evidence.tobytes()
            for block, evidence in zip(layer.block_ijk.tolist(), layer.evidence_of(layer.block_ijk), strict=True)
        }
    fields = layer.store.fields
    if isinstance(layer, PackedLayer):
        rows = [layer.store.rows(layer.store.cells([slot])) for slot in range(layer.store.n_blocks)]
        return {
            tuple(block): b"".join(fields[name][rows[slot]].tobytes() for name in sorted(fields))
            for slot, block in enumerate(layer.block_ijk.tolist())
        }
    return {
        tuple(block): b"".join(fields[name][slot].tobytes() for name in sorted(fields))
        for slot, block in enumerate(layer.block_ijk.tolist())
    }


def test_what_was_never_observed_is_nan(case):
    layer = fed(case, (0, 1))
    assert np.isnan(case.read(layer, np.array([[50.0, 50.0, 50.0], [-9.0, 0.0, 0.0]]))).all()
    assert np.isnan(case.read(case.make(voxel_size_m=VOXEL_SIZE), np.zeros((3, 3)))).all()
    assert not np.isnan(case.read(layer, voxels(layer, layer.block_ijk))).all()


def test_the_blocks_reported_are_the_blocks_changed(case):
    layer = case.make(voxel_size_m=VOXEL_SIZE)
    before: dict[tuple[int, ...], bytes] = {}
    for n in (0, 1, 0, 0):
        reported = case.feed(layer, n)
        after = snapshot(layer)
        empty = snapshot_of_nothing(layer)
        changed = {block for block, content in after.items() if content != before.get(block, empty)}
        assert {tuple(block) for block in reported.blocks.tolist()} == changed
        assert len(np.unique(reported.blocks, axis=0)) == len(reported)
        assert reported.block_size_m == pytest.approx(layer.block_size_m)
        before = after


def snapshot_of_nothing(layer: MapLayer) -> bytes:
    """What a block holds that was only allocated."""
    if isinstance(layer, OccupancyMap):
        return layer.evidence_of([[1000, 1000, 1000]]).tobytes()
    if isinstance(layer, PackedLayer):
        return b""
    filled = {name: layer.store._filled(name, 1) for name in layer.store.fields}
    return b"".join(filled[name].tobytes() for name in sorted(filled))


def test_changes_since_a_revision_are_the_union_of_the_changes_after_it(case):
    layer = fed(case, (0,))
    start = layer.revision
    reported = [case.feed(layer, n) for n in (1, 2)]
    expected = {tuple(block) for changed in reported for block in changed.blocks.tolist()}
    assert {tuple(block) for block in layer.changed_since(start).blocks.tolist()} == expected
    assert len(layer.changed_since(layer.revision)) == 0
    assert {tuple(b) for b in reported[0].union(reported[1]).blocks.tolist()} == expected


def test_save_then_load_is_identity(case, tmp_path):
    layer = fed(case, (0, 1, 2))
    layer.save(tmp_path / "map.npz")
    loaded = type(layer).load(tmp_path / "map.npz")
    assert loaded.parameters() == layer.parameters()
    assert snapshot(loaded) == snapshot(layer)
    assert np.array_equal(loaded.block_ijk, layer.block_ijk)
    points = voxels(layer, layer.block_ijk[:3]) + 0.01
    assert np.array_equal(case.read(loaded, points), case.read(layer, points), equal_nan=True)


def test_a_loaded_map_goes_on_as_the_original_would(case, tmp_path):
    layer = fed(case, (0, 1))
    if isinstance(layer, EsdfMap):
        pytest.skip("a loaded distance field follows no source")
    layer.save(tmp_path / "map.npz")
    loaded = type(layer).load(tmp_path / "map.npz")
    case.feed(layer, 2)
    case.feed(loaded, 2)
    assert snapshot(loaded) == snapshot(layer)


def test_damaged_and_foreign_files_are_refused(case, tmp_path):
    layer = fed(case, (0,))
    layer.save(tmp_path / "map.npz")
    content = (tmp_path / "map.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[: len(content) // 2])
    (tmp_path / "text.npz").write_text("no map at all")
    (tmp_path / "empty.npz").write_bytes(b"")
    for name in ("cut.npz", "text.npz", "empty.npz"):
        with pytest.raises(MappingError, match=name):
            type(layer).load(tmp_path / name)
    state = layer.state()
    with pytest.raises(MappingError, match="expected a saved"):
        type(layer).from_state({**state, "kind": np.array("picture")})
    del state["block_ijk"]
    with pytest.raises(MappingError, match="block_ijk"):
        type(layer).from_state(state)


def test_the_order_of_independent_scans_does_not_matter(case):
    layers = [fed(case, order) for order in ((0, 3, 6), (6, 0, 3))]
    points = voxels(layers[0], layers[0].block_ijk)
    first = case.read(layers[0], points)
    for other in layers[1:]:
        assert np.allclose(case.read(other, points), first, rtol=0.0, atol=case.tolerance, equal_nan=True)


def test_equal_input_gives_equal_bytes(case):
    assert snapshot(fed(case, (0, 1, 2))) == snapshot(fed(case, (0, 1, 2)))


def test_bad_parameters_are_refused_by_name(case):
    for name, bad in {**case.bad, "voxel_size_m": 0.0}.items():
        with pytest.raises(InvalidParameter, match=name):
            case.make(**{"voxel_size_m": VOXEL_SIZE, name: bad}) if name != "source" else EsdfMap(bad)


def test_points_of_a_wrong_shape_are_refused(case):
    with pytest.raises(InvalidParameter, match=r"\(N, 3\)"):
        case.make(voxel_size_m=VOXEL_SIZE).query(np.zeros(3))


def test_memory_is_counted(case):
    layer = fed(case, (0,))
    least = sum(len(content) for content in snapshot(layer).values())
    assert (
        layer.memory_bytes >= (0.5 if isinstance(layer, OccupancyMap) else 1.0) * least
    )  # uniform blocks hold no voxels


@pytest.mark.parametrize("case", CASES[:4], ids=lambda case: case.name)
def test_any_number_of_threads_gives_the_same_map(case):
    import numba

    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = snapshot(fed(case, (0, 1, 2)))
    finally:
        numba.set_num_threads(threads)
    assert snapshot(fed(case, (0, 1, 2))) == alone


def compiled() -> dict[str, int]:
    """For each kernel, for how many types of input it is compiled."""
    modules = (hashing, marching_cubes, occupancy, surface, tsdf, visibility)
    modules += (collision, esdf, mend_classes, mend_crossings, nearest, sites)
    kernels = {f"{module.__name__}.{name}": value for module in modules for name, value in vars(module).items()}
    return {name: len(kernel.signatures) for name, kernel in kernels.items() if hasattr(kernel, "signatures")}


def test_kernels_are_compiled_once_whatever_arrays_a_caller_holds():
    depth = Room().depth(TOUR[0], SMALL_CAMERA)
    color = np.full((*depth.shape, 3), 100, np.uint8)
    points = Room().scan(TOUR[0], 50)
    counts = []
    for cloud in (points, points.astype(np.float32)[::2], np.asfortranarray(points)):
        for layer in (OccupancyMap(VOXEL_SIZE), TsdfMap(VOXEL_SIZE)):
            layer.integrate_image(depth, SMALL_CAMERA, TOUR[0])
            layer.integrate(cloud, TOUR[0])
            layer.query(cloud)
            spheres_are_free(EsdfMap(layer, 0.3), cloud, 0.1)
        layer.integrate_image(depth, SMALL_CAMERA, TOUR[0], color)
        layer.surface()
        layer.surface(layer.block_ijk[::2])
        layer.mesh()
        for array in (depth, color, points):
            array.setflags(write=False)
        counts.append(compiled())
    assert counts[1] == counts[0]
    assert counts[2] == counts[0]


@pytest.mark.parametrize("make", [OccupancyMap, TsdfMap])
def test_a_pose_may_be_a_matrix_and_must_be_one(make):
    one, other = make(VOXEL_SIZE), make(VOXEL_SIZE)
    points = Room().scan(TOUR[1], 50)
    one.integrate(points, TOUR[1])
    other.integrate(points, TOUR[1].matrix)
    assert snapshot(one) == snapshot(other)
    with pytest.raises(InvalidParameter, match="pose"):
        one.integrate(points, np.full((4, 4), np.nan))
    with pytest.raises(InvalidParameter, match="pose"):
        one.integrate(points, SE3.identity().matrix[:3])
