from __future__ import annotations

import gzip
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
import pytest
from spool_bag.export import export_bag
from spool_bag.importing.bag_import import DEFAULT_START
from spool_bag.importing.bag_import import import_record as import_csv
from spool_bag.importing.logger_record import read_record as read_csv
from spool_bag.information import describe
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.block_gate import BlockGate, Verdict
from spool_core.cdr import encode_block
from spool_core.errors import InputError
from spool_core.stamps import sampling_period

HEADER = "time_s,body_m_s2,spool_m_s2"


def signal(n: int, *, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((2, n)).round(3)


def record(n: int = 4000, rate: float = 2000.0, *, keep: np.ndarray | None = None, oil: bool = False) -> str:
    """Return a logger's file of ``n`` samples with times of five decimals."""
    body, spool = signal(n)
    rows = []
    for at in range(n) if keep is None else np.flatnonzero(keep):
        row = f"{at / rate:.5f},{body[at]:.3f},{spool[at]:.3f}"
        rows.append(row + f",{40 + at / n:.2f}" if oil else row)
    return "\n".join([HEADER + (",oil_temperature_C" if oil else ""), *rows]) + "\n"


def save(folder: Path, text: str) -> Path:
    path = folder / "record.csv"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize(
    "rate", [1000.0, 2000.0, 2048.0, 5120.0, 10000.0, 44100.0, 51200.0, 102.4, 1 / 0.003]
)
def test_period_is_what_the_logger_was_set_to(rate: float) -> None:
    times = np.round(np.arange(4000) / rate, 5)
    steps = np.diff(times)
    found = sampling_period(float(steps.mean()), float(np.ptp(steps)), steps.size)
    assert found == pytest.approx(1.0 / rate, rel=1e-9 if rate != 102.4 else 1e-6)


def test_import_keeps_every_sample(tmp_path: Path) -> None:
    result = import_csv(save(tmp_path, record(oil=True)), tmp_path / "bag", valve="press/left")
    assert (result.samples, result.blocks, result.lost_blocks, result.temperatures) == (4000, 100, 0, 2)
    assert (result.period, result.duration, result.warnings) == (0.0005, 2.0, ())
    reader = BagReader(tmp_path / "bag")
    blocks = list(reader.blocks("press/left"))
    body, spool = signal(4000)
    np.testing.assert_array_equal(np.concatenate([block.body for block in blocks]), body.astype(np.float32))
    np.testing.assert_array_equal(np.concatenate([block.spool for block in blocks]), spool.astype(np.float32))
    gate = BlockGate()
    assert [gate.judge(block) for block in blocks] == [Verdict.RESTARTS] + [Verdict.CONTINUES] * 99
    assert [block.stamp for block in blocks] == [DEFAULT_START + 20_000_000 * at for at in range(100)]
    assert list(reader.temperatures("press/left")) == [
        (DEFAULT_START, 40.0),
        (DEFAULT_START + 1_000_000_000, 40.5),
    ]
    message = next(iter(reader.messages("/press/left/acceleration")))
    assert message.header.frame_id == "press/left"


def test_import_is_reproducible(tmp_path: Path) -> None:
    path = save(tmp_path, record())
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    import_csv(path, tmp_path / "a" / "bag")
    import_csv(path, tmp_path / "b" / "bag")
    files = [(tmp_path / name / "bag" / "bag_0.mcap").read_bytes() for name in "ab"]
    assert files[0] == files[1]


@pytest.mark.parametrize(("offset", "start"), [(-1.5, DEFAULT_START), (1_700_000_000.0, 0)])
def test_times_may_begin_before_a_trigger_or_be_of_a_calendar(
    tmp_path: Path, offset: float, start: int
) -> None:
    rows = record(200).splitlines()
    moved = [f"{float(row.split(',')[0]) + offset:.5f},{row.partition(',')[2]}" for row in rows[1:]]
    import_csv(save(tmp_path, "\n".join([HEADER, *moved])), tmp_path / "bag")
    valve = describe(tmp_path / "bag").valves[0]
    assert valve.first_stamp_ns == pytest.approx(start + offset * 1e9, abs=1000)
    assert (valve.lost_blocks, valve.sample_rate) == (0, 2000.0)


def test_a_gap_is_counted_as_lost_blocks(tmp_path: Path) -> None:
    keep = np.ones(4000, dtype=bool)
    keep[1010:1250] = False  # six blocks of 40
    result = import_csv(save(tmp_path, record(keep=keep)), tmp_path / "bag")
    assert result.lost_blocks == 6
    assert "1 gap in" in result.warnings[0]
    assert "line 1012" in result.warnings[0]
    valve = describe(tmp_path / "bag").valves[0]
    assert (valve.lost_blocks, valve.refused_blocks, valve.samples) == (6, 0, 3760)


def test_names_are_mapped(tmp_path: Path) -> None:
    path = save(tmp_path, record().replace(HEADER, "t,ch1, ch2", 1))
    with pytest.raises(InputError, match=r"no column body_m_s2, spool_m_s2; it has t, ch1, ch2: .*--columns"):
        read_csv(path)
    found = read_csv(path, columns={"time_s": "t", "body_m_s2": "ch1", "spool_m_s2": "ch2"})
    np.testing.assert_array_equal(found.columns["body_m_s2"], signal(4000)[0])
    with pytest.raises(InputError, match="'pace' is not one of time_s"):
        read_csv(path, columns={"pace": "t"})
    with pytest.raises(InputError, match="no column ch7"):
        read_csv(path, columns={"time_s": "t", "body_m_s2": "ch7", "spool_m_s2": "ch2"})


@pytest.mark.parametrize("kind", ["driven", "imposed"])
def test_force_records(tmp_path: Path, kind: str) -> None:
    text = record(100).replace(HEADER, "time_s,displacement_m,force_N", 1)
    found = read_csv(save(tmp_path, text), kind)
    assert set(found.columns) == {"displacement_m", "force_N"}
    with pytest.raises(InputError, match="no column body_m_s2, spool_m_s2"):
        read_csv(save(tmp_path, text))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: [], "empty"),
        (lambda rows: rows[:1], "0 samples"),
        (lambda rows: rows[:2], "1 samples"),
        (lambda rows: [*rows[:9], "0.00450,abc,1.0", *rows[10:]], "line 10: body_m_s2 is .abc"),
        (lambda rows: [*rows[:9], "0.00400,1.0", *rows[10:]], "line 10 has 2 cells, the header has 3"),
        (lambda rows: [*rows[:9], "0.00400,,1.0", *rows[10:]], "line 10: body_m_s2 is empty, NaN"),
        (lambda rows: [*rows[:9], "0.00400,1.0,nan", *rows[10:]], "line 10: spool_m_s2 is empty, NaN"),
        (lambda rows: [*rows[:9], "0.00400,1.0,inf", *rows[10:]], "line 10: spool_m_s2 is empty, NaN"),
        (lambda rows: [*rows[:9], "0.00300,1.0,1.0", *rows[10:]], "line 10: time_s does not increase"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, change: Callable[[list[str]], list[str]], message: str
) -> None:
    rows = change(record(200).splitlines())
    path = save(tmp_path, "\n".join(rows))
    with pytest.raises(InputError, match=message) as caught:
        import_csv(path, tmp_path / "bag")
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "bag").exists()


