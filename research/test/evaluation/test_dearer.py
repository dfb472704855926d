from __future__ import annotations

from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_evaluation.bench import dearer, markdown_of, reference_line
from spool_evaluation.results.timing import Timing


@pytest.fixture(name="page")
def _page(tmp_path: Path) -> Path:
    """Return a page on which a replay took 1 s where the reference took 0.1 us."""
    page = tmp_path / "page.md"
    table = markdown_of([Timing("replay", "real time", 1.0, 300.0), Timing("refit", "real time", 0.5, 4.0)])
    page.write_text(f"# Title\n\n{table}\n\n{reference_line(1e-7)}\n", "utf-8")
    return page


@pytest.mark.parametrize(
    ("taken", "reference", "named"),
    [(1.2, 1e-7, []), (1.5, 1e-7, ["replay, real time: 1.5 times what it cost on page.md"]), (1.5, 2e-7, [])],
    ids=["little more", "half as much again", "a machine half as fast"],
)
def test_work_that_got_dearer_is_named_in_units_of_the_reference(
    page: Path, taken: float, reference: float, named: list[str]
) -> None:
    rows = [Timing("replay", "real time", taken, 300.0), Timing("new work", "real time", 9.0, 1.0)]
    assert dearer(page, [row.cells() for row in rows], reference) == named


@pytest.mark.parametrize(
    ("text", "reason"),
    [("# Title\n", "no reference of its run"), (reference_line(1e-7), "no row of this benchmark")],
)
def test_a_page_that_cannot_be_compared_with_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    page = tmp_path / "page.md"
    page.write_text(text, "utf-8")
    with pytest.raises(InputError, match=reason):
        dearer(page, [Timing("replay", "real time", 1.0, 300.0).cells()], 1e-7)
