"""Every package's package.xml: well formed, licensed, and naming what the package imports."""

import ast
import shutil
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest
from spool_core.errors import OLDEST

SOURCE = Path(__file__).resolve().parent.parent / "ros2_ws" / "src"
PACKAGES = sorted(path.parent for path in SOURCE.parent.glob("*/spool_*/package.xml"))
# Import name -> rosdep's name, where it is not "python3-" and the import name.
ROSDEP_NAMES = {
    "PIL": "pil",
    "yaml": "yaml",
    "mcap": "mcap-ros2-support",
    "zstandard": "mcap-ros2-support",  # a requirement of mcap
    "markupsafe": "jinja2",  # a requirement of jinja2
    "lz4": "mcap-ros2-support",
    "ament_index_python": "ament_index_python",
}
# Third-party keys of rosdep's list (ros/rosdistro, rosdep/python.yaml) that the packages may use; what has no
# key there is installed with pip, as spool_bringup/README.md says.
ROSDEP_KEYS = {
    "mcap-ros2-support",
    "python3-cryptography",
    "python3-h5py",
    "python3-hypothesis",
    "python3-jinja2",
    "python3-matplotlib",
    "python3-numba",
    "python3-numpy",
    "python3-openpyxl",
    "python3-pil",
    "python3-pydantic",
    "python3-pytest",
    "python3-rich",
    "python3-rosbags-pip",
    "python3-scipy",
    "python3-typer",
    "python3-uvicorn",
    "python3-yaml",
}
# Packages of a Jazzy installation that the packages may name.
ROS_PACKAGES = {
    "ament_cmake",
    "ament_cmake_pytest",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "launch",
    "launch_ros",
    "lifecycle_msgs",
    "rcl_interfaces",
    "rclpy",
    "ros2launch",
    "rosgraph_msgs",
    "rosidl_default_generators",
    "rosidl_default_runtime",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
}
# Without a key, and documented for pip: what converts records, the OPC UA server, and the peers of the
# benchmarks and tests.
FROM_PIP = {"pyarrow", "pysindy", "river", "ruptures", "asyncua"}
# The page in the browser, and what drives a browser and reads metrics in its tests.
FROM_PIP |= {"starlette", "playwright", "prometheus_client"}
# What fleets need.
FROM_PIP |= {"duckdb", "distributed"}
# What formats of data loggers need.
FROM_PIP |= {"charset_normalizer", "pint", "nptdms", "asammdf", "pyuff", "matio"}
RUNTIME = {"depend", "exec_depend", "build_depend", "build_export_depend"}
TEST = {*RUNTIME, "test_depend"}


def manifest(package: Path) -> ElementTree.Element:
    return ElementTree.parse(package / "package.xml").getroot()


def declared(package: Path, tags: set[str]) -> set[str]:
    keys = {(entry.text or "").strip() for entry in manifest(package) if entry.tag in tags}
    return keys | {key.removeprefix("python3-").removesuffix("-pip") for key in keys}


