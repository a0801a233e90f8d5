"""What the command line prints: tables and trees for people, JSON for programs."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text
from rich.tree import Tree

from reasoning.knowledge import Test

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["Printer"]

TRUTH_STYLES = {"true": "bold green", "false": "bold red", "unknown": "bold yellow"}


class Printer:
    """Prints results to standard output and errors and progress to standard error.

    json   print each result as one JSON object instead of tables
    """

    def __init__(self, *, json: bool = False) -> None:
        self.json = json
        self.out = Console(highlight=False)
        self.err = Console(stderr=True, highlight=False)

    # -- for programs ----------------------------------------------------------------------------------------
    def document(self, value: Any) -> None:
        """One JSON object, in one line. JSON has no NaN and no infinity: they become null."""
        print(json.dumps(_finite(value), ensure_ascii=False, allow_nan=False, default=str), flush=True)

    # -- for people ------------------------------------------------------------------------------------------
    def line(self, text: str, style: str = "") -> None:
        self.out.print(Text(text, style=style), soft_wrap=True)

    def problem(self, code: str, message: str, hint: str | None = None) -> None:
        """One line that says what is wrong, and the hint, if any; with `--json` an object too."""
        message = " ".join(message.split())
        if self.json:
            self.document({"problem": {"code": code, "message": message, "hint": hint}})
        text = f"{message} ({hint})" if hint else message
        self.err.print(Text("error: ", style="bold red").append(text, style="default"), soft_wrap=True)

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """A table; numbers are set to the right."""
        rows = [tuple(row) for row in rows]
        table = Table(
            title=Text(title) if title else None, title_justify="left", title_style="bold", min_width=len(title)
        )
        for i, column in enumerate(columns):
            numbers = bool(rows) and all(isinstance(row[i], int | float) for row in rows)
            table.add_column(Text(column), justify="right" if numbers else "left", overflow="fold")
        for row in rows:
            table.add_row(*(cell if isinstance(cell, Text) else Text(shown(cell)) for cell in row))
        self.out.print(table)

    def truth(self, truth: str, note: str = "") -> None:
        self.out.print(Text(truth, style=TRUTH_STYLES.get(truth, "")).append(note, style="default"), soft_wrap=True)

    def explanation(self, explanation: Mapping[str, Any], *, brief: bool = False) -> None:
        """A proof tree: what holds by which rule, with the measured values and their thresholds.

        brief   without the facts behind measured values
        """
        self.out.print(_tree(explanation, brief))

    def answers(self, answers: Any, rows: Sequence[Mapping[str, Any]], why: Mapping[str, Any] | None) -> None:
        """The truth, the bindings as a table, and the proof tree when it was asked for."""
        more = ", and more" if answers.truncated else ""
        count = f"{len(rows)} answer{'' if len(rows) == 1 else 's'}{more}"
        self.truth(answers.truth, f"   {count}, {answers.elapsed_ms:.1f} ms")
        if rows and rows[0]:
            names = list(rows[0])
            self.table("", names, ([row.get(name) for name in names] for row in rows))
        if why is not None:
            self.explanation(why)

    def change(self, change: Any) -> None:
        """How the answers to a watched goal changed: a line for each that came or went."""
        self.truth(change.truth, f"   revision {change.revision}, {len(list(change.answers))} answers")
        for sign, rows, style in (("+", change.came, "green"), ("-", change.went, "red")):
            for row in rows:
                self.line(f"  {sign} " + ", ".join(f"{name} = {shown(value)}" for name, value in row.items()), style)
        if change.problem is not None:
            self.problem(**(plain_problem(change.problem) or {}))

    def place(self, place: Any, *, corners: bool = True) -> None:
        """Each reading of a phrase: its nodes, its region (all corners, or its extent), and the poses to stand at."""
        self.truth(place.truth, f"   {place.phrase}")
        for number, answer in enumerate(place.answers, start=1):
            region = answer.region
            about = ", ".join(getattr(node, "id", str(node)) for node in answer.nodes)
            self.line(f"{number}. {about}")
            if region is not None:
                ring = " ".join(f"({x:.2f}, {y:.2f})" for x, y in region.polygon) if corners else _extent(region)
                self.line(f"   region {ring}, z {region.z_min:.2f} … {region.z_max:.2f} m")
            if answer.poses:
                self.table(
                    "   where to stand", ("x [m]", "y [m]", "yaw [°]", "clearance [m]", "way [m]"), _poses(answer)
                )
        if place.ambiguous:
            self.line(f"ambiguous: it could be {', '.join(map(str, place.ambiguous))}", "yellow")

    def plan(self, plan: Any) -> None:
        """The status, and the steps in order, each with where to stand for it."""
        rooms = " → ".join(plan.rooms)
        self.plan_status(plan.status, f"   {plan.goal}" + (f"   {rooms}" if rooms else ""))
        if plan.steps:
            rows = ((k, s.action, ", ".join(s.arguments), *_stand(s.target)) for k, s in enumerate(plan.steps, start=1))
            self.table("", ("", "action", "of", "x [m]", "y [m]", "yaw [°]"), rows)

    def plan_status(self, status: str, note: str = "") -> None:
        style = {"solved": "true", "unsolvable": "false"}.get(status, "unknown")
        self.out.print(Text(status, style=TRUTH_STYLES[style]).append(note, style="default"), soft_wrap=True)

    def replayed(self, dataset: Any, told: Any) -> None:
        """What became of a recording."""
        figures = told.as_json()
        rows = [(kind, n) for kind, n in figures["observations"].items()]
        rows += [(f"skipped: {reason}", n) for reason, n in dataset.skipped.items() if n]
        rows += [(f"refused: {reason}", n) for reason, n in figures["refused"].items()]
        self.table(f"{dataset.name} ({dataset.format})", ("observations", "count"), rows)
        times = figures["image_ms"]
        if times["median"] is not None:
            self.line(
                f"{figures['elapsed_s']:.1f} s; an image or scan takes {times['median']:.0f} ms (median), "
                f"{times['p99']:.0f} ms (p99)"
            )

    def status(self, status: Mapping[str, Any]) -> None:
        """What each layer holds and how many nodes there are; of a server, its health too."""
        state = status.get("state", status)
        if "world" in status:
            self.line(f"world {status['world']}, up {status['uptime_s']:.0f} s, version {status['version']}", "bold")
        layers = state.get("layers", {})
        self.table(
            "map",
            ("layer", "voxel [m]", "blocks", "memory [MB]"),
            (
                (name, layer.get("voxel_size_m"), layer.get("blocks"), round(layer.get("memory_bytes", 0) / 1e6, 1))
                for name, layer in layers.items()
            ),
        )
        counts = {**state.get("nodes", {}), "edges": state.get("edges", 0)}
        self.table(
            f"graph, revision {state.get('revision', status.get('revision'))}", ("layer", "count"), counts.items()
        )
        inputs = status.get("inputs") or {}
        if inputs:
            names = ("received", "taken", "dropped", "refused", "waiting")
            self.table("inputs", ("input", *names), ((key, *(n[name] for name in names)) for key, n in inputs.items()))
        if status.get("problems"):
            self.line(f"{status['problems']} messages were refused; their causes are on `problems`", "yellow")

    def figures(self, evaluation: Any) -> None:
        """The figures of an evaluation, one a line, and its label accuracy by the number of views."""
        told = evaluation.as_json()
        noise = told["noise"]
        faults = f", {noise['mislabelled']:.0%} of things mislabelled an image" if noise else ""
        self.table(
            f"{told['seeds']} simulated home{'' if told['seeds'] == 1 else 's'}{faults}",
            ("figure", "value"),
            told["figures"].items(),
        )
        if told["semantics.accuracy_by_views"]:
            self.table(
                "labels of voxels, by the number of images that labelled them",
                ("images", "share of voxels", "right in the map", "right in one image"),
                (tuple(row.values()) for row in told["semantics.accuracy_by_views"]),
            )
        for name in ("uncounted", "notes"):
            if told.get(name):
                self.line(f"{name}: {'; '.join(map(str, told[name]))}", "dim")

    def events(self, events: Iterable[Any]) -> None:
        """What happened to things, one a line."""
        rows = [
            (
                f"{e.stamp_ns / 1e9:.2f}",
                e.kind,
                e.node,
                e.label,
                _place(e.origin),
                _place(e.position),
                e.other or "",
                e.reason,
            )
            for e in events
        ]
        self.table("events", ("at [s]", "what", "node", "class", "from", "where", "other", "why"), rows)

    def joined(self, report: Any) -> None:
        """What became of two graphs that were joined."""
        found = report.alignment
        if found is not None:
            x, y, z = report.T_ours_theirs.translation
            turn = math.degrees(report.T_ours_theirs.log()[5])
            self.line(
                f"theirs lies at ({x:.2f}, {y:.2f}, {z:.2f}) m, turned by {turn:.1f}°: {found.joined} of {found.of} "
                f"things fit, {1e3 * found.rms_m:.0f} mm apart; the next best way fits {found.runner_up}"
            )
        pairs = [(j.layer, j.ours, j.theirs, j.reason, j.kept) for j in report.joined if j.layer in ("room", "object")]
        self.table("joined", ("layer", "ours", "theirs", "why", "kept"), pairs)
        if report.conflicts:
            rows = [(c.kind, c.node, c.ours, c.theirs, c.stays, c.why) for c in report.conflicts]
            self.table("conflicts", ("of", "node", "ours", "theirs", "stays", "why"), rows)
        self.line(
            f"{len(report.joined)} nodes joined, {len(report.added)} added; edges: {report.edges_added} added, "
            f"{report.edges_shared} in both, {report.edges_dropped} left out"
        )

    def checks(self, checks: Iterable[Any]) -> None:
        """The machine, one check a line, and what to install."""
        rows = [
            (Text("ok", style="green") if c.ok else Text("missing", style="bold red"), c.name, c.found, c.advice or "")
            for c in checks
        ]
        self.table("this machine", ("", "what", "found", "what to do"), rows)

    @contextmanager
    def progress(self, title: str, total: int | None) -> Iterator[Any]:
        """A progress bar; the value is called with nothing to advance by one, or with `done` and `total` to set it."""
        with self._bar() as bar:
            task = bar.add_task(title, total=total)

            def advance(done: int | None = None, of: int | None = None) -> None:
                if done is None:
                    bar.advance(task)
                else:
                    bar.update(task, completed=done, total=of)

            yield advance

    def _bar(self) -> Progress:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        return Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left:"),
            TimeRemainingColumn(),
            console=self.err,
            disable=self.json or not self.err.is_terminal,
            transient=True,
        )


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def shown(value: Any) -> str:
    """A value in a table cell: nodes by id and label, numbers rounded, points in brackets."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if hasattr(value, "id") and hasattr(value, "label"):
        return f"{value.id} ({value.label})" if value.label else str(value.id)
    if hasattr(value, "tolist"):
        return shown(value.tolist())
    if isinstance(value, list | tuple):
        return "(" + ", ".join(shown(item) for item in value) + ")"
    return str(value)


