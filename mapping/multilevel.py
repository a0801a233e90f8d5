"""Several surfaces above each cell of the ground: the multi-level surface map."""

from __future__ import annotations

from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapping.errors import InvalidParameter
from mapping.kernels import multilevel
from mapping.layer import require
from mapping.tiles import Grouped, HeightNoise, TileLayer

Array: TypeAlias = NDArray[Any]


class MultiLevelMap(TileLayer):
    """A list of surface patches a cell, each with a mean height μ, a standard deviation σ and a depth d.

    voxel_size_m   edge of a cell [m];  max_range_m, above_sensor_m  see `TileLayer`
    gap_m          points of a scan in a cell that are farther apart than this [m] belong to different intervals
    thickness_m    an interval longer than this [m] is vertical, others are horizontal
    most_patches   patches a cell may have
    noise          by keyword, see `HeightNoise`

    (Triebel, Pfaff & Burgard, Multi-Level Surface Maps for Outdoor Terrain Mapping and Loop Closing, IROS 2006.) The
    points of a scan in a cell are cut into intervals; a horizontal one measures a surface at the weighted mean of its
    points with d = 0, a vertical one at its highest point with d its length. Then, with the patch nearest to the
    measurement z: |z − μ| ≤ 3σ corrects it (Kalman); z in [μ − d, μ] is disregarded; else z is a new patch.

    Beyond these rules: patches that overlap become one; a measurement that is disregarded or corrects a patch still
    makes it as deep as it is itself; of more than `most_patches`, the two with the smallest gap become one, since a map
    that is too solid is safer than one that is too empty. The rules depend on the order of scans where these overlap.
    """

    kind: ClassVar[str] = "multilevel"

    def __init__(
        self,
        voxel_size_m: float = 0.1,
        max_range_m: float = 30.0,
        *,
        gap_m: float = 0.3,
        thickness_m: float = 0.1,
        most_patches: int = 6,
        above_sensor_m: float = np.inf,
        **noise: float,
    ) -> None:
        self.gap_m = require("gap_m", gap_m, 0.0, 100.0, "m")
        self.thickness_m = require("thickness_m", thickness_m, 0.0, 100.0, "m")
        if require("most_patches", most_patches, 0.0, 64.0) != int(most_patches):
            raise InvalidParameter(f"most_patches: expected a whole number, got {most_patches!r}")
        self.most_patches = int(most_patches)
        super().__init__(
            {"patches": np.dtype((np.float32, (self.most_patches, 3)))},
            {"patches": np.nan},
            voxel_size_m,
            max_range_m,
            above_sensor_m,
            HeightNoise(**noise),
        )

    def parameters(self) -> dict[str, Any]:
        own = {"gap_m": self.gap_m, "thickness_m": self.thickness_m, "most_patches": self.most_patches}
        return {**super().parameters(), **own}

    def query(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The height (N,) [m] of the patch nearest to each point (N, 3) [m] in its cell; NaN where there is none.

        A patch is as near as what it occupies. For points (N, 2) the lowest patch counts.
        """
        return self._nearest(p_map)[:, 0].copy()

    def variance(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The variance (N,) [m²] of that height; NaN where unknown."""
        return self._nearest(p_map)[:, 1].copy()

    def nearest(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """(N, 3) μ, σ and d [m] of the patch nearest to each point (N, 3), the lowest for (N, 2); NaN unknown."""
        found = self._nearest(p_map)[:, :3].copy()
        found[:, multilevel.VARIANCE] = np.sqrt(found[:, multilevel.VARIANCE])
        return found

    def clearance(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """The free height (N,) [m] above the patch nearest to each point: ∞ where none is above, NaN unknown."""
        return self._nearest(p_map)[:, 3].copy()

    def patches(self, p_map: ArrayLike) -> NDArray[np.float64]:
        """(N, most_patches, 3) μ, σ and d [m] of the patches in each point's cell, ascending; NaN beyond them."""
        patches = self._cells("patches", p_map)
        patches[..., multilevel.VARIANCE] = np.sqrt(patches[..., multilevel.VARIANCE])
        return patches

    def _nearest(self, p_map: ArrayLike) -> NDArray[np.float64]:
        slots, local = self.locate(p_map)
        points = np.asarray(p_map, dtype=np.float64)
        heights = points[:, 2].copy() if points.shape[1] == 3 else np.full(len(points), np.nan)
        found = np.empty((len(points), 4))
        multilevel.read_nearest(self.store.fields["patches"], slots, local, heights, found)
        return found

    def _fuse(self, scan: Grouped, slots: NDArray[np.int64]) -> NDArray[np.bool_]:
        changed = np.empty(len(slots), np.bool_)
        multilevel.fuse_patches(
            self.store.fields["patches"],
            slots,
            scan.tiles,
            scan.starts,
            scan.heights,
            scan.weights,
            self.voxel_size_m,
            scan.pose,
            scan.quadratic,
            self.noise.least_sigma_m**2,
            self.gap_m,
            self.thickness_m,
            changed,
        )
        return changed
