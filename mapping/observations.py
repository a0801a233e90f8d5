"""What sensors, segmenters and robots say: frozen, validated values.

Everything that enters the system is one of these models. A bad one is refused at its construction with a single
`InvalidObservation` that names the field, the value and what was expected. Arrays are stored read-only, without a
copy where the input already has the right type. Poses (`T_*`) accept an `SE3`, a matrix (4, 4), or the wire form
`{"translation": [x, y, z], "rotation_wxyz": [w, x, y, z]}`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainSerializer,
    ValidationError,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from mapping.errors import InvalidObservation, InvalidParameter
from mapping.geometry import SE3, CameraIntrinsics

MAX_DEPTH_M = 1000.0
MAX_COORDINATE_M = 1.0e6

_CHUNK = re.compile(r"[a-z][a-z0-9_]*\Z")


# -- field types ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Array:
    """What an array field must be. `dtypes`: the accepted ones, the first is for lists; None in `shape` is any."""

    dtypes: tuple[str, ...]
    shape: tuple[int | None, ...]
    meaning: str

    @property
    def expected(self) -> str:
        shape = tuple("n" if n is None else n for n in self.shape)
        return f"{' or '.join(self.dtypes)} of shape {shape}".replace("'", "")

    def check(self, value: Any) -> NDArray[Any]:
        """`value` as a read-only contiguous array, without a copy where it is one."""
        if not isinstance(value, np.ndarray):
            if not isinstance(value, (list, tuple)):
                raise ValueError(f"expected an array, {self.expected}, got {type(value).__name__}")
            try:
                value = np.asarray(value, dtype=self.dtypes[0])
            except (ValueError, TypeError, OverflowError) as error:
                raise ValueError(f"expected an array, {self.expected}, got a list that is not one ({error})") from None
        if not any(value.dtype == np.dtype(name) for name in self.dtypes):
            raise ValueError(f"expected {self.expected}, got dtype {value.dtype}")
        if value.ndim != len(self.shape) or any(
            n is not None and n != m for n, m in zip(self.shape, value.shape, strict=True)
        ):
            raise ValueError(f"expected {self.expected}, got shape {value.shape}")
        if value.flags.writeable or not value.flags.c_contiguous:
            value = np.ascontiguousarray(value).view()
            value.setflags(write=False)
        return np.asarray(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"$ref": "#/$defs/Array", "description": f"{self.meaning}; {self.expected}"}


def _pose(value: Any) -> SE3:
    try:
        if isinstance(value, SE3):
            return value
        if isinstance(value, Mapping):
            if set(value) != {"translation", "rotation_wxyz"}:
                raise ValueError(f"expected translation and rotation_wxyz, got {sorted(map(str, value))}")
            return SE3.from_quaternion(value["rotation_wxyz"], np.asarray(value["translation"], dtype=np.float64))
        return SE3.from_matrix(value)
    except InvalidParameter as error:
        raise ValueError(str(error).removeprefix("pose: ")) from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected an SE3, a matrix (4, 4) or translation and rotation_wxyz ({error})") from None


def _chunk(value: Any) -> Any:
    if isinstance(value, str) and not _CHUNK.match(value):
        raise ValueError("expected a name of lower-case letters, digits and _ that begins with a letter")
    return value


Pose: TypeAlias = Annotated[
    SE3,
    BeforeValidator(_pose),
    PlainSerializer(
        lambda T: {"translation": T.translation.tolist(), "rotation_wxyz": T.quaternion_wxyz.tolist()}, when_used="json"
    ),
    WithJsonSchema(
        {
            "type": "object",
            "required": ["translation", "rotation_wxyz"],
            "properties": {
                "translation": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
                "rotation_wxyz": {"type": "array", "items": {"type": "number"}, "minItems": 4, "maxItems": 4},
            },
        }
    ),
]
Name: TypeAlias = Annotated[str, BeforeValidator(_chunk), Field(max_length=64)]
Stamp: TypeAlias = Annotated[int, Field(ge=0, lt=2**63, strict=True)]
Covariance: TypeAlias = Annotated[
    NDArray[Any], _Array(("float64", "float32"), (6, 6), "x, y, z, roll, pitch, yaw (m, rad), in the sensor frame")
]
Confidence: TypeAlias = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Metres: TypeAlias = Annotated[float, Field(gt=0.0, le=1000.0, allow_inf_nan=False)]

DepthArray: TypeAlias = Annotated[
    NDArray[Any], _Array(("float32", "uint16"), (None, None), "depth: float32 metres or uint16 millimetres")
]
ColorArray: TypeAlias = Annotated[NDArray[Any], _Array(("uint8",), (None, None, 3), "red, green, blue")]
LabelImage: TypeAlias = Annotated[NDArray[Any], _Array(("uint16",), (None, None), "class ids, 0 = not labelled")]
InstanceImage: TypeAlias = Annotated[NDArray[Any], _Array(("uint32",), (None, None), "instance ids, 0 = none")]
ConfidenceImage: TypeAlias = Annotated[NDArray[Any], _Array(("float32",), (None, None), "0 … 1")]
MaskArray: TypeAlias = Annotated[NDArray[Any], _Array(("bool",), (None, None), "mask")]
PointArray: TypeAlias = Annotated[NDArray[Any], _Array(("float32",), (None, 3), "x, y, z in the sensor frame [m]")]
LabelColumn: TypeAlias = Annotated[NDArray[Any], _Array(("uint16",), (None,), "class ids, 0 = not labelled")]
InstanceColumn: TypeAlias = Annotated[NDArray[Any], _Array(("uint32",), (None,), "instance ids, 0 = none")]
FloatColumn: TypeAlias = Annotated[NDArray[Any], _Array(("float32",), (None,), "a number a point")]
TimeColumn: TypeAlias = Annotated[NDArray[Any], _Array(("int64",), (None,), "nanoseconds after stamp_ns")]
Vector3: TypeAlias = Annotated[NDArray[Any], _Array(("float64", "float32"), (3,), "x, y, z [m]")]
Quaternion: TypeAlias = Annotated[NDArray[Any], _Array(("float64", "float32"), (4,), "w, x, y, z")]
PolygonArray: TypeAlias = Annotated[NDArray[Any], _Array(("float64", "float32"), (None, 2), "corners x, y [m]")]


# -- models --------------------------------------------------------------------------------------------------


def _shorten(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.dtype}{value.shape}"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


class Observation(BaseModel):
    """Base of all observations: frozen, no unknown fields, one clear error."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, ignored_types=(cached_property,)
    )

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            path = ".".join(str(part) for part in first["loc"])
            inner = first.get("ctx", {}).get("error")
            if isinstance(inner, InvalidObservation):  # of a part that is a model itself: it has said it all
                _, dot, rest = str(inner).partition(".")
                kind, colon, reason = str(inner).partition(":")
                part = f".{rest}" if dot and "." in kind else f"{colon}{reason}"
                raise InvalidObservation(f"{type(self).__name__}.{path}{part}") from None
            reason = first["msg"].removeprefix("Value error, ").removeprefix(f"{path}: ")
            if first["type"] == "missing":
                raise InvalidObservation(f"{type(self).__name__}.{path}: missing; it is required") from None
            where = f"{type(self).__name__}.{path}" if path else type(self).__name__
            value = "" if not path else f" (value: {_shorten(first['input'])})"
            raise InvalidObservation(f"{where}: {reason}{value}") from None

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in type(self).model_fields)

    def __hash__(self) -> int:
        return id(self)


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return bool(a == b)


