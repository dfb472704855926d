"""Tables of results on the terminal and on a page."""

from __future__ import annotations

import re

import pytest
from rich.console import Console
from spool_report import page as html
from spool_report.terminal import Table

SHOWN = Table(
    ("parameter", "value", "unit"),
    [("spring stiffness", 1692.4, "N/m"), ("[red]drag[/red]", "0.52", "N s/m"), ("mass",)],
    ("value",),
    "Parameters",
)


def printed(table: Table, width: int = 80) -> str:
    """Return what a terminal of that width shows."""
    console = Console(width=width, record=True)
    table.show(console)
    return console.export_text()


def test_terminal_and_page_show_the_same_cells() -> None:
    rows = re.findall("<tr>(.*?)</tr>", html.table(SHOWN))
    on_page = [[cell for cell in re.findall("<t[dh][^>]*>(.*?)</t[dh]>", row) if cell] for row in rows]
    on_terminal = [re.split(" {2,}|(?<=]) ", line.strip()) for line in printed(SHOWN).splitlines()]
    assert on_page == on_terminal
    assert on_page[1] == ["spring stiffness", "1692", "N/m"]
    assert on_page[2] == ["[red]drag[/red]", "0.52", "N s/m"]


def test_numbers_stand_below_each_other() -> None:
    lines = printed(SHOWN).splitlines()
    ends = {
        line.index(text) + len(text) for line, text in zip(lines, ("value", "1692", "0.52"), strict=False)
    }
    assert len(ends) == 1
    assert html.table(SHOWN).count('<td class="n">') == 2


def test_a_name_that_is_too_wide_goes_on_in_the_next_line() -> None:
    name = "viscous_coefficient_of_the_second_land"
    assert name in "".join(printed(Table(("parameter",), [(name,)]), width=20).split())


@pytest.mark.parametrize("show", [printed, html.table])
def test_without_rows_nothing_is_shown(show: object) -> None:
    assert callable(show)
    assert show(Table(("parameter",), [], title="Parameters")) == ""
