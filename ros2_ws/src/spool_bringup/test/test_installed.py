"""What a built workspace offers to ROS 2 tools: executables, launch file, configuration, the index."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from spool_tools.demo.processes import find_executable

EXECUTABLES = {
    "spool_sim": "simulator",
    "spool_estimator": "estimator",
    "spool_monitor": "monitor",
    "spool_bag": "recorder",
    "spool_bringup": "spool",
}
PACKAGES = (*EXECUTABLES, "spool_msgs", "spool_node", "spool_stream")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_is_in_the_index_and_has_its_manifest(package: str) -> None:
    prefix = Path(get_package_prefix(package))
    assert (prefix / "share/ament_index/resource_index/packages" / package).exists()
    assert (Path(get_package_share_directory(package)) / "package.xml").is_file()


@pytest.mark.parametrize(("package", "executable"), EXECUTABLES.items())
def test_executables_are_where_ros2_run_looks(package: str, executable: str) -> None:
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    assert os.access(path, os.X_OK)
    assert find_executable(package, executable) == path


@pytest.mark.parametrize(
    "file",
    [
        "launch/valve.launch.py",
        "config/valve.yaml",
        "config/valves.yaml",
        "config/diagnostic_aggregator.yaml",
        "package.xml",
    ],
)
def test_what_ros2_launch_needs_is_shared(file: str) -> None:
    source = Path(__file__).resolve().parent.parent / file
    shared = Path(get_package_share_directory("spool_bringup")) / file
    assert shared.read_bytes() == source.read_bytes()
