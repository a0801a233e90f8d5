"""Kernels of uncertain labels: evidence is spread over the voxels where it may belong.

Lengths are in voxels. The mass that a Gaussian along one axis has in each cell is read from a table, by standard
deviation and by where in its cell the mean lies; in space axis follows axis, each given those before.
"""

from __future__ import annotations

from math import erf, exp, log2, pi, sqrt
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import pack
from mapping.kernels.label_sums import slot_of

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any
Float: TypeAlias = Any

REACH = 3.0
"""Standard deviations at which a Gaussian is cut off; what is left is scaled to one."""
SHIFT = 5
PHASES = 1 << SHIFT
"""A mean is rounded to the middle of so many parts of its cell."""
MERGED = 2.5
"""Sources within so many standard deviations of each other may become one."""
CERTAIN = 0.1
"""Places known to less than this [voxels] mostly stay in their voxel."""
VOXELS_A_SOURCE = 32
"""How many voxels a source is expected to reach."""
BIAS = 1 << 22
"""Added to coordinates [voxels], so that rounding to zero is rounding down."""
FINEST_SD, STEPS, LEVELS = 0.02, 16, 139
"""Standard deviations of the table: 0, then FINEST_SD·2^(n/STEPS), n = 0 … LEVELS − 2."""
LARGEST_SD = FINEST_SD * 2.0 ** ((LEVELS - 2) / STEPS)
"""Points whose place is less certain than this along some axis [voxels] are not spread."""
WIDTH = 2 * int(np.ceil(REACH * LARGEST_SD)) + 1
"""Cells of a row of the table."""


@njit(cache=True)
def tabulate(mass: Array, offset: Array, within: Array, beside: Array) -> None:
    """Fill the table of Gaussians cut off at `REACH`, in place.

    mass, offset : (LEVELS, PHASES, WIDTH) float32, the mass of each cell and how far [parts of a cell] the mean of what
                   is there is from that of all, which is the middle of part q of cell `beside[l]`
    within       : (LEVELS,) float64, the variance that is left when the cell is known
    beside       : (LEVELS,) int64, cells to each side of that of the mean that may hold some of the mass
    """
    mass[:] = 0.0
    offset[:] = 0.0
    within[:] = 0.0
    beside[:] = 0
    mass[0, :, 0] = 1.0
    kept = erf(REACH / sqrt(2.0))
    variance = 1.0 - 2.0 * REACH * exp(-0.5 * REACH * REACH) / sqrt(2.0 * pi) / kept
    for l in range(1, LEVELS):
        sd = FINEST_SD * 2.0 ** ((l - 1) / STEPS)
        beside[l] = int(np.ceil(REACH * sd))
        for q in range(PHASES):
            mean = beside[l] + (q + 0.5) / PHASES
            between = 0.0
            for c in range(2 * beside[l] + 1):
                a = min(max((c - mean) / sd, -REACH), REACH)
                b = min(max((c + 1 - mean) / sd, -REACH), REACH)
                if a == b:
                    continue
                part = 0.5 * (erf(b / sqrt(2.0)) - erf(a / sqrt(2.0)))
                at = (exp(-0.5 * a * a) - exp(-0.5 * b * b)) / sqrt(2.0 * pi) / part
                mass[l, q, c] = part / kept
                offset[l, q, c] = PHASES * sd * min(max(at, a), b)
                between += part / kept * at * at
            within[l] += sd * sd * max(variance - between, 0.0) / PHASES


@njit(cache=True)
def _level_of(variance: Float) -> Int:
    """The level of the table whose standard deviation is nearest to the root of `variance`."""
    squares = variance / (FINEST_SD * FINEST_SD)
    return 0 if squares < 0.5 else min(max(np.int64(round(0.5 * STEPS * log2(squares))) + 1, 1), LEVELS - 1)


@njit(cache=True)
def _reach(variance: Float) -> Float:
    """How far from its mean the mass of the Gaussian that the table has for a variance goes, at the most."""
    return REACH * max(sqrt(variance) * 2.0 ** (1.0 / STEPS), FINEST_SD)


@njit(cache=True, inline="always")
def _covariance(v: Array, twists: Array, qx: Float, qy: Float, qz: Float) -> None:
    """Write the covariance (3, 3) of a place into `v`, in place; q: from what the pose turns about to that place."""
    v[:] = 0.0
    for c in range(6):
        a, b, g = twists[3, c], twists[4, c], twists[5, c]
        dx, dy, dz = twists[0, c] + b * qz - g * qy, twists[1, c] + g * qx - a * qz, twists[2, c] + a * qy - b * qx
        v[0, 0] += dx * dx
        v[1, 1] += dy * dy
        v[2, 2] += dz * dz
        v[0, 1] += dx * dy
        v[0, 2] += dx * dz
        v[1, 2] += dy * dz
    v[1, 0], v[2, 0], v[2, 1] = v[0, 1], v[0, 2], v[1, 2]


