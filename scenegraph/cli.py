"""The command line. No logic of its own: each command calls one function of the package and prints what came back.

Exit status: 0 success, 1 the answer is no or unknown, 2 a usage or input error, told in one line.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from scenegraph.console import (
    Printer,
    plain,
    plain_change,
    plain_explanation,
    plain_place,
    plain_plan,
    plain_problem,
    plain_status,
)

__all__ = ["app", "main"]


class _Commands(TyperGroup):
    """Tells every error that has a code, and every wrong usage, in one line; anything else is a fault of ours."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        words = list(sys.argv[1:] if args is None else args)
        try:
            told = super().main(words, prog_name, complete_var, False, windows_expand_args, **extra)
            status = told if isinstance(told, int) else 0
        except (typer.Abort, KeyboardInterrupt):
            status = 130
        except BrokenPipeError:
            sys.stderr.close()  # whoever read our output has gone; nothing is left to be told
            status = 0
        except Exception as error:
            problem = _problem(error)
            if problem is None:
                raise
            Printer(json="--json" in words).problem(*problem)
            status = 2
        if standalone_mode:
            sys.exit(status)
        return status


def _problem(error: Exception) -> tuple[str, str, str | None] | None:
    """Code, message and hint of an error that is the user's or the machine's; None of one that is a fault of ours."""
    if hasattr(error, "format_message"):  # wrong usage, of whichever click typer brings
        return "usage", error.format_message(), "see --help"
    code = getattr(error, "code", None)
    if isinstance(code, str):
        return code, str(error), getattr(error, "hint", None)
    if isinstance(error, ModuleNotFoundError) or "shared object file" in str(error):
        return "not_installed", str(error), "scenegraph doctor says what to install"
    return None


app = typer.Typer(
    cls=_Commands,
    name="scenegraph",
    help="A layered world model for robots: voxel maps, a labelled scene graph, symbolic answers.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

MISUSES = frozenset(
    (
        "bad_argument",
        "forbidden",
        "not_a_plan_goal",
        "syntax_error",
        "unbound_variable",
        "unknown_name",
        "unknown_predicate",
        "unknown_robot",
    )
)
"""Problems of a goal to be planned for that are faults of whoever wrote it."""

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
Map = Annotated[Path | None, typer.Option("--map", help="A world that was saved by replay --save or serve --store.")]
Connect = Annotated[
    str | None,
    typer.Option("--connect", metavar="ENDPOINT", help="A server; default SCENEGRAPH_ENDPOINT or tcp/127.0.0.1:7447."),
]
WorldName = Annotated[str, typer.Option("--world", metavar="NAME", help="The name of the world that is served.")]
Robot = Annotated[str | None, typer.Option(help="The robot from whose place it is meant.")]
VoxelSize = Annotated[
    float | None, typer.Option("--voxel-size-m", help="Edge of a voxel in metres; default by the sensor.")
]
MaxRange = Annotated[float | None, typer.Option("--max-range-m", help="Nothing is mapped beyond so many metres.")]


def main() -> None:
    """The program."""
    app()


# -- making worlds ---------------------------------------------------------------------------------------------------


@app.command()
def demo(
    output: Annotated[Path, typer.Option(help="Folder for the pictures and the report.")] = Path("out/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Which simulated home.")] = 7,
    as_json: Json = False,
) -> None:
    """Map a simulated home over Zenoh, ask questions about it, and draw it."""
    from scenegraph.demo import run

    run(output=output, seed=seed, printer=Printer(json=as_json))


