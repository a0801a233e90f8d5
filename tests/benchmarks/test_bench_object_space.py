"""From masks that bleed to the space of objects, beside the paper's methods (Martín et al. 2021, its Figures 8–10 and
Table 1): how many voxels, how many of them false, how many true ones lost, how long. Run with `make bench`, or

    pytest tests/benchmarks/test_bench_object_space.py --benchmark-enable -s

A plot goes where the environment variable SCENEGRAPH_PLOTS says, else to a folder that is printed. A voxel is *true*
when a measured pixel that truly shows the object lies in it (lost: of the pixels in the mask), *false* otherwise.
False voxels are those *across a step*, parted from the object by more than two voxels in depth between two
neighbouring pixels, and those on a surface that *touches* it.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.ndimage import median_filter

from mapping.datasets import open_dataset
from mapping.geometry import SE3, CameraIntrinsics
from mapping.object_space import space_of_mask, space_of_views
from mapping.observations import RgbdImage
from mapping.plane import Plane
from scenegraph.simulation import NoiseModel, simulate_home
from tests import naive_object_space as naive
from tests.support.bleeding import (
    MaskedImage,
    depth_clusters,
    eroded,
    known_planes,
    packed,
    projected,
    simulated_masks,
)
from tests.support.racing import Table, columns, race
from tests.support.recordings import recording

SIZE = 0.02
EROSION_PX = 5
NEAR_M = 3.0
"""Musts are judged where noise (σ = 14 mm at 3 m) is smaller than a voxel and pixels lie closer than voxels."""
HOMES = (11, 12, 13, 14)
"""None of the homes that were looked at when the method's constants were chosen, which were 0, 1 and 2."""
REALISTIC = NoiseModel(missed=0.0, mislabelled=0.0, confused=0.0)
EXACT = NoiseModel(0.0, 0.0, 0, (3, 8), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

Method = Callable[[MaskedImage], np.ndarray]


@dataclass
class Score:
    """Of one method and one detection: voxels, false ones across a step and on what touches, lost ones, ms."""

    voxels: int
    step: int
    touch: int
    lost: int
    ms: float
    true: int
    distance_m: float


def points_of(seen: MaskedImage, mask: np.ndarray) -> np.ndarray:
    v, u = np.nonzero(mask & (seen.depth > 0.0))
    z, c = seen.depth[v, u].astype(np.float64), seen.camera
    p = np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], axis=1)
    return np.asarray(p @ seen.T_map_camera.rotation.T + seen.T_map_camera.translation)


def ours(seen: MaskedImage, planes: list[Plane] | None = None, noise: tuple[float, float] | None = None) -> np.ndarray:
    more = {} if noise is None else {"depth_noise": noise}
    space = space_of_mask(seen.depth, seen.camera, seen.mask, SIZE, seen.T_map_camera, planes=planes, **more)
    return packed(space.voxel_ijk)


def direct(seen: MaskedImage) -> np.ndarray:
    return projected(seen.depth, seen.mask, seen.camera, seen.T_map_camera, SIZE)


def erosion(seen: MaskedImage) -> np.ndarray:
    return projected(seen.depth, eroded(seen.mask, EROSION_PX), seen.camera, seen.T_map_camera, SIZE)


def erosion_into_octree(seen: MaskedImage) -> None:
    """The erosion baseline as published: what is left of the mask goes into an octree, point by point."""
    import pyoctomap

    tree = pyoctomap.ColorOcTree(SIZE)
    for point in points_of(seen, eroded(seen.mask, EROSION_PX)):
        tree.updateNode(point, True)


