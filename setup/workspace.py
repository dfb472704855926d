"""Workspace: built with colcon, which packages have to be built again, and patches of the ROS 2 wheels."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from setup.layout import Layout, SetupError
from setup.packages import failure, site_packages
from setup.process import Runner, ask
from setup.requirements import SetupState

TAIL_LINES = 40
# Of the built workspace's environment only what differs from the surroundings is kept; these always do.
SHELL_VARIABLES = ("_", "SHLVL", "PWD", "OLDPWD", "COLCON_CURRENT_PREFIX")
OURS = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH")

# The install links to Python, launch and configuration files: only their coming and going needs a build.
CONTENT_MATTERS = (".msg", ".srv", ".action", ".idl", ".xml", ".toml", ".cmake", ".c", ".cpp", ".h", ".hpp")
CONTENT_MATTERS_NAMES = ("CMakeLists.txt", "setup.py", "setup.cfg")
NOT_BUILT = ("test", "build", "__pycache__")

NUMPY = re.compile(rb"/opt/python/cp3\d+-cp3\d+t?/lib/python3\.\d+t?/site-packages/numpy/_?core/include")
PYTHON = re.compile(rb"/opt/python/cp3\d+-cp3\d+t?/include/python3\.\d+t?")
FOLDERS = "import numpy, sysconfig; print(sysconfig.get_paths()['include']); print(numpy.get_include())"


def base_environment(layout: Layout, environment: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the tools of `.venv` run: pinned, whatever the user's shell holds.

    Args:
        layout: the project.
        environment: the user's.
    """
    dropped = (
        "PYTHONHOME",
        "PIP_TARGET",
        "PIP_PREFIX",
        "PIP_REQUIRE_VIRTUALENV",
        "VIRTUAL_ENV",
        "COLCON_PREFIX_PATH",
    )
    result = {name: value for name, value in environment.items() if name not in dropped}
    result |= {
        "PIP_USER": "0",
        "PYTHONNOUSERSITE": "1",
        "VIRTUAL_ENV": str(layout.venv),
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }
    result["PATH"] = _before(layout.venv / "bin", environment.get("PATH", os.defpath))
    if layout.underlay.is_wheels:
        packages = site_packages(layout)
        libraries = [layout.venv / "lib", *sorted(packages.glob("ros_*.libs") if packages else ())]
        result["LD_LIBRARY_PATH"] = os.pathsep.join(str(path) for path in libraries)
        result["AMENT_PREFIX_PATH"] = result["CMAKE_PREFIX_PATH"] = str(layout.venv)
        result.pop("PYTHONPATH", None)
    else:
        result["AMENT_PREFIX_PATH"] = os.pathsep.join(layout.underlay.prefixes)
        for name in ("CMAKE_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"):
            entries = environment.get(name, "").split(os.pathsep)
            foreign = (entry for entry in entries if entry and not entry.startswith(f"{layout.root}{os.sep}"))
            result[name] = os.pathsep.join(foreign)
        result["CMAKE_PREFIX_PATH"] = _before(*layout.underlay.prefixes, result["CMAKE_PREFIX_PATH"])
    return result


def build(layout: Layout, environment: Mapping[str, str], runner: Runner, names: list[str]) -> None:
    """Build packages of the workspace.

    Args:
        layout: the project.
        environment: of `base_environment`.
        runner: runs colcon.
        names: packages; the others have to be built already.

    Raises:
        SetupError: a package did not build; its output is on stderr.
    """
    command: list[str | Path] = [layout.python, "-m", "colcon", "--log-base", layout.output / "log", "build"]
    command += ["--symlink-install", "--base-paths", layout.workspace / "src"]
    command += ["--build-base", layout.output / "build", "--install-base", layout.install]
    command += ["--event-handlers", "console_direct+", "--packages-select", *names]
    command += ["--cmake-args", "-DBUILD_TESTING=OFF", f"-DPython3_EXECUTABLE={layout.python}"]
    command += [f"-DPYTHON_EXECUTABLE={layout.python}", "--no-warn-unused-cli"]
    # Left to colcon, make starts no second compiler on a machine that has just been busy.
    jobs = {"MAKEFLAGS": environment.get("MAKEFLAGS") or f"-j{len(os.sched_getaffinity(0))}"}
    code, output = runner.run("build", command, {**environment, **jobs}, layout.workspace)
    if code == 0:
        return
    failed = [line.split()[2] for line in output.splitlines() if line.startswith("Failed   <<<")]
    error = failure(f"{' and '.join(failed) or 'the workspace'} did not build", output, runner.log("build"))
    sys.stderr.write("\n" + "".join(output.splitlines(keepends=True)[-TAIL_LINES:]))
    raise error


def compile_bytecode(layout: Layout, environment: Mapping[str, str], runner: Runner) -> None:
    """Compile the modules of the workspace, as uv does those that it installs."""
    command: list[str | Path] = [layout.python, "-m", "compileall", "-q", "-j", "0"]
    runner.run("bytecode", [*command, layout.workspace / "src", layout.install], environment)