def plain(value: Any) -> Any:
    """An answer's value as JSON: a node as `{"node": id, …}`, anything else as `{"value": …}`, as on the wire."""
    if hasattr(value, "id") and hasattr(value, "label"):
        position = [round(float(x), 3) for x in value.position]
        return {"node": value.id, "label": value.label, "position": position}
    return {"value": value.tolist() if hasattr(value, "tolist") else value}


def plain_change(change: Any) -> dict[str, Any]:
    """A change of a watch, of a world or from a server, as JSON."""
    rows = {"came": change.came, "went": change.went, "answers": change.answers}
    return {
        "truth": change.truth,
        **{name: [{k: plain(v) for k, v in row.items()} for row in side] for name, side in rows.items()},
        "revision": change.revision,
        "stamp_ns": change.stamp_ns,
        "problem": plain_problem(change.problem),
    }


def plain_explanation(given: Any) -> Any:
    """An explanation, of a world or from a server, as JSON; None when there is none."""
    return given.as_json() if hasattr(given, "as_json") else given


def plain_problem(given: Any) -> dict[str, Any] | None:
    return None if given is None else {"code": given.code, "message": given.message, "hint": given.hint}


def plain_plan(plan: Any) -> dict[str, Any]:
    """A plan, of a world or from a server, in its wire form."""
    from scenegraph.service.replies import plan_reply

    reply = plan if hasattr(plan, "model_dump") else plan_reply(plan)
    told: dict[str, Any] = reply.model_dump(mode="json")
    return told


