"""Pages that are read on any screen, without pictures too, and that say what they were made from."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest
from spool_report.outputs import suite_version
from spool_tools.cli import main


@pytest.fixture(scope="module", name="bag")
def _bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("made") / "bag"
    words = ["simulate", "--seconds", "12", "--excitation", "multisine", "--out", str(bag)]
    assert main(words) == 0
    return bag


@pytest.fixture(scope="module", name="page")
def _page(bag: Path) -> str:
    path = bag.parent / "fit.html"
    assert main(["fit", str(bag), "--valve", "4weh10_soft", "--report", str(path)]) == 0
    return path.read_text(encoding="utf-8")


def test_it_says_what_it_was_made_from(page: str, bag: Path) -> None:
    foot = page[page.index("<footer>") :]
    (record,) = bag.glob("*.mcap")
    assert hashlib.sha256(record.read_bytes()).hexdigest() in foot
    assert suite_version() in foot
    assert f"./spool fit {bag} --valve 4weh10_soft --report" in foot
    assert "4weh10_soft: 0.18 kg, 1632 N/m, 15.2 Hz" in foot
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", foot)


def test_it_fits_narrow_and_dark_screens(page: str) -> None:
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in page
    assert "@media (prefers-color-scheme:dark)" in page
    # Whatever is wider than the screen scrolls within its own box.
    for tag in ("<table", "<img"):
        assert page.count(f'<div class="wide">{tag}') == page.count(tag) > 0


def test_what_is_seen_in_a_picture_is_said(page: str) -> None:
    said = re.findall(r'<img alt="([^"]*)"', page)
    assert len(said) == len(set(said)) >= 3
    assert any(re.search(r"leaves [0-9.]+ %", text) for text in said)
    assert any(re.search(r"ratio: coulomb [0-9.]+", text) for text in said)
