"""What labels cost: a labelled image of 640×480, 40 classes, 30 things, into semantic voxels and lasting instances.

Run with `make bench`. A furnished room, realistic noise of depth, masks that bleed by 3–8 px, 10 % of the things missed
and 25 % mislabelled in each image; voxels of 2.5 cm. The whole update is what `LayeredMap` does with the labels of an
image: masks are cut into pieces, votes for classes counted, pieces joined to lasting instances and their votes counted.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from mapping.geometry import SE3
from mapping.layered import LayeredMap
from mapping.observations import RgbdImage
from mapping.segmentation import segment
from scenegraph.simulation.noise import NoiseModel, Segmenter
from tests.support.racing import Table, race
from tests.support.rooms import LARGE_CAMERA
from tests.support.scenes import Block, Scene, looking_at, shell

THINGS, PANELS = 30, 7
IMAGES = 48
NOISE = NoiseModel(mislabelled=0.25, confused=0.0)
MUST_MS = 20.0
MUST_BYTES = 24


@cache
def scene() -> Scene:
    """A room of 6 × 5 m with 30 things of as many classes, and panels of 7 classes on its walls."""
    rng = np.random.default_rng(0)
    blocks = shell((0.0, 0.0), (6.013, 5.017), 2.61)
    for n in range(PANELS):
        blocks.append(Block(f"panel{n}", (0.7 + 0.75 * n, 5.0, 1.3), (0.6, 0.06, 1.1)))
    for n in range(THINGS):
        size = rng.uniform(0.12, 0.6, 3)
        center = (rng.uniform(0.6, 5.4), rng.uniform(0.6, 4.6), size[2] / 2 if n % 2 else rng.uniform(0.4, 1.2))
        blocks.append(Block(f"thing{n}", center, tuple(size), n + 1, rng.uniform(0.0, 3.0)))
    return Scene(tuple(blocks))


@cache
def images() -> list[RgbdImage]:
    """A walk around the room."""
    rng = np.random.default_rng(1)
    made = scene()
    stuff = len(made.blocks) - THINGS
    class_of = np.array([0, *(made.id_of(block.label) for block in made.blocks)])
    true_class = np.append(0, class_of[stuff + 1 :]).astype(np.uint16)
    segmenter = Segmenter.make(NOISE, true_class, true_class[1:], rng)
    taken = []
    for n in range(IMAGES):
        angle = 2.0 * np.pi * n / IMAGES
        at = (3.0 + 2.2 * np.cos(angle), 2.5 + 1.8 * np.sin(angle), 1.4)
        pose = looking_at(at, (3.0 - np.cos(angle + 0.5), 2.5 - np.sin(angle + 0.5), 0.8))
        depth, hit = made.cast(pose, LARGE_CAMERA)
        seen = segmenter.segment(np.maximum(hit - stuff, 0).astype(np.int32), class_of[hit].astype(np.uint16), rng)
        taken.append(
            RgbdImage(
                stamp_ns=n, robot="robot", sensor="camera", depth=NOISE.depth_mm(depth, rng), intrinsics=LARGE_CAMERA,
                T_map_camera=pose, labels=seen.labels, instances=seen.instances,
            )
        )  # fmt: skip
    return taken


def things() -> np.ndarray:
    """(65536,) bool: which class ids have instances."""
    table = np.zeros(1 << 16, bool)
    for n in range(THINGS):
        table[scene().id_of(f"thing{n}")] = True
    return table


def empty() -> LayeredMap:
    return LayeredMap(voxel_size_m=0.05, instance_voxel_size_m=0.025, max_range_m=6.0, label_range_m=5.0)


def test_one_labelled_image(benchmark: BenchmarkFixture, table: Table) -> None:
    """The room is seen twice: the first time all is new."""
    layers, kinds = empty(), things()
    assert len(scene().classes) == 40

    def update(n: int) -> None:
        image = images()[n % IMAGES]
        assert image.T_map_camera is not None
        layers.label_image(image, image.T_map_camera, kinds)

    images()
    whole, _ = race(benchmark, update, {}, rounds=2 * IMAGES)
    table.add("semantic update", "640×480, 40 classes, 30 things", whole, {}, must_ms=MUST_MS)
    pieces = [len(segment(image, image.depth_m, kinds)) for image in images()]
    table.notes.append(
        f"semantic update: {np.median(pieces):.0f} masks of things an image (median), "
        f"{len(layers.instances.instances)} instances in the end"
    )
    for name, layer in (("classes", layers.semantics), ("instances", layers.instances)):
        n = layer.store.n_records
        table.notes.append(
            f"{name}: {layer.memory_bytes / n:.1f} bytes a surface voxel with all tables and room to grow "
            f"({n} voxels){f', must be ≤ {MUST_BYTES}' if name == 'classes' else ''}"
        )


def test_where_the_time_goes(benchmark: BenchmarkFixture, table: Table) -> None:
    layers, kinds = empty(), things()
    for image in images():
        layers.label_image(image, image.T_map_camera or SE3.identity(), kinds)
    seen = [segment(image, image.depth_m, kinds) for image in images()]
    steps: dict[str, Callable[[int], object]] = {
        "votes for classes": lambda n: layers.semantics.integrate_image(
            images()[n].depth_m, seen[n].labels, seen[n].trust, LARGE_CAMERA, images()[n].T_map_camera
        ),
        "lasting instances": lambda n: layers.instances.integrate_image(
            seen[n], images()[n].depth_m, LARGE_CAMERA, images()[n].T_map_camera, n
        ),
    }
    masks, others = race(benchmark, lambda n: segment(images()[n], images()[n].depth_m, kinds), steps, rounds=IMAGES)
    for name, times in {"masks to pieces": masks, **others}.items():
        table.add("of which", name, times, {})
