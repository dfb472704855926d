"""Needed system packages: those whose shared libraries the packed files ask for and do not bring."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

_ELF = b"\x7fELF"


def needed_packages(stage: Path) -> list[str]:
    """Return the packages of this system that hold the libraries which files under ``stage`` need."""
    brought: set[str] = set()
    asked: set[str] = set()
    for path in stage.rglob("*"):
        if not path.is_file() or path.is_symlink():
            continue
        with path.open("rb") as stream:
            if stream.read(4) != _ELF:
                continue
        brought.add(path.name)
        asked |= _asked(path)
    missing = {name for name in asked - brought if not any(one.startswith(name) for one in brought)}
    found = {package for name in missing for package in _package_of(name)}
    return sorted(found)


def _asked(path: Path) -> set[str]:
    shown = subprocess.run(["objdump", "-p", str(path)], capture_output=True, text=True, check=False)
    return set(re.findall(r"^\s+NEEDED\s+(\S+)", shown.stdout, re.M))


def _package_of(library: str) -> set[str]:
    """Return the package whose file ``library`` is, none where this system has none: an optional one."""
    known = subprocess.run(["ldconfig", "-p"], capture_output=True, text=True, check=False).stdout
    match = re.search(rf"^\s+{re.escape(library)} .*=> (\S+)", known, re.M)
    if match is None:
        return set()
    real = Path(match[1]).resolve()
    for candidate in (str(real), str(real).removeprefix("/usr")):
        owner = subprocess.run(["dpkg", "-S", candidate], capture_output=True, text=True, check=False)
        if owner.returncode == 0:
            return {owner.stdout.partition(":")[0]}
    return set()
