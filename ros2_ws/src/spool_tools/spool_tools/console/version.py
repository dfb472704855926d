"""Version of the suite: that of the package, and the commit where the sources are a git checkout."""

from __future__ import annotations

import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from xml.etree import ElementTree

#: s, which a git command may take.
PATIENCE = 5.0


@cache
def suite_version() -> str:
    """Return like ``0.1.0 (commit 1a2b3c4d5e6f)``; a ``+`` behind the commit: files were changed since."""
    commit = _commit(Path(__file__).resolve().parent)
    return f"{_package_version()} (commit {commit})" if commit else _package_version()


def _package_version() -> str:
    """Return the version that package.xml gives, or what is installed."""
    manifest = Path(__file__).resolve().parents[2] / "package.xml"
    if manifest.is_file():
        return ElementTree.parse(manifest).findtext("version", "unknown")
    try:
        return version("spool_tools")
    except PackageNotFoundError:
        return "unknown"


def _commit(folder: Path) -> str:
    """Return the commit that is checked out in ``folder``, empty where it is no checkout."""
    revision = _git(folder, "rev-parse", "--short=12", "HEAD")
    changed = revision and _git(folder, "status", "--porcelain", "--untracked-files=no")
    return revision + ("+" if changed else "")


def _git(folder: Path, *words: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True, text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
