"""The garbage collector is off in between and as it was afterwards, whatever happens."""

import gc

import pytest

from scenegraph.collector import collector_paused


@collector_paused()
def fail() -> None:
    with collector_paused():
        assert not gc.isenabled()
    assert not gc.isenabled()
    raise KeyError


@pytest.mark.parametrize("on", [True, False])
def test_the_collector_is_as_it_was_afterwards(on: bool) -> None:
    before = gc.isenabled()
    (gc.enable if on else gc.disable)()
    try:
        with pytest.raises(KeyError):
            fail()
        assert gc.isenabled() is on
    finally:
        (gc.enable if before else gc.disable)()
