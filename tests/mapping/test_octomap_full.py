"""OctoMap's `.ot` files: log-odds and colours come back to the last bit; what changed is written as OctoMap would."""

import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.errors import InvalidParameter, MappingError
from mapping.grid import split_ijk
from mapping.occupancy import OccupancyMap
from mapping.octomap import OctoMapTree, read_octomap, write_octomap
from mapping.octomap_tree import HIGHEST, LOWEST
from tests import naive_octomap as naive
from tests.support.recordings import recording
from tests.support.rooms import TOUR, Room

VALUES = [float(np.float32(v)) for v in (-2.0003, -0.405465, -0.81093, 0.0, 0.441833, 0.847298, 3.511)]
SEEDS = st.integers(0, 2**31)


def again(layer: OccupancyMap, path) -> bytes:
    layer.write(path)
    return path.read_bytes()


def steps_of(layer: OccupancyMap, log_odds: float) -> int:
    """The evidence that the map keeps for a log-odds."""
    steps = round(log_odds / layer.log_odds_step)
    steps = max(steps, 0) if log_odds >= 0.0 else min(steps, -1)
    return min(max(steps, layer.lowest_evidence), layer.highest_evidence)


def change(layer: OccupancyMap, keys: list[naive.Key], evidence: list[int]) -> None:
    """Set voxels, by their keys, to other evidence."""
    layer.assign((np.array(keys).reshape(-1, 3) - naive.ORIGIN + 0.5) * layer.voxel_size_m, evidence)


def theirs(points: np.ndarray, colors: np.ndarray | None, path, *, pruned: bool = False, finished: bool = True):
    """An `.ot` file that OctoMap wrote after hits and misses of points (N, 3)."""
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTree(0.1) if colors is None else pyoctomap.ColorOcTree(0.1)
    for n, point in enumerate(points):
        tree.updateNode(point, n % 3 > 0)
        if colors is not None and n % 2:
            tree.setNodeColor(point, *(int(c) for c in colors[n]))
    if finished:
        tree.updateInnerOccupancy()
    if pruned:
        tree.prune()
    tree.write(str(path))
    return tree


# -- to the last bit ---------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.booleans())
def test_any_tree_comes_back_byte_for_byte(tmp_path_factory, seed, colored):
    path = tmp_path_factory.mktemp("maps") / "map.ot"
    tree = naive.random_tree(np.random.default_rng(seed), VALUES, colored)
    path.write_bytes(naive.write_full(tree, "0.05", "ColorOcTree" if colored else "OcTree"))
    assert again(read_octomap(path), path.with_name("again.ot")) == path.read_bytes()


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_any_binary_tree_comes_back_byte_for_byte(tmp_path_factory, seed):
    path = tmp_path_factory.mktemp("maps") / "map.bt"
    tree = naive.random_tree(np.random.default_rng(seed), VALUES, False)
    path.write_bytes(naive.write_binary(tree, "0.05"))
    assert again(read_octomap(path), path.with_name("again.bt")) == path.read_bytes()


@pytest.mark.parametrize("colored", [False, True], ids=["plain", "colour"])
@pytest.mark.parametrize("pruned", [False, True], ids=["whole", "pruned"])
@pytest.mark.parametrize("finished", [False, True], ids=["stale", "updated"])
def test_what_octomap_writes_comes_back_byte_for_byte(tmp_path, colored, pruned, finished):
    rng = np.random.default_rng(5)
    points = np.concatenate([rng.normal(0.0, 1.0, (600, 3)), 0.05 + 0.1 * np.argwhere(np.ones((16, 8, 8)))])
    colors = rng.integers(0, 256, points.shape) if colored else None
    theirs(np.tile(points, (2, 1)), None if colors is None else np.tile(colors, (2, 1)), tmp_path / "theirs.ot",
           pruned=pruned and colored, finished=finished)  # fmt: skip
    layer = read_octomap(tmp_path / "theirs.ot")
    assert again(layer, tmp_path / "ours.ot") == (tmp_path / "theirs.ot").read_bytes()


