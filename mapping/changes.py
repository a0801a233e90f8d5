"""Which voxels became occupied, free or unknown since somebody looked last."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.cells import CellStore
from mapping.grid import ijk_to_centre, join_ijk
from mapping.kernels.cells import UNKNOWN
from mapping.occupancy import OccupancyMap, classes_of


class VoxelChanges(NamedTuple):
    """Voxels whose class changed: centres (N, 3) [m], their class `before` and `after` (N,) int8: 1 occupied, 0 free,
    −1 unknown."""

    centres: NDArray[np.float64]
    before: NDArray[np.int8]
    after: NDArray[np.int8]


class ChangeDetector:
    """Remembers the classes of an occupancy map's voxels, and says which are others now.

    Evidence that grows without a change of class is no change. What uniform space costs is what it costs in the map.
    """

    def __init__(self, occupancy: OccupancyMap) -> None:
        self.occupancy = occupancy
        self._seen = 0
        self._classes = CellStore(occupancy.voxel_size_m)
        self.changes()

    def changes(self) -> VoxelChanges:
        """The voxels whose class changed since the last call (or since this detector was made)."""
        blocks = self.occupancy.changed_since(self._seen).blocks
        self._seen = self.occupancy.revision
        after = classes_of(self.occupancy.evidence_of(blocks))
        before = self._classes.read(blocks)
        before[before == UNKNOWN] = -1
        self._classes.write(blocks, np.where(after < 0, np.int8(UNKNOWN), after), self._seen)
        rows, local = np.nonzero(before != after)
        centres = ijk_to_centre(join_ijk(blocks[rows], local), self.occupancy.voxel_size_m)
        return VoxelChanges(centres, before[rows, local], after[rows, local])
