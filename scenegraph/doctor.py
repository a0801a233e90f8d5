"""Is this machine ready? Each check says what it found and, where something is missing, what to install."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

__all__ = ["Check", "examine"]

SWIPL_MIN = (9, 0)
LIBRARIES = {  # what open3d links to; a bare Debian lacks them
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
MODULES = {  # import name → distribution
    "numpy": "numpy",
    "numba": "numba",
    "scipy": "scipy",
    "networkx": "networkx",
    "pydantic": "pydantic",
    "open3d": "open3d-cpu",
    "pyswip": "pyswip",
    "zenoh": "eclipse-zenoh",
    "zstandard": "zstandard",
    "PIL": "pillow",
    "shapely": "shapely",
    "unified_planning": "unified-planning",
    "pyperplan": "up-pyperplan",
    "matplotlib": "matplotlib",
}
MEMORY_MIN_GB = 2.0


@dataclass(frozen=True)
class Check:
    """One thing that was looked at: `found` says what is there, `advice` what to do when it is not `ok`."""

    name: str
    ok: bool
    found: str
    advice: str | None = None

    def as_json(self) -> dict[str, Any]:
        """The check as a plain mapping."""
        return asdict(self)


def examine(endpoint: str = "tcp/127.0.0.1:7447") -> Iterator[Check]:
    """Look at this machine, one check after the other; nothing is changed and nothing is installed."""
    for check in _checks(endpoint):
        yield replace(check, advice=None) if check.ok else check


def _checks(endpoint: str) -> Iterator[Check]:
    yield _python()
    yield _prolog()
    yield from _libraries()
    yield _modules()
    yield _kernel_cache()
    yield _memory()
    yield port(endpoint)


def _python() -> Check:
    version = platform.python_version()
    return Check("Python", sys.version_info >= (3, 11), version, "install Python 3.11 or newer")


def _prolog() -> Check:
    advice = "sudo apt-get install swi-prolog-nox (or see swi-prolog.org)"
    swipl = shutil.which("swipl")
    if swipl is None:
        return Check("SWI-Prolog", False, "swipl is not on the PATH", advice)
    try:
        told = subprocess.run([swipl, "--version"], capture_output=True, text=True, timeout=20, check=True).stdout
    except (OSError, subprocess.SubprocessError) as error:
        return Check("SWI-Prolog", False, f"{swipl} does not run ({error})", advice)
    version = re.search(r"(\d+)\.(\d+)\.(\d+)", told)
    ok = version is not None and (int(version[1]), int(version[2])) >= SWIPL_MIN
    needed = f"version {'.'.join(map(str, SWIPL_MIN))} or newer is needed: {advice}"
    return Check("SWI-Prolog", ok, f"{version[0] if version else told.strip()[:60]} at {swipl}", needed)


def _libraries() -> Iterator[Check]:
    """Only Linux has them apart; on other systems open3d brings what it needs."""
    if sys.platform != "linux":
        return
    for library, package in LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            yield Check(library, False, "not installed", f"sudo apt-get install {package}")
        else:
            yield Check(library, True, "installed")


def _modules() -> Check:
    missing = [package for module, package in MODULES.items() if importlib.util.find_spec(module) is None]
    if missing:
        return Check("Python packages", False, f"missing: {', '.join(missing)}", f"pip install {' '.join(missing)}")
    return Check("Python packages", True, f"{len(MODULES)} found")


def _kernel_cache() -> Check:
    """Where numba keeps compiled kernels: NUMBA_CACHE_DIR, else beside the sources, else in the user's cache folder."""
    told = os.environ.get("NUMBA_CACHE_DIR")
    kernels = importlib.util.find_spec("mapping.kernels")
    beside = [Path(folder) / "__pycache__" for folder in (kernels.submodule_search_locations or [])] if kernels else []
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
    for folder in [Path(told)] if told else [*beside, user]:
        if _writable(folder):
            return Check("kernel cache", True, str(folder))
    return Check(
        "kernel cache",
        False,
        "no folder for compiled kernels can be written: every start compiles them again (about 30 s)",
        "set NUMBA_CACHE_DIR to a folder that can be written",
    )


def _writable(folder: Path) -> bool:
    """Whether a file can be made in `folder`, or in the nearest folder above it that exists."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _memory() -> Check:
    cores = os.cpu_count() or 1
    try:
        memory_gb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (ValueError, OSError, AttributeError):
        return Check("machine", True, f"{cores} cores")
    return Check(
        "machine",
        memory_gb >= MEMORY_MIN_GB,
        f"{cores} cores, {memory_gb:.1f} GB of memory",
        f"a home at 5 cm needs about {MEMORY_MIN_GB:g} GB; use larger voxels",
    )


def port(endpoint: str) -> Check:
    """Whether `endpoint` (`tcp/HOST:PORT`) is free to listen at, or a server is there already."""
    name = f"endpoint {endpoint}"
    match = re.fullmatch(r"(\w+)/(.+):(\d{1,5})", endpoint)
    if match is None or int(match[3]) > 65535:
        return Check(name, False, "not an endpoint", "write it as tcp/127.0.0.1:7447")
    if match[1] != "tcp":
        return Check(name, True, f"{match[1]} is not looked at")
    host, number = match[2].strip("[]"), int(match[3])
    with contextlib.suppress(OSError), socket.create_connection((host, number), timeout=1.0):
        return Check(name, True, "something listens there already: `scenegraph status` tells whether it is a server")
    try:
        family = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, number))
    except OSError as error:
        return Check(name, False, f"cannot be listened at ({error.strerror})", "serve at another one: --endpoint")
    return Check(name, True, "free")