def plain_place(place: Any) -> dict[str, Any]:
    """A place, of a world or from a server, in its wire form."""
    from scenegraph.service.replies import where_reply

    reply = place if hasattr(place, "model_dump") else where_reply(place, phrase=place.phrase)
    told: dict[str, Any] = reply.model_dump(mode="json")
    return told


def _place(position: tuple[float, float, float] | None) -> str:
    return "" if position is None else ", ".join(f"{c:.2f}" for c in position)


def plain_status(target: Any) -> dict[str, Any]:
    """The status of a world or of a server as JSON."""
    told = target.status()
    return told.model_dump(mode="json") if hasattr(told, "model_dump") else dict(told)


def _extent(region: Any) -> str:
    x, y = zip(*region.polygon, strict=True)
    return f"of {len(x)} corners, x {min(x):.2f} … {max(x):.2f}, y {min(y):.2f} … {max(y):.2f}"


def _poses(answer: Any) -> Iterator[tuple[Any, ...]]:
    for goal in answer.poses:
        x, y = goal.pose.translation[:2]
        yaw = math.degrees(math.atan2(goal.pose.rotation[1, 0], goal.pose.rotation[0, 0]))
        yield round(float(x), 2), round(float(y), 2), round(yaw), round(goal.clearance_m, 2), goal.path_length_m