@app.command()
def serve(
    world: WorldName = "home",
    store: Annotated[Path | None, typer.Option(help="Load the world from this file and keep it there.")] = None,
    endpoint: Annotated[str | None, typer.Option(help="Where to listen; default tcp/127.0.0.1:7447.")] = None,
    connect: Annotated[list[str] | None, typer.Option(help="Further endpoints to connect to.")] = None,
    config: Annotated[Path | None, typer.Option(help="World configuration, TOML or JSON.")] = None,
    voxel_size_m: VoxelSize = None,
    max_range_m: MaxRange = None,
    save_every_s: Annotated[float, typer.Option(help="With --store: save at least that often, in seconds.")] = 60.0,
    as_json: Json = False,
) -> None:
    """Serve a world until interrupted."""
    from scenegraph.serving import read_config
    from scenegraph.serving import serve as run

    printer = Printer(json=as_json)

    def started(where: str) -> None:
        if as_json:
            printer.document({"world": world, "endpoint": where})
        else:
            printer.line(f"serving {world} at {where}; end it with Ctrl-C", "bold")

    run(
        world,
        endpoint=endpoint,
        connect=connect or (),
        store=store,
        config=read_config(config, {"voxel_size_m": voxel_size_m, "max_range_m": max_range_m}),
        save_every_s=save_every_s,
        started=started,
    )


@app.command()
def replay(
    source: Annotated[Path, typer.Argument(help="Folder or file: our recordings, TUM, Redwood, 3DTK, PCD, CARMEN.")],
    every: Annotated[int, typer.Option(min=1, help="Only every so-manieth image and scan.")] = 1,
    voxel_size_m: VoxelSize = None,
    max_range_m: MaxRange = None,
    poses: Annotated[str | None, typer.Option(help="3DTK: frames (registered) or odometry.")] = None,
    option: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="An option of the reader.")] = None,
    save: Annotated[Path | None, typer.Option(help="Save the world to this file.")] = None,
    connect: Connect = None,
    world: WorldName = "home",
    as_json: Json = False,
) -> None:
    """Play a recording into a new world, or into a server with --connect."""
    from scenegraph.pipeline import open_recording, sending, world_for
    from scenegraph.pipeline import replay as play

    printer = Printer(json=as_json)
    if connect and (save or voxel_size_m or max_range_m):
        raise typer.BadParameter("--save, --voxel-size-m and --max-range-m are of a new world: not with --connect")
    dataset = open_recording(source, **_options(option, poses=poses))
    with ExitStack() as stack:
        if connect:
            target: Any = stack.enter_context(_client(connect, world))
            integrate = sending(target)
        else:
            target = stack.enter_context(world_for(dataset, voxel_size_m, max_range_m))
            integrate = target.integrate
        advance = stack.enter_context(printer.progress(dataset.name, len(dataset)))
        told = play(dataset, integrate, every=every, advance=advance)
        if save:
            target.save(save)
        status = plain_status(target)
    if as_json:
        printer.document(
            {
                "source": str(source),
                "format": dataset.format,
                **told.as_json(),
                "skipped": {reason: n for reason, n in dataset.skipped.items() if n},
                "status": status,
            }
        )
    else:
        printer.replayed(dataset, told)
        printer.status(status)
    if told.refused and not told.image_ms:
        reason = next(iter(told.refused))
        printer.problem("all_refused", f"every image and scan was refused: {reason}")
        raise typer.Exit(2)


@app.command()
def simulate(
    output: Annotated[Path, typer.Option(help="Folder to write the recording to.")],
    seed: Annotated[int, typer.Option(min=0, help="Which simulated home.")] = 0,
    noise: Annotated[Literal["none", "realistic"], typer.Option(help="Of depth, labels and poses.")] = "realistic",
    images_per_room: Annotated[int, typer.Option(min=7, help="About how many images in each room.")] = 30,
    lidar: Annotated[bool, typer.Option("--lidar", help="Add scans of a rotating lidar.")] = False,
    as_json: Json = False,
) -> None:
    """Record what a robot sees on a tour through a simulated home; replay reads it."""
    from scenegraph.pipeline import record_home

    printer = Printer(json=as_json)
    with printer.progress(f"home {seed}", None) as advance:
        counts = record_home(seed, output, noise=noise, images_per_room=images_per_room, lidar=lidar, advance=advance)
    if as_json:
        printer.document({"output": str(output), "seed": seed, "noise": noise, "observations": counts})
    else:
        printer.table(f"recorded to {output}", ("observation", "count"), counts.items())


