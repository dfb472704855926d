"""Workspace: its packages linked into one prefix, its messages built, and patches of the ROS 2 wheels."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import sys
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from setup.layout import Layout, SetupError
from setup.packages import failure, site_packages
from setup.process import Runner, ask
from setup.requirements import PYTHON, SERIES, VERSION

TAIL_LINES = 40
#: The one package that is compiled.
MESSAGES = "spool_msgs"
BUILD = """source=$0 build=$1; shift
cmake -S "$source" -B "$build" "$@" && cmake --build "$build" && cmake --install "$build"
"""
#: Built messages that are kept: of other branches, locks and Pythons.
KEPT = 20
#: Stands for the project's folder in built messages, until they are unpacked.
PLACE = b"@SPOOL@"
#: Asks setuptools what setup.py declares: a line of JSON for each folder.
DECLARED = """
import json, os, sys, setuptools
from distutils.core import run_setup
for folder in sys.argv[1:]:
    os.chdir(folder)
    one = run_setup("setup.py", stop_after="init")
    words = {"name": one.get_name(), "version": one.get_version(), "packages": one.packages or []}
    words |= {"files": one.data_files or [], "entries": one.entry_points or {}}
    print(json.dumps(words), flush=True)
"""

# The install links to Python, launch and configuration files: only their coming and going needs a build.
CONTENT_MATTERS = (".msg", ".srv", ".action", ".idl", ".xml", ".toml", ".cmake", ".c", ".cpp", ".h", ".hpp")
CONTENT_MATTERS_NAMES = ("CMakeLists.txt", "setup.py", "setup.cfg")
NOT_BUILT = ("test", "build", "__pycache__")

NUMPY = re.compile(rb"/opt/python/cp3\d+-cp3\d+t?/lib/python3\.\d+t?/site-packages/numpy/_?core/include")
INCLUDE = re.compile(rb"/opt/python/cp3\d+-cp3\d+t?/include/python3\.\d+t?")
FOLDERS = "import numpy, sysconfig; print(sysconfig.get_paths()['include']); print(numpy.get_include())"


def base_environment(layout: Layout, environment: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the tools of `.venv` run: pinned, whatever the user's shell holds.

    Args:
        layout: the project.
        environment: the user's.
    """
    dropped = ("PYTHONHOME", "PIP_TARGET", "PIP_PREFIX", "PIP_REQUIRE_VIRTUALENV", "VIRTUAL_ENV")
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


