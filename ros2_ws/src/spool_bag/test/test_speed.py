"""Speed of the machine's shaft through import, bag and export."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from spool_bag.export import export_bag
from spool_bag.importing.bag_import import DEFAULT_START, import_record
from spool_bag.metadata import ACCELERATION_BLOCK, FLOAT64
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import CdrError, Speed, decode_speed, encode_block, encode_speed


def save(path: Path, header: str, speeds: list[str], period: float = 0.001) -> Path:
    rows = [f"{n * period:.3f},{n % 7},{n % 5},{speed}" for n, speed in enumerate(speeds)]
    path.write_text("\n".join([f"time_s,body_m_s2,spool_m_s2,{header}", *rows]) + "\n")
    return path


def test_a_column_of_speeds_comes_back_as_it_was(tmp_path: Path) -> None:
    speeds = [600.0 + 0.5 * n for n in range(1000)]
    import_record(save(tmp_path / "a.csv", "speed_rpm", [str(one) for one in speeds]), tmp_path / "bag")
    told = list(BagReader(tmp_path / "bag").speeds("valve_1"))
    assert told == [(DEFAULT_START + n * 1_000_000, speeds[n]) for n in range(0, 1000, 100)]
    export_bag(tmp_path / "bag", tmp_path / "out.csv")
    with (tmp_path / "out.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["speed_rpm"]) for row in rows] == [speeds[n - n % 100] for n in range(1000)]
    import_record(tmp_path / "out.csv", tmp_path / "again")
    assert list(BagReader(tmp_path / "again").speeds("valve_1")) == told


@pytest.mark.parametrize(("header", "one"), [("drehzahl [Hz]", 60.0), ("speed [1/min]", 1.0)])
def test_a_speed_in_another_unit_is_converted(tmp_path: Path, header: str, one: float) -> None:
    import_record(save(tmp_path / "a.csv", header, ["15"] * 500), tmp_path / "bag")
    assert [rpm for _, rpm in BagReader(tmp_path / "bag").speeds("valve_1")] == [15.0 * one] * 5


def test_empty_cells_are_no_speed(tmp_path: Path) -> None:
    speeds = [""] * 300 + ["900"] * 200
    import_record(save(tmp_path / "a.csv", "speed_rpm", speeds), tmp_path / "bag")
    told = list(BagReader(tmp_path / "bag").speeds("valve_1"))
    assert told == [(DEFAULT_START + n * 1_000_000, 900.0) for n in (300, 400)]


@pytest.mark.parametrize("behind", [0, 1_000_000_000_000_000])
def test_a_speed_holds_when_it_was_received_on_the_clock_of_the_blocks(tmp_path: Path, behind: int) -> None:
    start = 1_700_000_000_000_000_000
    samples = np.zeros(20, np.float32)
    with BagWriter(tmp_path / "bag") as writer:
        blocks = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        speed = writer.add_topic("/valve_1/speed", FLOAT64)
        for n in range(50):
            stamp = start + n * 20_000_000
            block = Block(stamp - behind, n, 0.001, samples, samples)
            writer.write(blocks, stamp, encode_block(block, "valve_1"), sequence=n)
            writer.write(speed, stamp + 5_000_000, encode_speed(Speed(0, 900.0 + n)))
    told = list(BagReader(tmp_path / "bag").speeds("valve_1"))
    late = 0 if behind else 5_000_000
    assert [rpm for _, rpm in told] == [900.0 + n for n in range(50)]
    assert all(
        abs(at - (start - behind + n * 20_000_000)) <= 5_000_000 + late for n, (at, _) in enumerate(told)
    )


def test_bytes_that_are_no_speed_are_refused() -> None:
    assert decode_speed(encode_speed(Speed(0, 870.5)), 7) == Speed(7, 870.5)
    for data in (b"", b"\0\1\0\0\0", b"\7\7\7\7" + bytes(8)):
        with pytest.raises(CdrError):
            decode_speed(data, 0)
