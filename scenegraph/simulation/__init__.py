"""Seeded homes, a robot's tour through them, what its sensors would see, and the truth about it all.

Truth is what the generator placed, from exact meshes. Nothing here knows of the maps and graphs that are judged by it.
"""

from scenegraph.simulation.assembling import simulate_home
from scenegraph.simulation.changing import change_home
from scenegraph.simulation.home import Change, Home, TrueDoor, TrueObject, TrueRoom, TrueWindow
from scenegraph.simulation.noise import NoiseModel
from scenegraph.simulation.rendering import CAMERA, Lidar, Rendered, Renderer
from scenegraph.simulation.structure import TruePlane
from scenegraph.simulation.tour import Step, Tour
from scenegraph.simulation.truth import TruthRecorder

__all__ = [
    "CAMERA",
    "Change",
    "Home",
    "Lidar",
    "NoiseModel",
    "Rendered",
    "Renderer",
    "Step",
    "Tour",
    "TrueDoor",
    "TrueObject",
    "TruePlane",
    "TrueRoom",
    "TrueWindow",
    "TruthRecorder",
    "change_home",
    "simulate_home",
]