def test_compressed_and_cut(tmp_path: Path) -> None:
    path = tmp_path / "record.csv.gz"
    path.write_bytes(gzip.compress(record().encode()))
    assert read_csv(path).time.size == 4000
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(InputError, match=r"record\.csv\.gz: the compressed file is cut off or damaged"):
        read_csv(path)
    with pytest.raises(InputError, match="No such file"):
        read_csv(tmp_path / "nothing.csv")


def test_temperature_may_begin_late(tmp_path: Path) -> None:
    rows = record(4000, oil=True).splitlines()
    rows[1:1001] = [row.rpartition(",")[0] + "," for row in rows[1:1001]]
    assert import_csv(save(tmp_path, "\n".join(rows)), tmp_path / "bag").temperatures == 2
    (stamp, celsius), _ = BagReader(tmp_path / "bag").temperatures("valve_1")
    assert (stamp - DEFAULT_START, celsius) == (500_000_000, 40.25)
    export_bag(tmp_path / "bag", tmp_path / "again.csv")
    assert import_csv(tmp_path / "again.csv", tmp_path / "bag_2").temperatures == 2


def test_suspicious_units_are_told(tmp_path: Path) -> None:
    time_s = np.arange(1000) / 1000.0
    wave = np.sin(80.0 * time_s)

    def warnings(body: float, spool: float) -> str:
        rows = [f"{t:.5f},{body * a:.6f},{spool * a:.6f}" for t, a in zip(time_s, wave, strict=True)]
        return " ".join(read_csv(save(tmp_path, "\n".join([HEADER, *rows]))).warnings)

    assert warnings(3.0, 2.0) == ""
    assert "body_m_s2 has an rms" in warnings(5000.0, 5.0)
    assert "is body_m_s2 in g instead of m/s^2?" in warnings(1.0, 9.80665)
    assert "is spool_m_s2 in g instead of m/s^2?" in warnings(9.80665, 1.0)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanosec")])