def _finite(name: str, values: NDArray[Any] | None) -> None:
    if values is not None and not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")


def _covariance(value: NDArray[Any] | None) -> NDArray[Any] | None:
    if value is None:
        return None
    _finite("covariance", value)
    if not np.allclose(value, value.T, atol=1e-9 + 1e-6 * float(np.abs(value).max())):
        raise ValueError("expected a symmetric matrix")
    if float(np.linalg.eigvalsh(value).min()) < -1e-9 - 1e-6 * float(np.abs(value).max()):
        raise ValueError("expected a positive semi-definite matrix, got a negative eigenvalue")
    return value


class Sensed(Observation):
    """An observation by a robot's sensor at a time."""

    stamp_ns: Stamp
    robot: Name
    sensor: Name


class RgbdImage(Sensed):
    """A depth image with, where there are any, colour and labels on the same or another camera.

    depth            (H, W) float32 [m] or uint16 [mm]; 0 (or NaN) = not measured
    intrinsics       of the depth image
    T_map_camera     pose of the depth camera's optical frame; None: looked up in the frame tree at stamp_ns
    covariance       (6, 6) of that pose
    color            (h, w, 3) uint8 RGB; another size than depth needs color_intrinsics
    T_depth_color    pose of the colour camera in the depth camera's frame; None: the same
    labels           (H, W) uint16 class ids of a LabelSpace, 0 = not labelled
    instances        (H, W) uint32, 0 = none; ids need not last from image to image
    label_confidence (H, W) float32 in 0 … 1
    """

    depth: DepthArray
    intrinsics: CameraIntrinsics
    T_map_camera: Pose | None = None
    covariance: Covariance | None = None
    color: ColorArray | None = None
    color_intrinsics: CameraIntrinsics | None = None
    T_depth_color: Pose | None = None
    labels: LabelImage | None = None
    instances: InstanceImage | None = None
    label_confidence: ConfidenceImage | None = None

    @field_validator("depth")
    @classmethod
    def _depth_in_range(cls, depth: NDArray[Any]) -> NDArray[Any]:
        if depth.size == 0:
            raise ValueError("expected at least one pixel")
        if depth.dtype == np.float32:
            lowest, highest = float(np.nanmin(depth, initial=0.0)), float(np.nanmax(depth, initial=0.0))
            if lowest < 0.0:
                raise ValueError(f"expected depths ≥ 0 m (0 = not measured), got {lowest:.3g}")
            if highest > MAX_DEPTH_M:
                raise ValueError(f"expected depths ≤ {MAX_DEPTH_M:.0f} m, got {highest:.3g}: are these millimetres?")
        return depth

    _covariance_is_one = field_validator("covariance")(_covariance)

    @field_validator("label_confidence")
    @classmethod
    def _confidence_in_range(cls, value: NDArray[Any] | None) -> NDArray[Any] | None:
        if value is not None and not ((value >= 0.0) & (value <= 1.0)).all():
            raise ValueError("expected confidences in 0 … 1")
        return value

    @model_validator(mode="after")
    def _sizes_match(self) -> RgbdImage:
        size = (self.intrinsics.height, self.intrinsics.width)
        if self.depth.shape != size:
            raise ValueError(f"depth has shape {self.depth.shape}, but intrinsics say (height, width) = {size}")
        for name in ("labels", "instances", "label_confidence"):
            value = getattr(self, name)
            if value is not None and value.shape != size:
                raise ValueError(f"{name} has shape {value.shape}, expected that of depth, {size}")
        if self.color is not None:
            camera = self.color_intrinsics or self.intrinsics
            if self.color.shape[:2] != (camera.height, camera.width):
                which = "color_intrinsics" if self.color_intrinsics else "intrinsics (color_intrinsics is absent)"
                raise ValueError(
                    f"color has shape {self.color.shape[:2]}, but {which} say {(camera.height, camera.width)}"
                )
        return self

    @cached_property
    def depth_m(self) -> NDArray[np.float32]:
        """(H, W) float32 [m], 0 where not measured."""
        if self.depth.dtype == np.uint16:
            return np.asarray(np.multiply(self.depth, np.float32(0.001), dtype=np.float32))
        return np.asarray(np.nan_to_num(self.depth, nan=0.0))


