"""From one kind of measurement or map to another: depth ⇄ points ⇄ range image, colour registered to depth, points ⇄
mesh, points → signed distances → occupancy, surfels → points.

Some conversions are methods or layers of their own: `TsdfMap.mesh` (signed distances → mesh), `TsdfMap.surface` (→
points), `TsdfMap.integrate` (scans of which the sensor's place is known → signed distances), `SurfelMap.integrate`
(points → surfels), `OccupancyMap.occupied_centres` (occupancy → points), `EsdfMap(occupancy)` (→ distances).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics
from mapping.grid import BLOCK_VOXELS, as_points, ijk_to_centre, join_ijk, point_to_ijk, read_only
from mapping.kernels import images
from mapping.layer import require
from mapping.mesh import Mesh
from mapping.occupancy import OccupancyMap
from mapping.range_view import as_ranges_m
from mapping.sensors import LidarModel
from mapping.tsdf import TsdfMap
from mapping.view import as_camera, as_depth_m, as_pose

if TYPE_CHECKING:
    from mapping.surfels import Surfels

Array: TypeAlias = NDArray[Any]
Camera: TypeAlias = CameraIntrinsics | Mapping[str, float]

_NEIGHBOURS = 8  # points that a voxel's signed distance is made from
_CHUNK = 256  # blocks converted at once: bounds the memory


# -- images ⇄ points -------------------------------------------------------------------------------------------


def depth_to_points(depth: Array, intrinsics: Camera) -> NDArray[np.float32]:
    """The points (N, 3) float32 [m, optical frame] that a depth image (H, W) measured, row by row.

    depth : float32 [m] or uint16 [mm]; 0, NaN and infinity = not measured
    """
    depth_m, camera = _checked_depth(depth, intrinsics)
    points = np.empty((depth_m.size + 1, 3), np.float32)  # one more, for what is written before it is known to count
    return points[: images.lift_depth(depth_m, _camera_row(camera), points)].copy()


def measured_pixels(depth: Array) -> NDArray[np.bool_]:
    """Which pixels (H, W) of a depth image measured something: those that `depth_to_points` gives a point for."""
    depth_m = as_depth_m(depth)
    return np.asarray((depth_m > 0.0) & np.isfinite(depth_m))


def points_to_depth(p_camera: ArrayLike, intrinsics: Camera) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Points (N, 3) [m, optical frame] → depth image (H, W) float32 [m], and which point each pixel shows.

    A point falls on the pixel nearest to it; of several the nearest counts; where there is none the depth is 0 and the
    index −1.
    """
    camera = as_camera(intrinsics)
    shape = (camera.height, camera.width)
    depth, index = np.empty(shape, np.float32), np.empty(shape, np.int64)
    images.drop_points(as_points(p_camera, "p_camera"), _camera_row(camera), depth, index)
    return depth, index


def range_image_to_points(ranges: Array, model: LidarModel) -> NDArray[np.float32]:
    """The points (N, 3) float32 [m, sensor frame] that a range image (rows, columns) float32 [m] measured, row by row.

    0, NaN and infinity = not measured.
    """
    ranges_m = as_ranges_m(ranges, model)
    measured = (ranges_m > 0.0) & np.isfinite(ranges_m)
    return np.asarray(model.rays()[measured] * ranges_m[measured][:, None])