def run_environment(layout: Layout, environment: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the suite runs: the user's, with the workspace's variables in place."""
    result = base_environment(layout, environment)
    for name, folder in _added(layout).items():
        result[name] = _before(folder, result.get(name, ""))
    return result


def link_packages(layout: Layout, environment: Mapping[str, str]) -> None:
    """Install the packages of Python by links, in the layout of `colcon build --merge-install`.

    Args:
        layout: the project.
        environment: of `base_environment`.

    Raises:
        SetupError: a setup.py failed.
    """
    packages = [path for path in layout.packages if (path / "setup.py").is_file()]
    answer = ask([layout.python, "-I", "-c", DECLARED, *packages], environment)
    lines = answer.stdout.splitlines()
    if answer.returncode != 0:
        reason = (answer.stderr.strip().splitlines() or ["no message"])[-1]
        raise SetupError(f"{packages[len(lines)] / 'setup.py'} failed: {reason}")
    for package, line in zip(packages, lines, strict=True):
        _link(layout, package, json.loads(line))
    added = ((name, shlex.quote(str(folder))) for name, folder in _added(layout).items())
    exports = (f"export {name}={folder}${{{name}:+:${name}}}\n" for name, folder in added)
    (layout.install / "COLCON_IGNORE").touch()
    (layout.install / "local_setup.bash").write_text("".join(exports), "utf-8")


def install_messages(layout: Layout, archive: Path) -> bool:
    """Unpack the built messages.

    Returns:
        Whether the archive is there and whole.
    """
    try:
        shutil.unpack_archive(archive, layout.install, "zip")
        os.utime(archive)
    except (FileNotFoundError, shutil.ReadError, zipfile.BadZipFile, zlib.error):
        return False
    _replace(layout.install / "share", PLACE, os.fsencode(layout.root))
    return True


def build_messages(layout: Layout, environment: Mapping[str, str], runner: Runner, archive: Path) -> None:
    """Build the messages with their CMakeLists.txt, into an archive for every clone of the project.

    Args:
        layout: the project.
        environment: of `base_environment`.
        runner: runs cmake.
        archive: of `messages_archive`.

    Raises:
        SetupError: they did not build; the output is on stderr.
    """
    folder, stage = layout.output / "build" / MESSAGES, layout.output / "build" / "stage"
    shutil.rmtree(stage, ignore_errors=True)
    # Left to itself, make starts no second compiler.
    jobs = {"MAKEFLAGS": environment.get("MAKEFLAGS") or f"-j{len(os.sched_getaffinity(0))}"}
    command: list[str | Path] = ["sh", "-c", BUILD, layout.workspace / "src" / MESSAGES, folder]
    command += ["-DBUILD_TESTING=OFF", f"-DPYTHON_ONLY={'ON' if layout.underlay.is_wheels else 'OFF'}"]
    command += [f"-D{name}_EXECUTABLE={layout.python}" for name in ("Python3", "PYTHON")]
    command += [f"-DPYTHON_INSTALL_DIR={modules(layout).relative_to(layout.install)}"]
    command += [f"-DCMAKE_INSTALL_PREFIX={layout.install}", "--no-warn-unused-cli"]
    code, output = runner.run("build", command, {**environment, **jobs, "DESTDIR": str(stage)})
    if code != 0:
        sys.stderr.write("\n" + "".join(output.splitlines(keepends=True)[-TAIL_LINES:]))
        raise failure(f"{MESSAGES} did not build", output, runner.log("build"))
    installed = stage / layout.install.relative_to("/")
    _replace(installed / "share", os.fsencode(layout.root), PLACE)
    for old in sorted(archive.parent.glob(f"{MESSAGES}-*.zip"), key=os.path.getmtime)[:-KEPT]:
        old.unlink(missing_ok=True)
    new = shutil.make_archive(str(archive.with_suffix(f".{os.getpid()}")), "zip", installed)
    os.replace(new, archive)
    shutil.rmtree(stage)


def messages_archive(layout: Layout, environment: Mapping[str, str]) -> Path:
    """Where the messages are kept once they are built, by what goes into them.

    The wheels of the lock are the same everywhere: their messages are kept beside the compiled kernels, where
    each clone finds them. Those of a sourced ROS 2, which may change, stay in the clone.
    """
    compiler = shutil.which((environment.get("CC") or "cc").split(" ")[0], path=environment.get("PATH"))
    parts = [_fingerprint(layout.workspace / "src" / MESSAGES), layout.lock_hash(), PYTHON, VERSION]
    parts += [ask([compiler, "--version"], environment).stdout if compiler else ""]
    key = hashlib.sha256("\0".join([*parts, os.confstr("CS_GNU_LIBC_VERSION") or ""]).encode()).hexdigest()
    folder = layout.notes
    if layout.underlay.is_wheels:
        from spool_core.kernels import kernel_files  # noqa: PLC0415  (a call that finds all set up needs none)

        with suppress(RuntimeError):
            shared = kernel_files.wanted_kernel_folder(environment).parent / "messages"
            folder = folder if kernel_files.refusal(shared) else shared
    return folder / f"{MESSAGES}-{key}.zip"


def compile_bytecode(layout: Layout, environment: Mapping[str, str], runner: Runner) -> None:
    """Compile the modules of the workspace, as uv does those that it installs."""
    command: list[str | Path] = [layout.python, "-m", "compileall", "-q", "-j", "0"]
    runner.run("bytecode", [*command, *sorted(modules(layout).iterdir())], environment)


def package_fingerprints(packages: Iterable[Path]) -> dict[str, str]:
    """A fingerprint of every package and of how it is linked, by package folder name."""
    how = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    return {path.name: f"{_fingerprint(path)} {how}" for path in packages}


def foreign_files(layout: Layout) -> list[Path]:
    """CMake files that still name the building machine's folders."""
    files = (layout.venv / "share").rglob("*.cmake")
    return [path for path in files if INCLUDE.search(path.read_bytes()) or NUMPY.search(path.read_bytes())]


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
        patched.write_bytes(INCLUDE.sub(lambda _: include, text))
        # A new file in its place: the old one may be a hard link into a cache that others use.
        os.replace(patched, path)


def modules(layout: Layout) -> Path:
    """The folder of the workspace's modules, in which Python also finds their entry points."""
    return layout.install / "lib" / f"python{SERIES}" / "site-packages"


def _added(layout: Layout) -> dict[str, Path]:
    """What the workspace adds to the variables of a shell."""
    prefix = layout.install
    paths = {"AMENT_PREFIX_PATH": prefix, "CMAKE_PREFIX_PATH": prefix, "LD_LIBRARY_PATH": prefix / "lib"}
    return paths | {"PYTHONPATH": modules(layout)}


def _link(layout: Layout, package: Path, declared: Mapping[str, Any]) -> None:
    """Link one package: modules, shared files, entry points, and its executables where `ros2 run` looks."""
    for top in {one.partition(".")[0] for one in declared["packages"]}:
        _symlink(modules(layout) / top, package / top)
    for folder, sources in declared["files"]:
        for source in sources:
            _symlink(layout.install / folder / Path(source).name, package / source)
    name, version, entries = declared["name"], declared["version"], declared["entries"]
    about = modules(layout) / f"{name}-{version}.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", "utf-8")
    groups = ("\n".join([f"[{group}]", *lines, ""]) for group, lines in entries.items())
    (about / "entry_points.txt").write_text("\n".join(groups), "utf-8")
    for line in entries.get("console_scripts", ()):
        executable, module, function = re.split(r"\s*[=:]\s*", line)
        script = layout.install / "lib" / name / executable
        script.parent.mkdir(parents=True, exist_ok=True)
        # Started by the shell: a path with a blank, or a long one, cannot stand in the first line.
        script.write_text(
            f"#!/bin/sh\n'''exec' {shlex.quote(str(layout.python))} \"$0\" \"$@\"\n' '''\n"
            # Processes of a pool import it again and must not run it.
            f"import sys\n\nfrom {module} import {function}\n\n"
            f'if __name__ == "__main__":\n    sys.exit({function}())\n',
            "utf-8",
        )
        script.chmod(0o755)


def _symlink(link: Path, target: Path) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(target)


def _replace(folder: Path, old: bytes, new: bytes) -> None:
    for path in folder.rglob("*"):
        if path.is_file() and not path.is_symlink() and old in (text := path.read_bytes()):
            path.write_bytes(text.replace(old, new))


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
