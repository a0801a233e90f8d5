"""A world on disk: what is kept, and how it comes back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mapping.observations import RobotDescription
from scenegraph.config import WorldConfig
from scenegraph.errors import StoreCorrupt, StoreForeign
from scenegraph.statements import read
from scenegraph.store import WorldParts, load_world, save_world

if TYPE_CHECKING:
    from scenegraph.world import World

W = TypeVar("W", bound="World")


def save(world: World, path: Path) -> None:
    """Write a world to one file, whole or not at all."""
    save_world(
        path,
        WorldParts(
            config=world.config.model_dump(mode="json"),
            layers={**world.map.state(), "rooms": world.perception.rooms.state()},
            graph=world.graph,
            documents={
                "labels": world.labels.document(),
                "robots": [_robot(robot) for robot in world.robots.values()],
                "statements": [statement.as_json() for statement in world.statements],
                "perception": world.perception.document(),
                "events": world.event_log.document(),
                "sightings": world.sightings.document(),
            },
        ),
    )


def load(kind: type[W], path: Path) -> W:
    """Read a world; its reasoner is told all facts anew."""
    parts = load_world(path)
    if not parts.layers:
        raise StoreForeign(
            f"{path}: a graph without a map",
            hint="mapping goes on only in a world; the graph can be asked (`ask --map`) and read with "
            "scenegraph.store.load_graph",
        )
    world = kind(WorldConfig(**parts.config))
    try:
        documents = parts.documents
        world.map.restore(parts.layers)
        world.graph = parts.graph
        world.labels.restore(documents["labels"])
        world.event_log.restore(documents["events"])
        world.sightings.restore(documents.get("sightings", {}))
        world.robots = {r["robot"]: RobotDescription(**r) for r in documents["robots"]}
        for robot in world.robots.values():
            world.meaning.learn_robot(robot)
        world.perception.restore(documents["perception"], parts.layers["rooms"], world.graph)
        world.statements = [read(**told, knowledge=world.meaning.knowledge) for told in documents["statements"]]
        world.meaning.remember(world.graph, world.labels.classes, world.perception.relations.facts, world.statements)
    except (KeyError, TypeError, ValueError) as error:
        world.close()
        raise StoreCorrupt(f"{path}: a part of the world does not fit the others: {error!r}") from error
    except BaseException:
        world.close()
        raise
    return world


def _robot(robot: RobotDescription) -> dict[str, Any]:
    return {**robot.model_dump(exclude={"footprint"}), "footprint": robot.footprint.tolist()}
