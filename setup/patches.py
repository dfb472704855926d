"""Patches for the CMake files of the ROS 2 wheels, which name folders of the machine that built them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from setup.errors import SetupError
from setup.layout import Layout
from setup.process import ask

NUMPY = re.compile(rb"/opt/python/cp3\d+-cp3\d+t?/lib/python3\.\d+t?/site-packages/numpy/_?core/include")
PYTHON = re.compile(rb"/opt/python/cp3\d+-cp3\d+t?/include/python3\.\d+t?")
FOLDERS = "import numpy, sysconfig; print(sysconfig.get_paths()['include']); print(numpy.get_include())"


def foreign_files(layout: Layout) -> list[Path]:
    """CMake files that still name the building machine's folders."""
    files = (layout.venv / "share").rglob("*.cmake")
    return [path for path in files if PYTHON.search(path.read_bytes()) or NUMPY.search(path.read_bytes())]


def apply(layout: Layout, environment: Mapping[str, str]) -> int:
    """Let the CMake files name this interpreter's headers and this NumPy's.

    Returns:
        How many files were changed.

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
    files = foreign_files(layout)
    for path in files:
        text = NUMPY.sub(lambda _: numpy_include, path.read_bytes())
        patched = path.with_name(path.name + ".new")
        patched.write_bytes(PYTHON.sub(lambda _: include, text))
        # A new file in its place: the old one may be a hard link into a cache that others use.
        os.replace(patched, path)
    return len(files)
