"""Fingerprints of packages: which have to be built again."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

# The install links to Python, launch and configuration files: only their coming and going needs a build.
CONTENT_MATTERS = (".msg", ".srv", ".action", ".idl", ".xml", ".toml", ".cmake", ".c", ".cpp", ".h", ".hpp")
CONTENT_MATTERS_NAMES = ("CMakeLists.txt", "setup.py", "setup.cfg")
NOT_BUILT = ("test", "build", "__pycache__")


def package_fingerprints(source: Path) -> dict[str, str]:
    """A fingerprint of every package beneath `source`, by package folder name."""
    return {
        path.name: _fingerprint(path) for path in sorted(source.iterdir()) if (path / "package.xml").is_file()
    }


def cmake_dependents(source: Path, changed: set[str]) -> set[str]:
    """`changed` with every compiled package that depends on one of them, directly or not."""
    found = set(changed)
    while True:
        more = {
            path.parent.name
            for path in source.glob("*/CMakeLists.txt")
            if path.parent.name not in found and _names_one_of(path.parent / "package.xml", found)
        }
        if not more:
            return found
        found |= more


def _names_one_of(manifest: Path, names: set[str]) -> bool:
    """Whether a package.xml depends on one of `names`."""
    text = manifest.read_text()
    return any(f"depend>{name}</" in text for name in names)


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