def printed(seen: MaskedImage, radius: float, offsets: np.ndarray = naive.DIAGONAL) -> np.ndarray:
    """Algorithm 1, started at the middle of the mask's bounding box."""
    v, u = (int(at.min() + at.max()) // 2 for at in np.nonzero(seen.mask))
    middle = np.zeros_like(seen.mask)
    middle[v, u] = True
    start = points_of(seen, middle)
    if len(start) == 0:
        return np.empty(0, np.int64)
    cells = naive.expand_octomap(points_of(seen, seen.mask), start[0], SIZE, radius=radius, offsets=offsets)
    return packed(np.floor(cells / SIZE))


PEERS: dict[str, Method] = {
    "direct": direct,
    f"erosion by {EROSION_PX} px": erosion,
    "printed, kr/2, 8 diagonals": lambda seen: printed(seen, SIZE / 2),
    "as its text, kr, 8 diagonals": lambda seen: printed(seen, SIZE),
    "kr, 26 neighbours": lambda seen: printed(seen, SIZE, naive.ALL_26),
}


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    """So that no time is spent on reading compiled kernels."""
    ours(disc(0.0))
    ours(disc(0.0), known_planes(simulate_home(0).structure[:1]))


def judge(methods: dict[str, Method], seen: MaskedImage, scores: dict[str, list[Score]]) -> None:
    """Score each method on one detection."""
    where = (seen.camera, seen.T_map_camera, SIZE)
    shown = projected(seen.depth, seen.shown, *where)
    true = projected(seen.depth, seen.shown & seen.mask, *where)
    touching = projected(seen.depth, seen.touch, *where)
    distance = float(np.median(seen.depth[seen.shown & seen.mask]))
    for name, method in methods.items():
        started = time.perf_counter()
        voxels = method(seen)
        ms = 1e3 * (time.perf_counter() - started)
        false = np.setdiff1d(voxels, shown)
        touch = len(np.intersect1d(false, touching))
        lost = len(np.setdiff1d(true, voxels))
        scores[name].append(Score(len(voxels), len(false) - touch, touch, lost, ms, len(true), distance))


def report(title: str, scores: dict[str, list[Score]], near_m: float = NEAR_M) -> list[str]:
    """A table of all methods: shares of the objects' true voxels, up to near_m and of all, and times."""
    head = ["method", "voxels", "false: step", "touching", "lost", "all: step", "touching", "lost",
            "ms: min", "median", "mean", "max"]  # fmt: skip
    rows = []
    for name, listed in scores.items():
        near = [score for score in listed if score.distance_m <= near_m]
        ms = [score.ms for score in listed]
        shares = [
            f"{sum(getattr(s, key) for s in some) / max(sum(s.true for s in some), 1):.2%}"
            for some in (near, listed)
            for key in ("step", "touch", "lost")
        ]
        times = [f"{value:.1f}" for value in (min(ms), np.median(ms), np.mean(ms), max(ms))]
        rows.append([name, str(sum(s.voxels for s in near)), *shares, *times])
    first = next(iter(scores.values()))
    count = sum(score.distance_m <= near_m for score in first)
    return [f"{title}: {count} detections up to {near_m:g} m, {len(first)} in all", *columns([head, *rows])]


def draw(scores: dict[str, list[Score]], title: str, folder: Path) -> Path:
    """The paper's Figures 8 (voxels), 9 (differences, here false and lost ones) and 10 (times) over all detections."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 11.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 1, sharex=True)
    order = np.argsort([score.true for score in next(iter(scores.values()))])
    for name, listed in scores.items():
        picked = [listed[n] for n in order]
        true = np.array([max(score.true, 1) for score in picked])
        for axis, values in zip(
            axes,
            (
                np.array([score.voxels for score in picked]),
                100.0 * np.array([score.step + score.touch for score in picked]) / true,
                100.0 * np.array([score.lost for score in picked]) / true,
                np.array([score.ms for score in picked]),
            ),
            strict=True,
        ):
            (line,) = axis.plot(values, ".", markersize=2.5, alpha=0.5)
            axis.plot(median_filter(values, 25, mode="nearest"), color=line.get_color(), label=name)
    for axis, words, scale in zip(
        axes, ("voxels", "false [% of true]", "lost [% of true]", "time [ms]"), ("log", "symlog", "linear", "log"),
        strict=True,
    ):  # fmt: skip
        axis.set_ylabel(words)
        axis.set_yscale(scale)
        axis.set_ylim(bottom=0.0 if scale != "log" else None)
        axis.grid(alpha=0.3)
    axes[0].legend(ncols=3, fontsize=8)
    axes[0].set_title(title)
    axes[-1].set_xlabel("detections, by their number of true voxels; lines: running medians of 25")
    path = folder / f"object_space_{title.split(',')[0].replace(' ', '_')}.png"
    figure.savefig(path, dpi=110)
    return path


@pytest.fixture
def plots(tmp_path: Path) -> Path:
    folder = Path(os.environ.get("SCENEGRAPH_PLOTS") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def note(table: Table, title: str, scores: dict[str, list[Score]], folder: Path) -> None:
    table.notes += ["", *report(title, scores), f"plot: {draw(scores, title, folder)}"]


def share(scores: Iterable[Score], key: str) -> float:
    near = [score for score in scores if score.distance_m <= NEAR_M]
    return sum(getattr(s, key) for s in near) / sum(s.true for s in near)


def test_masks_of_simulated_homes(benchmark: BenchmarkFixture, table: Table, plots: Path) -> None:
    scores: dict[str, list[Score]] = defaultdict(list)
    exact: dict[str, list[Score]] = defaultdict(list)

    def run() -> None:
        for seed in HOMES:
            home = simulate_home(seed)
            planes = known_planes(home.structure)
            methods: dict[str, Method] = {"product": ours, "with planes": lambda seen, p=planes: ours(seen, p)}
            for seen in simulated_masks(home, noise=REALISTIC, voxel_size_m=SIZE, images_per_room=3, every=4):
                judge({**methods, **PEERS}, seen, scores)
            methods = {
                "product": lambda seen: ours(seen, None, (0.0, 0.0)),
                "with planes": lambda seen, p=planes: ours(seen, p, (0.0, 0.0)),
            }
            for seen in simulated_masks(home, noise=EXACT, voxel_size_m=SIZE, images_per_room=3, every=8):
                judge({**methods, "direct": direct, f"erosion by {EROSION_PX} px": erosion}, seen, exact)

    benchmark.pedantic(run, rounds=1)
    note(table, "simulated homes, noise of a structured-light camera", scores, plots)
    table.notes += ["", *report("exact depth, no missing pixels", exact)]
    found = scores["product"]
    assert share(found, "step") <= 0.01
    assert share(found, "lost") <= 0.02


@pytest.mark.parametrize("name", ["tum_fr1_rpy_rgbd", "open3d_icl_livingroom_rgbd"])
def test_masks_of_real_images(benchmark: BenchmarkFixture, table: Table, plots: Path, name: str) -> None:
    images = [image for image in open_dataset(recording(name)) if isinstance(image, RgbdImage)]
    scores: dict[str, list[Score]] = defaultdict(list)

    def run() -> None:
        for n, image in enumerate(islice(images, 0, None, max(len(images) // 15, 1))):
            for seen in depth_clusters(image, seed=n):
                judge({"product": ours, **PEERS}, seen, scores)

    benchmark.pedantic(run, rounds=1)
    note(table, f"{name}, masks are clusters of depth", scores, plots)


def test_several_views_and_planes(benchmark: BenchmarkFixture, table: Table) -> None:
    """Things on true planes, seen from several places: what is false after votes over views."""
    sums = {key: np.zeros(4) for key in ("one view", "one view, planes", "views", "views, planes")}

    def run() -> None:
        for seed in HOMES[:3]:
            home = simulate_home(seed)
            planes = known_planes(home.structure)
            seen_of: dict[int, list[MaskedImage]] = defaultdict(list)
            for seen in simulated_masks(home, noise=REALISTIC, voxel_size_m=SIZE, images_per_room=8, every=2):
                if np.median(seen.depth[seen.shown & seen.mask]) <= NEAR_M:
                    seen_of[seen.entity].append(seen)
            for views in seen_of.values():
                if len(views) >= 3:
                    join(views[:6], planes, sums)

    benchmark.pedantic(run, rounds=1)
    head = ["way", "true voxels", "false: step", "touching", "lost"]
    rows = [[key, f"{s[0]:.0f}", *(f"{value / s[0]:.2%}" for value in s[1:])] for key, s in sums.items()]
    table.notes += ["", f"things seen 3 to 6 times within {NEAR_M:g} m:", *columns([head, *rows])]
    assert sums["views, planes"][2] <= 0.05 * sums["views, planes"][0]


def join(views: list[MaskedImage], planes: list[Plane], sums: dict[str, np.ndarray]) -> None:
    """Add up the true voxels of one thing's views, and false ones across a step, on what touches, and lost ones."""
    where = [(seen.camera, seen.T_map_camera, SIZE) for seen in views]
    shown = [projected(seen.depth, seen.shown, *at) for seen, at in zip(views, where, strict=True)]
    true = [projected(seen.depth, seen.shown & seen.mask, *at) for seen, at in zip(views, where, strict=True)]
    touching = [projected(seen.depth, seen.touch, *at) for seen, at in zip(views, where, strict=True)]
    for known, name in ((None, ""), (planes, ", planes")):
        spaces = [
            space_of_mask(s.depth, s.camera, s.mask, SIZE, s.T_map_camera, planes=known, with_others=True)
            for s in views
        ]
        for n, space in enumerate(spaces):
            sums["one view" + name] += count(packed(space.voxel_ijk), shown[n], true[n], touching[n])
        joined = packed(space_of_views(spaces).voxel_ijk)
        sums["views" + name] += count(joined, *(np.unique(np.concatenate(a)) for a in (shown, true, touching)))


def count(voxels: np.ndarray, shown: np.ndarray, true: np.ndarray, touching: np.ndarray) -> np.ndarray:
    false = np.setdiff1d(voxels, shown)
    touch = len(np.intersect1d(false, touching))
    return np.array([len(true), len(false) - touch, touch, len(np.setdiff1d(true, voxels))])


def disc(noise_m: float) -> MaskedImage:
    """A detection of 50 000 pixels: a slanted disc 1.5 m away, before a wall."""
    camera = CameraIntrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480)
    v, u = np.mgrid[:480, :640]
    away = np.hypot(v - 240, u - 320)
    depth = np.where(away < 120, 1.5 + 0.001 * (u - 320), 2.5)
    depth += np.random.default_rng(0).normal(0.0, noise_m, depth.shape)
    own, mask = away < 120, away < 126
    pose = SE3.identity()
    return MaskedImage("disc", depth.astype(np.float32), mask, camera, pose, pose, own, mask & ~own, mask & False)


def test_time(benchmark: BenchmarkFixture, table: Table) -> None:
    seen = disc(0.0035)
    assert 49_000 < seen.mask.sum() < 51_000
    peers = {name: (lambda n, m=method: m(seen)) for name, method in PEERS.items()}
    peers["erosion into an octree (pyoctomap)"] = lambda n: erosion_into_octree(seen)
    taken, theirs = race(
        benchmark,
        lambda n: space_of_mask(seen.depth, seen.camera, seen.mask, SIZE, seen.T_map_camera),
        peers, rounds=40, peer_every=8,
    )  # fmt: skip
    shares = dict.fromkeys([*list(PEERS)[2:], "erosion into an octree (pyoctomap)"], 0.1)
    table.add("space of a mask of 50k pixels, 2 cm", "–", taken, theirs, must_ms=15.0, must_share=shares)
