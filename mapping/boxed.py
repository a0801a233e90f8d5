"""What a box in an image is drawn around: a box is no segmentation, and its background no part of the thing."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import CameraIntrinsics
from mapping.object_space import DEPTH_NOISE, space_of_mask

Array: TypeAlias = NDArray[Any]

VOXEL_M = 0.03
"""What lies farther apart than this is not one surface, unless neighbouring pixels show it to be."""
BAND_SHARE = 0.15
LEAST_BAND_PX = 3
"""The surroundings of a box are a band of this share of its shorter side about it, and so many pixels at least; and its
four corners, which are all there is to see of them where it reaches to the border of the image."""
BACKGROUND_SHARE = 0.15
MOST_BACKGROUNDS = 3
"""A plane on which this share of the surroundings lies goes on behind the box: floor, table or wall."""
HYPOTHESES = 60
MOST_POINTS = 400
LEAST_KEPT = 0.05
"""Where less than this share of a box stands out of its background, the thing is flat and lies in it: a picture, a
rug."""


def surface_in_box(
    depth_m: Array, intrinsics: CameraIntrinsics, box: tuple[float, float, float, float]
) -> NDArray[np.bool_]:
    """The pixels (H, W) bool of the thing that a box u0, v0, u1, v1 [px] of a depth image (H, W) float32 [m] shows.

    Planes on which the surroundings of the box lie are taken for background, and of the rest the cluster in the middle
    for the thing (`space_of_mask`). All pixels in the box where nothing stands out.
    """
    height, width = depth_m.shape
    u0, v0, u1, v1 = (round(c) for c in box)
    inside = np.zeros((height, width), np.bool_)
    inside[max(v0, 0) : max(v1, 0), max(u0, 0) : max(u1, 0)] = True
    measured = inside & (depth_m > 0.0)
    if not measured.any():
        return inside
    band = max(LEAST_BAND_PX, round(BAND_SHARE * min(u1 - u0, v1 - v0)))
    around = np.zeros((height, width), np.bool_)
    around[max(v0 - band, 0) : max(v1 + band, 0), max(u0 - band, 0) : max(u1 + band, 0)] = True
    around &= ~inside
    for rows in (slice(max(v0, 0), max(v0 + band, 0)), slice(max(v1 - band, 0), max(v1, 0))):
        for columns in (slice(max(u0, 0), max(u0 + band, 0)), slice(max(u1 - band, 0), max(u1, 0))):
            around[rows, columns] = True
    around &= depth_m > 0.0
    rays = intrinsics.rays().reshape(-1, 3)
    where = np.flatnonzero(around)
    where = where[:: max(1, len(where) // MOST_POINTS)]
    planes = background_planes((rays[where] * depth_m.reshape(-1, 1)[where]).astype(np.float64))
    within = np.flatnonzero(measured)
    points = rays[within] * depth_m.reshape(-1, 1)[within]
    standing = measured.copy()
    standing.reshape(-1)[within] = ~_near(points, planes[:, :3], planes[:, 3]).any(axis=1)
    space = space_of_mask(depth_m, intrinsics, standing, VOXEL_M, bleed_px=1)
    if space.kept.sum() < LEAST_KEPT * measured.sum():
        return inside
    return space.kept


def background_planes(points: Array) -> NDArray[np.float64]:
    """The planes (P, 4), unit normal and offset, on which large shares of camera points (N, 3) [m] lie, the largest
    first: random sample consensus, the same for the same points."""
    found: list[Array] = []
    rest = points
    random = np.random.default_rng(0)
    while len(found) < MOST_BACKGROUNDS and len(rest) >= max(3.0, BACKGROUND_SHARE * len(points)):
        a, b, c = (rest[random.integers(len(rest), size=HYPOTHESES)] for _ in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        sound = lengths > 1e-9
        if not sound.any():
            break
        normals = normals[sound] / lengths[sound, None]
        offsets = (normals * a[sound]).sum(axis=1)
        on = _near(rest, normals, offsets)
        best = int(on.sum(axis=0).argmax())
        mine = rest[on[:, best]]
        if len(mine) < BACKGROUND_SHARE * len(points):
            break
        centre = mine.mean(axis=0)
        normal = np.linalg.eigh((mine - centre).T @ (mine - centre))[1][:, 0]
        found.append(np.array([*normal, normal @ centre]))
        rest = rest[~on[:, best]]
    return np.array(found).reshape(-1, 4)


def _near(points: Array, normals: Array, offsets: Array) -> NDArray[np.bool_]:
    """(N, P) whether camera points (N, 3) [m] lie on planes (P, 3), (P,), as far as depth can tell."""
    sigma = DEPTH_NOISE[0] + DEPTH_NOISE[1] * (points[:, 2] - 0.4) ** 2
    return np.asarray(np.abs(points @ normals.T - offsets) < (2.0 * sigma + 0.25 * VOXEL_M)[:, None])
