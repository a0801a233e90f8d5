"""What class ids mean, unified over the label spaces of all sensors by class name."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.errors import InvalidObservation
from mapping.grid import read_only
from mapping.kernels.images import translate
from mapping.observations import ClassInfo, LabelSpace

Array: TypeAlias = NDArray[Any]
N_IDS = 1 << 16


class Labels:
    """The world's own class ids (1 …), and tables from each sensor's ids to them."""

    def __init__(self) -> None:
        self._classes: list[ClassInfo] = []
        self._ids: dict[str, int] = {}
        self._tables: dict[tuple[str | None, str | None], NDArray[np.uint16]] = {}
        self._things = np.zeros(N_IDS, bool)
        self._moving = np.zeros(N_IDS, bool)

    def learn(self, space: LabelSpace) -> list[ClassInfo]:
        """Take in a label space; returns the classes that were not known by name. Ids keep their meaning for good."""
        fresh = []
        table = np.zeros(N_IDS, np.uint16)
        for sensor_id, info in sorted(space.classes.items()):
            if info.name not in self._ids:
                self._add(info)
                fresh.append(info)
            table[sensor_id] = self._ids[info.name]
        self._tables[space.robot, space.sensor] = table
        return fresh

    def translate(self, labels: Array, robot: str, sensor: str) -> NDArray[np.uint16]:
        """A sensor's class ids as the world's; raises `InvalidObservation` for an id that no label space names."""
        for key in ((robot, sensor), (robot, None), (None, sensor), (None, None)):
            if key in self._tables:
                table = self._tables[key]
                break
        else:
            raise InvalidObservation(
                f"labels: no label space is known for {robot}/{sensor}",
                hint="publish a LabelSpace before labelled data",
            )
        translated = np.empty(labels.shape, np.uint16)
        if translate(read_only(np.ascontiguousarray(labels).ravel()), table, translated.ravel()):
            unknown = (translated == 0) & (labels != 0)
            raise InvalidObservation(
                f"labels: class id {int(labels[unknown][0])} is not in the label space of {robot}/{sensor}",
                hint="publish a LabelSpace that names it",
            )
        return translated

    def id_of(self, name: str) -> int:
        """The id of a class by name; a name that no label space has is taken in as a thing."""
        if name not in self._ids:
            self._add(ClassInfo(name=name))
        return self._ids[name]

    def _add(self, info: ClassInfo) -> None:
        self._classes.append(info)
        self._ids[info.name] = len(self._classes)
        self._things[len(self._classes)] = info.kind == "thing"
        self._moving[len(self._classes)] = info.moves

    def name(self, class_id: int) -> str:
        """The class name of an id."""
        return self._classes[class_id - 1].name

    def document(self) -> dict[str, Any]:
        """All classes and tables as JSON values."""
        tables = [[*key, [[int(i), int(t[i])] for i in np.flatnonzero(t)]] for key, t in self._tables.items()]
        return {"classes": [info.model_dump(mode="json") for info in self._classes], "tables": tables}

    def restore(self, document: dict[str, Any]) -> None:
        """Take over what `document` gave."""
        for info in document["classes"]:
            self._add(ClassInfo(**info))
        for robot, sensor, pairs in document["tables"]:
            table = np.zeros(N_IDS, np.uint16)
            for sensor_id, class_id in pairs:
                table[sensor_id] = class_id
            self._tables[robot, sensor] = table

    @property
    def classes(self) -> list[ClassInfo]:
        """All classes; index i has id i + 1."""
        return list(self._classes)

    @property
    def things(self) -> NDArray[np.bool_]:
        """(65536,) whether a class id has instances."""
        return self._things

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(65536,) whether what a class id names moves by itself."""
        return self._moving
