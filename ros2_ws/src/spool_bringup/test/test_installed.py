"""What a built workspace offers to ROS 2 tools: executables, launch file, configuration, the index."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from spool_tools.operations.node_processes import find_executable

EXECUTABLES = {
    "spool_sim": "simulator",
    "spool_estimator": "estimator",
    "spool_monitor": "monitor",
    "spool_bag": "recorder",
    "spool_bringup": "spool",
}
PACKAGES = (*EXECUTABLES, "spool_core", "spool_gap", "spool_msgs", "spool_view")


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


@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("spool_estimator", ["estimator"]),
        ("spool_bringup", ["host", "--processes", "1"]),
        ("spool_bringup", ["host", "--processes", "2"]),
        ("spool_bringup", ["spool", "valve", "new"]),
    ],
)
def test_the_pydantic_of_debian_12_is_named_in_one_line(
    tmp_path: Path, package: str, words: list[str]
) -> None:
    (tmp_path / "pydantic").mkdir()
    (tmp_path / "pydantic" / "__init__.py").write_text("class BaseModel: ...\n", "utf-8")
    (tmp_path / "pydantic-1.10.4.dist-info").mkdir()
    described = "Metadata-Version: 2.1\nName: pydantic\nVersion: 1.10.4\n"
    (tmp_path / "pydantic-1.10.4.dist-info" / "METADATA").write_text(described, "utf-8")
    executable, *arguments = words
    path = ":".join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [str(find_executable(package, executable)), *arguments],
        env={**os.environ, "PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{executable}: pydantic 1.10.4 is too old, pydantic>=2.0 is needed: ")