@njit(cache=True)
def merge_sources(
    ijk: Array, labels: Array, sums: Array, squares: Array, centre: Array, twists: Array
) -> tuple[Array, Array, Array, Array]:
    """Sources of a class that lie close beside how far they are spread, as one.

    Along each axis 2ⁿ voxels, no more than `MERGED` standard deviations given the other axes, hold one source. Its mean
    and covariance are those of its points, so that what is spread differs in higher moments only. Points of one voxel
    stay in it where they are certain: along an axis with a standard deviation below `CERTAIN` they are drawn towards
    their mean, in proportion.

    ijk (s, 3) int32, labels (s,) uint16, sums (s, 4), squares (s, 6) float64 as `label_sums` gives them; centre, twists
    as in `measure_spread`. Returns labels (m,), mean (m, 3), evidence (m,) and covariance (m, 3, 3) of the points, in
    order of first appearance.
    """
    n_sources = ijk.shape[0]
    size = 64
    while size < 2 * n_sources:
        size *= 2
    table = np.full((size, 2), -1, np.int64)
    label_of, evidence = np.empty(n_sources, np.uint16), np.empty(n_sources)
    mean, around = np.empty((n_sources, 3)), np.empty((n_sources, 3, 3))
    v, own = np.empty((3, 3)), np.empty((3, 3))
    n = 0
    for s in range(n_sources):
        _covariance(v, twists, sums[s, 0] - centre[0], sums[s, 1] - centre[1], sums[s, 2] - centre[2])
        minor0 = v[1, 1] * v[2, 2] - v[1, 2] * v[1, 2]
        minor1 = v[0, 0] * v[2, 2] - v[0, 2] * v[0, 2]
        minor2 = v[0, 0] * v[1, 1] - v[0, 1] * v[0, 1]
        determinant = (
            v[0, 0] * minor0
            - v[0, 1] * (v[0, 1] * v[2, 2] - v[1, 2] * v[0, 2])
            + v[0, 2] * (v[0, 1] * v[1, 2] - v[1, 1] * v[0, 2])
        )
        a, b, c = _halvings(determinant, minor0), _halvings(determinant, minor1), _halvings(determinant, minor2)
        tag = (np.int64(a) << 6 | b << 3 | c) << 16 | np.int64(labels[s])
        slot = slot_of(table, pack(ijk[s, 0] >> a, ijk[s, 1] >> b, ijk[s, 2] >> c), tag, n)
        w = sums[s, 3]
        f0, f1, f2 = _looseness(v[0, 0]), _looseness(v[1, 1]), _looseness(v[2, 2])
        own[0, 0], own[1, 1], own[2, 2] = f0 * f0 * squares[s, 0], f1 * f1 * squares[s, 1], f2 * f2 * squares[s, 2]
        own[0, 1] = own[1, 0] = f0 * f1 * squares[s, 3]
        own[0, 2] = own[2, 0] = f0 * f2 * squares[s, 4]
        own[1, 2] = own[2, 1] = f1 * f2 * squares[s, 5]
        if slot == n:
            label_of[n], evidence[n] = labels[s], w
            mean[n, 0], mean[n, 1], mean[n, 2] = sums[s, 0], sums[s, 1], sums[s, 2]
            around[n] = own
            n += 1
            continue
        share = w / (evidence[slot] + w)
        evidence[slot] += w
        for d in range(3):
            for e in range(3):
                apart = (sums[s, d] - mean[slot, d]) * (sums[s, e] - mean[slot, e])
                around[slot, d, e] += share * (own[d, e] - around[slot, d, e] + (1.0 - share) * apart)
        for d in range(3):
            mean[slot, d] += share * (sums[s, d] - mean[slot, d])
    return label_of[:n], mean[:n], evidence[:n], around[:n]


@njit(cache=True)
def _looseness(variance: Float) -> Float:
    """0 where a place is certain … 1 from a standard deviation of `CERTAIN` on."""
    return min(sqrt(variance) / CERTAIN, 1.0)


@njit(cache=True)
def _halvings(determinant: Float, minor: Float) -> Int:
    """n for 2ⁿ voxels, 8 at the most, of an axis whose variance given the others is determinant/minor."""
    variance = determinant / minor if minor > 1e-12 else 0.0
    n = 0
    while n < 3 and MERGED * MERGED * variance >= 4.0:
        variance *= 0.25
        n += 1
    return n