# -- questions -------------------------------------------------------------------------------------------------------


@app.command()
def ask(
    goal: Annotated[str, typer.Argument(help="Such as 'near(X, oven), on(X, Y)'.")],
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    robot: Robot = None,
    limit: Annotated[int, typer.Option(min=1, help="At most so many answers.")] = 100,
    timeout_s: Annotated[float, typer.Option(help="Give up after so many seconds.")] = 1.0,
    explain: Annotated[bool, typer.Option("--explain", help="Say why, or why not.")] = False,
    as_json: Json = False,
) -> None:
    """Ask a question. Exit status 0: yes, 1: no or unknown.

    --map may also name a graph without a map: JSON of spark_dsg or networkx, GraphML.
    """
    printer = Printer(json=as_json)
    with _opened(map_path, connect, world, graphs=True) as target:
        answers = target.ask(goal, robot=robot, limit=limit, timeout_s=timeout_s)
        rows = [dict(row) for row in answers]
        why = plain_explanation(answers.explain()) if explain else None
    problem = plain_problem(answers.problem)
    if as_json:
        printer.document(
            {
                "truth": answers.truth,
                "answers": [{name: plain(value) for name, value in row.items()} for row in rows],
                "truncated": answers.truncated,
                "revision": answers.revision,
                "elapsed_ms": answers.elapsed_ms,
                "problem": problem,
                "explanation": why,
            }
        )
    else:
        printer.answers(answers, rows, why)
        if problem is not None:
            printer.problem(**problem)
    raise typer.Exit(2 if answers.problem is not None else 0 if answers.truth == "true" else 1)