def link_sources(layout: Layout) -> str:
    """Link each Python package into the folder from which it runs once it is built, as colcon does itself.

    Returns:
        A path on which Python finds all of them before they are built.
    """
    folders = []
    for source in sorted(path.parent for path in (layout.workspace / "src").glob("*/setup.py")):
        folder = layout.output / "build" / source.name
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / source.name).exists():
            (folder / source.name).symlink_to(source / source.name)
        folders.append(str(folder))
    return os.pathsep.join(folders)


def remove_built(layout: Layout, package: str | None = None) -> None:
    """Remove what was built, of one package or all."""
    for folder in (layout.output / "build", layout.install):
        shutil.rmtree(folder / package if package else folder, ignore_errors=True)


def learn_environment(layout: Layout, environment: Mapping[str, str]) -> dict[str, str]:
    """The path variables that the built workspace wants, without what the user's shell adds.

    Raises:
        SetupError: the built workspace cannot be sourced.
    """
    setup = layout.install / "local_setup.bash"
    clean = {
        name: value for name, value in environment.items() if name in OURS or name in ("PATH", "HOME", "LANG")
    }
    answer = ask(["bash", "--noprofile", "--norc", "-c", '. "$0" && env -0', setup], clean)
    if answer.returncode != 0:
        raise SetupError(f"{setup} cannot be sourced: delete {layout.install} and call again")
    pairs = (entry.partition("=") for entry in answer.stdout.split("\0") if entry)
    found = {name: value for name, _, value in pairs if name not in (*SHELL_VARIABLES, "HOME", "LANG")}
    own_path = found.pop("PATH", "").split(os.pathsep)
    known = environment.get("PATH", "").split(os.pathsep)
    found["PATH"] = os.pathsep.join(
        [str(layout.venv / "bin"), *(part for part in own_path if part not in known)]
    )
    return found


def run_environment(layout: Layout, state: SetupState, environment: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the suite runs: the user's, with the workspace's variables in place."""
    result = base_environment(layout, environment)
    path = _before(*state.environment.get("PATH", "").split(os.pathsep), environment.get("PATH", os.defpath))
    return result | state.environment | {"PATH": path}


def package_fingerprints(source: Path) -> dict[str, str]:
    """A fingerprint of every package beneath `source`, by package folder name."""
    return {
        path.name: _fingerprint(path) for path in sorted(source.iterdir()) if (path / "package.xml").is_file()
    }


def cmake_dependents(source: Path, changed: set[str]) -> set[str]:
    """`changed` with every compiled package that depends on one of them, directly or not."""
    found = set(changed)
    folders = [path.parent for path in source.glob("*/CMakeLists.txt")]
    manifests = {folder.name: (folder / "package.xml").read_text("utf-8") for folder in folders}
    while True:
        more = {
            name
            for name, text in manifests.items()
            if name not in found and any(f"depend>{one}</" in text for one in found)
        }
        if not more:
            return found
        found |= more


def foreign_files(layout: Layout) -> list[Path]:
    """CMake files that still name the building machine's folders."""
    files = (layout.venv / "share").rglob("*.cmake")
    return [path for path in files if PYTHON.search(path.read_bytes()) or NUMPY.search(path.read_bytes())]


def patch_foreign_files(layout: Layout, environment: Mapping[str, str]) -> None:
    """Write this interpreter's and this NumPy's headers into the CMake files.

    Raises:
        SetupError: the environment does not tell its folders.
    """
    answer = ask([layout.python, "-I", "-c", FOLDERS], environment)
    folders = answer.stdout.encode().splitlines()
    if answer.returncode != 0 or len(folders) != 2:
        raise SetupError(
            f"the environment {layout.venv} is damaged (NumPy cannot be imported): "
            "delete that folder and call again"
        )
    include, numpy_include = folders
    for path in foreign_files(layout):
        text = NUMPY.sub(lambda _: numpy_include, path.read_bytes())
        patched = path.with_name(path.name + ".new")
        patched.write_bytes(PYTHON.sub(lambda _: include, text))
        # A new file in its place: the old one may be a hard link into a cache that others use.
        os.replace(patched, path)


def _before(*parts: str | Path) -> str:
    """Paths joined, each once, the first place counts."""
    entries = [entry for part in parts for entry in str(part).split(os.pathsep) if entry]
    return os.pathsep.join(dict.fromkeys(entries))


def _fingerprint(package: Path) -> str:
    """Hash over the names of all files that the build uses, and the content of those that it copies."""
    digest = hashlib.sha256()
    python_package = package / package.name if (package / "setup.py").exists() else None
    for folder, folders, files in os.walk(package):
        folders[:] = sorted(
            name
            for name in folders
            if name not in NOT_BUILT
            and not name.startswith(".")
            and not name.endswith(".egg-info")
            and Path(folder) / name != python_package
        )
        for name in sorted(files):
            path = Path(folder) / name
            if name.startswith(".") or name.endswith((".pyc", ".md")):
                continue
            digest.update(f"{path.relative_to(package)}\0".encode())
            if name in CONTENT_MATTERS_NAMES or name.endswith(CONTENT_MATTERS):
                digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()
