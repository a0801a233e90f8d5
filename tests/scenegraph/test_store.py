"""A stored world comes back as it was, or is refused with the reason; a save that dies changes nothing."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from scenegraph import store
from scenegraph.errors import StoreCorrupt, StoreError, StoreForeign, StoreTooNew
from scenegraph.graph import GraphChanges, Node, SceneGraph
from scenegraph.store import WorldParts, load_graph, load_world, save_graph, save_world
from scenegraph.world import World


def parts(n: int = 3) -> WorldParts:
    graph = SceneGraph()
    changes = GraphChanges()
    for i in range(n):
        position = (i, 0.1, 1e-300)
        changes.put(
            Node(
                id=f"object_{i}",
                layer="object",
                label="Süße Tür",
                position=position,
                first_seen_ns=0,
                last_seen_ns=2**62,
            )
        )
    graph.commit(changes, 7)
    random = np.random.default_rng(n)
    return WorldParts(
        config={"voxel_size_m": 0.05},
        layers={
            "tsdf": {
                "distance": random.normal(size=(4, 512)).astype(np.float32),
                "keys": random.integers(-9, 9, (4, 3), dtype=np.int32),
                "none": np.empty((0, 512), np.uint8),
                "one": np.float64(0.1),
                "seen": random.random((3, 5)) > 0.5,
                "fortran": np.asfortranarray(random.integers(0, 9, (3, 4))),
            },
            "names": {"classes": np.array(["wall", "Stuhl"])},
        },
        graph=graph,
        documents={"statements": ["rename(room_2, 'guest room')"], "n": None},
    )


def assert_same(found: WorldParts, expected: WorldParts) -> None:
    assert found.config == expected.config
    assert found.graph == expected.graph
    assert found.documents == expected.documents
    assert {k: set(v) for k, v in found.layers.items()} == {k: set(v) for k, v in expected.layers.items()}
    for layer, arrays in expected.layers.items():
        for name, array in arrays.items():
            again = found.layers[layer][name]
            assert again.dtype == np.asarray(array).dtype
            np.testing.assert_array_equal(again, array)


def test_a_world_comes_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a world #1?.sgm"
    save_world(path, parts())
    found = load_world(path)
    assert_same(found, parts())
    assert found.graph.snapshot() == parts().graph.snapshot()
    assert len(found.graph.as_of(6)) == 0
    assert load_graph(path) == parts().graph
    assert os.listdir(tmp_path) == [path.name]


def test_arrays_longer_than_a_chunk_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_CHUNK_BYTES", 100)
    save_world(tmp_path / "w", parts())
    assert_same(load_world(tmp_path / "w"), parts())


def test_an_empty_world_comes_back(tmp_path: Path) -> None:
    save_world(tmp_path / "w", WorldParts(config={}))
    assert_same(load_world(tmp_path / "w"), WorldParts(config={}))


@pytest.mark.parametrize("keep", [0.02, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(tmp_path: Path, keep: float) -> None:
    path = tmp_path / "w"
    save_world(path, parts(200))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * keep)])
    with pytest.raises(StoreCorrupt):
        load_world(path)


def test_no_damage_goes_unnoticed(tmp_path: Path) -> None:
    path = tmp_path / "w"
    save_world(path, parts())
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for at in random.integers(100, len(whole), 400):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << int(random.integers(8))
        path.write_bytes(damaged)
        try:
            found = load_world(path)
        except StoreError:
            continue
        assert_same(found, parts())  # the bit was in unused space


def test_missing_rows_are_noticed(tmp_path: Path) -> None:
    for number, statement in enumerate(
        ["DELETE FROM chunk WHERE field = 'keys'", "DELETE FROM document WHERE name = 'graph'", "DROP TABLE chunk"]
    ):
        path = tmp_path / str(number)
        save_world(path, parts())
        with sqlite3.connect(path) as database:
            database.execute(statement)
        database.close()
        with pytest.raises(StoreCorrupt):
            load_world(path)


def test_a_foreign_file_is_neither_read_nor_overwritten(tmp_path: Path) -> None:
    text, database_file, empty = tmp_path / "notes.txt", tmp_path / "other.db", tmp_path / "empty"
    text.write_text("my notes " * 50)
    empty.touch()
    database = sqlite3.connect(database_file)
    database.execute("CREATE TABLE t (x)")
    database.commit()
    database.close()
    for path in (text, database_file, empty):
        before = path.read_bytes()
        with pytest.raises(StoreForeign, match="not a stored world"):
            load_world(path)
        with pytest.raises(StoreForeign):
            save_world(path, parts())
        assert path.read_bytes() == before


def test_a_newer_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as newer:
        newer.setattr(store, "FORMAT_VERSION", 99)
        save_world(tmp_path / "w", parts())
    with pytest.raises(StoreTooNew, match="99"):
        load_world(tmp_path / "w")


def test_a_graph_alone_comes_back_and_is_no_world(tmp_path: Path) -> None:
    graph = parts(50).graph
    save_graph(tmp_path / "g", graph)
    again = load_graph(tmp_path / "g")
    assert again.snapshot() == graph.snapshot()
    assert len(again.as_of(6)) == 0
    with pytest.raises(StoreForeign, match="a graph without a map"):
        World.load(tmp_path / "g")


def test_a_file_whose_voxels_are_of_another_kind_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as older:
        older.setattr(store, "FORMAT_VERSION", 1)
        save_world(tmp_path / "w", parts())
    with pytest.raises(StoreForeign, match="format version 1, but"):
        load_world(tmp_path / "w")


def test_what_cannot_be_stored_is_named(tmp_path: Path) -> None:
    for bad, message in (
        (WorldParts(config={"x": float("nan")}), "'config' is not JSON"),
        (WorldParts(config={}, documents={"told": {1, 2}}), "'told' is not JSON"),
        (WorldParts(config={}, layers={"tsdf": {"o": np.array([None])}}), "'tsdf'.*'o'.*object"),
    ):
        with pytest.raises(StoreError, match=message):
            save_world(tmp_path / "w", bad)
    with pytest.raises(StoreError, match="does not exist"):
        save_world(tmp_path / "none" / "w", parts())
    with pytest.raises(StoreError, match="cannot be opened"):
        load_world(tmp_path / "w")
    with pytest.raises(StoreError, match="cannot be opened"):
        load_world(tmp_path)
    assert os.listdir(tmp_path) == []


def test_a_save_that_fails_leaves_the_old_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "w"
    save_world(path, parts())

    def no_space(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "_flush", no_space)
    with pytest.raises(StoreError, match="No space left"):
        save_world(path, parts(9))
    assert_same(load_world(path), parts())
    assert os.listdir(tmp_path) == ["w"]


KILLED = """
import sys
import numpy as np
from scenegraph.store import WorldParts, save_world
for i in range(100000):
    save_world(sys.argv[1], WorldParts(config={"i": i}, layers={"l": {"a": np.full(200000, i)}}))
    print(i, flush=True)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill signal")
def test_a_killed_save_leaves_a_whole_world(tmp_path: Path) -> None:
    path = tmp_path / "w"
    child = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    with child.stdout:
        for _ in range(5):
            saved = int(child.stdout.readline())
        time.sleep(0.013)
        child.kill()
        child.wait()
    found = load_world(path)
    assert found.config["i"] >= saved
    assert (found.layers["l"]["a"] == found.config["i"]).all()
    save_world(path, found)
    assert os.listdir(tmp_path) == ["w"]  # what the killed one left is gone
