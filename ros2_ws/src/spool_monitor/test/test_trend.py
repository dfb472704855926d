from __future__ import annotations

import math
import random
import sqlite3
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_monitor.state_database import own_file
from spool_monitor.trend import DAY, HOUR, KEPT, MINUTE, Sums, TrendStore, finest
from spool_monitor.trend_writer import TrendWriter

SECOND = 1_000_000_000
NOON = 1_735_732_800  # s, 2025-01-01 12:00 UTC


def stored(folder: Path, *values: tuple[float, float]) -> TrendStore:
    """Return a store that took ``values``: s since noon and what was measured."""
    store = TrendStore(folder / "trends.sqlite")
    sums = Sums()
    for seconds, value in values:
        sums.add(round((NOON + seconds) * SECOND), "coulomb_force", "N", value)
    store.write(sums)
    return store


def test_each_span_has_minimum_mean_and_maximum(tmp_path: Path) -> None:
    store = stored(tmp_path, (0, 1.0), (30, 3.0), (59.9, 5.0), (60, 7.0))
    first, second = store.spans("coulomb_force", MINUTE)
    assert (first.start, first.count, first.minimum, first.mean, first.maximum) == (NOON, 3, 1.0, 3.0, 5.0)
    assert (second.start, second.count, second.mean) == (NOON + 60, 1, 7.0)
    for seconds in (HOUR, DAY):
        (only,) = store.spans("coulomb_force", seconds)
        assert (only.start, only.count, only.mean) == (NOON // seconds * seconds, 4, 4.0)
    assert store.units() == {"coulomb_force": "N"}


def test_a_span_goes_on_after_a_restart(tmp_path: Path) -> None:
    stored(tmp_path, (0, 1.0)).close()
    (span,) = stored(tmp_path, (1, 3.0)).spans("coulomb_force", MINUTE)
    assert (span.count, span.minimum, span.mean, span.maximum) == (2, 1.0, 2.0, 3.0)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 300), st.floats(-1e6, 1e6)), min_size=1, max_size=60), st.randoms())
def test_it_does_not_matter_when_it_is_written(
    tmp_path_factory: pytest.TempPathFactory, values: list[tuple[int, float]], chance: random.Random
) -> None:
    store = TrendStore(tmp_path_factory.mktemp("trend") / "t.sqlite")
    sums = Sums()
    for seconds, value in values:
        sums.add((NOON + seconds) * SECOND, "x", "1", value)
        if chance.random() < 0.3:
            store.write(sums)
            sums = Sums()
    store.write(sums)
    spans = store.spans("x", MINUTE)
    store.close()
    for span in spans:
        inside = [value for at, value in values if NOON + at - (NOON + at) % 60 == span.start]
        assert (span.count, span.minimum, span.maximum) == (len(inside), min(inside), max(inside))
        assert span.mean == pytest.approx(sum(inside) / len(inside), rel=1e-9, abs=1e-6)
    assert sum(span.count for span in spans) == len(values)


def test_what_is_no_number_is_left_out(tmp_path: Path) -> None:
    assert stored(tmp_path, (0, math.nan), (1, math.inf)).spans("coulomb_force", MINUTE) == []


def test_the_file_is_bounded_and_keeps_the_newest(tmp_path: Path) -> None:
    store = TrendStore(tmp_path / "t.sqlite")
    sums = Sums()
    minutes = KEPT[MINUTE] + 500
    for minute in range(minutes):
        sums.add((NOON + 60 * minute) * SECOND, "x", "1", 1.0)
    store.write(sums)
    spans = store.spans("x", MINUTE)
    assert len(spans) == KEPT[MINUTE]
    assert spans[-1].start == NOON + 60 * (minutes - 1)
    assert len(store.spans("x", HOUR)) == math.ceil(minutes / 60)


def test_one_wrong_clock_does_not_cost_the_history(tmp_path: Path) -> None:
    store = stored(tmp_path, (0, 1.0), (60, 1.0))
    sums = Sums()
    sums.add(NOON * 2 * SECOND, "coulomb_force", "N", 1.0)
    store.write(sums)
    assert len(store.spans("coulomb_force", MINUTE)) == 3


def test_counters_go_on_over_restarts(tmp_path: Path) -> None:
    for _ in range(3):
        store = TrendStore(tmp_path / "t.sqlite")
        sums = Sums()
        sums.count("travel", "m", 0.5)
        store.write(sums, NOON * SECOND)
        store.close()
    store = TrendStore(tmp_path / "t.sqlite")
    assert store.counters() == {"travel": 1.5}
    (span,) = store.spans("travel", DAY)
    assert (span.minimum, span.maximum) == (0.5, 1.5)