class Scan(Sensed):
    """Points of one sweep of a range sensor.

    points         (N, 3) float32 in the sensor frame [m]
    T_map_sensor   pose of the sensor at stamp_ns; None: looked up in the frame tree
    covariance     (6, 6) of that pose
    labels, instances, intensity, time_offset_ns   (N,) each, a value a point
    """

    points: PointArray
    T_map_sensor: Pose | None = None
    covariance: Covariance | None = None
    labels: LabelColumn | None = None
    instances: InstanceColumn | None = None
    intensity: FloatColumn | None = None
    time_offset_ns: TimeColumn | None = None

    @field_validator("points")
    @classmethod
    def _points_finite(cls, points: NDArray[Any]) -> NDArray[Any]:
        _finite("points", points)
        if points.size and float(np.abs(points).max()) > MAX_COORDINATE_M:
            raise ValueError(f"expected coordinates within ±{MAX_COORDINATE_M:.0e} m, got {np.abs(points).max():.3g}")
        return points

    _covariance_is_one = field_validator("covariance")(_covariance)

    @model_validator(mode="after")
    def _lengths_match(self) -> Scan:
        for name in ("labels", "instances", "intensity", "time_offset_ns"):
            value = getattr(self, name)
            if value is not None and len(value) != len(self.points):
                raise ValueError(f"{name} has {len(value)} entries, expected one a point: {len(self.points)}")
        return self