@njit(cache=True)
def measure_spread(
    sources: Array, around: Array, centre: Array, twists: Array, order: Array, within: Array, beside: Array,
    slopes: Array, levels: Array, low: Array, high: Array,
) -> None:  # fmt: skip
    """How the place of each source is spread by that of the sensor, in place.

    sources : (s, 3) float64 [voxels], moved to the mean of where they may be (to second order)
    around  : (s, 3, 3) float64, covariance of the points that a source stands for
    centre  : (3,) what the sensor's pose turns about [voxels]
    twists  : (6, 6) float64, columns whose outer products sum to the covariance, in the map's axes: 3 rows of shift
              [voxels], 3 of rotation [rad]
    order   : (3,) int64, the axes, outermost first
    slopes  : (s, 3) float64, filled: how far the second axis moves with the first, the third with first and second
    levels  : (s, 3) int64, filled: the table's standard deviation of each, given those before; −1 where the place is
              less certain than the table goes
    low, high : (s, 3) int64, filled: voxels between which all of the mass lies, in that order of axes
    """
    v = np.empty((3, 3))
    o, m, n = order[0], order[1], order[2]
    for s in range(sources.shape[0]):
        qx, qy, qz = sources[s, 0] - centre[0], sources[s, 1] - centre[1], sources[s, 2] - centre[2]
        _covariance(v, twists, qx, qy, qz)
        for c in range(6):
            a, b, g = twists[3, c], twists[4, c], twists[5, c]
            dx, dy, dz = twists[0, c] + b * qz - g * qy, twists[1, c] + g * qx - a * qz, twists[2, c] + a * qy - b * qx
            sources[s, 0] += 0.5 * (b * dz - g * dy)
            sources[s, 1] += 0.5 * (g * dx - a * dz)
            sources[s, 2] += 0.5 * (a * dy - b * dx)
        for d in range(3):
            for e in range(3):
                v[d, e] += around[s, d, e]
        first = _level_of(v[o, o])
        a10 = v[m, o] / v[o, o] if first > 0 else 0.0
        a20 = v[n, o] / v[o, o] if first > 0 else 0.0
        v11 = max(v[m, m] - a10 * v[m, o], 0.0) + a10 * a10 * within[first]
        v12 = v[m, n] - a10 * v[n, o] + a10 * a20 * within[first]
        v22 = max(v[n, n] - a20 * v[n, o], 0.0) + a20 * a20 * within[first]
        second = _level_of(v11)
        a21 = v12 / v11 if second > 0 else 0.0
        third = _level_of(max(v22 - a21 * v12, 0.0) + a21 * a21 * within[second])
        slopes[s, 0], slopes[s, 1], slopes[s, 2] = a10, a20, a21
        levels[s, 0], levels[s, 1], levels[s, 2] = first, second, third
        if not max(v[0, 0], v[1, 1], v[2, 2]) <= LARGEST_SD * LARGEST_SD:
            levels[s, 0] = -1
            continue
        reach0, reach1 = _reach(v[o, o]), _reach(v11)
        far1 = abs(a10) * reach0
        far2 = abs(a20) * reach0 + abs(a21) * reach1
        low[s, 0] = np.int64(np.floor(sources[s, o])) - beside[first]
        high[s, 0] = np.int64(np.floor(sources[s, o])) + beside[first]
        low[s, 1] = np.int64(np.floor(sources[s, m] - far1)) - beside[second]
        high[s, 1] = np.int64(np.floor(sources[s, m] + far1)) + beside[second]
        low[s, 2] = np.int64(np.floor(sources[s, n] - far2)) - beside[third]
        high[s, 2] = np.int64(np.floor(sources[s, n] + far2)) + beside[third]


@njit(cache=True)
def _spread(
    box: Array, n1: Int, n2: Int, corner: Int, sources: Array, evidence: Array, slopes: Array, levels: Array,
    order: Array, mass: Array, offset: Array, beside: Array,
) -> None:  # fmt: skip
    """Add the evidence of sources to a dense box of voxels, in place. n1, n2: its last two sides, in that order of
    axes; corner: index in it of voxel (−BIAS, −BIAS, −BIAS), which may lie outside."""
    o, m, n = order[0], order[1], order[2]
    for s in range(sources.shape[0]):
        row0, row1, row2 = levels[s, 0] * PHASES, levels[s, 1] * PHASES, levels[s, 2] * PHASES
        far0, far1, far2 = beside[levels[s, 0]], beside[levels[s, 1]], beside[levels[s, 2]]
        x0, x1, x2 = (sources[s, o] + BIAS) * PHASES, (sources[s, m] + BIAS) * PHASES, (sources[s, n] + BIAS) * PHASES
        a10, a20, a21 = slopes[s, 0], slopes[s, 1], slopes[s, 2]
        wide = np.uintp(2 * far2 + 1)
        part0 = np.int64(x0)
        t0 = (row0 + (part0 & PHASES - 1)) * WIDTH
        for a in range(t0, t0 + 2 * far0 + 1):
            w0 = evidence[s] * mass[a]
            y1, y2 = x1 + a10 * offset[a], x2 + a20 * offset[a]
            part1 = np.int64(y1)
            t1 = (row1 + (part1 & PHASES - 1)) * WIDTH
            at1 = corner + (((part0 >> SHIFT) - far0 + a - t0) * n1 + (part1 >> SHIFT) - far1 - t1) * n2 - far2
            for b in range(t1, t1 + 2 * far1 + 1):
                w = np.float32(w0 * mass[b])
                part2 = np.int64(y2 + a21 * offset[b])
                t2 = np.uintp((row2 + (part2 & PHASES - 1)) * WIDTH)  # no sign: to the compiler a plain run of numbers
                at2 = np.uintp(at1 + b * n2 + (part2 >> SHIFT))
                for c in range(wide):
                    box[at2 + c] += w * mass[t2 + c]


