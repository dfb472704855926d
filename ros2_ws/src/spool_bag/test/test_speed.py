"""Speed of the machine's shaft through import, bag and export."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_bag.export import export_bag
from spool_bag.importing.bag_import import DEFAULT_START, import_record
from spool_bag.importing.choices import choices
from spool_bag.metadata import ACCELERATION_BLOCK, FLOAT64
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import CdrError, Speed, decode_speed, encode_block, encode_speed
from spool_core.errors import InputError
from spool_core.numbers import Array


def save(path: Path, header: str, speeds: list[str], period: float = 0.001) -> Path:
    rows = [f"{n * period:.3f},{n % 7},{n % 5},{speed}" for n, speed in enumerate(speeds)]
    path.write_text("\n".join([f"time_s,body_m_s2,spool_m_s2,{header}", *rows]) + "\n", "utf-8")
    return path


def test_a_column_of_speeds_comes_back_as_it_was(tmp_path: Path) -> None:
    speeds = [600.0 + 0.5 * n for n in range(1000)]
    import_record(save(tmp_path / "a.csv", "speed_rpm", [str(one) for one in speeds]), tmp_path / "bag")
    told = list(BagReader(tmp_path / "bag").speeds("valve_1"))
    assert told == [(DEFAULT_START + n * 1_000_000, speeds[n]) for n in range(0, 1000, 100)]
    export_bag(tmp_path / "bag", tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(encoding="utf-8") as stream:
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


def pulsed(
    path: Path,
    per_revolution: int,
    *,
    noise: float = 0.0,
    without: tuple[int, ...] = (),
    twice: tuple[int, ...] = (),
) -> Path:
    """Write 12 s of a run-up from 600 to 1200 rev/min with a tacho of 5 V that is high for a third."""
    time = np.arange(0.0, 12.0, 0.0002)
    turns = per_revolution * (10.0 * time + 10.0 * time**2 / 24.0)
    tacho = 5.0 * (turns % 1.0 < 0.35)
    tacho[np.isin(turns.astype(int), without)] = 0.0
    tacho[np.isin(turns.astype(int), twice) & (turns % 1.0 > 0.12) & (turns % 1.0 < 0.18)] = 0.0
    tacho += np.random.default_rng(1).normal(0.0, 1e-9 + noise, time.size)
    rows = [f"{t:.4f},{n % 7},{n % 5},{one:.3f}" for n, (t, one) in enumerate(zip(time, tacho, strict=True))]
    path.write_text("\n".join(["time_s,body_m_s2,spool_m_s2,tacho_pulse", *rows]) + "\n", "utf-8")
    return path


def read_speeds(bag: Path) -> tuple[Array, Array]:
    stamps, rpm = np.array(list(BagReader(bag).speeds("valve_1"))).T
    return (stamps - DEFAULT_START) * 1e-9, rpm


@pytest.mark.parametrize(("per_revolution", "noise"), [(1, 0.0), (1, 0.3), (7, 0.3), (30, 0.0)])
def test_pulses_of_a_tacho_become_the_speed(tmp_path: Path, per_revolution: int, noise: float) -> None:
    path = pulsed(tmp_path / "a.csv", per_revolution, noise=noise)
    found = import_record(path, tmp_path / "bag", how=choices(pulses=per_revolution))
    at, rpm = read_speeds(tmp_path / "bag")
    inner = (at > 0.3) & (at < 11.7)
    assert rpm[inner] == pytest.approx(600.0 + 50.0 * at[inner], rel=0.005)
    assert np.mean(rpm[inner] / (600.0 + 50.0 * at[inner])) == pytest.approx(1.0, abs=2e-4)
    assert not [text for text in found.warnings if "tacho" in text]


def test_missing_and_double_pulses_are_reported_and_repaired(tmp_path: Path) -> None:
    path = pulsed(tmp_path / "a.csv", 6, without=(100, 500, 501), twice=(300, 700, 800, 900))
    found = import_record(path, tmp_path / "bag", how=choices(pulses=6))
    tacho = [text for text in found.warnings if "tacho" in text]
    assert tacho == ["tacho: 3 missing pulses filled in", "tacho: 4 double pulses left out"]
    at, rpm = read_speeds(tmp_path / "bag")
    inner = (at > 0.3) & (at < 11.7)
    assert rpm[inner] == pytest.approx(600.0 + 50.0 * at[inner], rel=0.01)


def test_a_pause_of_the_shaft_has_no_speed(tmp_path: Path) -> None:
    found = import_record(
        pulsed(tmp_path / "a.csv", 6, without=tuple(range(200, 260))), tmp_path / "bag", how=choices(pulses=6)
    )
    assert "tacho: 1 pause of more than 3 pulses: no speed there" in found.warnings
    at, rpm = read_speeds(tmp_path / "bag")
    assert np.diff(at).max() == pytest.approx(0.9, abs=0.2)
    inner = (at > 0.3) & (at < 11.7)
    assert rpm[inner] == pytest.approx(600.0 + 50.0 * at[inner], rel=0.02)


@pytest.mark.parametrize(
    ("tacho", "given", "wrong"),
    [
        (lambda n: 0.0, {"pulses": 1}, "it is constant"),
        (lambda n: float(np.random.default_rng(n).normal()), {"pulses": 1}, "it has no two levels"),
        (lambda n: float(n % 3 == 0), {"pulses": 1}, "too dense for 1000 Hz"),
        (lambda n: float(n % 10 < 4), {"pulses": 100}, "fewer than one revolution of 100"),
        (lambda n: float(n % 10 < 4), {"pulses": 0}, "from 1 to 10000"),
        (lambda n: float(n % 10 < 4), {"columns": "tacho=tacho_pulse"}, "add --pulses-per-revolution"),
    ],
)
def test_what_is_no_tacho_is_refused(
    tmp_path: Path, tacho: Callable[[int], float], given: dict[str, Any], wrong: str
) -> None:
    path = save(tmp_path / "a.csv", "tacho_pulse", [f"{tacho(n):.4f}" for n in range(900)])
    with pytest.raises(InputError, match=wrong):
        import_record(path, tmp_path / "bag", how=choices(**given))
    with pytest.raises(InputError, match="no column tacho_pulse"):
        import_record(save(tmp_path / "b.csv", "x", ["1"] * 900), tmp_path / "bag", how=choices(pulses=1))


def test_a_speed_that_contradicts_the_pulses_is_reported(tmp_path: Path) -> None:
    rows = [f"{n * 0.001:.3f},{n % 7},{n % 5},{5 * (n % 50 < 20)},1200" for n in range(2000)]
    (tmp_path / "a.csv").write_text(
        "time_s,body_m_s2,spool_m_s2,ch3,speed_rpm\n" + "\n".join(rows) + "\n", "utf-8"
    )
    found = import_record(tmp_path / "a.csv", tmp_path / "bag", how=choices(columns="tacho=ch3", pulses=2))
    assert any("speed_rpm is 2 times it" in text for text in found.warnings)
    assert read_speeds(tmp_path / "bag")[1] == pytest.approx(600.0, rel=1e-3)
