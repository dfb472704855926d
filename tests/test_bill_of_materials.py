"""Bill of materials: each package that a release installs stands in it, with what proves it the same."""

from __future__ import annotations

import re
import sysconfig
from importlib.metadata import distributions
from pathlib import Path

import pytest

from setup.packaging.package import bill_of_materials, locked

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements" / "wheels.lock"


def normal(name: str) -> str:
    """Return a name as package indexes compare it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def test_each_locked_package_stands_in_it_with_its_version_and_hashes() -> None:
    bill = bill_of_materials(ROOT, "1.0.0")
    components = {normal(one["name"]): one for one in bill["components"]}
    assert set(components) == {normal(name) for name in locked(LOCK)}
    for one in bill["components"]:
        assert one["version"] in one["purl"]
        assert one["hashes"], f"{one['name']} is not pinned by a hash"
        assert all(re.fullmatch("[0-9a-f]{64}", pin["content"]) for pin in one["hashes"])
    assert bill["dependencies"][0]["dependsOn"] == [one["bom-ref"] for one in bill["components"]]


def test_the_same_lock_gives_the_same_bill() -> None:
    assert bill_of_materials(ROOT, "1.0.0") == bill_of_materials(ROOT, "1.0.0")


def test_what_is_installed_is_what_the_bill_says() -> None:
    # Not what setuptools holds for itself; a wheel ros_X holds metadata of X besides, as an .egg-info.
    ours = list(distributions(path=[sysconfig.get_path("purelib")]))
    installed = {
        normal(one.metadata["Name"]): one.version for one in ours if one.read_text("WHEEL") is not None
    }
    if not any(name.startswith("ros-") for name in installed):
        pytest.skip("stands on a sourced ROS 2: its packages are not of the lock")
    bill = bill_of_materials(ROOT, "1.0.0")
    versions: dict[str, set[str]] = {}
    for one in bill["components"]:  # a package may be locked for each series of Python
        versions.setdefault(normal(one["name"]), set()).add(one["version"])
    wrong = {
        name: version
        for name, version in installed.items()
        if not name.startswith("spool-") and name not in ("pip", "setuptools", "wheel")
        if version not in versions.get(name, set())
    }
    assert wrong == {}
