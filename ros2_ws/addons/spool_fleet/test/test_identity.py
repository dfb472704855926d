"""Identity of bags: machine, valve and date by path, table and metadata."""

from __future__ import annotations

from datetime import date, datetime, timezone
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_fleet.add import Identity, PathPattern, joined, read_table, start_of

DAY = 86_400_000_000_000
NAMES = st.text("abcdefghijklmnopqrstuvwxyz0123456789_-", min_size=1, max_size=12)


@given(NAMES, NAMES, st.dates(date(1971, 1, 1), date(2200, 1, 1)))
def test_a_pattern_gives_back_what_a_path_was_made_of(machine: str, valve: str, day: date) -> None:
    path = Path("/data") / machine / day.isoformat() / valve
    assert PathPattern("{machine}/{date}/{valve}").match(path) == Identity(machine, valve, day)


@pytest.mark.parametrize(
    ("pattern", "path", "found"),
    [
        ("{machine}_{date}", "/d/press_2_20260301", Identity("press_2", "", date(2026, 3, 1))),
        ("{machine}/*/{valve}", "/d/m/anything/v.mcap", Identity("m", "v", None)),
        ("{machine}/{date}/{valve}", "/d/m/2026-02/v", Identity("m", "v", date(2026, 2, 1), 28)),
        ("{machine}_{date}", "/d/press_2_2026_03", Identity("press_2", "", date(2026, 3, 1), 31)),
        ("{machine}/{date}", "/d/m/yesterday", None),
        ("{machine}/{date}", "/d/m/2026-13-01", None),
        ("{machine}/{date}/{valve}", "/m/v", None),
    ],
)
def test_paths_that_do_not_fit_say_nothing(pattern: str, path: str, found: Identity | None) -> None:
    assert PathPattern(pattern).match(Path(path)) == found


@pytest.mark.parametrize(
    ("pattern", "path", "why"),
    [
        ("{machine}/{date}", "/d/m/yesterday", "'yesterday' is not a date; dates begin with YYYY-MM-DD or"),
        ("{machine}/{date}", "/d/m/2026-13", "'2026-13' is not a date"),
        ("press_{machine}/{valve}", "/d/saw_1/v", "'saw_1' is not like press_{machine}"),
        ("{machine}/{date}/{valve}", "/m/v", "the path has fewer than 3 parts"),
        ("{machine}/{date}/{valve}", "/d/m/2026-02/v", ""),
    ],
)
def test_a_path_that_does_not_fit_is_explained(pattern: str, path: str, why: str) -> None:
    assert PathPattern(pattern).misfit(Path(path)).startswith(why)


@pytest.mark.parametrize(("day", "taken"), [(1, True), (31, True), (40, False)])
def test_stamps_in_the_month_of_a_path_count(day: int, taken: bool) -> None:
    march = Identity("m", "v", date(2026, 3, 1), 31)
    first = round(datetime(2026, 3, 1, tzinfo=timezone.utc).timestamp()) * 1_000_000_000
    start, said = start_of(march, first + (day - 1) * DAY + DAY // 2)
    assert (start == first) != taken
    assert bool(said) != taken


@pytest.mark.parametrize("pattern", ["{machin}", "{valve}/{valve}", "plain", ""])
def test_a_pattern_without_known_fields_is_refused(pattern: str) -> None:
    with pytest.raises(InputError, match="--pattern"):
        PathPattern(pattern)


def test_a_table_names_bags_beside_it(tmp_path: Path) -> None:
    table = tmp_path / "bags.csv"
    table.write_text("bag,machine,valve,date\nrun_7,press,v2,2026-03-01\n", encoding="utf-8")
    assert read_table(table) == {tmp_path / "run_7": Identity("press", "v2", date(2026, 3, 1))}


def test_a_table_without_a_column_is_refused_by_its_name(tmp_path: Path) -> None:
    table = tmp_path / "bags.csv"
    table.write_text("bag,machine\nrun_7,press\n", encoding="utf-8")
    with pytest.raises(InputError, match="no column valve"):
        read_table(table)


def test_what_is_filed_counts_before_what_the_bag_says() -> None:
    assert joined(Identity("filed"), Identity("recorded", "v")) == Identity("filed", "v")
    assert joined(None, Identity()).machine == "unknown"


def test_stamps_count_unless_they_contradict_the_date_of_the_path() -> None:
    stamp = 20_000 * DAY + DAY // 2
    same = Identity("m", "v", date(2024, 10, 4))
    assert start_of(same, stamp) == (stamp, "")
    other, said = start_of(Identity("m", "v", date(2026, 3, 1)), stamp)
    assert other == 20_513 * DAY
    assert "2024-10-04" in said
    assert start_of(Identity("m", "v"), stamp) == (stamp, "")
