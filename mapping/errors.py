"""Errors of the mapping package.

MappingError              anything that mapping refuses or cannot do
├── InvalidObservation    an observation breaks its contract (also a ValueError)
├── InvalidParameter      a map or method was configured with an impossible value (also a ValueError)
├── PoseUnavailable       the frame tree cannot say where a sensor was
└── DatasetError          a recording on disk is missing something or is damaged

Each carries a `code` (snake_case, stable, machine-readable), a message and, where there is one, a `hint`.
"""

from __future__ import annotations


class MappingError(Exception):
    """Base of all errors of this package."""

    code = "mapping_error"

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint


class InvalidObservation(MappingError, ValueError):
    """An observation breaks its contract; the message names field, value and what was expected."""

    code = "invalid_observation"


class InvalidParameter(MappingError, ValueError):
    """A parameter is outside its range; the message names it, its value and what was expected."""

    code = "invalid_parameter"


class PoseUnavailable(MappingError):
    """The pose of a sensor at a time is not known to the frame tree."""

    code = "pose_unavailable"


class DatasetError(MappingError):
    """A recording cannot be read; the message names the file and what is missing or wrong."""

    code = "dataset_error"
