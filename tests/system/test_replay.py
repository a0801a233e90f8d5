"""`scenegraph replay` on real recordings, through the whole path."""

import json

from typer.testing import CliRunner

from scenegraph.cli import app
from tests.support.recordings import recording


def replayed(name, *options):
    result = CliRunner().invoke(app, ["replay", str(recording(name)), "--json", *options])
    assert result.exit_code == 0, result.stderr or result.exception
    return json.loads(result.stdout)


def test_simulated_scans_build_the_layers_and_the_structure():
    told = replayed("la3dm_sim_lidar_poses/sim_structured")
    assert told["observations"] == {"Scan": 12}
    assert told["refused"] == {}
    layers = told["status"]["layers"]
    assert layers["occupancy"]["voxel_size_m"] == 0.1
    assert layers["occupancy"]["blocks"] > 500
    assert layers["tsdf"]["blocks"] > 300
    assert told["status"]["nodes"]["structure"] > 5


def test_colour_and_depth_images_build_the_layers():
    told = replayed("open3d_icl_livingroom_rgbd", "--voxel-size-m", "0.05", "--every", "2")
    assert told["observations"] == {"RgbdImage": 3}
    assert told["status"]["layers"]["tsdf"]["voxel_size_m"] == 0.05
    assert told["status"]["layers"]["tsdf"]["blocks"] > 20
    assert told["status"]["nodes"]["structure"] > 0