class Box3d(Observation):
    """An oriented box in the sensor frame: centre (3,) [m], edge lengths (3,) [m], rotation w x y z."""

    center: Vector3
    size: Vector3
    rotation_wxyz: Quaternion = Field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]), validate_default=True)

    @model_validator(mode="after")
    def _is_a_box(self) -> Box3d:
        _finite("center", self.center)
        if not (np.isfinite(self.size).all() and (self.size > 0).all()):
            raise ValueError(f"size: expected three lengths > 0 m, got {self.size.tolist()}")
        _pose({"translation": self.center, "rotation_wxyz": self.rotation_wxyz})
        return self


class Detection(Observation):
    """One detected thing: a class and a place, as one of box2d (u0, v0, u1, v1) [px], mask (H, W) and box3d."""

    label: Annotated[str, Field(min_length=1, max_length=128)]
    confidence: Confidence = 1.0
    box2d: tuple[float, float, float, float] | None = None
    mask: MaskArray | None = None
    box3d: Box3d | None = None
    instance: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    attributes: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _has_one_place(self) -> Detection:
        given = [name for name in ("box2d", "mask", "box3d") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"expected exactly one of box2d, mask and box3d, got {' and '.join(given) or 'none'}")
        if self.box2d is not None:
            u0, v0, u1, v1 = self.box2d
            if not (np.isfinite(self.box2d).all() and u0 < u1 and v0 < v1):
                raise ValueError(f"box2d: expected u0 < u1 and v0 < v1, finite, got {self.box2d}")
        return self


class Detections(Sensed):
    """What a detector found in the image that has the same stamp and sensor; 3D boxes stand in that sensor's frame.

    T_map_sensor   pose of a sensor that sends boxes and no images; None: looked up in the frame tree
    """

    items: tuple[Detection, ...]
    T_map_sensor: Pose | None = None


class AgentPose(Observation):
    """Where a robot is: pose of its base_link in map, with the covariance (6, 6) of that pose."""

    stamp_ns: Stamp
    robot: Name
    T_map_base: Pose
    covariance: Covariance | None = None

    _covariance_is_one = field_validator("covariance")(_covariance)


class CorrectedPose(Observation):
    """Where a robot's base_link was at stamp_ns, as is known now; and as was believed, None: looked up in the frame
    tree."""

    stamp_ns: Stamp
    T_map_base: Pose
    T_map_base_before: Pose | None = None


