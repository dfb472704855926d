"""What a built workspace offers to ROS 2 tools: executables, launch file, configuration, the index."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from spool_stream.errors import InputError
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


# How executables are found.


def install(prefix: Path, package: str, *executables: str) -> Path:
    marker = prefix / "share/ament_index/resource_index/packages" / package
    marker.parent.mkdir(parents=True)
    marker.touch()
    for name in executables:
        path = prefix / "lib" / package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("#!/bin/sh\n")
        path.chmod(0o755)
    return prefix


def test_the_first_prefix_that_has_it_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = install(tmp_path / "one", "some_package", "other")
    two, three = (install(tmp_path / name, "some_package", "node") for name in ("two", "three"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{one}::{two}:{three}")
    assert find_executable("some_package", "node") == two / "lib/some_package/node"


def test_what_is_not_there_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefix = install(tmp_path, "some_package", "beta", "alpha")
    (prefix / "lib/some_package/data.txt").write_text("not executable")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    with pytest.raises(InputError, match="package other_package is not installed"):
        find_executable("other_package", "node")
    with pytest.raises(InputError, match=r"no executable node; it has: alpha, beta$"):
        find_executable("some_package", "node")
    with pytest.raises(InputError, match=r"no executable data\.txt"):
        find_executable("some_package", "data.txt")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    with pytest.raises(InputError, match="is the workspace built and sourced"):
        find_executable("some_package", "alpha")


def test_a_package_without_executables_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(install(tmp_path, "some_messages")))
    with pytest.raises(InputError, match=r"it has: none$"):
        find_executable("some_messages", "node")
