"""How a world is set up."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from scenegraph.errors import InvalidConfig

Metres = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class WorldConfig(BaseModel):
    """Parameters of a world; all lengths in metres.

    voxel_size_m          edge of the voxels of the metric layers
    instance_voxel_size_m edge of the voxels of classes and things; default half a voxel, at most 2.5 cm
    max_range_m           surfaces beyond this distance from the sensor are not mapped
    label_range_m         labels beyond this are not believed
    moving                what becomes of classes that move by themselves: left out of the map; kept beside it, each
                          thing as a model of its own that moves; or fused like all else
    fusion                of labels: votes, or measurements that are right with the confidence that comes with them
    spread_labels         whether labels of images are spread over where they may belong, given the pose's covariance
    rule_files            Prolog files of the user, loaded after the rules that come with the package
    robot_radius_m        of robots that do not describe themselves
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    voxel_size_m: Annotated[float, Field(ge=0.005, le=1.0, allow_inf_nan=False)] = 0.05
    instance_voxel_size_m: Metres | None = None
    max_range_m: Metres = 6.0
    label_range_m: Metres = 5.0
    moving: Literal["leave_out", "model", "fuse"] = "leave_out"
    fusion: Literal["votes", "bayes"] = "votes"
    spread_labels: bool = False
    rule_files: tuple[Path, ...] = ()
    robot_radius_m: Metres = 0.25

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = ".".join(str(part) for part in first["loc"])
            raise InvalidConfig(f"WorldConfig.{name}: {first['msg']} (value: {first['input']!r})") from None

    @property
    def fine_voxel_size_m(self) -> float:
        return self.instance_voxel_size_m or min(0.025, 0.5 * self.voxel_size_m)
