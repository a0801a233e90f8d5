"""The real recordings that tests read where the environment variable SCENEGRAPH_DATA tells their folder."""

import os
from pathlib import Path

import pytest


def recording(name: str) -> Path:
    """The folder or file `name` of the real data; the test is skipped, saying so, where there is none."""
    root = os.environ.get("SCENEGRAPH_DATA")
    if not root:
        pytest.skip("SCENEGRAPH_DATA is not set: no real data to read")
    path = Path(root) / name
    if not path.exists():
        pytest.skip(f"SCENEGRAPH_DATA has no {name}")
    return path