@pytest.mark.parametrize("offset", [0.0, 1_700_000_000.0])
def test_another_unit_of_time_is_refused_by_name(
    tmp_path: Path, factor: float, unit: str, offset: float
) -> None:
    rows = [f"{(offset + at / 1000) * factor:.3f},{at % 7}.5,{at % 5}.5" for at in range(200)]
    with pytest.raises(InputError, match=f"time_s steps by .* are these {unit}"):
        import_csv(save(tmp_path, "\n".join([HEADER, *rows])), tmp_path / "bag")
    text = "\n".join(["time_s,displacement_m,force_N", *rows])
    if factor == 1e3:
        assert unit in read_csv(save(tmp_path, text), "driven").warnings[0]
    else:
        with pytest.raises(InputError, match=f"are these {unit}"):
            read_csv(save(tmp_path, text), "driven")


def test_times_of_a_calendar_take_no_start(tmp_path: Path) -> None:
    rows = [f"{1_700_000_000 + at / 1000:.3f},{at % 7}.5,{at % 5}.5" for at in range(200)]
    path = save(tmp_path, "\n".join([HEADER, *rows]))
    with pytest.raises(InputError, match="counts from 1970 itself"):
        import_csv(path, tmp_path / "bag", start=DEFAULT_START)
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("cell", ["1e308", "-1e300"])
def test_a_number_that_nothing_measures_is_refused(tmp_path: Path, cell: str) -> None:
    for column in range(3):
        rows = record(200).splitlines()
        cells = rows[9].split(",")
        cells[column] = cell
        rows[9] = ",".join(cells)
        with pytest.raises(InputError, match=r"line 1[01]: .*(nothing measures|does not increase)|line 10"):
            import_csv(save(tmp_path, "\n".join(rows)), tmp_path / "bag")


