"""The quality declaration: each of its claims, looked up."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent for path in (ROOT / "ros2_ws").glob("*/spool_*/package.xml"))
DECLARATION = (ROOT / "QUALITY_DECLARATION.md").read_text("utf-8")
CI = (ROOT / ".ci" / "run").read_text("utf-8")


def test_every_claim_is_checked_here() -> None:
    """A claim that joins the table needs its check."""
    claims = re.findall(r"^\| (\d\.\w+) ", DECLARATION, re.M)
    assert claims == ["1.i", "1.iii", "2.iv", "3.i", "3.iii", "3.iv", "4.i", "4.v", "5.i", "6.i", "7.i"]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_a_package_has_readme_and_tests(package: Path) -> None:
    assert len((package / "README.md").read_text("utf-8")) > 500
    if (package / "setup.py").exists():
        assert list((package / "test").rglob("test_*.py"))


def test_ci_runs_tests_linters_and_types() -> None:
    for step in ("./spool test", "ruff check .", "ruff format --check .", "mypy --strict"):
        assert step in CI


def test_everything_locked_has_hashes() -> None:
    for lock in (ROOT / "requirements").glob("*.lock"):
        entries = re.split(r"\n(?=[A-Za-z0-9])", lock.read_text("utf-8"))
        assert all("--hash=sha256:" in entry for entry in entries if "==" in entry.partition("\n")[0])


def test_the_platforms_are_those_of_the_launcher() -> None:
    assert "Python 3.10 to 3.13" in (ROOT / "README.md").read_text("utf-8")
    assert "versions='3.10 to 3.13'" in (ROOT / "spool").read_text("utf-8")


def test_security_says_how_to_report() -> None:
    assert "security@" in (ROOT / "SECURITY.md").read_text("utf-8")