def points_to_range_image(p_sensor: ArrayLike, model: LidarModel) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Points (N, 3) [m, sensor frame] → range image (rows, columns) float32 [m], and which point each beam met; see
    `LidarModel.range_image`."""
    return model.range_image(p_sensor)


# -- colour of one camera for the depth of another -------------------------------------------------------------


def register_color(
    color: Array,
    color_intrinsics: Camera,
    T_depth_color: SE3 | ArrayLike,
    depth: Array,
    intrinsics: Camera,
    *,
    tolerance: float = 0.02,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """The colour that each pixel of a depth image has in the image of another camera.

    color      (h, w, 3) uint8 of the colour camera, which stands at `T_depth_color` in the depth camera's frame
    depth      (H, W) float32 [m] or uint16 [mm]; 0, NaN and infinity = not measured
    tolerance  share of the distance by which a surface may lie behind another one and still be the same

    Returns the colours (H, W, 3) uint8, interpolated between pixels, and which of them are valid (H, W) bool: measured,
    inside the colour image, and not hidden from the colour camera by something else that the depth image shows. The
    hidden are found by drawing the depth image into the colour camera (a z-buffer, Catmull 1974).
    Raises `InvalidObservation` where an image does not fit its camera.
    """
    depth_m, camera = _checked_depth(depth, intrinsics)
    other = as_camera(color_intrinsics)
    pixels = np.asarray(color)
    if pixels.dtype != np.uint8 or pixels.shape != (other.height, other.width, 3):
        raise InvalidObservation(
            f"color: expected uint8 {(other.height, other.width, 3)} as color_intrinsics say, "
            f"got {pixels.dtype} {pixels.shape}"
        )
    seen, nearest = _look(depth_m, camera, other, T_depth_color)
    registered, valid = np.empty((*depth_m.shape, 3), np.uint8), np.empty(depth_m.shape, np.bool_)
    share = require("tolerance", tolerance, 0.0, 1.0)
    images.pick_colors(seen, nearest, share, read_only(np.ascontiguousarray(pixels)), registered, valid)
    return registered, valid


def register_labels(
    labels: Array,
    label_intrinsics: Camera,
    T_depth_color: SE3 | ArrayLike,
    depth: Array,
    intrinsics: Camera,
    *,
    tolerance: float = 0.02,
) -> tuple[Array, NDArray[np.bool_]]:
    """The label that each pixel of a depth image has in a mask, or an image of classes or instances, of another camera.

    labels  (h, w) of any type, of the camera that stands at `T_depth_color` in the depth camera's frame

    As `register_color`, but the nearest pixel counts, since what lies between two labels is neither. Returns labels
    (H, W) of the same type, 0 or False where they are not valid, and which are valid (H, W) bool.
    """
    depth_m, camera = _checked_depth(depth, intrinsics)
    other = as_camera(label_intrinsics)
    pixels = np.asarray(labels)
    if pixels.shape != (other.height, other.width):
        raise InvalidObservation(
            f"labels have shape {pixels.shape}, but label_intrinsics say {(other.height, other.width)}"
        )
    seen, nearest = _look(depth_m, camera, other, T_depth_color)
    index = np.empty(depth_m.shape, np.int32)
    images.pick_pixels(seen, nearest, require("tolerance", tolerance, 0.0, 1.0), index)
    valid = index >= 0
    return np.where(valid, pixels.ravel()[index], np.zeros((), pixels.dtype)), valid


def _look(
    depth_m: Array, camera: CameraIntrinsics, other: CameraIntrinsics, T_depth_color: SE3 | ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of depth lies in the other camera's image, and how near what covers each pixel of that is."""
    pose = as_pose(T_depth_color, "T_depth_color").inverse()
    pose_row = np.concatenate([pose.rotation.ravel(), pose.translation])
    seen = np.empty((*depth_m.shape, 3), np.float32)
    images.look_from(depth_m, _camera_row(camera), pose_row, _camera_row(other), seen)
    nearest = np.full((other.height, other.width), np.inf, np.float32)
    images.cover(depth_m, seen, other.fx / camera.fx, other.fy / camera.fy, nearest)
    return seen, nearest


def _camera_row(camera: CameraIntrinsics) -> NDArray[np.float64]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height])


def _checked_depth(depth: Array, intrinsics: Camera) -> tuple[NDArray[np.float32], CameraIntrinsics]:
    camera = as_camera(intrinsics)
    depth_m = as_depth_m(depth)
    if depth_m.shape != (camera.height, camera.width):
        raise InvalidObservation(
            f"depth has shape {depth_m.shape}, but intrinsics say (height, width) = {(camera.height, camera.width)}"
        )
    return depth_m, camera