def test_a_failed_writing_leaves_nothing_half_done(tmp_path: Path) -> None:
    store = stored(tmp_path, (0, 1.0))
    other = sqlite3.connect(tmp_path / "trends.sqlite")
    other.execute(
        "CREATE TRIGGER full BEFORE UPDATE ON span WHEN NEW.seconds = 86400 "
        "BEGIN SELECT RAISE(ABORT, 'disk full'); END"
    )
    other.commit()
    other.close()
    sums = Sums()
    sums.add(NOON * SECOND, "coulomb_force", "N", 9.0)
    with pytest.raises(OSError, match=r"trends\.sqlite: disk full"):
        store.write(sums)
    assert [span.count for span in store.spans("coulomb_force", MINUTE)] == [1]


def count(path: Path, seconds: int = MINUTE) -> list[int]:
    store = TrendStore(path, read_only=True)
    counts = [span.count for span in store.spans("x", seconds)]
    store.close()
    return counts


def writer(path: Path) -> tuple[TrendWriter, list[str]]:
    said: list[str] = []
    return TrendWriter(path, said.append, patience=0.05), said


def feed(trends: TrendWriter, second: int) -> None:
    """Gather one value, and wait until it is written or is not."""
    trends._sums.add((NOON + second) * SECOND, "x", "1", 1.0)
    trends.flush((NOON + second) * SECOND)
    assert trends._writing is not None
    trends._writing.result()


