"""The rule base: Prolog modules as package data, and the path to them."""

from __future__ import annotations

from pathlib import Path

__all__ = ["rule_path"]


def rule_path(name: str = "") -> Path:
    """The path of a rule module (`rule_path("spatial")`), or of the folder that holds them all."""
    folder = Path(__file__).resolve().parent
    return folder / f"{name}.pl" if name else folder
