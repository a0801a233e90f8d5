"""What the demo shows: tables for people as it goes, one JSON object for programs at its end, and both in a file."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenegraph import console
from scenegraph.exporting import write_text

if TYPE_CHECKING:
    from scenegraph.console import Printer
    from scenegraph.graph import Node, SceneGraph
    from scenegraph.simulation import Home, Tour

__all__ = ["Shown", "reason_in_words"]

_LABELS = ("wall", "floor", "ceiling", "door", "window", "no_feature")
_ROWS = 6
_VOXELS = 512  # of a block


class Shown:
    """Prints each part as it comes, and keeps it for the report."""

    def __init__(self, printer: Printer) -> None:
        self._printer = printer
        self._kept: dict[str, Any] = {"legs": [], "questions": []}
        self._leg = ""

    # -- the tour ----------------------------------------------------------------------------------------------
    def start(self, endpoint: str, home: Home, tour: Tour) -> None:
        """The server runs and the home is built."""
        self._kept["home"] = {"seed": home.seed, "rooms": len(home.rooms), "objects": len(home.objects)}
        self._kept["images"] = len(tour)
        self._line(f"A server runs as its own process at {endpoint}.")
        self._line(
            f"A simulated robot takes {len(tour)} images on its tour of home {home.seed} ({len(home.rooms)} rooms, "
            f"{len(home.objects)} things)\nand publishes them over Zenoh, noisy as a real camera's. "
            "The first takes longer: kernels are compiled once."
        )

    @contextmanager
    def leg(self, room: str, images: int) -> Iterator[Any]:
        """One room of the tour, with a progress bar."""
        self._leg = f"{room}, {images} images"
        with self._printer.progress(f"  {self._leg}", images) as advance:
            yield advance

    def grown(self, status: Mapping[str, Any]) -> None:
        """What the map and the graph hold after a leg."""
        state = status["state"]
        megabytes = sum(layer["memory_bytes"] for layer in state["layers"].values()) / 1e6
        blocks = sum(layer["blocks"] for layer in state["layers"].values())
        nodes = state["nodes"]
        self._kept["legs"].append(
            {"leg": self._leg, "blocks": blocks, "megabytes": round(megabytes, 1), "nodes": nodes}
        )
        self._line(
            f"  {self._leg:<26} → {blocks:>6} blocks, {megabytes:>5.0f} MB, {nodes.get('structure', 0):>3} planes, "
            f"{nodes.get('room', 0)} rooms, {nodes.get('object', 0):>3} objects, {state['edges']:>4} edges"
        )

    # -- what the world holds ----------------------------------------------------------------------------------
    def layers(self, status: Mapping[str, Any]) -> None:
        """A row for each layer."""
        layers = status["state"]["layers"]
        self._kept["layers"] = layers
        self._kept["inputs"] = status["inputs"]
        rows = [
            (name, d["voxel_size_m"], d["blocks"], f"{_VOXELS * d['blocks']:,}", round(d["memory_bytes"] / 1e6, 1))
            for name, d in layers.items()
        ]
        self._table("\nWhat each layer holds", ("layer", "voxel [m]", "blocks", "voxels", "memory [MB]"), rows)

    def planes(self, graph: SceneGraph) -> None:
        """Planes by label, and the largest ones."""
        structure = graph.nodes("structure")
        count = Counter(node.label for node in structure)
        area: defaultdict[str, float] = defaultdict(float)
        for node in structure:
            area[node.label] += _area(node)
        labels = [*(label for label in _LABELS if label in count), *sorted(set(count) - set(_LABELS))]
        rows = [(label.replace("_", " "), count[label], round(area[label], 1)) for label in labels]
        self._kept["planes"] = [{"label": label, "count": n, "area_m2": a} for label, n, a in rows]
        self._table("\nThe planes and their labels", ("label", "count", "area [m²]"), rows)
        largest = sorted(structure, key=_area, reverse=True)[:_ROWS]
        told = [(n.id, n.label.replace("_", " "), round(_area(n), 1), _size(n)) for n in largest]
        self._table("the largest", ("plane", "label", "area [m²]", "width × height [m]"), told)

    def rooms(self, graph: SceneGraph) -> None:
        """Each room with its type, why, and what is in it."""
        rows, kept = [], []
        for room in graph.nodes("room"):
            inside = [graph.node(edge.source) for edge in graph.edges("in", target=room.id)]
            things = Counter(node.label for node in inside if node.layer == "object")
            kind = str(room.attributes.get("type", "unknown"))
            reason = reason_in_words(str(room.attributes.get("type_reason", "nothing speaks for a type")))
            listed = ", ".join(label if n == 1 else f"{n} {label}" for label, n in sorted(things.items()))
            kept.append({"room": room.id, "type": kind, "reason": reason, "objects": dict(things)})
            rows.append((room.id, kind.replace("_", " "), reason, room.attributes.get("area_m2"), listed))
        self._kept["rooms"] = kept
        self._table("\nThe rooms and their objects", ("room", "type", "because of", "m²", "objects"), rows)

    # -- questions ---------------------------------------------------------------------------------------------
    def question(self, number: int, english: str, goal: str, answers: Any) -> None:
        """A question with its answers, and why the first one holds, or why there is none."""
        rows = [dict(row) for row in answers]
        why = console.plain_explanation(answers.explain())
        self._kept["questions"].append(
            {
                "question": english,
                "goal": goal,
                "truth": answers.truth,
                "answers": [{name: console.plain(value) for name, value in row.items()} for row in rows],
                "explanation": why,
                "problem": console.plain_problem(answers.problem),
            }
        )
        if self._printer.json:
            return
        self._printer.line(f"\n{number}. {english}", "bold")
        self._printer.line(f"   {goal}", "cyan")
        count = f"{len(rows)} answers" if len(rows) != 1 else "1 answer"
        self._printer.truth(answers.truth, f"   {count}, {answers.elapsed_ms:.1f} ms" if rows else "")
        for row in rows[:_ROWS]:
            self._printer.line("   " + ", ".join(f"{name} = {console.shown(value)}" for name, value in row.items()))
        if len(rows) > _ROWS:
            self._printer.line(f"   … and {len(rows) - _ROWS} more")
        if answers.problem is not None:
            self._printer.problem(answers.problem.code, answers.problem.message, answers.problem.hint)
        if why is not None:
            self._printer.explanation({**why, "children": why["children"][:1]} if rows else why, brief=True)

    def place(self, place: Any) -> None:
        """Where a phrase leads to."""
        self._kept["where"] = console.plain_place(place)
        if not self._printer.json:
            self._printer.line(f'\nWhere is "{place.phrase}", and where can the robot stand there?', "bold")
            self._printer.place(place, corners=False)

    # -- the end -----------------------------------------------------------------------------------------------
    def truth(self, told: Mapping[str, Any]) -> None:
        """The comparison with what the home really holds, in one line."""
        self._kept["truth"] = told
        figures = told["figures"]
        words = [
            f"{name} {figures[f'{key}.precision']:.2f}/{figures[f'{key}.recall']:.2f}"
            for name, key in [("objects", "objects"), ("rooms", "rooms")]
            + [(relation, f"relations.{relation}") for relation in ("on", "in", "near")]
            if f"{key}.precision" in figures
        ]
        planes = f", planes labelled right {figures['planes.accuracy']:.2f}" if "planes.accuracy" in figures else ""
        self._line(f"\nAgainst the truth (precision/recall): {', '.join(words)}{planes}", "bold")

    def end(self, files: Mapping[str, Path], seconds: Mapping[str, float], report: Path) -> None:
        """Where the files are, and what took how long. Writes the report."""
        self._kept |= {"files": {name: str(path) for name, path in files.items()}, "seconds": dict(seconds)}
        write_text(report, json.dumps(self._kept, indent=1, default=str) + "\n")
        if self._printer.json:
            self._printer.document(self._kept)
            return
        self._line("\nWall time: " + ", ".join(f"{part} {s:.0f} s" for part, s in seconds.items()))
        self._line("Look at:")
        for name, path in files.items():
            self._line(f"  {name:<18} {path}")
        program = sys.argv[0] if sys.argv[0].endswith("scenegraph") else "scenegraph"  # as it was called
        self._line(f"Ask it yourself:  {program} ask 'near(X, sofa)' --explain --map {files['world']}")

    def _line(self, text: str, style: str = "") -> None:
        if not self._printer.json:
            self._printer.line(text, style)

    def _table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        if not self._printer.json:
            self._printer.table(title, columns, rows)


def reason_in_words(reason: str) -> str:
    """`evidence(3.7, [speaks(bed,2.0), speaks(nightstand,0.8)])` → `bed 2.0, nightstand 0.8`; else as it is."""
    spoken = re.findall(r"speaks\((\w+),\s*([\d.]+)\)", reason)
    return ", ".join(f"{what.replace('_', ' ')} {float(weight):g}" for what, weight in spoken) or reason


def _area(node: Node) -> float:
    if "area_m2" not in node.attributes and node.box is not None:
        return float(np.prod(np.sort(node.box.size)[1:]))
    return float(node.attributes.get("area_m2", 0.0))


def _size(node: Node) -> str:
    if node.box is None:
        return "–"
    wide, thin, high = (float(s) for s in node.box.size)
    return f"{max(wide, thin):.1f} × {high if node.label not in ('floor', 'ceiling') else min(wide, thin):.1f}"
