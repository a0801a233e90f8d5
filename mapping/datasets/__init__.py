"""Readers of recorded data, one format a file. `open_dataset` finds the format by looking at the folder or file."""

from mapping.datasets.dataset import Dataset
from mapping.datasets.opening import FORMATS, open_dataset

__all__ = ["FORMATS", "Dataset", "open_dataset"]
