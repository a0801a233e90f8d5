"""A fresh installation has what the package imports: whatever is imported is declared, and the doctor looks for it."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

from scenegraph.doctor import MODULES

ROOT = Path(__file__).parents[2]
OURS = ("mapping", "reasoning", "rules", "scenegraph")
DISTRIBUTIONS = {**MODULES, "pydantic_core": "pydantic"}
OPTIONAL = {"spark_dsg", "pyarrow", "py_trees"}  # extras, imported where an export or a behaviour tree is asked for


def imported() -> dict[str, Path]:
    """Every foreign module that our sources import, and one file that does."""
    found = {}
    for path in (path for package in OURS for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            found.update({name.split(".")[0]: path for name in names})
    return {name: path for name, path in found.items() if name not in sys.stdlib_module_names and name not in OURS}


def declared() -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {re.match(r"[\w-]+", requirement)[0] for requirement in project["dependencies"]}


def test_what_is_imported_is_declared():
    known = declared()
    missing = {
        name: str(path.relative_to(ROOT))
        for name, path in imported().items()
        if name not in OPTIONAL and DISTRIBUTIONS.get(name, name) not in known
    }
    assert missing == {}


def test_what_is_declared_is_imported_and_looked_for_by_the_doctor():
    used = {DISTRIBUTIONS.get(name, name) for name in imported()} | {"open3d"}
    assert declared() <= used
    assert set(MODULES.values()) <= declared()
    assert declared() - {"typer", "rich", "open3d"} <= set(MODULES.values())
