"""Simulated homes, one after the other: mapped on a tour, then judged floor by floor."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import partial
from multiprocessing import get_context

import numba

from mapping.observations import RgbdImage
from scenegraph.config import WorldConfig
from scenegraph.evaluation.access import judge_access
from scenegraph.evaluation.doors import judge_doors
from scenegraph.evaluation.graph import judge_objects, judge_planes, judge_rooms
from scenegraph.evaluation.relations import judge_relations
from scenegraph.evaluation.result import Evaluation
from scenegraph.evaluation.second_tour import take_second_tour
from scenegraph.evaluation.semantics import judge_voxels
from scenegraph.evaluation.views import ViewLog
from scenegraph.simulation import Home, TruthRecorder, simulate_home
from scenegraph.simulation.noise import Noise, NoiseModel
from scenegraph.simulation.observing import noise_model
from scenegraph.world import World

__all__ = ["evaluate", "judge", "map_home"]


def evaluate(
    seeds: int,
    first_seed: int = 0,
    *,
    noise: Noise = "realistic",
    mislabelled: float | None = None,
    config: WorldConfig | None = None,
    second_tour: bool = False,
    workers: int = 1,
    advance: Callable[[], object] | None = None,
) -> Evaluation:
    """Map `seeds` simulated homes, beginning with `first_seed`, and judge each against its truth.

    noise       *none*, *realistic*, or a `NoiseModel`
    mislabelled share of the things that get a wrong class in an image, drawn anew for each; instead of the noise's own
    second_tour whether each home is then changed and mapped again, see `evaluation.second_tour`
    workers     processes that map homes at the same time; with more than one, the times of images say little
    advance     called after each home

    Raises `InvalidParameter` on a noise that does not exist, or a share outside 0 … 1.
    """
    model = noise_model(noise, mislabelled)
    result = Evaluation(noise=model)
    one = partial(_evaluate_home, noise=model, config=config, second_tour=second_tour)
    with ExitStack() as stack:
        homes = range(first_seed, first_seed + seeds)
        if workers > 1:
            pool = ProcessPoolExecutor(
                workers, mp_context=get_context("spawn"), initializer=_share_cores, initargs=(workers,)
            )
            found = stack.enter_context(pool).map(one, homes)
        else:
            found = map(one, homes)
        for home in found:
            result.merge(home)
            if advance is not None:
                advance()
    return result


def _share_cores(workers: int) -> None:
    numba.set_num_threads(max(1, numba.get_num_threads() // workers))


def _evaluate_home(seed: int, *, noise: NoiseModel, config: WorldConfig | None, second_tour: bool) -> Evaluation:
    result = Evaluation(seeds=[seed], noise=noise)
    home = simulate_home(seed)
    with World(config) as world:
        views = ViewLog(world.map.semantics.voxel_size_m, world.config.label_range_m)
        recorder, times = map_home(world, home, noise, seed, views)
        things = judge(world, home, recorder, result, views)
        if second_tour:
            take_second_tour(world, home, recorder, things, noise, seed, result)
    result.image_ms += times
    return result


def map_home(
    world: World, home: Home, noise: Noise, seed: int, views: ViewLog | None = None
) -> tuple[TruthRecorder, list[float]]:
    """Take a tour of a home; returns what was truly seen, and the time of each image after the first ten [ms].

    views : takes down the labels of each image, where the map took it to be seen from
    """
    recorder = TruthRecorder(home)
    times: list[float] = []
    for observation in home.observe(noise=noise, seed=seed, recorder=recorder):
        started = time.perf_counter()
        world.integrate(observation)
        if isinstance(observation, RgbdImage):
            times.append((time.perf_counter() - started) * 1e3)
            if views is not None and world.T_map_camera is not None:
                views.add(observation, world.T_map_camera)
    return recorder, times[10:]


def judge(
    world: World, home: Home, recorder: TruthRecorder, result: Evaluation, views: ViewLog | None = None
) -> dict[str, str]:
    """Add one home's counts to `result`; what single views say of it too, when they were taken down.

    Returns node id → true id of the things that were found.
    """
    countable = recorder.countable
    result.uncounted += [f"{home.seed}: {o.id}" for o in home.objects if o.id not in countable]
    things = judge_objects(world, home, countable, result, confused=recorder.confused)
    rooms = judge_rooms(world, home, result)
    doors = judge_doors(world, home, rooms, result)
    judge_relations(world, home, things | rooms, countable, result)
    judge_access(world, home, things, doors, result)
    judge_planes(world, home, recorder, result)
    result.notes += judge_voxels(world, home, recorder, result.semantics, views)
    return things