@pytest.mark.parametrize("from_the_start", [False, True])
def test_what_is_gathered_while_the_file_is_locked_is_written_afterwards(
    tmp_path: Path, from_the_start: bool
) -> None:
    path = tmp_path / "t.sqlite"
    stored(tmp_path).close()
    (tmp_path / "trends.sqlite").replace(path)
    other = sqlite3.connect(path, isolation_level=None)
    if from_the_start:
        other.execute("PRAGMA locking_mode=EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
    trends, said = writer(path)
    feed(trends, 0)
    if not from_the_start:
        other.execute("BEGIN EXCLUSIVE")
    for second in (10, 20, 70):
        feed(trends, second)
    assert "locked" in trends.trouble
    assert len(said) == 1
    other.execute("COMMIT")
    other.close()
    feed(trends, 80)
    assert trends.trouble == ""
    assert "written again" in said[1]
    trends.close()
    assert count(path) == [3, 2]
    assert count(path, DAY) == [5]


def test_a_writing_whose_end_was_not_heard_is_counted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sync that fails after the last page says nothing of what the disk holds."""
    path = tmp_path / "t.sqlite"
    trends, _ = writer(path)
    write = TrendStore.write
    for heard, fails in ((True, False), (False, True), (False, False)):
        with monkeypatch.context() as disk:

            def unheard(store: TrendStore, *given: Any, written: bool = not fails) -> None:
                if written:
                    write(store, *given)
                raise OSError(5, "Input/output error")

            if not heard:
                disk.setattr(TrendStore, "write", unheard)
            feed(trends, 0)
        feed(trends, 1)
    trends.close()
    assert count(path) == [6]


def test_what_a_disk_never_took_is_named_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for heals in (True, False):
        trends, said = writer(tmp_path / "t.sqlite")
        with monkeypatch.context() as disk:
            disk.setattr(TrendStore, "write", lambda *_: (_ for _ in ()).throw(OSError(5, "no disk")))
            feed(trends, 0)
            if not heals:
                trends.close()
        if heals:
            trends.close()
        assert ("unwritten data in memory are lost" in said[-1]) is not heals
    assert count(tmp_path / "t.sqlite") == [1]


def test_the_file_removed_while_it_is_in_use_is_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "t.sqlite"
    trends, said = writer(path)
    feed(trends, 0)
    for one in tmp_path.iterdir():
        one.unlink()
    feed(trends, 10)
    feed(trends, 20)
    trends.close()
    assert count(path) == [2]
    assert "removed or replaced" in said[0]


def test_a_file_damaged_while_it_is_in_use_is_put_aside(tmp_path: Path) -> None:
    path = tmp_path / "t.sqlite"
    trends, said = writer(path)
    feed(trends, 0)
    trends.close()
    path.write_bytes(b"no data base" * 1000)
    again, said = writer(path)
    feed(again, 10)
    again.close()
    assert "renames it to t.sqlite.damaged" in said[0]
    assert count(path) == [1]


def test_what_is_held_while_nothing_can_be_written_is_bounded() -> None:
    held = Sums()
    for minute in range(500):
        more = Sums()
        more.add((NOON + 60 * minute) * SECOND, "x", "1", 1.0)
        more.count("travel", "m", 1.0)
        held.merge(more, most=100)
    assert len(held.spans) == 100
    assert sum(values[0] for (_, seconds, _), values in held.spans.items() if seconds == DAY) == 500
    assert max(start for _, seconds, start in held.spans if seconds == MINUTE) == NOON + 60 * 499
    assert held.counts == {"travel": 500.0}


def test_a_later_version_s_file_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "t.sqlite"
    base = sqlite3.connect(path)
    base.execute("PRAGMA user_version=2")
    base.execute("CREATE TABLE other (x)")
    base.commit()
    base.close()
    later = path.read_bytes()
    trends, said = writer(path)
    feed(trends, 0)
    trends.close()
    assert "a later version of the suite wrote it" in said[0]
    assert path.read_bytes() == later
    assert own_file(path) == tmp_path / "t.format1.sqlite"
    assert count(own_file(path)) == [1]


def test_only_the_owner_may_read_the_trends(tmp_path: Path) -> None:
    path = tmp_path / "trends.sqlite"
    path.touch(mode=0o644)
    store = stored(tmp_path, (0, 1.0))
    assert {stat.S_IMODE(one.stat().st_mode) for one in tmp_path.iterdir()} == {0o600}
    store.close()


def test_a_value_of_the_wrong_kind_is_damage(tmp_path: Path) -> None:
    stored(tmp_path, (0, 1.0)).close()
    base = sqlite3.connect(tmp_path / "trends.sqlite")
    base.execute("UPDATE span SET minimum = 'low'")
    base.commit()
    base.close()
    store = TrendStore(tmp_path / "trends.sqlite", read_only=True)
    with pytest.raises(InputError, match="it is damaged"):
        store.spans("coulomb_force", MINUTE)
    store.close()


WRITER = """
import sys
from pathlib import Path
from spool_monitor.trend import Sums, TrendStore
store = TrendStore(Path(sys.argv[1]))
while True:
    sums = Sums()
    for second in range(50):
        sums.add((1735732800 + second) * 10**9, "x", "1", 1.0)
    sums.count("travel", "m", 50.0)
    store.write(sums)
    print("written", flush=True)
"""


def test_killed_while_writing_it_holds_all_that_was_written_and_no_half(
    tmp_path: Path, killed: Callable[[str, list[str], int], list[str]]
) -> None:
    path, told = tmp_path / "t.sqlite", 0
    chance = random.Random(1)
    for _ in range(5):
        told += len(killed(WRITER, [str(path)], chance.randrange(1, 40)))
    store = TrendStore(path)
    counts = {seconds: sum(span.count for span in store.spans("x", seconds)) for seconds in KEPT}
    assert len(set(counts.values())) == 1
    assert counts[MINUTE] == store.counters()["travel"]
    assert 50 * told <= counts[MINUTE] <= 50 * (told + 5)


def test_what_is_no_trend_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.sqlite: no such file"):
        TrendStore(tmp_path / "missing.sqlite", read_only=True)
    (tmp_path / "text.sqlite").write_text("no data base at all, but long enough to look at" * 50, "utf-8")
    with pytest.raises(InputError, match=r"text\.sqlite: it is damaged"):
        TrendStore(tmp_path / "text.sqlite")
    sqlite3.connect(tmp_path / "empty.sqlite").close()
    with pytest.raises(InputError, match=r"empty\.sqlite: it holds no trends"):
        TrendStore(tmp_path / "empty.sqlite", read_only=True)


def test_a_reader_sees_what_a_living_writer_wrote(tmp_path: Path) -> None:
    writer = stored(tmp_path, (0, 1.0))
    reader = TrendStore(tmp_path / "trends.sqlite", read_only=True)
    assert len(reader.spans("coulomb_force", MINUTE)) == 1
    reader.close()
    writer.close()


@pytest.mark.parametrize(
    ("duration", "expected"), [(3600.0, MINUTE), (1e6, HOUR), (1e8, DAY), (0.0, MINUTE), (1e12, DAY)]
)
def test_the_finest_spans_that_are_not_too_many_are_shown(duration: float, expected: int) -> None:
    assert finest(KEPT, duration) == expected
