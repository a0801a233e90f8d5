"""Rigid transforms and the camera model: image ⇄ points.

Conventions: `T_a_b` is the pose of frame b in frame a, so that `p_a = T_a_b @ p_b`. Quaternions are `wxyz`.
Optical frames have z forward, x right, y down (REP-103).
"""

from __future__ import annotations

from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from mapping.errors import InvalidParameter

Array: TypeAlias = NDArray[Any]

_ROTATION_TOLERANCE = 1e-4  # poses arrive as float32 and as text with four decimals
_ROUNDING = 1e-12  # rotations that are farther off than by rounding are mended
_IDENTITY = np.eye(3)


def hat(w: ArrayLike) -> Array:
    """The skew-symmetric matrix of `w` (3,), so that `hat(w) @ p == cross(w, p)`."""
    x, y, z = np.asarray(w, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _so3_coefficients(angle: float) -> tuple[float, float, float]:
    """sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³, stable near zero."""
    if angle < 1e-6:
        return 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    return np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3


class SE3:
    """A rigid transform, immutable. `T_a_b @ T_b_c` chains, `T_a_b @ p_b` maps points (..., 3) [m].

    Raises `InvalidParameter` when the rotation is not one or a number is not finite. A rotation that is off
    by rounding (1e-4) is projected to the nearest one.
    """

    __slots__ = ("_rotation", "_translation")

    def __init__(self, rotation: ArrayLike, translation: ArrayLike) -> None:
        r = np.array(rotation, dtype=np.float64)
        t = np.array(translation, dtype=np.float64)
        if r.shape != (3, 3) or t.shape != (3,):
            raise InvalidParameter(
                f"pose: expected a rotation (3, 3) and a translation (3,), got {r.shape} and {t.shape}"
            )
        if not (np.isfinite(r).all() and np.isfinite(t).all()):
            raise InvalidParameter("pose: expected finite numbers, got NaN or infinity")
        error = float(np.abs(r @ r.T - np.eye(3)).max())
        if error > _ROTATION_TOLERANCE or np.linalg.det(r) < 0.0:
            raise InvalidParameter(
                f"pose: expected an orthonormal right-handed rotation, got R·Rᵀ off by {error:.2g}, "
                f"determinant {np.linalg.det(r):.3g}"
            )
        if error > _ROUNDING:
            u, _, vt = np.linalg.svd(r)
            r = u @ vt
        r.setflags(write=False)
        t.setflags(write=False)
        self._rotation = r
        self._translation = t

    @staticmethod
    def _proper(rotation: Array, translation: Array) -> SE3:
        """Of parts that are fresh and right by how they were computed: nothing is checked."""
        made = object.__new__(SE3)
        rotation.setflags(write=False)
        translation.setflags(write=False)
        made._rotation, made._translation = rotation, translation
        return made

    # -- construction -------------------------------------------------------------------------------------
    @staticmethod
    def identity() -> SE3:
        return SE3(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> SE3:
        """From a homogeneous matrix (4, 4)."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4):
            raise InvalidParameter(f"pose: expected a matrix (4, 4), got {m.shape}")
        if not np.isfinite(m).all():
            raise InvalidParameter("pose: expected finite numbers, got NaN or infinity")
        if not np.allclose(m[3], (0.0, 0.0, 0.0, 1.0), atol=1e-6):
            raise InvalidParameter(f"pose: expected the last row 0 0 0 1, got {m[3].tolist()}")
        return SE3(m[:3, :3], m[:3, 3])

    @staticmethod
    def from_quaternion(wxyz: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """From a quaternion (4,) w x y z, normalised here if within 1 % of unit length, and a translation (3,) [m]."""
        q = np.asarray(wxyz, dtype=np.float64)
        norm = float(np.linalg.norm(q)) if q.shape == (4,) else np.nan
        if not 0.99 < norm < 1.01:
            raise InvalidParameter(f"pose: expected a unit quaternion w x y z, got {np.asarray(wxyz).tolist()}")
        w, x, y, z = q / norm
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        return SE3(rotation, translation)

    @staticmethod
    def exp(xi: ArrayLike) -> SE3:
        """The transform reached by the twist `xi` (6,): x, y, z [m], roll, pitch, yaw [rad]."""
        twist = np.asarray(xi, dtype=np.float64)
        if twist.shape != (6,) or not np.isfinite(twist).all():
            raise InvalidParameter(f"xi: expected six finite numbers, got {twist.tolist()}")
        v, w = twist[:3], twist[3:]
        a, b, c = _so3_coefficients(float(np.sqrt(w @ w)))
        k = hat(w)
        squared = k @ k
        return SE3._proper(_IDENTITY + a * k + b * squared, (_IDENTITY + b * k + c * squared) @ v)

    # -- parts --------------------------------------------------------------------------------------------
    @property
    def rotation(self) -> Array:
        """(3, 3), read-only."""
        return self._rotation

    @property
    def translation(self) -> Array:
        """(3,) [m], read-only."""
        return self._translation

    @property
    def matrix(self) -> Array:
        """Homogeneous (4, 4)."""
        m = np.eye(4)
        m[:3, :3] = self._rotation
        m[:3, 3] = self._translation
        return m

    @property
    def quaternion_wxyz(self) -> Array:
        """Unit quaternion (4,) with w ≥ 0 (Shepperd's method: divide by the largest component)."""
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = self._rotation.tolist()
        trace = xx + yy + zz
        squares = (trace, 2.0 * xx - trace, 2.0 * yy - trace, 2.0 * zz - trace)  # 4·q² − 1 of w, x, y, z
        products = (  # 4·q·qᵀ
            (1 + trace, zy - yz, xz - zx, yx - xy),
            (zy - yz, 1 + squares[1], yx + xy, xz + zx),
            (xz - zx, yx + xy, 1 + squares[2], zy + yz),
            (yx - xy, xz + zx, zy + yz, 1 + squares[3]),
        )
        q = np.array(products[squares.index(max(squares))])
        q /= np.sqrt(q @ q)
        return q if q[0] >= 0 else -q

    # -- algebra ------------------------------------------------------------------------------------------
    def inverse(self) -> SE3:
        turned = self._rotation.T.copy()
        return SE3._proper(turned, -turned @ self._translation)

    def log(self) -> Array:
        """The twist (6,) x, y, z [m], roll, pitch, yaw [rad] with `SE3.exp(T.log()) == T`; rotation angle below π."""
        w, x, y, z = self.quaternion_wxyz
        sine = float(np.linalg.norm((x, y, z)))
        angle = 2.0 * np.arctan2(sine, w)
        scale = 2.0 if sine < 1e-12 else angle / sine
        rotation_vector = scale * np.array([x, y, z])
        _, b, c = _so3_coefficients(angle)
        k = hat(rotation_vector)
        left_jacobian = _IDENTITY + b * k + c * k @ k
        return np.concatenate([np.linalg.solve(left_jacobian, self._translation), rotation_vector])

    def interpolate(self, other: SE3, share: float) -> SE3:
        """The transform `share` ∈ [0, 1] of the way along the screw motion from this one to `other`."""
        return self @ SE3.exp(share * (self.inverse() @ other).log())

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: SE3 | Array) -> SE3 | Array:
        if isinstance(other, SE3):
            rotation = self._rotation @ other._rotation
            translation = self._rotation @ other._translation + self._translation
            if abs(rotation @ rotation.T - _IDENTITY).max() > _ROUNDING:  # many products drift
                return SE3(rotation, translation)
            return SE3._proper(rotation, translation)
        points = np.asarray(other)
        dtype = np.float32 if points.dtype == np.float32 else np.float64
        return np.asarray(points @ self._rotation.T.astype(dtype) + self._translation.astype(dtype))

    # -- values -------------------------------------------------------------------------------------------
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SE3):
            return NotImplemented
        return np.array_equal(self._rotation, other._rotation) and np.array_equal(self._translation, other._translation)

    def __hash__(self) -> int:
        return hash((self._rotation.tobytes(), self._translation.tobytes()))

    def isclose(self, other: SE3, atol: float = 1e-9) -> bool:
        return bool(np.allclose(self.matrix, other.matrix, atol=atol, rtol=0.0))

    def __reduce__(self) -> tuple[Any, ...]:
        return SE3, (np.array(self._rotation), np.array(self._translation))

    def __repr__(self) -> str:
        t = ", ".join(f"{v:.3f}" for v in self._translation)
        q = ", ".join(f"{v:.4f}" for v in self.quaternion_wxyz)
        return f"SE3(translation=({t}), rotation_wxyz=({q}))"


class CameraIntrinsics(BaseModel):
    """A pinhole camera without distortion. Pixel (u, v) = (fx·x/z + cx, fy·y/z + cy); (0, 0) is the centre of
    the upper left pixel. Lengths in pixels."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    fx: float = Field(gt=0.0, allow_inf_nan=False)
    fy: float = Field(gt=0.0, allow_inf_nan=False)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)
    width: int = Field(gt=0, le=65536)
    height: int = Field(gt=0, le=65536)

    def rays(self, rows: slice = slice(None), columns: slice = slice(None)) -> Array:
        """(height, width, 3) float32: the direction of each pixel in the optical frame, with z = 1; of some rows and
        columns only, where they are given."""
        u = (np.arange(self.width, dtype=np.float32)[columns] - np.float32(self.cx)) / np.float32(self.fx)
        v = (np.arange(self.height, dtype=np.float32)[rows] - np.float32(self.cy)) / np.float32(self.fy)
        rays = np.ones((len(v), len(u), 3), dtype=np.float32)
        rays[..., 0] = u[None, :]
        rays[..., 1] = v[:, None]
        return rays

    def backproject(self, depth_m: Array) -> Array:
        """Depth (height, width) [m] → points (height, width, 3) [m] in the optical frame; depth 0 gives the origin."""
        return self.rays() * np.asarray(depth_m, dtype=np.float32)[..., None]

    def project(self, p_camera: Array) -> tuple[Array, Array]:
        """Points (N, 3) [m] in the optical frame → pixels (N, 2) and depth z (N,) [m]; NaN pixels where z ≤ 0."""
        z = p_camera[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = p_camera[:, :2] / np.where(z > 0, z, np.nan)[:, None]
        return uv * (self.fx, self.fy) + (self.cx, self.cy), z