@app.command()
def watch(
    goal: Annotated[str, typer.Argument(help="Such as 'near(X, oven)'.")],
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    robot: Robot = None,
    limit: Annotated[int, typer.Option(min=1, help="At most so many answers.")] = 100,
    timeout_s: Annotated[float, typer.Option(help="Give up each time after so many seconds.")] = 1.0,
    changes: Annotated[
        int | None, typer.Option(min=1, help="End after so many changes, the first answers included.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the answers to a question, and whenever they change what came and went, until interrupted.

    The world in a file of --map does not change: its answers are printed once. --json prints an object a line. Exit
    status 0: the last answer was yes, 1: no or unknown.
    """
    printer = Printer(json=as_json)
    truth = "unknown"
    with (
        _opened(map_path, connect, world) as target,
        suppress(KeyboardInterrupt),  # the usual way to end it
        target.watch(goal, robot=robot, limit=limit, timeout_s=timeout_s) as told,
    ):
        for change in islice(told, changes):
            truth = change.truth
            if as_json:
                printer.document(plain_change(change))
            else:
                printer.change(change)
    raise typer.Exit(0 if truth == "true" else 1)


@app.command()
def where(
    phrase: Annotated[str, typer.Argument(help="Such as 'near the oven'.")],
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    robot: Robot = None,
    as_json: Json = False,
) -> None:
    """Say where something is and where to stand. Exit status 0: found, 1: not."""
    printer = Printer(json=as_json)
    with _opened(map_path, connect, world) as target:
        place = target.where(phrase, robot=robot)
    problem = plain_problem(place.problem)
    if as_json:
        printer.document(plain_place(place))
    else:
        printer.place(place)
        if problem is not None:
            printer.problem(**problem)
    raise typer.Exit(2 if place.problem is not None else 0 if place.truth == "true" else 1)


@app.command()
def plan(
    goal: Annotated[str, typer.Argument(help="Such as 'on(cup, table)' or 'in(milk, fridge), closed(fridge)'.")],
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    robot: Robot = None,
    timeout_s: Annotated[float, typer.Option(help="Give up after so many seconds.")] = 10.0,
    domain: Annotated[
        Path | None, typer.Option(help="With --map: a mapping to a PDDL domain of your own, TOML or JSON.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what a robot has to do to bring a goal about. Exit status 0: a plan, 1: none, or not known."""
    printer = Printer(json=as_json)
    if domain is not None and map_path is None:
        raise typer.BadParameter("--domain needs --map: a server plans in the household domain")
    with _opened(map_path, connect, world, graphs=True) as target:
        options = {} if domain is None else {"domain": domain}
        found = target.plan(goal, robot=robot, timeout_s=timeout_s, **options)
    problem = plain_problem(found.problem)
    if as_json:
        printer.document(plain_plan(found))
    else:
        printer.plan(found)
        if problem is not None:
            printer.problem(**problem)
    raise typer.Exit(2 if problem and problem["code"] in MISUSES else 0 if found.status == "solved" else 1)


@app.command()
def tell(
    statement: Annotated[str | None, typer.Argument(help="Such as \"rename(room_2, 'guest room')\".")] = None,
    taxonomy: Annotated[
        Path | None,
        typer.Option(help="Tell a tree of classes instead: OWL or RDFS (.owl .rdf .ttl), .csv, indented .txt."),
    ] = None,
    rules: Annotated[
        Path | None,
        typer.Option(help="Tell the rules in this file, which define new words.", exists=True, dir_okay=False),
    ] = None,
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    author: Annotated[str, typer.Option(help="Who says so.")] = "operator",
    reason: Annotated[str, typer.Option(help="Why.")] = "",
    as_json: Json = False,
) -> None:
    """State something about the world; it is kept in the history."""
    from scenegraph.interop import read_taxonomy
    from scenegraph.statements import telling

    printer = Printer(json=as_json)
    if [statement, taxonomy, rules].count(None) != 2:
        raise typer.BadParameter("one is needed of: a statement, --taxonomy, --rules")
    if rules is not None:
        statements = [telling(rules.stem, rules.read_text(encoding="utf-8"))]
    else:
        statements = [statement] if statement is not None else read_taxonomy(str(taxonomy)).statements()
    with _opened(map_path, connect, world) as target:
        for one in statements:
            told = target.tell(one, author=author, reason=reason)
            if not told.accepted:
                break
        if map_path is not None and (told.accepted or len(statements) > 1):
            target.save(map_path)
    problem = plain_problem(told.problem)
    if as_json:
        printer.document({"accepted": told.accepted, "revision": told.revision, "problem": problem})
    elif told.accepted:
        printer.line(f"accepted; revision {told.revision}")
    else:
        printer.problem(**(problem or {"code": "refused", "message": "the statement was refused"}))
    raise typer.Exit(0 if told.accepted else 2)


@app.command()
def status(map_path: Map = None, connect: Connect = None, world: WorldName = "home", as_json: Json = False) -> None:
    """Show what each layer holds, and how a server is."""
    printer = Printer(json=as_json)
    with _opened(map_path, connect, world) as target:
        told = plain_status(target)
    if as_json:
        printer.document(told)
    else:
        printer.status(told)


@app.command()
def events(
    since_ns: Annotated[int | None, typer.Option(help="Only what happened after this stamp, nanoseconds.")] = None,
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    as_json: Json = False,
) -> None:
    """Tell what happened to things: appeared, moved, vanished, merged, split, relabelled."""
    printer = Printer(json=as_json)
    with _opened(map_path, connect, world) as target:
        told = target.events(since_ns)
    if as_json:
        printer.document({"events": [event.model_dump(mode="json") for event in told]})
    else:
        printer.events(told)


# -- judging ---------------------------------------------------------------------------------------------------------


@app.command()
def evaluate(
    seeds: Annotated[int, typer.Option(min=1, help="How many simulated homes.")] = 10,
    first_seed: Annotated[int, typer.Option(min=0, help="The seed of the first.")] = 0,
    noise: Annotated[Literal["none", "realistic"], typer.Option(help="Of depth, labels and poses.")] = "realistic",
    mislabelled: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Share of things that get a wrong class in an image, drawn anew for each; with --noise none the only "
            "fault.",
            show_default="0.05 when realistic, else 0",
        ),
    ] = None,
    second_tour: Annotated[
        bool, typer.Option("--second-tour", help="Then change each home and map it again: what becomes of its things?")
    ] = False,
    workers: Annotated[
        int, typer.Option(min=1, help="Homes mapped at the same time; with more than one, times of images say little.")
    ] = 1,
    as_json: Json = False,
) -> None:
    """Map simulated homes and print figures against their truth."""
    from scenegraph.evaluation import evaluate as run

    printer = Printer(json=as_json)
    with printer.progress("homes", seeds) as advance:
        result = run(
            seeds, first_seed=first_seed, noise=noise, mislabelled=mislabelled, second_tour=second_tour,
            workers=workers, advance=advance,
        )  # fmt: skip
    if as_json:
        printer.document(result.as_json())
    else:
        printer.figures(result)


@app.command()
def export(
    form: Annotated[
        str,
        typer.Option(
            "--format",
            help="json, spark_dsg, node_link, graphml, csv, parquet, gltf, pddl, png, cost, ply, mesh, ot, bt, npz.",
        ),
    ],
    output: Annotated[Path, typer.Option(help="The file to write.")],
    layer: Annotated[
        str | None, typer.Option(help="Of which map layer ply, mesh, ot, bt and npz are: semantics, tsdf, occupancy, …")
    ] = None,
    box: Annotated[
        str | None, typer.Option(metavar="X0,Y0,Z0,X1,Y1,Z1", help="Only the part of the layer about this box, metres.")
    ] = None,
    costs: Annotated[Path | None, typer.Option(help="cost: a JSON file, class name → cost.")] = None,
    band: Annotated[
        tuple[float, float], typer.Option(metavar="LOW HIGH", help="cost: heights that matter, metres.")
    ] = (-0.1, 1.0),
    goal: Annotated[str | None, typer.Option(help="pddl: the goal to plan for, such as 'on(cup, table)'.")] = None,
    robot: Annotated[str | None, typer.Option(help="pddl: the robot that acts.")] = None,
    everything: Annotated[
        bool, typer.Option("--everything", help="pddl: all that is known, not only what the goal can touch.")
    ] = False,
    map_path: Map = None,
    connect: Connect = None,
    world: WorldName = "home",
    as_json: Json = False,
) -> None:
    """Write the graph or the map as a file of another program.

    ply is the mesh, or with --layer semantics a cloud of labelled points; mesh and ot (OctoMap) are in the colours of
    classes; cost is a grid for navigation, a PNG beside a YAML file as map_server reads them, or, by the name of the
    file, arrays (.npz) or all surfaces in space (.ply); pddl is the problem of a goal for a planner, its domain in a
    file beside it. --map may also name a graph without a map (JSON of spark_dsg
    or networkx, GraphML), which is then written in another format of graphs.
    """
    from scenegraph import exporting

    exporting.check_format(form)
    printer = Printer(json=as_json)
    if (form == "cost") != (costs is not None):
        raise typer.BadParameter("--costs FILE belongs to --format cost, and --format cost needs it")
    if (form == "pddl") != (goal is not None):
        raise typer.BadParameter("--goal GOAL belongs to --format pddl, and --format pddl needs it")
    absent: tuple[str, ...] = ()
    with _opened(map_path, connect, world, graphs=True) as target:
        if goal is not None:
            path, domain = exporting.export_pddl(target, goal, output, robot=robot, scoped=not everything)
            told = {"format": form, "output": str(path), "domain": str(domain), "bytes": path.stat().st_size}
            if as_json:
                printer.document(told)
            else:
                printer.line(f"wrote {path} ({path.stat().st_size:,} bytes) and {domain}")
            return
        source = exporting.source_of(target) if map_path else exporting.Served(target)
        if costs is not None:
            path, absent = exporting.export_cost(source, costs, output, band_m=band)
        else:
            path = exporting.export(source, form, output, layer=layer, box=box)
    if as_json:
        printer.document({"format": form, "output": str(path), "bytes": path.stat().st_size, "absent": list(absent)})
    else:
        printer.line(f"wrote {path} ({path.stat().st_size:,} bytes)")
        if absent:
            printer.line(f"classes of the table that this map does not know: {', '.join(absent)}", "yellow")


@app.command()
def join(
    ours: Annotated[Path, typer.Argument(help="A stored world, or a graph in a file; its ids stay.")],
    theirs: Annotated[Path, typer.Argument(help="Another of the same place, by another robot or in another session.")],
    output: Annotated[Path, typer.Option(help="The file to write the joined graph to, as our JSON.")],
    name: Annotated[str, typer.Option(help="What theirs is called: new ids end in it.")] = "theirs",
    same_map: Annotated[bool, typer.Option("--same-map", help="Both are in one map frame: look for none.")] = False,
    as_json: Json = False,
) -> None:
    """Make two graphs of one place one. Where theirs lies in ours is found from the things in both.

    What comes out is a graph without a map: to be asked, viewed and exported. Mapping goes on in either world; a newer
    state of theirs is joined again, and changes only what is new."""
    from mapping.geometry import SE3
    from scenegraph.importing import graph_in
    from scenegraph.interop import export_graph
    from scenegraph.joining import join as joined

    printer = Printer(json=as_json)
    graph, other = graph_in(ours), graph_in(theirs)
    changes, report = joined(graph, other, SE3.identity() if same_map else None, name=name)
    graph.commit(changes, max(graph.stamp_ns, other.stamp_ns))
    export_graph(graph, "json", output)
    if as_json:
        printer.document({"output": str(output), **report.as_json()})
    else:
        printer.joined(report)
        printer.line(f"wrote {output}: {len(graph)} nodes, {graph.n_edges} edges")


@app.command()
def schema(
    output: Annotated[Path | None, typer.Option(help="Write to this file instead of the terminal.")] = None,
    as_json: Json = False,
) -> None:
    """Print the JSON Schemas of all messages and the table of keys."""
    from scenegraph.service.messages import schema as make

    text = json.dumps(make(), indent=None if as_json else 2)
    if output is None:
        print(text)
    else:
        from scenegraph.exporting import write_text

        write_text(output, text + "\n")


@app.command()
def doctor(
    endpoint: Annotated[str, typer.Option(help="Where a server is meant to listen.")] = "tcp/127.0.0.1:7447",
    as_json: Json = False,
) -> None:
    """Check this machine and say what to install. Exit status 1 when something is missing."""
    from scenegraph.doctor import examine

    printer = Printer(json=as_json)
    checks = list(examine(endpoint))
    ok = all(check.ok for check in checks)
    if as_json:
        printer.document({"ok": ok, "checks": [check.as_json() for check in checks]})
    else:
        printer.checks(checks)
    raise typer.Exit(0 if ok else 1)


# -- opening -----------------------------------------------------------------------------------------


def _client(endpoint: str | None, world: str) -> AbstractContextManager[Any]:
    from scenegraph.service.client import Client

    return Client(world, endpoint)


def _opened(
    map_path: Path | None, connect: str | None, world: str, *, graphs: bool = False
) -> AbstractContextManager[Any]:
    """A saved world, or a server's: both know the same verbs. With `graphs` a graph in a file will do, too."""
    if map_path is not None and connect is not None:
        raise typer.BadParameter("--map and --connect exclude each other")
    if map_path is None:
        return _client(connect, world)
    if graphs:
        from scenegraph.importing import open_map

        return open_map(map_path)
    from scenegraph.world import World

    return World.load(map_path)


def _options(given: list[str] | None, **named: Any) -> dict[str, Any]:
    """Reader options: `up=y` → {"up": "y"}; numbers and true/false as such."""
    options = {name: value for name, value in named.items() if value is not None}
    for text in given or ():
        name, sign, value = text.partition("=")
        if not sign:
            raise typer.BadParameter(f"--option: expected NAME=VALUE, got {text!r}")
        try:
            options[name] = json.loads(value)
        except ValueError:
            options[name] = value
    return options


if __name__ == "__main__":
    main()
