"""OctoMap files: what its tools write comes back byte for byte, they open ours, and damage is named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter, MappingError
from mapping.occupancy import FREE, OCCUPIED, OccupancyMap
from mapping.octomap import read_octomap
from tests.support.recordings import recording
from tests.support.rooms import TOUR, Room


def map_of(voxels: np.ndarray, occupied: np.ndarray, voxel_size: float = 0.1) -> OccupancyMap:
    layer = OccupancyMap(voxel_size)
    evidence = np.where(occupied, layer.highest_evidence, layer.lowest_evidence)
    layer.assign((voxels + 0.5) * voxel_size, evidence)
    return layer


def contents(layer: OccupancyMap) -> set[tuple[float, ...]]:
    free, occupied = layer.free_centres(), layer.occupied_centres()
    return {(*np.round(c, 6), FREE) for c in free} | {(*np.round(c, 6), OCCUPIED) for c in occupied}


def test_a_real_map_comes_back_byte_for_byte(tmp_path):
    path = recording("octomap_maps/geb079.bt")
    layer = read_octomap(path)
    layer.write(tmp_path / "again.bt")
    assert (tmp_path / "again.bt").read_bytes() == path.read_bytes()
    assert layer.voxel_size_m == 0.08


def test_a_map_that_is_not_pruned_comes_back_too_and_pruned_once_its_file_is_forgotten(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    path = recording("la3dm_sim_lidar_poses/sim_structured/map.bt")
    layer = read_octomap(path)
    layer.write(tmp_path / "again.bt")
    assert (tmp_path / "again.bt").read_bytes() == path.read_bytes()
    layer.octomap = None
    layer.write(tmp_path / "ours.bt")
    tree = pyoctomap.OcTree(0.1)
    tree.readBinary(str(path))
    tree.writeBinary(str(tmp_path / "theirs.bt"))
    assert (tmp_path / "ours.bt").read_bytes() == (tmp_path / "theirs.bt").read_bytes()


def test_pyoctomap_opens_ours_and_writes_the_same(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    layer = OccupancyMap(0.1)
    for n in range(3):
        layer.integrate(Room().scan(TOUR[n], 1000, seed=n), TOUR[n])
    layer.write(tmp_path / "ours.bt")
    tree = pyoctomap.OcTree(0.2)
    assert tree.readBinary(str(tmp_path / "ours.bt"))
    assert tree.getResolution() == pytest.approx(0.1)
    for centre in layer.occupied_centres()[::50]:
        assert tree.isNodeOccupied(tree.search(centre))
    for centre in layer.free_centres()[::500]:
        assert not tree.isNodeOccupied(tree.search(centre))
    tree.writeBinary(str(tmp_path / "theirs.bt"))
    assert (tmp_path / "ours.bt").read_bytes() == (tmp_path / "theirs.bt").read_bytes()


def test_full_trees_keep_their_evidence(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    layer, tree = OccupancyMap(0.1), pyoctomap.OcTree(0.1)
    for n in range(2):
        points = Room().scan(TOUR[n], 500, seed=n).astype(np.float32).astype(np.float64)
        layer.integrate(points, TOUR[n])
        tree.insertPointCloud(TOUR[n] @ points, np.array(TOUR[n].translation))
    tree.updateInnerOccupancy()
    tree.write(str(tmp_path / "theirs.ot"))
    theirs = read_octomap(tmp_path / "theirs.ot")
    centres = np.concatenate([theirs.occupied_centres(), theirs.free_centres()])
    assert len(centres) == len(layer.occupied_centres()) + len(layer.free_centres())
    assert np.allclose(theirs.query(centres), layer.query(centres), atol=0.01)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 400), st.sampled_from([2, 12, 60]), st.floats(0.0, 1.0))
def test_any_map_comes_back(tmp_path_factory, seed, n, spread, share):
    rng = np.random.default_rng(seed)
    layer = map_of(rng.integers(-spread, spread, (n, 3)), rng.random(n) < share)
    path = tmp_path_factory.mktemp("maps") / "map.bt"
    layer.write(path)
    again = read_octomap(path)
    assert contents(again) == contents(layer)
    again.write(path.with_name("again.bt"))
    assert path.with_name("again.bt").read_bytes() == path.read_bytes()


def test_large_uniform_regions_are_one_node(tmp_path):
    cube = np.argwhere(np.ones((32, 32, 32)))
    map_of(cube, np.zeros(len(cube), np.bool_)).write(tmp_path / "cube.bt")
    header, stream = (tmp_path / "cube.bt").read_bytes().split(b"data\n")
    assert len(stream) == 2 * 11  # one inner node a level down to the cube of 2⁵ voxels
    assert b"size 12\n" in header
    again = read_octomap(tmp_path / "cube.bt")
    assert len(again.free_centres()) == 32**3


def test_an_empty_map_comes_back_empty(tmp_path):
    OccupancyMap(0.25).write(tmp_path / "empty.bt")
    again = read_octomap(tmp_path / "empty.bt")
    assert again.voxel_size_m == 0.25
    assert again.store.n_blocks == 0


def test_damaged_and_foreign_files_are_refused(tmp_path):
    voxels = np.random.default_rng(0).integers(-20, 20, (300, 3))
    map_of(voxels, np.arange(300) % 3 == 0).write(tmp_path / "map.bt")
    content = (tmp_path / "map.bt").read_bytes()
    start = content.index(b"data\n") + 5
    damaged = {
        "cut": (content[:-40], "cut off or damaged"),
        "odd": (content[:-1], "cut off or damaged"),
        "long": (content + b"\0\0", "bytes"),
        "no data": (content[:start], "ends after its header"),
        "no header": (content[: start - 5], "no line 'data'"),
        "foreign": (b"PNG" + content, "not an OctoMap file"),
        "size": (content.replace(b"size ", b"size 1"), "nodes"),
        "tree": (content.replace(b"id OcTree", b"id StampedTree"), "type OcTree"),
        "resolution": (content.replace(b"res 0.1", b"res 0.0"), "bad header"),
        "number": (content.replace(b"res 0.1", b"res x"), "bad header"),
        "endless": (content[:start] + b"\xff\xff" * 40, "cut off or damaged"),
    }
    for name, (bad, message) in damaged.items():
        path = tmp_path / f"{name}.bt"
        path.write_bytes(bad)
        with pytest.raises(MappingError, match=message):
            read_octomap(path)


def test_a_file_that_claims_the_whole_space_is_refused_before_it_takes_memory(tmp_path):
    header = b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n"
    (tmp_path / "vast.bt").write_bytes(header + b"\x55\x55")
    with pytest.raises(MappingError, match="cover"):
        read_octomap(tmp_path / "vast.bt")


def test_other_suffixes_and_maps_beyond_the_keys_are_refused(tmp_path):
    layer = map_of(np.array([[40000, 0, 0]]), np.array([True]))
    with pytest.raises(InvalidParameter, match="32768"):
        layer.write(tmp_path / "far.bt")
    with pytest.raises(InvalidParameter, match=r"\.bt"):
        OccupancyMap().write(tmp_path / "map.pcd")
