"""`./spool report`: the month on paper holds what the journals and trends hold."""

from __future__ import annotations

import re
from datetime import datetime, timezone
from pathlib import Path

import pytest
from spool_monitor.journal import Journal, JournalEntry
from spool_monitor.state_database import FILE
from spool_monitor.state_file import valve_folder
from spool_monitor.trend import Sums, TrendStore
from spool_tools.cli import main

BEGIN = int(datetime(2026, 10, 1, tzinfo=timezone.utc).timestamp())
DAY, SECOND = 86400, 1_000_000_000
ADVICE = "Take an oil sample (ISO 4406), change the filter, flush, clean the spool"


def valve(base: Path, name: str, rise: float, days: int = 31) -> Path:
    """Keep a month in which the Coulomb force of ``name`` rises by ``rise`` N, over ``days`` of it."""
    path = valve_folder(base, name) / FILE
    path.parent.mkdir(parents=True)
    store, sums = TrendStore(path), Sums()
    for hour in range(24 * days):
        at = (BEGIN + 3600 * hour) * SECOND
        sums.add(at, "coulomb_force", "N", 0.1 + rise * hour / (24 * days))
        sums.add(at, "viscous_coefficient", "N s/m", 8.2)
        sums.add(at, "natural_frequency", "Hz", 28.7)
        sums.add(at, "travel", "m", 100.0 + hour)
    store.write(sums)
    store.close()
    return path


def raised(path: Path, day: int, *, over: bool) -> None:
    journal = Journal(path)
    stamp = (BEGIN + DAY * day) * SECOND
    found = [JournalEntry(stamp, "raise", "friction_drift/coulomb_force", 202, state="unacknowledged")]
    if over:
        found.append(
            JournalEntry(stamp + SECOND, "clear", "friction_drift/coulomb_force", 202, state="normal")
        )
    journal.write(found)
    journal.close()


def cells(page: str, name: str) -> list[str]:
    row = re.search(rf"<tr><th[^>]*>{name}</th>(.*?)</tr>", page, re.S)
    assert row is not None
    return [re.sub(r"<[^>]+>", "", one).strip() for one in re.findall(r"<td.*?>(.*?)</td>", row[1], re.S)]


def test_each_valve_has_its_line_and_open_alarms_come_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, out = tmp_path / "state", tmp_path / "october.html"
    raised(valve(state, "press/left", 0.05), 4, over=True)
    raised(valve(state, "press/right", 0.0, days=20), 9, over=False)
    raised(valve_folder(state, "press/left") / FILE, 32, over=True)  # of the next month
    valve(state, "saw/top", 0.0)
    assert main(["report", "--month", "2026-10", "--state-folder", str(state), "--out", str(out)]) == 0
    assert "3 valves, 2 alarms" in capsys.readouterr().out
    page = out.read_text(encoding="utf-8")
    assert page.index("<h2>press</h2>") < page.index(">right</th>") < page.index(">left</th>")
    assert page.index(">left</th>") < page.index("<h2>saw</h2>")
    left, right = cells(page, "left"), cells(page, "right")
    assert left[:3] == ["1", f"05 Oct: Friction drift (oil contamination). {ADVICE}", ""]
    assert left[3].startswith("0.101")
    assert "(+48 %)" in left[3]
    assert left[-2:] == ["743", "100 %"]
    assert right[2] == "Friction drift (oil contamination)"
    assert right[-1] == "65 %"
    assert "2 of 2 valves raised 2 alarms; open at the end: right; 1 valve without complete data." in page
    assert "http" not in re.sub(r"http://www\.w3\.org/\S+", "", page)


def test_a_month_of_a_hundred_valves_stays_small(tmp_path: Path) -> None:
    state, out = tmp_path / "state", tmp_path / "month.html"
    first = valve(state, "press_1/valve_1", 0.02)
    raised(first, 3, over=True)
    content = first.read_bytes()
    for number in range(1, 100):
        path = valve_folder(state, f"press_{number // 10 + 1}/valve_{number % 10 + 1}_{number}") / FILE
        path.parent.mkdir(parents=True)
        path.write_bytes(content)
    assert main(["report", "--month", "2026-10", "--state-folder", str(state), "--out", str(out)]) == 0
    assert out.stat().st_size < 5_000_000
    assert out.read_text(encoding="utf-8").count("<tr><th>valve_") == 100


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--month", "10/2026"], "--month '10/2026': write it like "),
        (["--month", "2999-01"], "--month 2999-01: it lies ahead"),
        (["--month", "2026-10", "--machine", "lathe"], "--machine lathe: there are: press"),
    ],
)
def test_a_wrong_month_or_machine_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    valve(tmp_path / "state", "press/left", 0.0, days=1)
    out = str(tmp_path / "x.html")
    assert main(["report", *arguments, "--state-folder", str(tmp_path / "state"), "--out", out]) == 2
    assert reason in capsys.readouterr().err
