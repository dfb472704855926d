"""Journal: every transition and act of a valve, bounded, there after a kill; figures equal counts by hand."""

from __future__ import annotations

import random
import sqlite3
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.events.language import LANGUAGES
from spool_core.uncertainty import Quantity
from spool_monitor.alarm import Operator
from spool_monitor.alarm_statistics import AlarmLimits, flood_share, peak_of, statistics
from spool_monitor.event import Event, EventState, Facts, Severity
from spool_monitor.journal import Journal, JournalEntry, entries_in
from spool_monitor.monitor import Monitor
from spool_monitor.state_database import FILE
from spool_monitor.valve_state import ValveState, entries_of

SECOND = 1_000_000_000
MINUTE, HOUR, DAY = 60 * SECOND, 3600 * SECOND, 86400 * SECOND


def opened(folder: Path | None) -> tuple[ValveState, list[str]]:
    warnings: list[str] = []
    state = ValveState(Monitor(), folder, warnings.append)
    state.open()
    return state, warnings


def resonance(state: EventState, stamp: int) -> Event:
    quantity = Quantity("amplification", "1", 2.4, 0.1)
    return Event(
        stamp, "resonance", state, Severity.WARNING, "", quantity, code=100, facts=Facts.of(quantity, 1.8)
    )


def announced(
    valve: str, alarm: str, *seconds: float, action: str = "raise", state: str = "unacknowledged"
) -> list[tuple[str, JournalEntry]]:
    return [
        (valve, JournalEntry(round(s * SECOND), action, alarm, 100, "S", "warning", state)) for s in seconds
    ]


def by_valve(*entries: list[tuple[str, JournalEntry]]) -> dict[str, list[JournalEntry]]:
    found: dict[str, list[JournalEntry]] = {}
    for valve, one in sorted((pair for some in entries for pair in some), key=lambda pair: pair[1].stamp):
        found.setdefault(valve, []).append(one)
    return found