def test_a_map_of_scans_comes_back_and_is_thresholded_as_octomap_does_it(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTree(0.1)
    for n in range(2):
        tree.insertPointCloud(TOUR[n] @ Room().scan(TOUR[n], 500, seed=n), np.array(TOUR[n].translation))
    tree.write(str(tmp_path / "theirs.ot"))
    layer = read_octomap(tmp_path / "theirs.ot")
    assert again(layer, tmp_path / "ours.ot") == (tmp_path / "theirs.ot").read_bytes()
    tree.writeBinary(str(tmp_path / "theirs.bt"))
    assert again(layer, tmp_path / "ours.bt") == (tmp_path / "theirs.bt").read_bytes()


def test_trees_with_times_come_back_as_octomap_itself_writes_them(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTreeStamped(0.1)
    for point in np.random.default_rng(1).normal(0.0, 1.0, (50, 3)):
        tree.updateNode(point, True)
    tree.write(str(tmp_path / "theirs.ot"))
    layer = read_octomap(tmp_path / "theirs.ot")
    assert again(layer, tmp_path / "ours.ot") == (tmp_path / "theirs.ot").read_bytes()


def test_what_pyoctomap_appends_to_binary_files_is_left_out(tmp_path):
    points = np.random.default_rng(2).normal(0.0, 1.0, (50, 3))
    theirs(points, np.full((50, 3), 9), tmp_path / "theirs.ot").writeBinary(str(tmp_path / "theirs.bt"))
    content = (tmp_path / "theirs.bt").read_bytes()
    assert b"\n#PYOC_" in content
    layer = read_octomap(tmp_path / "theirs.bt")
    assert again(layer, tmp_path / "ours.bt") == content[: content.index(b"\n#PYOC_")]
    assert set(again(layer, tmp_path / "ours.ot").split(b"data\n")[1][5::8]) == {255}  # a colour tree without colours


def test_colours_and_exact_log_odds_can_be_asked_for(tmp_path):
    rng = np.random.default_rng(3)
    points, colors = rng.normal(0.0, 1.0, (300, 3)), rng.integers(0, 256, (300, 3))
    tree = theirs(points, colors, tmp_path / "theirs.ot", pruned=True)
    octomap = read_octomap(tmp_path / "theirs.ot").octomap
    asked = np.concatenate([points, points + 0.3, [[np.nan, 0.0, 0.0], [1e9, 0.0, 0.0], [-3276.75, 0.0, 0.0]]])
    given_colors, log_odds = octomap.colors_of(asked), octomap.log_odds_of(asked)
    for n, point in enumerate(asked[:-3]):
        node = tree.search(point)
        known = node is not None
        assert np.isnan(log_odds[n]) != known
        if known:
            assert log_odds[n] == np.float32(node.getLogOdds())
            assert tuple(given_colors[n]) == tuple(node.getColor())
    assert np.isnan(log_odds[-3:]).all()
    assert (given_colors[-3:] == 255).all()
    assert octomap.memory_bytes == 8 * len(octomap.children)


@pytest.mark.parametrize("name", ["map.bt", "map.ot"])
@pytest.mark.parametrize("colored", [False, True], ids=["plain", "colour"])
def test_what_a_file_said_is_saved_with_the_map(tmp_path, name, colored):
    tree = naive.random_tree(np.random.default_rng(13), VALUES, colored)
    kind = "ColorOcTree" if colored else "OcTree"
    binary = name == "map.bt"
    content = naive.write_binary(tree, "0.05", kind) if binary else naive.write_full(tree, "0.05", kind)
    (tmp_path / name).write_bytes(content)
    layer = read_octomap(tmp_path / name)
    layer.save(tmp_path / "map.npz")
    assert again(OccupancyMap.load(tmp_path / "map.npz"), tmp_path / name) == content
    state = layer.octomap.state()
    assert OctoMapTree.from_state({}, 0.05) is None
    damaged = {
        "kind": np.array("Tree"), "children": state["octomap.children"][:-1], "content": np.full(3, np.nan, np.float32),
        "colors": np.zeros((1, 3), np.uint8),
    }  # fmt: skip
    for field, value in damaged.items():
        with pytest.raises(MappingError, match="saved map's OctoMap nodes"):
            OctoMapTree.from_state({**state, f"octomap.{field}": value}, 0.05)
    loop = {**state, "octomap.children": np.full_like(state["octomap.children"], 255)}
    with pytest.raises(MappingError, match="not a tree"):
        OctoMapTree.from_state(loop, 0.05)


# -- changed since -----------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.booleans())
def test_changed_maps_are_written_as_the_naive_merge_says(tmp_path_factory, seed, colored):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("maps") / "map.ot"
    kind = "ColorOcTree" if colored else "OcTree"
    tree = naive.random_tree(rng, VALUES, colored)
    path.write_bytes(naive.write_full(tree, "0.05", kind))
    layer = read_octomap(path)
    voxels = naive.voxels_of(tree, lambda value: steps_of(layer, value))
    keys = list(voxels)
    blocks, local = split_ijk(np.array(keys) - naive.ORIGIN)
    assert np.count_nonzero(layer.evidence_of(layer.block_ijk) != -128) == len(keys)
    assert (layer.evidence_of(blocks)[np.arange(len(keys)), local] == list(voxels.values())).all()
    keys = [keys[n] for n in rng.integers(0, len(keys), rng.integers(1, 5))]
    keys += [tuple(int(k) for k in np.clip(np.array(key) + rng.integers(-9, 9, 3), 0, 65535)) for key in keys[:3]]
    keys = sorted(set(keys))
    evidence = [int(e) for e in rng.choice([-128, -10, 3, layer.lowest_evidence, layer.highest_evidence], len(keys))]
    change(layer, keys, evidence)
    voxels = {key: e for key, e in {**voxels, **dict(zip(keys, evidence, strict=True))}.items() if e != -128}
    limits = {layer.lowest_evidence: LOWEST, layer.highest_evidence: HIGHEST}
    expected, _ = naive.merge(
        tree, None, voxels, lambda value: steps_of(layer, value),
        lambda e: float(limits.get(e, np.float32(e * layer.log_odds_step))),
    )  # fmt: skip
    assert again(layer, path) == naive.write_full(expected, "0.05", kind)
    blocks = layer.block_ijk
    assert (read_octomap(path).evidence_of(blocks) == layer.evidence_of(blocks)).all()


def test_leaves_that_did_not_change_keep_their_log_odds(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    path = tmp_path / "theirs.ot"
    points = np.random.default_rng(4).normal(0.0, 1.0, (400, 3))
    theirs(np.tile(points, (3, 1)), None, path)
    layer = read_octomap(path)
    layer.integrate(points[1:8], np.eye(4))
    layer.write(tmp_path / "ours.ot")
    tree = pyoctomap.OcTree(0.1).read(str(tmp_path / "ours.ot"))
    exact = layer.octomap.log_odds_of(points)
    now = np.array([tree.search(point).getLogOdds() for point in points], np.float32)
    apart = np.abs(layer.query(points) - 1.0 / (1.0 + np.exp(-exact.astype(np.float64)))) > 0.01
    assert 0 < apart.sum() < 20
    assert (now == exact)[~apart].all()
    assert not (now == exact)[apart].any()


# -- ours, opened by theirs --------------------------------------------------------------------------------


def test_pyoctomap_reads_our_log_odds(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    layer = OccupancyMap(0.1)
    for n in range(3):
        layer.integrate(Room().scan(TOUR[n], 1000, seed=n), TOUR[n])
    content = again(layer, tmp_path / "ours.ot")
    tree = pyoctomap.OcTree(0.2).read(str(tmp_path / "ours.ot"))
    assert tree.getResolution() == pytest.approx(0.1)
    centres = np.concatenate([layer.occupied_centres()[::50], layer.free_centres()[::500]])
    log_odds = np.array([tree.search(centre).getLogOdds() for centre in centres])
    assert np.allclose(1.0 / (1.0 + np.exp(-log_odds)), layer.query(centres), atol=1e-4)
    assert tree.getNumLeafNodes() == content[content.index(b"data\n") + 5 :][4::5].count(0)
    tree.write(str(tmp_path / "theirs.ot"))
    assert (tmp_path / "theirs.ot").read_bytes() == content
    again_ours = read_octomap(tmp_path / "ours.ot")
    assert np.array_equal(again_ours.evidence_of(layer.block_ijk), layer.evidence_of(layer.block_ijk))


def test_a_map_gets_colours_for_a_colour_tree(tmp_path):
    pyoctomap = pytest.importorskip("pyoctomap")
    layer = OccupancyMap(0.1)
    layer.integrate(Room().scan(TOUR[0], 1000, seed=0), TOUR[0])

    def colors(p_map):
        return (128.0 + 20.0 * p_map).astype(np.uint8)

    write_octomap(layer, tmp_path / "ours.ot", colors=colors)
    tree = pyoctomap.ColorOcTree(0.2).read(str(tmp_path / "ours.ot"))
    for centre in layer.occupied_centres()[::20]:
        assert np.allclose(tree.search(centre).getColor(), colors(centre), atol=2.1)
    for centre in layer.free_centres()[::2000]:
        assert tuple(tree.search(centre).getColor()) == naive.WHITE
    tree.updateInnerOccupancy()
    tree.write(str(tmp_path / "theirs.ot"))
    content = (tmp_path / "ours.ot").read_bytes()
    assert (tmp_path / "theirs.ot").read_bytes() == content
    assert again(read_octomap(tmp_path / "ours.ot"), tmp_path / "again.ot") == content


def test_colours_of_another_shape_or_for_a_bt_file_are_refused(tmp_path):
    layer = OccupancyMap()
    layer.integrate(np.array([[1.0, 0.0, 0.0]]), np.eye(4))
    with pytest.raises(InvalidParameter, match=r"colors: expected uint8 \(1, 3\)"):
        write_octomap(layer, tmp_path / "map.ot", colors=lambda p: np.zeros(len(p), np.uint8))
    with pytest.raises(InvalidParameter, match=r"ends in \.ot"):
        write_octomap(layer, tmp_path / "map.bt", colors=lambda p: np.zeros(p.shape, np.uint8))
    assert not list(tmp_path.iterdir())


# -- OctoMap's own tools -----------------------------------------------------------------------------------


def tool(name: str, *arguments) -> str:
    """What one of OctoMap's programs says; the test is skipped, saying so, where they are not installed."""
    program = shutil.which(name)
    if program is None:
        pytest.skip(f"{name} is not installed (Debian package octomap-tools)")
    return subprocess.run([program, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


@pytest.mark.parametrize("suffix", [".bt", ".bt.ot", ".bt_ml.ot"])
def test_what_graph2tree_writes_comes_back_byte_for_byte(tmp_path, suffix):
    tool("graph2tree", "-i", recording("octomap_maps/spherical_scan.graph"), "-o", tmp_path / "map.bt", "-res", "0.05")
    path = tmp_path / f"map{suffix}"
    assert again(read_octomap(path), tmp_path / f"again{path.suffix}") == path.read_bytes()


def test_convert_octree_makes_the_same_of_a_file_as_reading_and_writing_it(tmp_path):
    path = recording("octomap_maps/geb079.bt")
    tool("convert_octree", path, tmp_path / "theirs.ot")
    layer = read_octomap(path)
    assert again(layer, tmp_path / "ours.ot") == (tmp_path / "theirs.ot").read_bytes()
    full = read_octomap(tmp_path / "theirs.ot")
    assert again(full, tmp_path / "again.ot") == (tmp_path / "theirs.ot").read_bytes()
    assert again(full, tmp_path / "again.bt") == path.read_bytes()


def test_compare_octrees_finds_no_difference_between_ours_and_theirs(tmp_path):
    tool("graph2tree", "-i", recording("octomap_maps/spherical_scan.graph"), "-o", tmp_path / "map.bt", "-res", "0.1")
    layer = read_octomap(tmp_path / "map.bt.ot")
    layer.octomap = None
    assert again(layer, tmp_path / "ours.ot") != (tmp_path / "map.bt.ot").read_bytes()
    said = tool("compare_octrees", tmp_path / "map.bt.ot", tmp_path / "ours.ot")
    assert abs(float(said.split("KLD:")[1].split()[0])) < 0.1  # sum over 4,926 leaves, of rounding to steps


def test_convert_octree_opens_our_colours(tmp_path):
    layer = OccupancyMap(0.1)
    layer.integrate(Room().scan(TOUR[0], 500, seed=0), TOUR[0])
    write_octomap(layer, tmp_path / "ours.ot", colors=lambda p: np.full(p.shape, 7, np.uint8))
    tool("convert_octree", tmp_path / "ours.ot", tmp_path / "theirs.ot")
    assert (tmp_path / "theirs.ot").read_bytes() == (tmp_path / "ours.ot").read_bytes()


# -- damage ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["bt", "ot", "colour"])
def sound(request, tmp_path_factory):
    """A file, and the folder that it lies in."""
    folder = tmp_path_factory.mktemp("sound")
    tree = naive.random_tree(np.random.default_rng(11), VALUES, True)
    if request.param == "bt":
        return naive.write_binary(tree, "0.05"), folder
    return naive.write_full(tree, "0.05", "ColorOcTree" if request.param == "colour" else "OcTree"), folder


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_files_cut_anywhere_are_refused(sound, data):
    content, folder = sound
    path = folder / "cut.ot"
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    with pytest.raises(MappingError, match="cut"):
        read_octomap(path)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_flipped_bits_are_refused_or_make_another_map_but_never_harm(sound, data):
    content, folder = sound
    damaged = bytearray(content)
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=3)):
        damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    path = folder / "flipped.ot"
    path.write_bytes(damaged)
    try:
        layer = read_octomap(path)
    except MappingError:
        return
    assert layer.memory_bytes < 1 << 24
    assert len(again(layer, path.with_suffix(".bt" if content.startswith(b"# Octomap OcTree b") else ".ot"))) > 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("size {n}", "size 9{n}", "cut off or damaged"),
        ("size {n}", "size {less}", "expected .* nodes in"),
        ("size {n}", "size -1", "bad header"),
        ("size {n}", "size 1e3", "expected id, size and res"),
        ("res 0.05", "res nan", "bad header"),
        ("res 0.05", "res 1e300", "bad header"),
        ("id ColorOcTree", "id OcTree", "expected .* nodes in"),
        ("id ColorOcTree", "id CountingOcTree", "expected a tree of type"),
        ("id ColorOcTree\n", "", "expected id, size and res"),
    ],
)
def test_headers_that_do_not_fit_are_refused(tmp_path, old, new, message):
    tree = naive.random_tree(np.random.default_rng(12), VALUES, True)
    content, n = naive.write_full(tree, "0.05", "ColorOcTree"), len(list(tree.walk()))
    was, becomes = (text.format(n=n, less=n - 1).encode() for text in (old, new))
    assert was in content
    (tmp_path / "map.ot").write_bytes(content.replace(was, becomes))
    with pytest.raises(MappingError, match=message):
        read_octomap(tmp_path / "map.ot")


def test_log_odds_that_are_not_numbers_are_refused(tmp_path):
    (tmp_path / "map.ot").write_bytes(naive.write_full(naive.Node(float("nan")), "0.05", "OcTree"))
    with pytest.raises(MappingError, match="not a finite number"):
        read_octomap(tmp_path / "map.ot")


def test_one_cell_that_fills_the_whole_space_goes_into_ot_files_only(tmp_path):
    layer = OccupancyMap()
    layer.fill_cells(np.argwhere(np.ones((64, 64, 64))) - 32, np.full(64**3, 7), np.full(64**3, -5))
    assert len(again(layer, tmp_path / "map.ot").split(b"data\n")[1]) == 5
    with pytest.raises(InvalidParameter, match="whole address space"):
        layer.write(tmp_path / "map.bt")
    with pytest.raises(MappingError, match="cover"):
        read_octomap(tmp_path / "map.ot")
