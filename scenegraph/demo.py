"""The main job, shown: a server of its own, a simulated robot that tours a home, questions, a picture, and the truth.

Whatever is printed was asked of the server over Zenoh, but for the last line: that compares the world the server saved
with what the home really holds.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapping.observations import RgbdImage
from scenegraph import console
from scenegraph.demo_report import Shown
from scenegraph.errors import ExportError
from scenegraph.graph import Box, SceneGraph
from scenegraph.server_process import heed, server_process

if TYPE_CHECKING:
    from scenegraph.console import Printer
    from scenegraph.service.client import Client
    from scenegraph.simulation import Home, Tour, TruthRecorder

__all__ = ["IMAGES_PER_ROOM", "QUESTIONS", "Question", "run"]

IMAGES_PER_ROOM = 14
WORLD = "home"
ROBOT = "robot"
PHRASE = "near the oven"


@dataclass(frozen=True)
class Question:
    """A goal, and what it means in English."""

    english: str
    goal: str


QUESTIONS = (
    Question("What is near the oven?", "near(X, oven)"),
    Question("What does a cup stand on?", "on(cup, Y)"),
    Question("What on a table in the kitchen is not near the oven?", "in(X, kitchen), on(X, table), \\+ near(X, oven)"),
    Question("Is there an umbrella near a bed? (None was ever seen.)", "near(umbrella, bed)"),
    Question("What in the kitchen is left of the oven, as the robot sees it?", "left_of(X, oven), in(X, kitchen)"),
)


@dataclass
class Clock:
    """Wall time of each part [s], in order."""

    parts: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def time(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        try:
            yield
        finally:
            self.parts[part] = round(self.parts.get(part, 0.0) + time.perf_counter() - began, 1)


def run(*, output: Path, seed: int, printer: Printer, images_per_room: int = IMAGES_PER_ROOM) -> None:
    """Map the simulated home of that seed over Zenoh, ask about it, draw it, and compare it with the truth.

    output   folder for the picture, the mesh, the graph, the saved world and the report; made when it is missing

    Raises `ExportError` when the folder cannot be written, and `ServiceError` when the server does not do its part.
    """
    from scenegraph.service.client import Client

    files = Files.in_folder(output)
    show, clock = Shown(printer), Clock()
    began = time.perf_counter()
    with server_process(WORLD, files.world, files.log) as endpoint:
        with clock.time("server and home"):
            home, tour, recorder = _home(seed, images_per_room)
        show.start(endpoint, home, tour)
        with Client(WORLD, endpoint) as client:
            with clock.time("mapping"):
                _drive(client, home, tour, recorder, show)
            with clock.time("questions"):
                _ask(client, show)
            with clock.time("picture"):
                _draw(client, home, tour, files)
    with clock.time("truth"):
        show.truth(_figures(files.world, home, recorder))
    clock.parts["altogether"] = round(time.perf_counter() - began, 1)
    show.end(files.kept(), clock.parts, files.report)


@dataclass(frozen=True)
class Files:
    """What the demo leaves behind."""

    picture: Path
    mesh: Path
    graph: Path
    world: Path
    report: Path
    log: Path

    @classmethod
    def in_folder(cls, folder: Path) -> Files:
        """In a folder that is made, and without what an earlier run left there. Raises `ExportError`."""
        names = ("picture.png", "mesh.ply", "graph.json", "home.world", "report.json", "server.log")
        files = cls(*(folder / name for name in names))
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for path in vars(files).values():
                path.unlink(missing_ok=True)
            files.log.touch()
        except OSError as error:
            raise ExportError(
                f"{folder}: cannot be written: {error.strerror}", hint="name another folder with --output"
            ) from None
        return files

    def kept(self) -> dict[str, Path]:
        """What is in each file; a log that is empty is taken away."""
        if self.log.stat().st_size == 0:
            self.log.unlink()
        told = {
            "picture": self.picture,
            "surface": self.mesh,
            "scene graph": self.graph,
            "world": self.world,
            "this report": self.report,
            "the server's log": self.log,
        }
        return {name: path for name, path in told.items() if path.exists() or path == self.report}


# -- the robot -------------------------------------------------------------------------------------------------------


def _home(seed: int, images_per_room: int) -> tuple[Home, Tour, TruthRecorder]:
    from scenegraph.simulation import Tour, TruthRecorder, simulate_home

    home = simulate_home(seed)
    return home, Tour(home, images_per_room=images_per_room), TruthRecorder(home)


def _drive(client: Client, home: Home, tour: Tour, recorder: TruthRecorder, show: Shown) -> None:
    """Publish the whole tour: while the server maps an observation the next is rendered, and none is dropped."""
    stream = home.observe(noise="realistic", seed=home.seed, tour=tour, recorder=recorder)
    kinds = {room.id: room.kind for room in home.rooms}
    sender = ThreadPoolExecutor(1)
    on_its_way: Future[Any] | None = None
    try:
        for room, count in legs([step.room for step in tour.steps]):
            with show.leg(kinds[room].replace("_", " "), count) as advance:
                images = 0
                while images < count:
                    heed()
                    observation = next(stream)
                    if on_its_way is not None:
                        on_its_way.result()
                    on_its_way = sender.submit(client.integrate, observation)
                    if isinstance(observation, RgbdImage):
                        images += 1
                        advance()
                if on_its_way is not None:
                    on_its_way.result()
                show.grown(console.plain_status(client))
    finally:
        sender.shutdown(wait=False, cancel_futures=True)


def legs(rooms: list[str], least: int = 5) -> list[tuple[str, int]]:
    """The rooms of a tour's steps as legs, room and number of steps; a passage of few steps belongs to what follows."""
    found: list[tuple[str, int]] = []
    passed = 0
    for room, steps in groupby(rooms):
        count = sum(1 for _ in steps)
        passed += count
        if count >= least or not found:
            if found and found[-1][0] == room:
                passed += found.pop()[1]
            found.append((room, passed))
            passed = 0
    if passed:
        found[-1] = (found[-1][0], found[-1][1] + passed)
    return found


