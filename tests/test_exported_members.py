"""What the packages say they export is what they export."""

import importlib

import pytest


@pytest.mark.parametrize("package", ["mapping", "scenegraph"])
def test_every_exported_name_has_a_home_and_can_be_imported(package: str) -> None:
    module = importlib.import_module(package)
    assert sorted(module.__all__) == sorted(module._HOME_OF)
    for name in module.__all__:
        assert getattr(module, name).__name__ == name


@pytest.mark.parametrize("package", ["mapping", "scenegraph"])
def test_an_unknown_name_is_an_attribute_error(package: str) -> None:
    with pytest.raises(AttributeError, match="Worlds"):
        _ = importlib.import_module(package).Worlds
