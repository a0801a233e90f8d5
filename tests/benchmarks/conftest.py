"""One table for all benchmarks of a run, printed at its end."""

from __future__ import annotations

import pytest

from tests.support.racing import Table, bytes_per_ms

_TABLE = Table()


@pytest.fixture(scope="session")
def table() -> Table:
    """Where benchmarks write their rows."""
    return _TABLE


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not (_TABLE.rows or _TABLE.notes):
        return
    terminalreporter.section("beside peers")
    terminalreporter.write_line(f"bound: touching the same bytes once, at {bytes_per_ms() / 1e6:.1f} GB/s")
    for line in _TABLE.lines():
        terminalreporter.write_line(line)
