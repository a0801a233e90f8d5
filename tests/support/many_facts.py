"""A storey of furnished rooms as facts: as many things as wanted, each with neighbours, a support and its room."""

from __future__ import annotations

import numpy as np

from reasoning import Compound
from tests.reasoning.homes import fact, pair, thing

CLASSES = (
    "cup", "mug", "plate", "bowl", "glass", "bottle", "book", "lamp", "chair", "armchair", "sofa", "table", "desk",
    "shelf", "cabinet", "oven", "fridge", "sink", "bed", "pillow", "tv", "laptop", "keyboard", "monitor", "vase",
    "plant", "box", "basket", "towel", "knife", "fork", "spoon", "pan", "pot", "kettle", "toaster", "clock",
    "picture", "shoe", "bag",
)  # fmt: skip
COLORS = ("red", "green", "blue", "white", "black", "brown")


class Storey:
    """`n` things in rooms of 100, on a grid of 0.5 m: every tenth is a table that carries three of the others."""

    def __init__(self, n: int, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.n = n
        self.rooms = [f"room_{r}" for r in range((n + 99) // 100)]
        self.label = ["table" if i % 10 == 0 else str(self.rng.choice(CLASSES)) for i in range(n)]

    def of(self, i: int) -> list[Compound]:
        """All facts of a thing, measured anew."""
        name, room = f"object_{i}", f"room_{i // 100}"
        x, y = 6.0 * (i // 100) + 0.5 * (i % 10), 0.5 * (i // 10 % 10)
        x, y = (value + float(self.rng.normal(0.0, 0.01)) for value in (x, y))
        rests = i % 10 in (1, 2, 3)
        size = (0.8, 0.8, 0.7) if i % 10 == 0 else (0.2, 0.2, 0.2)
        facts = thing(name, self.label[i], x, y, 0.8 if rests else 0.35, size)
        facts.append(fact("attribute", name, "color", COLORS[i % len(COLORS)]))
        facts.append(fact("measured", "footprint_share", name, room, 1.0))
        if rests:
            facts.append(fact("measured", "contact", name, f"object_{i - i % 10}", float(self.rng.uniform(0.1, 1.0))))
        for step in (1, 2, 10, 11, 20):
            if i % 100 + step < 100 and i + step < self.n:
                facts += pair(name, f"object_{i + step}", float(self.rng.uniform(0.0, 2.0)))
        return facts

    def facts(self) -> list[Compound]:
        """Everything there is."""
        rooms = [fact("node", room, "room") for room in self.rooms]
        return [*rooms, *(one for i in range(self.n) for one in self.of(i))]
