"""Package for Debian: `./spool package` builds the suite at its final place and packs it.

The environment holds absolute paths, so it is made at /opt/spool: in a separate mount namespace, of which
nothing stays on this machine.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Any

from setup.layout import SetupError
from setup.process import say

NAME = "spool-valves"
PREFIX = Path("opt/spool")
FILES = Path(__file__).with_name("files")
#: What a machine does not need: tests and what they need, studies, how the project is made.
LEFT_OUT = ("tests", "research", ".ci", "CONTRIBUTING.md", "conftest.py")
#: The Python of Debian 12; the environment is made with it.
PYTHON = "/usr/bin/python3.11"
EXAMPLE = "Example: ./spool package --out dist"

_LOCKED = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==([^\s;\\]+)", re.M)
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")

_ELF = b"\x7fELF"


def package(root: Path, environment: dict[str, str], arguments: list[str]) -> int:
    """Build the package; return the exit code.

    Raises:
        SetupError: a tool is missing, or the build failed.
    """
    parser = argparse.ArgumentParser(
        prog="./spool package",
        description="A Debian package of the suite with its own environment, and its bill of materials.",
        epilog=EXAMPLE,
    )
    parser.add_argument("--out", type=Path, default=Path("dist"), metavar="DIR", help="where (default dist)")
    parser.add_argument("--version", default="", help="version (default: of the packages, with the commit)")
    options = parser.parse_args(arguments)
    for tool in ("dpkg-deb", "dpkg", "unshare", "git"):
        if shutil.which(tool) is None:
            raise SetupError(
                f"./spool package needs {tool}: install it (Debian, Ubuntu: apt install dpkg-dev)"
            )
    if not os.access(PYTHON, os.X_OK):
        raise SetupError(f"./spool package makes a package for Debian 12, whose Python is {PYTHON}: not here")
    version = options.version or _version(root)
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="spool_package_", dir=out) as folder:
        stage = Path(folder) / "root"
        _build(root, stage, environment)
        sizes = _fill(root, stage, version)
        target = out / f"{NAME}_{version}_amd64.deb"
        _run(["dpkg-deb", "--root-owner-group", "-Zzstd", "--build", str(stage), str(target)], environment)
    bill = out / f"{NAME}_{version}.cdx.json"
    bill.write_text(json.dumps(bill_of_materials(root, version), indent=1) + "\n", "utf-8")
    say(f"{target}: {target.stat().st_size / 1e6:.0f} MB, {sizes / 1e6:.0f} MB installed")
    say(f"{bill}: its contents (CycloneDX)")
    return 0


def locked(path: Path) -> dict[str, str]:
    """Return the versions by name that a lock, or a list of requirements, names."""
    return dict(_LOCKED.findall(path.read_text("utf-8")))


def bill_of_materials(root: Path, version: str) -> dict[str, Any]:
    """Return the bill of the suite at ``version``: every package of ``wheels.lock`` with its hashes."""
    text = (root / "requirements" / "wheels.lock").read_text("utf-8")
    entries = re.split(r"\n(?=[A-Za-z0-9])", text)
    components = []
    for entry in entries:
        match = _LOCKED.match(entry)
        if match is None:
            continue
        name, release = match[1].lower().replace("_", "-"), match[2]
        components.append(
            {
                "type": "library",
                "bom-ref": f"pkg:pypi/{name}@{release}",
                "name": name,
                "version": release,
                "purl": f"pkg:pypi/{name}@{release}",
                "hashes": [
                    {"alg": "SHA-256", "content": content} for content in sorted(_HASH.findall(entry))
                ],
            }
        )
    components.sort(key=lambda one: str(one["bom-ref"]))
    digest = hashlib.sha256(text.encode()).hexdigest()
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "serialNumber": uuid.uuid5(uuid.NAMESPACE_URL, digest).urn,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": "spool-valves",
                "name": "spool-valves",
                "version": version,
                "licenses": [{"license": {"id": "Apache-2.0"}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": "spool-valves", "dependsOn": [one["bom-ref"] for one in components]}],
    }


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
        shown = subprocess.run(["objdump", "-p", str(path)], capture_output=True, text=True, check=False)
        asked |= set(re.findall(r"^\s+NEEDED\s+(\S+)", shown.stdout, re.M))
    missing = {name for name in asked - brought if not any(one.startswith(name) for one in brought)}
    found = {package for name in missing for package in _package_of(name)}
    return sorted(found)


def _version(root: Path) -> str:
    text = (root / "ros2_ws/src/spool_bringup/package.xml").read_text("utf-8")
    released = text.partition("<version>")[2].partition("</version>")[0]
    made = subprocess.run(
        ["git", "log", "-1", "--format=%cd.%h", "--date=format:%Y%m%d%H%M%S"],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    return f"{released}+git{made.stdout.strip()}" if made.returncode == 0 else released


def _build(root: Path, stage: Path, environment: dict[str, str]) -> None:
    """Set the committed tree up at /opt/spool, as seen by this build alone."""
    place = stage / PREFIX
    place.mkdir(parents=True)
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=root, capture_output=True, check=False)
    if archive.returncode:
        raise SetupError(f"./spool package packs what is committed: {archive.stderr.decode().strip()}")
    subprocess.run(["tar", "-x", "-C", place], input=archive.stdout, check=True)
    for name in LEFT_OUT:
        path = place / name
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    script = (
        'set -e; mount -t tmpfs none /opt; mkdir /opt/spool; mount --bind "$1" /opt/spool; cd /opt/spool; '
        f"SPOOL_PYTHON={PYTHON} ./spool --version; "
        ".venv/bin/uv pip uninstall --python .venv/bin/python $2; "
        ".venv/bin/python -m compileall -q -j 0 ros2_ws/src ros2_ws/install setup .venv/lib || true"
    )
    unneeded = " ".join(sorted(locked(root / "requirements" / "development.in")))
    own = [] if os.geteuid() == 0 else ["--map-root-user"]
    say("setting the suite up at /opt/spool, in a separate name space")
    _run(["unshare", "--mount", *own, "sh", "-c", script, "sh", str(place), unneeded], environment)
    for waste in ("ros2_ws/build", ".setup/on_wheels/logs"):
        shutil.rmtree(place / waste, ignore_errors=True)


def _fill(root: Path, stage: Path, version: str) -> int:
    """Put units, settings and control files in; return the installed size, B."""
    for source in sorted(FILES.rglob("*")):
        relative = source.relative_to(FILES)
        if source.is_dir() or relative.parts[0] == "DEBIAN":
            continue
        target = stage / relative
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target)
    settings = stage / "etc/spool/machine"
    settings.mkdir(parents=True, exist_ok=True)
    for name in ("valves.yaml", "valve.yaml"):
        shutil.copy2(root / "ros2_ws/src/spool_bringup/config" / name, settings / name)
    documents = stage / "usr/share/doc" / NAME
    documents.mkdir(parents=True)
    shutil.copy2(root / "LICENSE", documents / "copyright")
    (documents / "bill_of_materials.cdx.json").write_text(json.dumps(bill_of_materials(root, version)))
    with gzip.open(documents / "changelog.gz", "wb") as stream:
        stream.write((root / "ros2_ws/src/spool_bringup/CHANGELOG.rst").read_bytes())
    control = stage / "DEBIAN"
    control.mkdir()
    for source in sorted((FILES / "DEBIAN").iterdir()):
        shutil.copy2(source, control / source.name)
        (control / source.name).chmod(0o755)
    kept = sorted(path for path in (stage / "etc").rglob("*") if path.is_file())
    (control / "conffiles").write_text("".join(f"/{path.relative_to(stage)}\n" for path in kept), "utf-8")
    size = sum(path.lstat().st_size for path in stage.rglob("*") if not path.is_dir())
    needed = ", ".join(["python3 (>= 3.11)", "python3 (<< 3.12)", "adduser", *needed_packages(stage)])
    (control / "control").write_text(
        f"Package: {NAME}\nVersion: {version}\nArchitecture: amd64\nSection: science\nPriority: optional\n"
        f"Maintainer: Spool suite maintainers <maintainers@spool-suite.org>\nInstalled-Size: {size // 1024}\n"
        f"Depends: {needed}\n"
        "Description: monitoring of hydraulic spool valves on ROS 2\n"
        " Estimates, monitors and records spool valves from two accelerometers each,\n"
        " with its own environment under /opt/spool; services spool@ and spool-recorder@.\n"
    )
    return size


def _run(command: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run(command, env=environment, stdout=sys.stderr, check=False)
    if done.returncode:
        raise SetupError(f"./spool package: {command[0]} ended with {done.returncode}: see above")


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