# -- surfaces ⇄ points -----------------------------------------------------------------------------------------


def mesh_to_points(
    mesh: Mesh, spacing_m: float, *, seed: int = 0
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Points spread evenly over a mesh, one to `spacing_m`² of its area.

    Returns points (N, 3) float32 [m], the unit normals (N, 3) float32 of their triangles, towards the side from which
    these are counter-clockwise, and the rows (N,) of these in `mesh.triangles`, for colours and labels.

    Every triangle gets its share of points to within one (systematic sampling of the summed areas); within a triangle
    they are uniform (Osada et al., Shape Distributions, 2002). The same seed gives the same points.
    """
    require("spacing_m", spacing_m, 0.0, 1e6, "m")
    random = np.random.default_rng(seed)
    a, b, c = (mesh.vertices[mesh.triangles[:, n]].astype(np.float64) for n in range(3))
    across = np.cross(b - a, c - a)
    doubled = np.linalg.norm(across, axis=1)
    summed = np.cumsum(0.5 * doubled)
    area = summed[-1] if len(summed) else 0.0
    n_points = round(area / spacing_m**2)
    at = (np.arange(n_points) + random.uniform()) * (area / max(n_points, 1))
    rows = np.searchsorted(summed, np.minimum(at, np.nextafter(area, 0.0)), side="right")  # never one without area
    root, along = np.sqrt(random.uniform(size=(n_points, 1))), random.uniform(size=(n_points, 1))
    points = (1.0 - root) * a[rows] + root * (1.0 - along) * b[rows] + root * along * c[rows]
    normals = across[rows] / doubled[rows][:, None]
    return points.astype(np.float32), normals.astype(np.float32), rows


def surfels_to_points(
    surfels: Surfels, spacing_m: float | None = None, *, seed: int = 0
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Points (N, 3) float32 [m] and unit normals (N, 3) float32 of surfels: their centres or, given `spacing_m`, points
    spread evenly over their discs, one to `spacing_m`² of area and one a disc at least."""
    if spacing_m is None:
        return surfels.centres.astype(np.float32), surfels.normals.copy()
    require("spacing_m", spacing_m, 0.0, 1e6, "m")
    random = np.random.default_rng(seed)
    radii = surfels.radii.astype(np.float64)
    counts = np.maximum(np.rint(np.pi * radii**2 / spacing_m**2), 1.0).astype(np.int64)
    rows = np.repeat(np.arange(len(surfels)), counts)
    normals = surfels.normals[rows].astype(np.float64)
    # Two axes across each normal (Duff et al., Building an Orthonormal Basis, Revisited, 2017).
    sign = np.copysign(1.0, normals[:, 2])
    p = -1.0 / (sign + normals[:, 2])
    q = normals[:, 0] * normals[:, 1] * p
    u = np.stack([1.0 + sign * normals[:, 0] ** 2 * p, sign * q, -sign * normals[:, 0]], axis=1)
    v = np.stack([q, sign + normals[:, 1] ** 2 * p, -normals[:, 1]], axis=1)
    reach = (radii[rows] * np.sqrt(random.uniform(size=len(rows))))[:, None]
    angle = random.uniform(0.0, 2.0 * np.pi, (len(rows), 1))
    points = surfels.centres[rows] + reach * (np.cos(angle) * u + np.sin(angle) * v)
    return points.astype(np.float32), surfels.normals[rows]


def estimate_normals(points: ArrayLike, seen_from: ArrayLike, neighbours: int = 12) -> NDArray[np.float32]:
    """Unit normals (N, 3) float32 of points (N, 3) [m]: across the plane that fits each point's nearest `neighbours`
    best, on the side of `seen_from`, the sensor's place (3,) or that of each point (N, 3) [m].

    Principal component analysis (Hoppe et al., Surface reconstruction from unorganized points, 1992).
    Raises `InvalidParameter` where `seen_from` does not fit, or for fewer points than `neighbours`, or those below 3.
    """
    places = as_points(points, "points")
    towards = np.asarray(seen_from, np.float64)
    if towards.shape not in ((3,), places.shape):
        raise InvalidParameter(f"seen_from: expected a place (3,) or one a point {places.shape}, got {towards.shape}")
    if not 3 <= neighbours <= len(places):
        raise InvalidParameter(f"neighbours: expected 3 … {len(places)} for {len(places)} points, got {neighbours!r}")
    near = places[cKDTree(places).query(places, k=neighbours)[1]]
    near = near - near.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(near.transpose(0, 2, 1) @ near)[1][:, :, 0]
    behind = np.einsum("ni,ni->n", normals, towards - places) < 0.0
    normals[behind] *= -1.0
    return normals.astype(np.float32)


def points_to_tsdf(
    points: ArrayLike, normals: ArrayLike, voxel_size_m: float, truncation_m: float | None = None
) -> TsdfMap:
    """Signed distances to the surface that points (N, 3) [m] with unit normals (N, 3) into free space lie on.

    A voxel's distance is the weighted mean of its distances from the planes of the nearest points, those within a voxel
    or two of the nearest (implicit moving least squares: Kolluri, Provably good moving least squares, 2008).
    Known are voxels within `truncation_m` (default as `TsdfMap`) of the surface whose foot point on it lies no farther
    than 1.5 voxels from a point, so that holes wider than some three voxels stay open. All weigh 1.
    Points should lie no farther apart than about a voxel. For a mesh, take `mesh_to_points` first.
    Raises `InvalidParameter` where points and normals are not finite, not of one number, or normals not of unit length.
    """
    places, directions = _oriented(points, normals)
    tsdf = TsdfMap(voxel_size_m, truncation_m)
    size, reach = tsdf.voxel_size_m, tsdf.truncation_m + 2.0 * tsdf.voxel_size_m
    steps = np.arange(-np.ceil(reach / tsdf.block_size_m), np.ceil(reach / tsdf.block_size_m) + 1)
    around = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int32)
    seeds = np.unique(point_to_ijk(places, size) >> 3, axis=0)
    blocks = np.unique((seeds[:, None] + around).reshape(-1, 3), axis=0)
    tree: Any = cKDTree(places) if len(places) else None
    distance, weight = (np.zeros((len(blocks), BLOCK_VOXELS), np.float32) for _ in range(2))
    for first in range(0, len(blocks), _CHUNK):
        part = slice(first, first + _CHUNK)
        ijk = join_ijk(
            np.repeat(blocks[part], BLOCK_VOXELS, axis=0), np.tile(np.arange(BLOCK_VOXELS), len(blocks[part]))
        )
        centres = ijk_to_centre(ijk, size)
        away, rows = tree.query(centres, k=range(1, _NEIGHBOURS + 1), distance_upper_bound=reach)
        near = np.isfinite(away[:, 0])
        centres, away, rows = centres[near], away[near], np.minimum(rows[near], len(places) - 1)
        share = np.exp(-0.5 * (away**2 - away[:, :1] ** 2) / size**2)  # relative to the nearest: never all zero
        heights = np.einsum("nki,nki->nk", centres[:, None] - places[rows], directions[rows])
        height = (share * heights).sum(axis=1) / share.sum(axis=1)
        aside = away[:, 0] ** 2 - height**2
        known = np.zeros(len(ijk), np.bool_)
        known[near] = (np.abs(height) <= tsdf.truncation_m) & (aside <= (1.5 * size) ** 2)
        values = np.zeros(len(ijk), np.float32)
        values[near] = height
        weight[part] = known.reshape(-1, BLOCK_VOXELS)
        distance[part] = np.where(known, values, 0.0).reshape(-1, BLOCK_VOXELS)
    used = weight.any(axis=1)
    return TsdfMap.from_state(
        {**tsdf.state(), "block_ijk": blocks[used], "distance": distance[used], "weight": weight[used]}
    )


