"""Classes and instances out of the map: at points, on meshes, as clouds and octrees; what is unknown stays apart."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mapping.errors import InvalidParameter
from mapping.labelled import (
    EMPTY,
    LABELLED,
    REACH,
    UNLABELLED,
    UNSEEN,
    labelled_cloud,
    labels_at,
    labels_near,
    labels_of_cubes,
    write_class_octree,
)
from mapping.layered import LayeredMap
from mapping.observations import ClassInfo, LabelSpace
from mapping.occupancy import OccupancyMap
from mapping.palette import UNLABELLED_COLOR, Palette, color_of_name
from mapping.ply import ply_bytes
from mapping.semantics import SemanticMap
from tests import naive_labelled as naive
from tests.support.scenes import Block, Scene, looking_at

FINE, COARSE = 0.05, 0.1
seeds = st.integers(0, 10_000)


def world(seed: int, n: int = 60, size: int = 6) -> tuple[SemanticMap, OccupancyMap]:
    """Fine voxels with random classes and coarser ones of random occupancy, independent of each other."""
    rng = np.random.default_rng(seed)
    semantics, occupancy = SemanticMap(voxel_size_m=FINE), OccupancyMap(COARSE, 5.0)
    weights = rng.choice([0.01, 1.0], n)  # the first is too little for a label
    semantics.integrate((rng.integers(-size, size, (n, 3)) + 0.5) * FINE, rng.integers(1, 4, n), weights)
    seen = np.unique(rng.integers(-size // 2, size // 2, (n, 3)), axis=0)
    occupancy.assign((seen + 0.5) * COARSE, np.where(rng.random(len(seen)) < 0.5, 30, -30))
    return semantics, occupancy


@pytest.fixture(scope="module")
def table() -> tuple[LayeredMap, Scene]:
    """A room with two things, seen from four sides."""
    scene = Scene(
        (
            Block("floor", (0.0, 0.0, -0.1), (4.0, 4.0, 0.2)),
            Block("box", (-0.4, 0.0, 0.15), (0.3, 0.3, 0.3), 1),
            Block("crate", (0.4, 0.1, 0.2), (0.3, 0.4, 0.4), 2),
        )
    )
    things = np.zeros(1 << 16, bool)
    things[[scene.id_of("box"), scene.id_of("crate")]] = True
    layers = LayeredMap(voxel_size_m=0.05, instance_voxel_size_m=0.025, max_range_m=6.0, label_range_m=5.0)
    for n in range(4):
        eye = (1.6 * np.cos(n * np.pi / 2), 1.6 * np.sin(n * np.pi / 2), 1.1)
        image = scene.image(looking_at(eye, (0.0, 0.0, 0.1)), n + 1)
        layers.integrate_image(image, image.T_map_camera, things)
    return layers, scene


# -- at points -------------------------------------------------------------------------------------------------------


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_never_observed_empty_unlabelled_and_labelled_are_told_apart(seed: int) -> None:
    semantics, occupancy = world(seed)
    points = np.random.default_rng(seed).uniform(-0.5, 0.5, (150, 3))
    found = labels_at(points, semantics, occupancy)
    assert found.state.tolist() == [naive.state_at(point, semantics, occupancy) for point in points]
    assert np.array_equal(found.labels, semantics.query(points)[0])
    assert np.array_equal(np.isnan(found.confidence), found.labels == 0)
    assert np.array_equal(found.observed, found.state != UNSEEN)


def test_each_state_is_met(table: tuple[LayeredMap, Scene]) -> None:
    layers, scene = table
    layers.occupancy.assign([[1.0, 1.0, 1.05]], 30)
    centres, labels, _ = layers.semantics.voxels()
    on_box = centres[(labels == scene.id_of("box")) & (layers.instances.query(centres) > 0)][0]
    points = [[9.0, 0.0, 0.0], [0.0, 0.0, 0.52], [1.0, 1.0, 1.05], on_box, [np.nan, 0.0, 0.0]]
    found = labels_at(points, layers.semantics, layers.occupancy, layers.instances)
    assert found.state.tolist() == [UNSEEN, EMPTY, UNLABELLED, LABELLED, UNSEEN]
    assert found.labels.tolist() == [0, 0, 0, scene.id_of("box"), 0]
    assert found.instances[3] in layers.instances.instances
    assert not found.instances[[0, 1, 2, 4]].any()


def test_an_empty_map_knows_nothing() -> None:
    found = labels_at(np.zeros((3, 3)), SemanticMap(voxel_size_m=FINE), OccupancyMap(COARSE, 5.0))
    assert not np.stack([found.labels, found.instances, found.state]).any()
    assert not labels_near(np.zeros((3, 3)), SemanticMap(voxel_size_m=FINE), 0.1)[0].any()
    assert len(labelled_cloud(SemanticMap(voxel_size_m=FINE))) == 0


@settings(max_examples=15, deadline=None)
@given(seed=seeds, reach=st.sampled_from([0.02, 0.05, 0.11]))
def test_the_nearest_label_matches_the_naive_twin(seed: int, reach: float) -> None:
    semantics, _ = world(seed, n=25)
    points = np.random.default_rng(seed).uniform(-0.45, 0.45, (60, 3))
    labels, confidence = labels_near(points, semantics, reach)
    voxels = naive.labels_by_voxel(semantics)
    for point, label in zip(points, labels, strict=True):
        assert int(label) in naive.nearest_labels(point, voxels, FINE, reach)
    assert np.array_equal(np.isnan(confidence), labels == 0)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, n=st.sampled_from([1, 2, 3]))
def test_cubes_have_the_class_that_most_of_their_voxels_have(seed: int, n: int) -> None:
    semantics, _ = world(seed, n=150)
    low = np.random.default_rng(seed).integers(-6, 5, (40, 3)) * FINE
    labels = labels_of_cubes(low + n * FINE / 2, n * FINE, semantics)
    voxels = naive.labels_by_voxel(semantics)
    assert labels.tolist() == [naive.label_of_cube(corner, n, voxels, FINE) for corner in low]


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_cubes_without_a_label_have_the_nearest_within_reach(seed: int) -> None:
    semantics, _ = world(seed, n=25)
    centres = (np.random.default_rng(seed).integers(-4, 4, (40, 3)) + 0.5) * COARSE
    alone, reaching = (labels_of_cubes(centres, COARSE, semantics, reach_m=reach) for reach in (0.0, 0.15))
    expected = np.where(alone != 0, alone, labels_near(centres, semantics, 0.15)[0])
    assert np.array_equal(reaching, expected)
    assert (reaching != alone).any()


def test_cubes_of_too_many_voxels_are_refused() -> None:
    with pytest.raises(InvalidParameter, match="edge_m"):
        labels_of_cubes(np.zeros((1, 3)), 65 * FINE, SemanticMap(voxel_size_m=FINE))


# -- colours ---------------------------------------------------------------------------------------------------------


def test_classes_have_the_colours_that_they_are_given_or_one_by_their_name() -> None:
    space = LabelSpace(classes={4: {"name": "wall", "color": (1, 2, 3)}, 9: {"name": "cup"}})
    palette = Palette(space)
    assert palette.of([4, 0, 9, 77]).tolist() == [
        [1, 2, 3], list(UNLABELLED_COLOR), list(color_of_name("cup")), list(color_of_name("77")),
    ]  # fmt: skip
    assert palette.of([]).shape == (0, 3)
    assert Palette([ClassInfo(name="a"), ClassInfo(name="cup")])[2] == palette[9]


def test_a_legend_names_classes_whatever_their_names_are() -> None:
    palette = Palette([ClassInfo(name="sofa", color=(1, 2, 3)), ClassInfo(name="end\nend_header\u00fc")])
    assert palette.legend([2, 1, 1, 0, 9])[0] == "class 1 1 2 3 sofa"
    head = ply_bytes([("x", np.zeros(1, np.float32))], comments=palette.legend([1, 2])).split(b"end_header\n")
    assert len(head) == 2
    assert b"end end_header\\xfc\n" in head[0]


def test_colours_by_name_are_stable_never_grey_and_seldom_alike() -> None:
    assert color_of_name("cup") == (242, 36, 191)
    colors = np.array([color_of_name(f"class {n}") for n in range(60)], float)
    assert (np.ptp(colors, axis=1) > 60).all()
    apart = np.linalg.norm(colors[:, None] - colors, axis=2) + 1e9 * np.eye(60)
    assert np.median(apart.min(axis=1)) > 15.0


# -- clouds ----------------------------------------------------------------------------------------------------------


def test_the_cloud_has_a_point_in_each_labelled_voxel(table: tuple[LayeredMap, Scene]) -> None:
    layers, scene = table
    palette = Palette([ClassInfo(name=name) for name in scene.classes])
    cloud = labelled_cloud(layers.semantics, layers.instances, palette)
    centres, labels, confidence = layers.semantics.voxels()
    assert np.abs(cloud.points - centres).max() < 0.0125 + 1e-5
    assert np.array_equal(cloud.labels, labels)
    assert np.array_equal(cloud.confidence, confidence)
    assert np.array_equal(cloud.instances, layers.instances.query(centres))
    assert np.array_equal(cloud.colors, palette.of(labels))
    moved = np.abs(cloud.points - centres).max(axis=1) > 1e-4
    assert moved[cloud.instances > 0].mean() > 0.3
    assert not moved[cloud.instances == 0].any()
    known = [layers.instances.points(number)[0] for number in np.unique(cloud.instances[cloud.instances > 0])]
    assert cKDTree(np.concatenate(known)).query(cloud.points[moved])[0].max() < 0.025


def test_a_cloud_is_read_back_by_open3d_and_by_a_plain_reader(table: tuple[LayeredMap, Scene], tmp_path) -> None:
    import open3d

    layers, scene = table
    cloud = labelled_cloud(layers.semantics, layers.instances)
    cloud.write_ply(tmp_path / "cloud.ply")
    plain = naive.read_ply(tmp_path / "cloud.ply")
    assert {name: plain[name].dtype.str for name in ("label", "instance", "confidence", "red")} == {
        "label": "<i4", "instance": "<i4", "confidence": "<f4", "red": "|u1",
    }  # fmt: skip
    assert np.array_equal(np.stack([plain[a] for a in "xyz"], axis=1), cloud.points)
    assert np.array_equal(plain["label"], cloud.labels)
    assert np.array_equal(plain["instance"], cloud.instances)
    assert np.array_equal(plain["confidence"], cloud.confidence)
    assert len(cloud.legend) == 0 < len(labelled_cloud(layers.semantics, None, Palette(scene.label_space)).legend)
    theirs = open3d.t.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    ours = cloud.to_open3d()
    for name in ("positions", "colors", "label", "instance", "confidence"):
        one, other = theirs.point[name].numpy(), ours.point[name].numpy()
        assert np.array_equal(one.astype(np.float64), other.astype(np.float64)), name
    assert np.array_equal(ours.point.label.numpy()[:, 0], cloud.labels)


# -- meshes ----------------------------------------------------------------------------------------------------------


def test_a_labelled_mesh_has_the_colours_of_its_classes_and_is_read_back(table, tmp_path) -> None:
    import open3d

    layers, scene = table
    palette = Palette([ClassInfo(name=name) for name in scene.classes])
    bare = layers.tsdf.mesh()
    with pytest.raises(InvalidParameter, match="labels"):
        bare.colored(palette)
    mesh = layers.tsdf.mesh(labels_from=layers.semantics).colored(palette)
    assert np.array_equal(mesh.vertices, bare.vertices)
    assert np.array_equal(mesh.colors, palette.of(mesh.labels))
    assert (mesh.labels == 0).mean() < 0.05 < (layers.semantics.query(mesh.vertices)[0] == 0).mean()
    mesh.write_ply(tmp_path / "mesh.ply")
    assert (tmp_path / "mesh.ply").read_bytes() == mesh.ply()
    plain = naive.read_ply(tmp_path / "mesh.ply")
    assert np.array_equal(plain["label"], mesh.labels)
    assert np.array_equal(plain["triangles"], mesh.triangles)
    theirs = open3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    assert np.array_equal(np.asarray(theirs.triangles), mesh.triangles)
    assert np.array_equal(np.rint(np.asarray(theirs.vertex_colors) * 255.0), mesh.colors)
    assert np.array_equal(np.stack([plain[c] for c in ("red", "green", "blue")], axis=1), mesh.colors)


def test_a_mesh_takes_labels_from_anything_that_can_be_asked(table) -> None:
    class North:
        def query(self, p_map):
            north = np.asarray(p_map)[:, 1] > 0.0
            return north.astype(np.uint16), north.astype(np.float32)

    mesh = table[0].tsdf.mesh(labels_from=North())
    assert np.array_equal(mesh.labels > 0, mesh.vertices[:, 1] > 0.0)


# -- octrees ---------------------------------------------------------------------------------------------------------


def test_a_class_octree_opens_in_octomap_with_the_colour_of_each_class(table, tmp_path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    layers, scene = table
    palette = Palette([ClassInfo(name=name) for name in scene.classes])
    write_class_octree(layers.occupancy, layers.semantics, tmp_path / "classes.ot", palette)
    tree = pyoctomap.ColorOcTree(0.2).read(str(tmp_path / "classes.ot"))
    assert tree.getResolution() == pytest.approx(0.05)
    centres = layers.occupancy.occupied_centres()
    expected = palette.of(labels_of_cubes(centres, 0.05, layers.semantics, reach_m=REACH * 0.05))
    assert len(np.unique(expected, axis=0)) > 2
    for centre, color in zip(centres, expected, strict=True):
        node = tree.search(centre)
        assert tree.isNodeOccupied(node)
        assert tuple(node.getColor()) == tuple(color)
    for centre in layers.occupancy.free_centres()[::500]:
        assert not tree.isNodeOccupied(tree.search(centre))


def test_a_solid_block_of_two_classes_is_not_pruned_to_one_colour(tmp_path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    semantics, occupancy = SemanticMap(voxel_size_m=0.1), OccupancyMap(0.1, 5.0)
    centres = (np.indices((8, 8, 8)).reshape(3, -1).T + 0.5) * 0.1
    occupancy.assign(centres, np.full(len(centres), 127))
    labels = np.where(centres[:, 0] < 0.45, 1, np.where(centres[:, 1] < 0.15, 2, 0))
    semantics.integrate(centres, labels)
    write_class_octree(occupancy, semantics, tmp_path / "block.ot", reach_m=0.0)
    tree = pyoctomap.ColorOcTree(0.2).read(str(tmp_path / "block.ot"))
    assert [tuple(tree.search(c).getColor()) for c in centres] == [tuple(c) for c in Palette().of(labels)]
    assert sum(1 for _ in tree.begin_leafs()) < len(centres)  # what is alike is still one leaf
