"""The doctor says what it found and what to install."""

import ctypes
import shutil
import socket

import pytest

from scenegraph import doctor


def checks(**changes):
    return {check.name: check for check in doctor.examine(**changes)}


def test_a_machine_that_runs_these_tests_is_ready_but_for_the_endpoint():
    found = checks(endpoint="tcp/127.0.0.1:0")
    assert all(check.ok for name, check in found.items() if not name.startswith(("endpoint", "machine"))), found
    assert all(check.advice is None for check in found.values() if check.ok)


def test_a_missing_prolog_is_told_with_its_package(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    check = checks()["SWI-Prolog"]
    assert not check.ok
    assert "swi-prolog-nox" in check.advice


def test_a_missing_library_is_told_with_its_package(monkeypatch):
    def load(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(doctor.sys, "platform", "linux")
    monkeypatch.setattr(ctypes, "CDLL", load)
    found = checks()
    for library, package in doctor.LIBRARIES.items():
        assert not found[library].ok
        assert package in found[library].advice


def test_an_old_prolog_is_not_enough(monkeypatch, tmp_path):
    swipl = tmp_path / "swipl"
    swipl.write_text("#!/bin/sh\necho 'SWI-Prolog version 8.4.2 for x86_64-linux'\n")
    swipl.chmod(0o755)
    monkeypatch.setattr(shutil, "which", lambda name: str(swipl))
    check = checks()["SWI-Prolog"]
    assert not check.ok
    assert "8.4.2" in check.found
    assert "9.0" in check.advice


def test_a_missing_package_is_told(monkeypatch):
    monkeypatch.setitem(doctor.MODULES, "no_such_module", "no-such-package")
    check = checks()["Python packages"]
    assert not check.ok
    assert check.advice == "pip install no-such-package"


def test_a_kernel_cache_that_cannot_be_written_is_told(monkeypatch):
    monkeypatch.setattr(doctor, "_writable", lambda folder: False)
    check = checks()["kernel cache"]
    assert not check.ok
    assert "NUMBA_CACHE_DIR" in check.advice


def test_an_endpoint_is_free_or_taken():
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        assert "something listens there already" in doctor.port(f"tcp/127.0.0.1:{number}").found
    assert doctor.port(f"tcp/127.0.0.1:{number}").found == "free"


@pytest.mark.parametrize("endpoint", ["127.0.0.1", "tcp/127.0.0.1", "tcp/127.0.0.1:99999", "tcp/:x"])
def test_what_is_no_endpoint_is_told(endpoint):
    assert doctor.port(endpoint).found == "not an endpoint"