def points_to_mesh(
    points: ArrayLike,
    normals: ArrayLike,
    spacing_m: float,
    method: Literal["distance", "poisson", "ball_pivoting"] = "distance",
) -> Mesh:
    """The surface that points (N, 3) [m] with unit normals (N, 3) into free space lie on, as a mesh.

    spacing_m  about how far the points lie apart
    method     "distance": zero crossings of `points_to_tsdf` with voxels of `spacing_m`; smooths noise, keeps holes.
               "poisson": Kazhdan & Hoppe, Screened Poisson Surface Reconstruction, 2013, by Open3D; closes holes, of
               which what lies farther than 3 `spacing_m` from all points is cut away again.
               "ball_pivoting": Bernardini et al. 1999, by Open3D; keeps the points as vertices, noise and all.

    The mesh of a smooth surface lies within half of `spacing_m` of it ("poisson": within all of it), and each of the
    points within `spacing_m` of the mesh. Raises `InvalidParameter` as `points_to_tsdf` does, and for fewer than four
    points where Open3D makes the mesh.
    """
    size = require("spacing_m", spacing_m, 0.0, 100.0, "m")
    if method == "distance":
        return points_to_tsdf(points, normals, size).mesh()
    if method not in ("poisson", "ball_pivoting"):
        raise InvalidParameter(f'method: expected "distance", "poisson" or "ball_pivoting", got {method!r}')
    import open3d

    places, directions = _oriented(points, normals)
    if len(places) < 4:
        raise InvalidParameter(f"points: expected four or more, got {len(places)}")
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(places.copy()))
    cloud.normals = open3d.utility.Vector3dVector(directions.copy())
    make = open3d.geometry.TriangleMesh
    if method == "ball_pivoting":
        made = make.create_from_point_cloud_ball_pivoting(cloud, open3d.utility.DoubleVector([size, 2.0 * size]))
    else:
        made, _ = make.create_from_point_cloud_poisson(cloud, depth=0, width=size, n_threads=1)
        away = cKDTree(places).query(np.asarray(made.vertices))[0]
        made.remove_vertices_by_mask(away > 3.0 * size)
    made.compute_vertex_normals()
    return Mesh(
        np.asarray(made.vertices).astype(np.float32),
        np.asarray(made.triangles).astype(np.int32),
        np.asarray(made.vertex_normals).astype(np.float32),
    )


