"""The nearest of many sites for the voxels of a block, exactly: sites are bits, and most are refused many at a time.

Sites are kept as `planes` (capacity, n, 8) uint64: bit 8·ly + lz of word lx of plane p says whether the voxel is a site
of that kind. A site is dropped for a box of voxels only when another is nearer to all of them. The difference of two
squared distances is linear in the voxel, so it is enough to ask this of the box's corners (the half-space test of
Voronoi diagrams; Maurer, Qi & Raghavan, PAMI 2003, use it for one row of voxels at a time). What survives is tried on
every voxel. All distances are squared and whole [voxels²], so that nothing is rounded.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.kernels.hashing import lookup

Array: TypeAlias = NDArray[Any]
Int: TypeAlias = Any

_ROOM = 1024
"""Sites tried at once: their number takes the low bits of an int32, and leaves enough for a squared distance."""
_BITS = 10

LOWEST = np.array([0] + [(n & -n).bit_length() - 1 for n in range(1, 256)], np.int64)
"""The lowest bit that is set in a byte."""


@njit(cache=True)
def fill_grid(table: Array, stored_ijk: Array, n_blocks: Int, first: Array, grid: Array) -> None:
    """The slot of each block of a dense box of blocks, −1 where there is none; fills grid (nx, ny, nz) int32.

    first : (3,) the block of grid[0, 0, 0]
    """
    nx, ny, nz = grid.shape
    if n_blocks < grid.size:
        grid[:] = -1
        for slot in range(n_blocks):
            x, y, z = stored_ijk[slot, 0] - first[0], stored_ijk[slot, 1] - first[1], stored_ijk[slot, 2] - first[2]
            if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz:
                grid[x, y, z] = slot
        return
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                grid[x, y, z] = lookup(table, first[0] + x, first[1] + y, first[2] + z)


@njit(cache=True, inline="always")
def gap(low: Int, high: Int, start: Int, end: Int) -> Int:
    """How many steps lie between the ranges low … high and start … end."""
    return max(max(start - high, low - end), 0)


@njit(cache=True)
def find_central(
    planes: Array, plane: Int, grid: Array, at: tuple[Int, Int, Int], offsets: Array, box: Array, central: Array
) -> bool:
    """The site that is nearest to the centre of `box` (6,); whether there is one. Fills central (3,), in place."""
    nx, ny, nz = grid.shape
    c0, c1, c2 = box[0] + box[3], box[1] + box[4], box[2] + box[5]  # twice the centre
    best = np.int64(1) << 40
    for o in range(offsets.shape[0]):
        if 4 * offsets[o, 3] >= best:
            break
        gx, gy, gz = at[0] + offsets[o, 0], at[1] + offsets[o, 1], at[2] + offsets[o, 2]
        if not (0 <= gx < nx and 0 <= gy < ny and 0 <= gz < nz):
            continue
        slot = grid[gx, gy, gz]
        if slot < 0:
            continue
        x0, y0, z0 = 8 * offsets[o, 0], 8 * offsets[o, 1], 8 * offsets[o, 2]
        for lx in range(8):
            word = planes[slot, plane, lx]
            along_x = np.int64(2 * (x0 + lx) - c0) ** 2
            if word == 0 or along_x >= best:
                continue
            for ly in range(8):
                byte = np.int64((word >> np.uint64(8 * ly)) & np.uint64(255))
                along_xy = along_x + np.int64(2 * (y0 + ly) - c1) ** 2
                if byte == 0 or along_xy >= best:
                    continue
                while byte:
                    lz = LOWEST[byte]
                    byte &= byte - 1
                    squared = along_xy + np.int64(2 * (z0 + lz) - c2) ** 2
                    if squared < best:
                        best = squared
                        central[0], central[1], central[2] = x0 + lx, y0 + ly, z0 + lz
    return bool(best < (np.int64(1) << 40))


@njit(cache=True)
def fill_tables(rival: Array, box: Array, apart: Array, lead: Array) -> None:
    """What each coordinate of a site adds to its squared distance from `box` (6,), and to how much nearer than the
    rival (3,) it can be to a voxel of the box: both are sums over the axes.

    apart, lead : (3, 2 m + 1, 9) int64, filled for the coordinates of m blocks to each side: for each axis, block and
                  voxel along it; last the least and the most of the block
    """
    m = apart.shape[1] // 2
    for a in range(3):
        low, high, q = box[a], box[a + 3], rival[a]
        for block in range(2 * m + 1):
            least, most = np.int64(1) << 40, -(np.int64(1) << 40)
            for n in range(8):
                s = 8 * (block - m) + n
                d = s - q
                apart[a, block, n] = gap(low, high, s, s) ** 2
                lead[a, block, n] = q * q - s * s + 2 * max(d * low, d * high)
                least, most = min(least, apart[a, block, n]), max(most, lead[a, block, n])
            apart[a, block, 8], lead[a, block, 8] = least, most


@njit(cache=True)
def gather_sites(
    words: Array, bx: Int, by: Int, bz: Int, apart: Array, lead: Array, worst: Int, sites: Array, count: Int
) -> Int:
    """Append those sites of a block, bits (8,) uint64, that may be the nearest of a voxel to sites (3, n), in place.

    bx, by, bz  : the block's place in apart and lead, see `fill_tables`
    worst       : sites farther from all voxels than this squared distance are none

    Returns the new number of sites, of which there may be 512 more.
    """
    apart_x, apart_y, apart_z = apart[0, bx], apart[1, by], apart[2, bz]
    lead_x, lead_y, lead_z = lead[0, bx], lead[1, by], lead[2, bz]
    m = apart.shape[1] // 2
    if apart_x[8] + apart_y[8] + apart_z[8] > worst or lead_x[8] + lead_y[8] + lead_z[8] < 0:
        return count
    for x in range(8):
        word = words[x]
        if word == 0 or lead_x[x] + lead_y[8] + lead_z[8] < 0:
            continue
        for y in range(8):
            byte = np.int64((word >> np.uint64(8 * y)) & np.uint64(255))
            room, ahead = worst - apart_x[x] - apart_y[y], lead_x[x] + lead_y[y]
            if byte == 0 or ahead + lead_z[8] < 0:
                continue
            while byte:
                z = LOWEST[byte]
                byte &= byte - 1
                if apart_z[z] <= room and ahead + lead_z[z] >= 0:
                    sites[0, count], sites[1, count], sites[2, count] = (
                        8 * (bx - m) + x,
                        8 * (by - m) + y,
                        8 * (bz - m) + z,
                    )
                    count += 1
    return count


@njit(cache=True)
def find_rival(x: Array, y: Array, z: Array, box: Array, scratch: Array) -> Int:
    """The first of the sites x, y, z (n,) float32 that is nearest to the centre of `box` (6,) float32."""
    c0, c1, c2 = box[0] + box[3], box[1] + box[4], box[2] + box[5]
    two = np.float32(2.0)
    for n in range(x.shape[0]):
        d0, d1, d2 = two * x[n] - c0, two * y[n] - c1, two * z[n] - c2
        scratch[n] = d0 * d0 + d1 * d1 + d2 * d2
    rival, closest = 0, scratch[0]
    for n in range(1, x.shape[0]):
        if scratch[n] < closest:
            rival, closest = n, scratch[n]
    return rival


@njit(cache=True)
def measure_lead(x: Array, y: Array, z: Array, rival: Int, box: Array, lead: Array) -> None:
    """How much nearer each site is than the rival to the voxel of `box` that is best for it; fills lead (n,) float32:
    negative where the rival beats it everywhere."""
    l0, l1, l2, h0, h1, h2 = box[0], box[1], box[2], box[3], box[4], box[5]
    q0, q1, q2 = x[rival], y[rival], z[rival]
    norm = q0 * q0 + q1 * q1 + q2 * q2
    two, zero = np.float32(2.0), np.float32(0.0)
    for n in range(x.shape[0]):
        d0, d1, d2 = x[n] - q0, y[n] - q1, z[n] - q2
        most = d0 * (h0 if d0 > zero else l0) + d1 * (h1 if d1 > zero else l1) + d2 * (h2 if d2 > zero else l2)
        lead[n] = norm - (x[n] * x[n] + y[n] * y[n] + z[n] * z[n]) + two * most


@njit(cache=True)
def fill_squares(along: Array, count: Int, squares: Array) -> None:
    """Squared distance along one axis from the first `count` sites (n,) int32 to four voxels, shifted to leave room for
    a number; fills squares (4, n) int32."""
    for a in range(4):
        row = squares[a]
        for n in range(count):
            d = np.int32(along[n] - np.int32(a))
            row[n] = np.int32(np.int32(d * d) << np.int32(_BITS))


@njit(cache=True)
def find_least(squares: Array, numbers: Array, count: Int, sums: Array, best: Array) -> None:
    """The nearest of `count` sites for each of 4³ voxels: fills best (64,) int32, squared distance and number in one.

    squares : (3, 4, n) int32 from `fill_squares`; numbers : (n,) int32; sums : (n,) int32, scratch
    """
    for y in range(4):
        for z in range(4):
            along_y, along_z = squares[1, y], squares[2, z]
            for n in range(count):
                sums[n] = np.int32(np.int32(along_y[n] + along_z[n]) + numbers[n])
            for x in range(4):
                along_x = squares[0, x]
                least = np.int32(2147483647)
                for n in range(count):
                    total = np.int32(sums[n] + along_x[n])
                    least = total if total < least else least
                best[x << 4 | y << 2 | z] = least


@njit(cache=True)
def try_sites(sites: Array, count: Int, boxes: Array, squared: Array, nearest: Array, lead: Array, work: Array) -> None:
    """Try the first `count` of sites (3, n) float32 on the voxels of the octants' boxes (8, 6) float32, in place.

    squared, nearest : (8, 64) int32, as in `find_nearest`, octant by octant; a site that is only as near as what was
                       tried before changes nothing
    lead, work       : (n,) float32 and (17, n) int32, scratch
    """
    best = np.empty(64, np.int32)
    x, y, z = sites[0, :count], sites[1, :count], sites[2, :count]
    along, numbers, sums, squares = work[:3], work[3], work[4], work[5:].reshape(3, 4, work.shape[1])
    mask = (1 << _BITS) - 1
    for octant in range(8):
        box = boxes[octant]
        if box[3] < box[0]:
            continue
        measure_lead(x, y, z, find_rival(x, y, z, box, lead), box, lead)
        x0, y0, z0 = 4 * (octant >> 2), 4 * ((octant >> 1) & 1), 4 * (octant & 1)
        kept = np.int64(0)
        for n in range(count):
            if lead[n] >= np.float32(0.0):
                along[0, kept], along[1, kept], along[2, kept] = x[n] - x0, y[n] - y0, z[n] - z0
                numbers[kept] = n
                kept += 1
        for a in range(3):
            fill_squares(along[a], kept, squares[a])
        find_least(squares, numbers, kept, sums, best)
        for v in range(64):
            if best[v] >> _BITS < squared[octant, v]:
                n = best[v] & mask
                squared[octant, v] = best[v] >> _BITS
                nearest[octant, v] = np.int32(
                    (np.int64(x[n]) + 512) << 20 | (np.int64(y[n]) + 512) << 10 | (np.int64(z[n]) + 512)
                )


@njit(cache=True, inline="always")
def local_of(octant: Int, v: Int) -> Int:
    """The place in its block of voxel v, 16 x + 4 y + z, of an octant."""
    x, y, z = (octant & 4) | v >> 4, (octant & 2) << 1 | ((v >> 2) & 3), (octant & 1) << 2 | (v & 3)
    return x << 6 | y << 3 | z


@njit(cache=True)
def bound_wanted(wanted: Array, far: Int, boxes: Array, whole: Array, squared: Array) -> bool:
    """The boxes of what is wanted (512,) of a block, its octants' (8, 6) float32 and its whole (6,), filled; whether
    there is anything. squared (8, 64) int32 becomes `far` where wanted, else 0: nothing is nearer."""
    none = True
    for octant in range(8):
        x0 = y0 = z0 = np.int64(8)
        x1 = y1 = z1 = np.int64(-1)
        for v in range(64):
            w = local_of(octant, v)
            squared[octant, v] = 0
            if wanted[w]:
                squared[octant, v] = far
                x, y, z = w >> 6, (w >> 3) & 7, w & 7
                x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
                x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
        box = boxes[octant]
        box[0], box[1], box[2], box[3], box[4], box[5] = x0, y0, z0, x1, y1, z1
        if none:
            whole[0], whole[1], whole[2], whole[3], whole[4], whole[5] = x0, y0, z0, x1, y1, z1
        whole[0], whole[1], whole[2] = min(whole[0], x0), min(whole[1], y0), min(whole[2], z0)
        whole[3], whole[4], whole[5] = max(whole[3], x1), max(whole[4], y1), max(whole[5], z1)
        none = bool(none and x1 < 0)
    return not none


@njit(cache=True)
def find_nearest(
    planes: Array,
    plane: Int,
    grid: Array,
    at: tuple[Int, Int, Int],
    offsets: Array,
    far: Int,
    wanted: Array,
    squared: Array,
    nearest: Array,
) -> None:
    """The nearest site of each wanted voxel of the block at cell `at` of the grid of slots, in place.

    offsets : (m, 4) int64, from the block to another in blocks, and the smallest squared distance between their voxels,
              sorted by it
    far     : sites at this squared distance or beyond are none
    wanted  : (512,) bool
    squared : (512,) int32, written where wanted: squared distance, `far` where there is no site
    nearest : (512,) int32, written where wanted and there is one: the site relative to the block's first voxel, 10 bits
              a coordinate, plus 512 each; of several the first in the order of `offsets`, then of the voxels
    """
    nx, ny, nz = grid.shape
    boxes, whole, rival = np.empty((8, 6), np.float32), np.empty(6, np.int64), np.empty(3, np.int64)
    mine, found = np.empty((8, 64), np.int32), np.empty((8, 64), np.int32)
    if not bound_wanted(wanted, far, boxes, whole, mine):
        return
    if find_central(planes, plane, grid, at, offsets, whole, rival):
        worst = np.int64(0)
        for a in range(3):
            worst += max(abs(rival[a] - whole[a]), abs(rival[a] - whole[a + 3])) ** 2
        worst = min(worst, far - 1)
        m = (np.int64(np.sqrt(worst)) + 8) >> 3
        apart, ahead = np.empty((3, 2 * m + 1, 9), np.int64), np.empty((3, 2 * m + 1, 9), np.int64)
        fill_tables(rival, whole, apart, ahead)
        sites, lead, work = (
            np.empty((3, _ROOM), np.float32),
            np.empty(_ROOM, np.float32),
            np.empty((17, _ROOM), np.int32),
        )
        count = np.int64(0)
        for o in range(offsets.shape[0]):
            if offsets[o, 3] > worst:
                break
            gx, gy, gz = at[0] + offsets[o, 0], at[1] + offsets[o, 1], at[2] + offsets[o, 2]
            if not (0 <= gx < nx and 0 <= gy < ny and 0 <= gz < nz):
                continue
            slot = grid[gx, gy, gz]
            if slot < 0:
                continue
            if count > _ROOM - 512:
                try_sites(sites, count, boxes, mine, found, lead, work)
                count = np.int64(0)
            bx, by, bz = m + offsets[o, 0], m + offsets[o, 1], m + offsets[o, 2]
            count = gather_sites(planes[slot, plane], bx, by, bz, apart, ahead, worst, sites, count)
        if count:
            try_sites(sites, count, boxes, mine, found, lead, work)
    for octant in range(8):
        for v in range(64):
            w = local_of(octant, v)
            if wanted[w]:
                squared[w] = mine[octant, v]
                nearest[w] = found[octant, v]