def _stand(target: Any) -> tuple[Any, Any, Any]:
    """Place and heading of a pose, in metres and degrees; blank when there is none."""
    if target is None:
        return "", "", ""
    x, y = target.translation[:2]
    yaw = math.degrees(math.atan2(target.rotation[1, 0], target.rotation[0, 0]))
    return round(float(x), 2), round(float(y), 2), round(yaw)


def _tree(explanation: Mapping[str, Any], brief: bool) -> Tree:
    truth = str(explanation.get("truth", ""))
    head = Text(f"{truth} ", style=TRUTH_STYLES.get(truth, "")).append(
        str(explanation.get("goal", "")), style="default"
    )
    if explanation.get("rule"):
        head.append(f"   [{explanation['rule']}]", style="dim")
    tree = Tree(head)
    tests = explanation.get("tests") or ()
    for test in tests:
        tree.add(Text(_test(test), style="cyan"))
    for fact in () if brief and tests else explanation.get("evidence") or ():
        tree.add(Text(_fact(fact), style="dim"))
    if explanation.get("observations"):
        tree.add(Text(f"seen by {', '.join(explanation['observations'])}", style="dim"))
    for child in explanation.get("children") or ():
        tree.children.append(_tree(child, brief))
    return tree


def _fact(fact: Any) -> str:
    """A ground fact, its numbers rounded."""
    return re.sub(r"\d+\.\d{5,}", lambda number: f"{float(number[0]):.4g}", str(fact).strip('"'))


def _test(test: Mapping[str, Any]) -> str:
    """How a comparison turned out: `gap 0.31 m =< 0.5 m (near_distance)`."""
    parts: dict[str, Any] = {field.name: test.get(field.name) for field in fields(Test)}
    return str(Test(**parts))