class PoseCorrection(Observation):
    """Past poses of a robot that turned out to be others, as when a loop is closed.

    stamp_ns   when that was found out: what was seen until then was seen from the poses as they were believed
    poses      in order of time, none after stamp_ns. Between two the correction is interpolated; after the last it
               holds until stamp_ns; before the first nothing is corrected
    """

    stamp_ns: Stamp
    robot: Name
    poses: Annotated[tuple[CorrectedPose, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _in_order_of_time(self) -> PoseCorrection:
        stamps = [pose.stamp_ns for pose in self.poses]
        for earlier, later in pairwise(stamps):
            if earlier >= later:
                raise ValueError(f"poses: expected them in order of time, each once, got {later} after {earlier}")
        if stamps[-1] > self.stamp_ns:
            raise ValueError(f"poses: expected none after stamp_ns {self.stamp_ns}, got {stamps[-1]}")
        return self


class Transform(Observation):
    """An edge of the frame tree: `T_parent_child` at stamp_ns; a static one holds at all times."""

    stamp_ns: Stamp
    robot: Name
    parent: Annotated[str, Field(min_length=1, max_length=128)]
    child: Annotated[str, Field(min_length=1, max_length=128)]
    T_parent_child: Pose
    static: bool = False

    @model_validator(mode="after")
    def _joins_two_frames(self) -> Transform:
        if self.parent == self.child:
            raise ValueError(f"expected two different frames, got parent = child = {self.parent!r}")
        return self


class ClassInfo(Observation):
    """One class of a label space. *Things* have instances, *stuff* does not; what *moves* by itself (people, pets,
    other robots) is no part of the static map unless the world is told to fuse all."""

    name: Annotated[str, Field(min_length=1, max_length=128)]
    kind: Literal["thing", "stuff"] = "thing"
    moves: bool = False
    color: tuple[int, int, int] | None = None
    parent: str | None = None

    @field_validator("color")
    @classmethod
    def _is_a_colour(cls, color: tuple[int, int, int] | None) -> tuple[int, int, int] | None:
        if color is not None and not all(0 <= c <= 255 for c in color):
            raise ValueError(f"expected red, green, blue in 0 … 255, got {color}")
        return color


class LabelSpace(Observation):
    """What class ids mean. Without robot and sensor it is the world's default."""

    classes: dict[int, ClassInfo]
    robot: Name | None = None
    sensor: Name | None = None

    @field_validator("classes")
    @classmethod
    def _ids_in_range(cls, classes: dict[int, ClassInfo]) -> dict[int, ClassInfo]:
        for key in classes:
            if not 1 <= key < 2**16:
                raise ValueError(f"expected class ids in 1 … 65535 (0 means not labelled), got {key}")
        return classes


class RobotDescription(Observation):
    """A robot's body and abilities: footprint (K, 2) in base_link [m], heights and reach [m], payload [kg]."""

    robot: Name
    footprint: PolygonArray
    height_m: Metres = 1.0
    reach_m: Metres | None = None
    max_width_m: Metres | None = None
    payload_kg: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None

    @field_validator("footprint")
    @classmethod
    def _is_a_polygon(cls, value: NDArray[Any]) -> NDArray[Any]:
        _finite("footprint", value)
        if len(value) < 3:
            raise ValueError(f"expected at least 3 corners, got {len(value)}")
        return value

    @cached_property
    def radius_m(self) -> float:
        """Radius of the disc about base_link that holds the footprint [m]."""
        return float(np.linalg.norm(self.footprint, axis=1).max())


OBSERVATIONS: dict[str, Callable[..., Observation]] = {
    model.__name__: model
    for model in (RgbdImage, Scan, Detections, AgentPose, PoseCorrection, Transform, LabelSpace, RobotDescription)
}