@njit(cache=True)
def spread(
    starts: Array, labels: Array, low: Array, high: Array, sources: Array, evidence: Array, slopes: Array,
    levels: Array, order: Array, origin: Array, mass: Array, offset: Array, beside: Array, least: Float,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Evidence of groups of sources where they may be: voxels (m, 3) int32, classes (m,) uint16, evidence (m,) float64.

    starts    : (g + 1,) int64, where in the sources each group begins; labels (g,) uint16, the class of each
    low, high : (g, 3) int64, voxels between which all of its mass lies, in that order of axes
    origin    : (3,) int64, added to voxels
    mass, offset : (LEVELS · PHASES · WIDTH,) float32 as `tabulate` gives them
    least     : voxels with no more evidence of a group are not listed
    The rest as in `measure_spread`; evidence (s,) float64.
    """
    largest = 0
    for g in range(labels.shape[0]):
        size = 1
        for d in range(3):
            size *= high[g, d] - low[g, d] + 1
        largest = max(largest, size)
    box = np.empty(largest, np.float32)
    room = VOXELS_A_SOURCE * sources.shape[0]
    ijk, classes, found = np.empty((room, 3), np.int32), np.empty(room, np.uint16), np.empty(room)
    n = 0
    for g in range(labels.shape[0]):
        n0, n1, n2 = high[g, 0] - low[g, 0] + 1, high[g, 1] - low[g, 1] + 1, high[g, 2] - low[g, 2] + 1
        part = box[: n0 * n1 * n2]
        part[:] = 0.0
        corner = -(((low[g, 0] + BIAS) * n1 + low[g, 1] + BIAS) * n2 + low[g, 2] + BIAS)
        a, b = starts[g], starts[g + 1]
        _spread(
            part, n1, n2, corner, sources[a:b], evidence[a:b], slopes[a:b], levels[a:b], order, mass, offset, beside
        )
        rows = np.zeros(n0 * n1, np.int64)
        filled = _count_cells(rows, part, n2, least)
        if n + filled > found.shape[0]:
            more = max(filled, n)
            ijk = np.concatenate((ijk[:n], np.empty((more, 3), np.int32)))
            classes = np.concatenate((classes[:n], np.empty(more, np.uint16)))
            found = np.concatenate((found[:n], np.empty(more)))
        _list_cells(ijk[n:], found[n:], rows, part, n1, n2, low[g], order, origin, least)
        classes[n : n + filled] = labels[g]
        n += filled
    return ijk[:n], classes[:n], found[:n]


@njit(cache=True)
def _count_cells(rows: Array, box: Array, n2: Int, least: Float) -> Int:
    """How many voxels have more than the least evidence; written for each row of `n2`, in place."""
    filled = 0
    for row in range(rows.shape[0]):
        part = box[row * n2 : (row + 1) * n2]
        count = 0
        for k in range(n2):
            count += part[k] > least
        rows[row] = count
        filled += count
    return filled


@njit(cache=True)
def _list_cells(
    ijk: Array, found: Array, rows: Array, box: Array, n1: Int, n2: Int, low: Array, order: Array, origin: Array,
    least: Float,
) -> None:  # fmt: skip
    """List the voxels of a box that have more than the least evidence, and it, in place."""
    o, p, q = order[0], order[1], order[2]
    x0, x1, x2 = low[0] + origin[o], low[1] + origin[p], low[2] + origin[q]
    n = 0
    for row in range(rows.shape[0]):
        i, j = row // n1, row % n1
        last = n + rows[row]
        k = 0
        while n < last:
            value = box[row * n2 + k]
            if value > least:
                ijk[n, o], ijk[n, p], ijk[n, q] = x0 + i, x1 + j, x2 + k
                found[n] = value
                n += 1
            k += 1