def imported(files: list[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for file in files:
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            else:
                continue
            found |= {name.split(".")[0]: file for name in names}
    return {name: file for name, file in found.items() if name not in sys.stdlib_module_names}


def undeclared(package: Path, files: list[Path], tags: set[str]) -> list[str]:
    keys = declared(package, tags)
    return [
        f"{file.relative_to(SOURCE)} imports {name}, package.xml does not name it"
        for name, file in imported(files).items()
        if name not in {package.name, *FROM_PIP} and name not in keys and ROSDEP_NAMES.get(name) not in keys
    ]


def test_there_are_packages():
    assert "spool_msgs" in [package.name for package in PACKAGES]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
class TestPackage:
    def test_manifest(self, package: Path):
        root = manifest(package)
        assert root.tag == "package"
        assert root.get("format") == "3"
        assert root.findtext("name") == package.name
        assert [entry.text for entry in root.findall("license")] == ["Apache-2.0"]
        assert "@" in (root.find("maintainer").get("email") or "")
        assert (root.find("url").get("type"), root.findtext("url")) == ("website", "https://spool-suite.org")
        build_type = root.findtext("export/build_type")
        assert build_type == ("ament_cmake" if (package / "CMakeLists.txt").exists() else "ament_python")
        keys = [(entry.tag, entry.text) for entry in root if entry.tag in TEST]
        assert len(keys) == len(set(keys))

    def test_every_dependency_is_a_key_that_rosdep_can_resolve(self, package: Path):
        """`rosdep install --from-paths ros2_ws/src --ignore-src` refuses all for one unknown key."""
        own = {other.name for other in PACKAGES}
        keys = {entry.text for entry in manifest(package) if entry.tag in TEST | {"buildtool_depend"}}
        assert keys - own - ROSDEP_KEYS - ROS_PACKAGES == set()

    def test_license_and_changelog_stand_in_the_package(self, package: Path):
        """A package is released by itself."""
        assert manifest(package).find("license").get("file") == "LICENSE"
        assert (package / "LICENSE").read_bytes() == (SOURCE.parent.parent / "LICENSE").read_bytes()
        assert f"Changelog for package {package.name}" in (package / "CHANGELOG.rst").read_text("utf-8")

    def test_imports_are_declared(self, package: Path):
        files = [*(package / package.name).rglob("*.py"), *(package / "launch").glob("*.py")]
        assert undeclared(package, files, RUNTIME) == []

    def test_imports_of_tests_are_declared(self, package: Path):
        assert undeclared(package, list((package / "test").rglob("*.py")), TEST) == []


def test_dependencies_have_no_cycle():
    """Colcon refuses to build a workspace whose packages wait for each other."""
    names = {package.name for package in PACKAGES}
    graph = {package.name: declared(package, TEST | {"buildtool_depend"}) & names for package in PACKAGES}
    assert set(TopologicalSorter(graph).static_order()) == names


@pytest.mark.parametrize(
    "package", [path for path in PACKAGES if (path / "setup.py").exists()], ids=lambda path: path.name
)
def test_colcon_finds_the_tests(package: Path):
    """`colcon test` runs pytest where setup.py names it for tests, else unittest, which finds none."""
    text = (package / "setup.py").read_text("utf-8")
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    (extras,) = [word.value for call in calls for word in call.keywords if word.arg == "extras_require"]
    assert ast.literal_eval(extras) == {"test": ["pytest"]}


def test_what_the_nodes_need_from_pip_is_in_the_documented_command():
    """Distributions have no rosbags and no mcap, and old releases of pydantic and typer."""
    readme = (SOURCE / "spool_bringup" / "README.md").read_text("utf-8")
    (line,) = [line for line in readme.splitlines() if "pip install" in line and "pydantic" in line]
    wanted = {word.strip("'").partition(">=")[0] for word in line.partition("install")[2].split()}
    assert wanted >= {"pydantic", "rosbags", "mcap-ros2-support"}
    for name in ("pydantic", "typer"):
        assert f"{name}>={OLDEST[name]}" in line


def test_what_has_no_rosdep_key_is_documented():
    readme = (SOURCE / "spool_bringup" / "README.md").read_text("utf-8")
    for name in FROM_PIP:
        assert name in readme


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_tests_of_a_copied_package_can_be_imported(package: Path):
    """As ``colcon test`` imports them: by their folder, or from the topmost one with an ``__init__.py``."""
    files = [path for path in (package / "test").rglob("*.py") if path.name != "__init__.py"]
    alone = [path for path in files if not (path.parent / "__init__.py").exists()]
    names = [path.name for path in alone if path.name != "conftest.py"]
    assert len(set(names)) == len(names)
    for path in files:
        relative = [
            node.level
            for node in ast.parse(path.read_text("utf-8")).body
            if isinstance(node, ast.ImportFrom) and node.level
        ]
        assert not relative or (path not in alone and max(relative) == 1), path


@pytest.mark.parametrize("tests", ["spool_core/test/node", "spool_view/test/web", "spool_bringup/test"])
def test_tests_of_a_copied_package_find_their_fixtures(tests: str, tmp_path: Path) -> None:
    """As ``colcon test`` runs them in another workspace, without the conftest.py of the checkout."""
    shutil.copytree(SOURCE / tests, tmp_path / tests, ignore=shutil.ignore_patterns("__pycache__"))
    words = ["-m", "pytest", "--setup-plan", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, *words, str(tmp_path / tests)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]
