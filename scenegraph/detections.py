"""Detections meet the image in which they were made, whichever comes first."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mapping.box_tracks import Sighting, UprightBox
from mapping.boxed import surface_in_box
from mapping.errors import InvalidObservation
from mapping.geometry import SE3
from mapping.observations import Box3d, Detections, RgbdImage
from scenegraph.labels import Labels

Array: TypeAlias = NDArray[Any]
Key: TypeAlias = tuple[str, str, int]

KEPT_IMAGES = 8
KEPT_DETECTIONS = 256


class Posed(NamedTuple):
    """An image without labels of its own and where it was taken."""

    image: RgbdImage
    T_map_camera: SE3


class DetectionDesk:
    """Holds the last images without labels, and detections whose image has not come yet, both up to a bound."""

    def __init__(self) -> None:
        self._images: OrderedDict[Key, Posed] = OrderedDict()
        self._detections: OrderedDict[Key, Detections] = OrderedDict()
        self._cameras: set[tuple[str, str]] = set()

    @property
    def waiting(self) -> int:
        """Detections that wait for their image."""
        return len(self._detections)

    def keep(self, image: RgbdImage, T_map_camera: SE3) -> None:
        """Remember an image that may get its labels from detections later."""
        self._cameras.add((image.robot, image.sensor))
        if image.labels is None:
            self._images[_key(image)] = Posed(image, T_map_camera)
            while len(self._images) > KEPT_IMAGES:
                self._images.popitem(last=False)

    def label(self, image: RgbdImage, labels: Labels) -> RgbdImage:
        """The image with the labels of the detections that waited for it; the image itself where there are none."""
        detections = self._detections.pop(_key(image), None) if image.labels is None else None
        return image if detections is None else painted(image, detections, labels)

    def stands_alone(self, detections: Detections) -> bool:
        """Whether there are only boxes in space, of a sensor that has not sent an image."""
        if (detections.robot, detections.sensor) in self._cameras:
            return False
        return all(item.box3d is not None for item in detections.items)

    def match(self, detections: Detections, labels: Labels) -> Posed | None:
        """The image that the detections belong to, labelled by them; None while it has not come."""
        posed = self._images.get(_key(detections))
        if posed is None:
            self._detections[_key(detections)] = detections
            while len(self._detections) > KEPT_DETECTIONS:
                self._detections.popitem(last=False)
            return None
        labelled = Posed(painted(posed.image, detections, labels), posed.T_map_camera)
        del self._images[_key(detections)]
        return labelled


def painted(image: RgbdImage, detections: Detections, labels: Labels) -> RgbdImage:
    """The image with class ids, instance ids and confidences of world classes painted in, the surest last, on top."""
    shape = image.depth.shape
    classes, instances = np.zeros(shape, np.uint16), np.zeros(shape, np.uint32)
    confidence = np.zeros(shape, np.float32)
    order = sorted(range(len(detections.items)), key=lambda n: detections.items[n].confidence)
    points: Array | None = None
    for n in order:
        item = detections.items[n]
        if item.mask is not None:
            if item.mask.shape != shape:
                raise InvalidObservation(
                    f"Detections.items.{n}.mask: expected the image's shape {shape}, got {item.mask.shape}"
                )
            where = item.mask
        elif item.box2d is not None:
            where = surface_in_box(image.depth_m, image.intrinsics, item.box2d)
        else:
            assert item.box3d is not None
            points = image.intrinsics.backproject(image.depth_m) if points is None else points
            where = _inside(item.box3d, points) & (image.depth_m > 0)
        classes[where] = labels.id_of(item.label)
        instances[where] = n + 1
        confidence[where] = item.confidence
    return image.model_copy(update={"labels": classes, "instances": instances, "label_confidence": confidence})


def sightings(detections: Detections, T_map_sensor: SE3) -> list[Sighting]:
    """The boxes in space of detections, in map."""
    return [
        Sighting(item.label, UprightBox.about(item.box3d, T_map_sensor), item.confidence)
        for item in detections.items
        if item.box3d is not None
    ]


def _inside(box: Box3d, points: Array) -> Array:
    T_camera_box = SE3.from_quaternion(box.rotation_wxyz, np.asarray(box.center, dtype=np.float64))
    local = (points - T_camera_box.translation) @ T_camera_box.rotation
    return np.asarray((np.abs(local) <= 0.5 * box.size).all(axis=-1))


def _key(observation: RgbdImage | Detections) -> Key:
    return observation.robot, observation.sensor, observation.stamp_ns
