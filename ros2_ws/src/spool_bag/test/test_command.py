"""The solenoid's command through import, bag and export."""

from __future__ import annotations

import csv
from pathlib import Path

from spool_bag.export import export_bag
from spool_bag.importing.bag_import import DEFAULT_START, import_record
from spool_bag.reader import BagReader
from spool_core.cdr import Command


def commands(bag: Path) -> list[Command]:
    return [item for item in BagReader(bag).stream("valve_1") if isinstance(item, Command)]


def test_a_column_of_commands_is_kept_to_the_sample_at_which_it_changes(tmp_path: Path) -> None:
    volts = ["0"] * 307 + ["24"] * 400 + ["0"] * 293
    rows = [f"{n * 0.001:.3f},{n % 7},{n % 5},{one}" for n, one in enumerate(volts)]
    table = tmp_path / "a.csv"
    table.write_text("\n".join(["time_s,body_m_s2,spool_m_s2,command", *rows]) + "\n", "utf-8")
    import_record(table, tmp_path / "bag")
    expected = [(0, 0.0), (307, 24.0), (707, 0.0)]
    assert commands(tmp_path / "bag") == [
        Command(DEFAULT_START + n * 1_000_000, value) for n, value in expected
    ]
    export_bag(tmp_path / "bag", tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(encoding="utf-8") as stream:
        found = [float(row["command"]) for row in csv.DictReader(stream)]
    assert found[:300] == [0.0] * 300
    assert found[320:700] == [24.0] * 380
    assert found[720:] == [0.0] * 280
