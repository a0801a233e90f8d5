"""Every `.plt` file beside this one, run by swipl; a warning or a left choice point fails it like a wrong answer."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from rules import rule_path

HERE = Path(__file__).parent


@pytest.mark.parametrize("suite", sorted(HERE.glob("*.plt")), ids=lambda path: path.stem)
def test_the_rules_pass_their_own_tests(suite: Path) -> None:
    swipl = shutil.which("swipl")
    assert swipl, "SWI-Prolog is not installed"
    run = subprocess.run(
        [
            swipl,
            "-q",
            "-p",
            f"rules={rule_path()}",
            "--on-warning=status",
            "--on-error=status",
            "-g",
            "run_tests",
            "-t",
            "halt",
            str(suite),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    said = run.stdout + run.stderr
    assert run.returncode == 0, said
    assert "Warning" not in said, said