def _oriented(points: ArrayLike, normals: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and their unit normals (N, 3), checked."""
    places, directions = as_points(points, "points"), as_points(normals, "normals")
    if places.shape != directions.shape:
        raise InvalidParameter(f"normals: expected one a point {places.shape}, got {directions.shape}")
    for name, values in (("points", places), ("normals", directions)):
        if not np.isfinite(values).all():
            raise InvalidParameter(f"{name}: expected finite numbers, got NaN or infinity")
    lengths = np.linalg.norm(directions, axis=1)
    if len(lengths) and np.abs(lengths - 1.0).max() > 1e-3:
        raise InvalidParameter(f"normals: expected unit vectors, got lengths {lengths.min():.3g} … {lengths.max():.3g}")
    return places, directions


def tsdf_to_occupancy(tsdf: TsdfMap) -> OccupancyMap:
    """What a signed distance map says of occupancy: voxels whose centre lies behind a surface are occupied, those
    before one are free, both as surely as an `OccupancyMap` can be, and what the map has not seen stays unknown.

    The faces between occupied and free voxels lie within half a voxel of the zero crossings between their centres.
    Behind a surface as much is occupied as the map knows: its truncation.
    """
    occupancy = OccupancyMap(tsdf.voxel_size_m, tsdf.max_range_m)
    distance, weight = tsdf.store.used("distance"), tsdf.store.used("weight")
    sides = np.where(distance > 0.0, np.int8(occupancy.lowest_evidence), np.int8(occupancy.highest_evidence))
    evidence = np.where(weight > 0.0, sides, np.int8(-128))
    known = (weight > 0.0).any(axis=1)
    occupancy.set_evidence(tsdf.block_ijk[known], evidence[known])
    return occupancy
