"""A served world is kept: statements at once, observations from time to time, nothing when nothing came in."""

import pytest

from scenegraph.errors import StoreError
from scenegraph.serving import StoredWorld, read_config
from tests.support.fake_world import FakeWorld
from tests.support.net import small_image


class World(FakeWorld):
    """Counts how often it was saved."""

    def __init__(self):
        super().__init__()
        self.saves = []
        self.full = False

    def save(self, path):
        if self.full:
            raise StoreError("the disk is full")
        self.saves.append(path)


def test_a_statement_is_saved_before_it_is_answered(tmp_path):
    world = World()
    stored = StoredWorld(world, tmp_path / "w")
    assert stored.tell("rename(table_1, desk)", author="me").accepted
    assert world.saves == [tmp_path / "w"]


def test_a_statement_that_cannot_be_saved_is_not_confirmed(tmp_path):
    world = World()
    world.full = True
    with pytest.raises(StoreError, match="disk is full"):
        StoredWorld(world, tmp_path / "w").tell("rename(table_1, desk)", author="me")


def test_observations_are_saved_from_time_to_time_and_at_the_end(tmp_path):
    world = World()
    with StoredWorld(world, tmp_path / "w", save_every_s=1e-9) as stored:
        stored.integrate(small_image(1))
        stored.integrate(small_image(2))
        assert len(world.saves) == 2
    assert len(world.saves) == 2  # nothing new since
    world = World()
    with StoredWorld(world, tmp_path / "w", save_every_s=0.0) as stored:
        stored.integrate(small_image(1))
        assert world.saves == []
    assert len(world.saves) == 1


def test_a_world_that_took_nothing_in_is_not_written(tmp_path):
    world = World()
    with StoredWorld(world, tmp_path / "w") as stored:
        assert stored.ask("table").truth == "true"
    assert world.saves == []


def test_a_full_disk_does_not_refuse_observations(tmp_path, caplog):
    world = World()
    world.full = True
    StoredWorld(world, tmp_path / "w", save_every_s=1e-9).integrate(small_image(1))
    assert "could not be saved: the disk is full" in caplog.text


def test_a_configuration_is_read_from_toml_or_json_with_changes_on_top(tmp_path):
    (tmp_path / "a.toml").write_text("voxel_size_m = 0.1\nmax_range_m = 8.0\n")
    (tmp_path / "a.json").write_text('{"voxel_size_m": 0.1, "max_range_m": 8.0}')
    for name in ("a.toml", "a.json"):
        config = read_config(tmp_path / name, {"voxel_size_m": 0.2, "max_range_m": None})
        assert (config.voxel_size_m, config.max_range_m) == (0.2, 8.0)
    assert read_config(None).voxel_size_m == 0.05