# -- what came of it -------------------------------------------------------------------------------------------------


def _ask(client: Client, show: Shown) -> None:
    graph = client.graph()
    show.layers(console.plain_status(client))
    show.planes(graph)
    show.rooms(graph)
    for number, question in enumerate(QUESTIONS, start=1):
        answers = client.ask(question.goal, robot=ROBOT, limit=50)
        show.question(number, question.english, question.goal, answers)
    show.place(client.where(PHRASE, robot=ROBOT))


def _draw(client: Client, home: Home, tour: Tour, files: Files) -> None:
    """The picture, the surface and the graph, all from the server."""
    from scenegraph.exporting import layers_of_server, write_text
    from scenegraph.picture import draw

    mesh = layers_of_server(client)("tsdf").mesh()
    mesh.write_ply(files.mesh)
    snapshot = client.snapshot()
    write_text(files.graph, snapshot.model_dump_json())
    draw(
        SceneGraph.from_snapshot(snapshot),
        files.picture,
        points=mesh.vertices,
        colors=mesh.colors,
        normals=mesh.normals,
        trajectory=[step.T_map_base.translation for step in tour.steps],
        truth=[(o.label, Box(center=o.center, size=o.size, rotation_wxyz=o.rotation_wxyz)) for o in home.objects],
        title=f"simulated home {home.seed}",
    )


def _figures(saved: Path, home: Home, recorder: TruthRecorder) -> dict[str, Any]:
    """How the saved world compares with what the home holds."""
    from scenegraph.evaluation import Evaluation, judge
    from scenegraph.world import World

    result = Evaluation()
    with World.load(saved) as world:
        judge(world, home, recorder, result)
    return {"figures": result.figures(), "notes": result.notes, "uncounted": len(result.uncounted)}