def test_a_binary_file_is_refused_and_not_shown(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(InputError, match="binary file, not a CSV text"):
        import_csv(path, tmp_path / "bag")
    path.write_bytes(bytes(range(1, 256)) * 40 + b"\n1,2,3\n")
    with pytest.raises(InputError) as caught:
        import_csv(path, tmp_path / "bag")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1500


def test_a_header_of_many_columns_is_not_shown_whole(tmp_path: Path) -> None:
    for count in (3000, 200_000):
        names = ",".join(f"channel_{at}" for at in range(count))
        with pytest.raises(InputError) as caught:
            read_csv(save(tmp_path, f"{names}\n{names}\n{names}\n"))
        assert len(str(caught.value)) < 1000


def test_columns_with_escapes_do_not_reach_the_terminal(tmp_path: Path) -> None:
    text = record(100).replace("spool_m_s2", "spool\x1b[31m", 1)
    with pytest.raises(InputError, match="no unit") as caught:
        read_csv(save(tmp_path, text))
    assert str(caught.value).isprintable()


EXPAND = """
import sys
from spool_bag.importing import table
from spool_bag.importing.logger_record import read_record as read_csv
table.MOST_SAMPLES //= 10
from spool_core.errors import InputError
try:
    read_csv(sys.argv[1])
except InputError as error:
    print(error)
# Not ru_maxrss, which a process takes over from the one that started it.
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


@pytest.mark.parametrize("unit", [b"0,0,0\n", b"0", b"\n"])
def test_a_packed_file_that_expands_without_bound_is_refused_in_bounded_memory(
    tmp_path: Path, unit: bytes
) -> None:
    piece = zlib.compressobj(9, zlib.DEFLATED, 31)
    block = unit * (16_000_000 // len(unit))
    parts = [piece.compress(b"time_s,body_m_s2,spool_m_s2\n")]
    parts += [piece.compress(block) for _ in range(8)]
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(b"".join([*parts, piece.flush()]))
    done = subprocess.run(
        [sys.executable, "-c", EXPAND, str(path)], capture_output=True, text=True, check=True
    )
    told, memory = done.stdout.splitlines()
    assert str(path) in told
    assert len(told) < 1000
    assert int(memory) < 1_000_000  # kB


@pytest.mark.parametrize("valve", ["", "2nd", "a b", "/valve_1", "a//b", "a__b", "../x"])
def test_impossible_valve_names_are_refused(tmp_path: Path, valve: str) -> None:
    with pytest.raises(InputError, match="valve name"):
        import_csv(save(tmp_path, record()), tmp_path / "bag", valve=valve)


def test_csv_to_bag_to_csv_is_exact(tmp_path: Path) -> None:
    keep = np.ones(4000, dtype=bool)
    keep[1010:1250] = False
    path = save(tmp_path, record(keep=keep, oil=True))
    import_csv(path, tmp_path / "bag")
    result = export_bag(tmp_path / "bag", tmp_path / "again.csv")
    assert (result.rows, result.refused_blocks) == (3760, 0)
    before, after = read_csv(path), read_csv(tmp_path / "again.csv")
    np.testing.assert_array_equal(after.time, before.time)
    assert after.period == before.period
    for name in ("body_m_s2", "spool_m_s2"):
        np.testing.assert_array_equal(
            after.columns[name].astype(np.float32), before.columns[name].astype(np.float32)
        )
    import_csv(tmp_path / "again.csv", tmp_path / "bag_2")
    first, second = (
        [(b.stamp, b.sequence, b.body.tobytes(), b.spool.tobytes()) for b in BagReader(bag).blocks("valve_1")]
        for bag in (tmp_path / "bag", tmp_path / "bag_2")
    )
    assert first == second
    text = (tmp_path / "again.csv").read_text("utf-8").splitlines()
    assert text[0] == HEADER + ",oil_temperature_C"
    cells = record(oil=True).splitlines()[2].split(",")
    assert text[2] == ",".join([*(f"{float(cell):g}" for cell in cells[:3]), "40"])


def test_parquet_holds_the_same_and_names_the_valves(tmp_path: Path) -> None:
    body, spool = signal(80)
    with BagWriter(tmp_path / "bag") as writer:
        for valve, scale in (("valve_1", 1.0), ("valve_2", 2.0)):
            channel = writer.add_topic(f"/{valve}/acceleration", ACCELERATION_BLOCK)
            import_block = next(_blocks(tmp_path, valve, scale * body, scale * spool))
            writer.write(channel, 1, encode_block(import_block, valve))
    export_bag(tmp_path / "bag", tmp_path / "out.parquet")
    table = pa_parquet.read_table(tmp_path / "out.parquet")
    assert table.column_names == ["valve", "time_s", "body_m_s2", "spool_m_s2"]
    assert table.column("valve").to_pylist() == ["valve_1"] * 40 + ["valve_2"] * 40
    export_bag(tmp_path / "bag", tmp_path / "out.csv.gz", valves=["valve_2"])
    only = pa_csv.read_csv(tmp_path / "out.csv.gz")
    np.testing.assert_array_equal(
        only.column("body_m_s2").to_numpy().astype(np.float32), (2.0 * body[:40]).astype(np.float32)
    )


def _blocks(folder: Path, valve: str, body: np.ndarray, spool: np.ndarray):
    rows = [f"{at / 2000:.5f},{body[at]:.3f},{spool[at]:.3f}" for at in range(body.size)]
    import_csv(save(folder, "\n".join([HEADER, *rows])), folder / f"of_{valve}", valve=valve)
    return BagReader(folder / f"of_{valve}").blocks(valve)


@pytest.mark.parametrize("name", ["out.xlsx", "out"])
def test_targets_of_export_are_checked(tmp_path: Path, name: str) -> None:
    import_csv(save(tmp_path, record()), tmp_path / "bag")
    with pytest.raises(InputError, match=name):
        export_bag(tmp_path / "bag", tmp_path / name)
    (tmp_path / "there.csv").write_text("", "utf-8")
    with pytest.raises(InputError, match=r"there\.csv exists already"):
        export_bag(tmp_path / "bag", tmp_path / "there.csv")
    with pytest.raises(InputError, match="no valve 'valve_7'"):
        export_bag(tmp_path / "bag", tmp_path / "x.csv", valves=["valve_7"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "record.csv", "there.csv"]