def test_the_journal_holds_what_happened_and_who_did_what(tmp_path: Path) -> None:
    state, warnings = opened(tmp_path)
    alarms, eva = state.alarms, Operator("Eva", 3 * SECOND, "speed reduced")
    state.note(entries_of([alarms.update(resonance(EventState.RAISED, SECOND))]))
    state.note(entries_of([alarms.update(resonance(EventState.RAISED, 2 * SECOND))]))  # its numbers moved
    state.note(entries_of(alarms.acknowledge("resonance", eva), eva))
    state.note(entries_of([alarms.update(resonance(EventState.CLEARED, 4 * SECOND))]))
    state.close()
    kept = entries_in(tmp_path / FILE)
    assert [(one.stamp // SECOND, one.action, one.state, one.who, one.comment) for one in kept] == [
        (1, "raise", "unacknowledged", "", ""),
        (3, "acknowledge", "acknowledged", "Eva", "speed reduced"),
        (4, "clear", "normal", "", ""),
    ]
    assert (kept[0].code, kept[0].namur, kept[0].value, kept[0].unit) == (100, "S", 2.4, "1")
    assert kept[0].headline(LANGUAGES["de"]).startswith("Resonanz")
    assert kept[0].headline(LANGUAGES["en"]) == kept[0].text != ""
    assert warnings == []


def test_old_entries_go_and_the_newest_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spool_monitor.journal.MOST_ENTRIES", 5)
    monkeypatch.setattr("spool_monitor.journal.FORGET_EVERY", 1)
    journal = Journal(tmp_path / FILE, days=30.0)
    for day in range(40):
        journal.write([JournalEntry(day * DAY, "raise", str(day))])
    assert [one.alarm for one in journal.entries()] == ["35", "36", "37", "38", "39"]
    journal.close()
    journal = Journal(tmp_path / FILE, days=2.0)
    journal.write([JournalEntry(40 * DAY, "raise", "40")])
    assert [one.alarm for one in journal.entries()] == ["38", "39", "40"]
    journal.close()


def test_what_cannot_be_written_is_held_and_written_later(tmp_path: Path) -> None:
    state, warnings = opened(tmp_path)
    first = JournalEntry(SECOND, "raise", "resonance")
    state.note([first])
    other = sqlite3.connect(tmp_path / FILE)
    other.execute("BEGIN EXCLUSIVE")
    state.note([JournalEntry(2 * SECOND, "clear", "resonance")])
    assert len(warnings) == 1
    assert "locked" in warnings[0]
    assert not state.writable
    other.rollback()
    other.close()
    state.retry(0)
    assert state.writable
    assert [one.action for one in entries_in(tmp_path / FILE)] == ["raise", "clear"]
    assert "again" in warnings[1]
    state.close()


def test_an_entry_of_a_clock_that_is_ahead_costs_no_other(tmp_path: Path) -> None:
    journal = Journal(tmp_path / FILE, days=30.0)
    now = time.time_ns()
    journal.write([JournalEntry(now, "raise", "resonance"), JournalEntry(now + 9000 * DAY, "raise", "rate")])
    assert [one.alarm for one in journal.entries()] == ["resonance", "rate"]
    journal.close()


def test_a_writing_whose_end_was_not_heard_is_in_the_journal_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sync that fails after the last page says nothing of what the disk holds."""
    state, _ = opened(tmp_path)
    write = Journal.write

    def unheard(journal: Journal, entries: Iterable[JournalEntry]) -> None:
        write(journal, entries)
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as disk:
        disk.setattr(Journal, "write", unheard)
        state.note([JournalEntry(1, "raise", "a")])
    state.note([JournalEntry(2, "clear", "a"), JournalEntry(3, "raise", "a")])
    state.close()
    assert [one.stamp for one in entries_in(tmp_path / FILE)] == [1, 2, 3]


WORKER = """
import sys
from pathlib import Path
from spool_monitor.journal import JournalEntry
from spool_monitor.monitor import Monitor
from spool_monitor.valve_state import ValveState

state = ValveState(Monitor(), Path(sys.argv[1]), print)
state.open()
number = int(sys.argv[2])
while True:
    number += 1
    state.note([JournalEntry(number, "raise", str(number))])
    print(number, flush=True)
"""


@pytest.mark.slow
def test_each_entry_that_was_noted_survives_kills(
    tmp_path: Path, killed: Callable[[str, list[str], int], list[str]]
) -> None:
    chance, told = random.Random(2), 0
    for _ in range(4):
        told = int(killed(WORKER, [str(tmp_path), str(told)], chance.randrange(1, 60))[-1])
        kept = [int(one.alarm) for one in entries_in(tmp_path / FILE)]
        # The one under way when the process was killed may be there, unsaid.
        assert kept in (list(range(1, told + 1)), list(range(1, told + 2)))
        told = kept[-1]


def test_the_figures_are_those_counted_by_hand() -> None:
    """Two days: 12 alarms in 11 s of one valve, two of another, one that stood before and never ended."""
    flood = announced("a", "resonance", *range(3600, 3612))
    journals = by_valve(
        announced("a", "spring_change", -3600.0),
        flood,
        announced("a", "resonance", *(s + 0.5 for s in range(3600, 3612)), action="clear", state="normal"),
        announced("b", "stale/estimate", 50_000.0, 90_000.0),
        announced("b", "stale/estimate", 50_100.0, 90_100.0, action="clear", state="normal"),
        announced("b", "resonance", 60_000.0, state="shelved"),
    )
    found = statistics(journals, 0, 2 * DAY)
    assert found.count == 14
    assert found.per_day == pytest.approx(7.0)
    assert found.per_hour == pytest.approx(14 / 48)
    assert found.peak == 12
    # From the eleventh alarm at 3610 s; the eighth leaves the 10 min at 4207 s, then four are left.
    assert found.flood_share * 2 * 86400 == pytest.approx(597.0)
    assert [(one.valve, one.alarm, one.count) for one in found.frequent] == [
        ("a", "resonance", 12),
        ("b", "stale/estimate", 2),
    ]
    assert found.frequent_share == pytest.approx(1.0)
    assert found.chattering == (("a", "resonance"),)
    assert found.stale == (("a", "spring_change"),)
    assert found.by_severity == {"warning": 14}
    assert found.beyond(AlarmLimits()) == ("peak", "chattering")
    assert found.beyond(AlarmLimits().changed(["peak=12", "chattering=1"])) == ()


def test_the_ten_most_frequent_count_where_there_are_more_than_ten_different_ones() -> None:
    many = by_valve(*(announced(f"valve_{place}", "resonance", 60.0 * place) for place in range(11)))
    assert "frequent_share" in statistics(many, 0, 2 * DAY).beyond(AlarmLimits())
    del many["valve_10"]
    assert "frequent_share" not in statistics(many, 0, 2 * DAY).beyond(AlarmLimits())


def test_rates_are_of_the_time_that_the_journals_cover() -> None:
    day = by_valve(announced("a", "resonance", 86_400.0, 100_000.0))
    assert statistics(day, 0, 2 * DAY).per_day == pytest.approx(2.0)
    minutes = by_valve(announced("a", "resonance", 2 * 86_400.0 - 180.0, 2 * 86_400.0 - 60.0))
    assert statistics(minutes, 0, 2 * DAY).per_hour == pytest.approx(2.0)


@given(st.lists(st.integers(0, 5 * 3600), max_size=60))
def test_peak_and_flood_agree_with_a_count_second_by_second(seconds: list[int]) -> None:
    stamps = sorted(second * SECOND for second in seconds)
    end = 6 * 3600
    inside = [sum(second <= now < second + 600 for second in seconds) for now in range(end)]
    flooded, total = False, 0
    for count in inside:
        flooded = count > 10 or (flooded and count >= 5)
        total += flooded
    assert peak_of(stamps) == max(inside)
    assert flood_share(stamps, 0, end * SECOND) * end == pytest.approx(total)


@pytest.mark.parametrize("limit", ["mood=3", "peak", "peak=many", "peak=-1", "peak=nan"])
def test_a_wrong_limit_is_refused(limit: str) -> None:
    with pytest.raises(InputError, match=f"--limit {limit}"):
        AlarmLimits().changed([limit])
