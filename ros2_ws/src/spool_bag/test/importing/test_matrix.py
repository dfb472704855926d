# ruff: noqa: E501 - one line a file
"""Every format a logger writes times its expected outcome: identical samples, or the named refusal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from spool_bag.export import export_bag
from spool_bag.importing.bag_import import import_record
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import read_record
from spool_bag.reader import BagReader
from spool_core.errors import InputError

from . import loggers as made

Maker = Callable[[Path], None]
G = {"unit": "body=g,spool=g"}
SI = {"unit": "body=m/s^2,spool=m/s^2"}
VOLTS = {"scale": "body=0.1V/(m/s^2),spool=0.1V/(m/s^2)"}
BY_NUMBER = {"columns": "time_s=0,body_m_s2=1,spool_m_s2=2"}
IMUS = {"topic": "body=/imu_1:z,spool=/imu_2:z"}


def in_g(text: str) -> str:
    """Return the samples of a text in g, eight digits."""
    lines = [line.split(",") for line in text.splitlines()]
    return "\n".join(",".join([t, *(f"{float(x) / made.GRAVITY:.9f}" for x in r)]) for t, *r in lines) + "\n"


def in_mv(text: str) -> str:
    """Return the samples of a text in mV of a sensor of 100 mV/g."""
    lines = [line.split(",") for line in text.splitlines()]
    return (
        "\n".join(",".join([t, *(f"{float(x) / made.GRAVITY * 100:.7f}" for x in r)]) for t, *r in lines)
        + "\n"
    )


def ms(t: float) -> str:
    return f"{1e3 * t:.1f}"


INDEX = "\n".join(
    f"{at},{b:.4f},{s:.4f}" for at, (b, s) in enumerate(zip(made.BODY, made.SPOOL, strict=True))
)
PREAMBLE = "Logger 4711\nOperator;Eva\n\n[Data]\n"
CLOCK = made.text(
    "Datum;Uhrzeit;Gehäuse [m/s²];Schieber [m/s²]\n",
    made.rows(",", ";", lambda t: made.german(t).replace(" ", ";", 1)),
)
CONTRACT = "time_s,body_m_s2,spool_m_s2\n"

READ: list[tuple[str, Maker, dict[str, object]]] = [
    ("contract.csv", made.text(CONTRACT, made.rows()), {}),
    ("packed.csv.gz", made.gz, {}),
    ("quoted.csv", made.quoted, {}),
    ("bom.csv", made.text("\ufeff" + CONTRACT, made.rows()), {}),
    ("utf16.csv", made.text("Zeit [s]\tGehäuse [m/s²]\tSchieber [m/s²]\n", made.rows(",", "\t"), "utf-16"), {}),
    ("utf16le.txt", made.text("time (s)\tbody (m/s^2)\tspool (m/s^2)\n", made.rows(".", "\t"), "utf-16-le"), {}),
    ("latin1.csv", made.text("Zeit [s];Gehäuse [m/s²];Schieber [m/s²]\n", made.rows(",", ";"), "latin-1"), {}),
    ("crlf.csv", made.text(CONTRACT, made.rows().replace("\n", "\r\n")), {}),
    ("unit_row.csv", made.text("t;Gehäuse;Schieber\ns;m/s²;m/s²\n", made.rows(",", ";")), {}),
    ("preamble.csv", made.text(PREAMBLE + "t [s];body [m/s^2];spool [m/s^2]\n", made.rows(".", ";")), {}),
    ("comment.dat", made.text("# time[s] body[m/s^2] spool[m/s^2]\n", made.rows(".", "  ")), {}),
    ("no_header.csv", made.text("", made.rows()), BY_NUMBER),
    ("headed.csv", made.text("t,ch1,ch2\n", made.rows()), {"columns": "time_s=t,body_m_s2=ch1,spool_m_s2=ch2"}),
    ("status.csv", made.text("t [s],body [m/s2],spool [m/s2],state\n", made.rows().replace("\n", ",ok\n")), {}),
    ("trailing.csv", made.text("t [s];body [m/s2];spool [m/s2];\n", made.rows(",", ";").replace("\n", ";\n")), {}),
    ("milliseconds.csv", made.text("time [ms],body [m/s2],spool [m/s2]\n", made.rows(time=ms)), {}),
    ("unnamed_ms.csv", made.text("time,body [m/s2],spool [m/s2]\n", made.rows(time=ms)), {"unit": "time=ms"}),
    ("iso.csv", made.text("timestamp,body [m/s2],spool [m/s2]\n", made.rows(time=made.iso)), {}),
    ("german_time.csv", made.text("Zeit;Gehäuse [m/s²];Schieber [m/s²]\n", made.rows(",", ";", made.german)), {}),
    ("clock.csv", CLOCK, {}),
    ("epoch_s.csv", made.text("time,body [m/s2],spool [m/s2]\n", made.rows(time=made.epoch(1.0, 4))), {}),
    ("epoch_ms.csv", made.text("time,body [m/s2],spool [m/s2]\n", made.rows(time=made.epoch(1e3, 1))), {}),
    ("epoch_us.csv", made.text("time,body [m/s2],spool [m/s2]\n", made.rows(time=made.epoch(1e6, 0))), {}),
    ("index.csv", made.text("sample,body [m/s2],spool [m/s2]\n", INDEX), {"rate": 2000.0}),
    ("g.csv", made.text("t [s],body [g],spool [g]\n", in_g(made.rows())), {}),
    ("g_told.csv", made.text("t [s],body,spool\n", in_g(made.rows())), G),
    ("mv.csv", made.text("t [s],body [mV],spool [mV]\n", in_mv(made.rows())), {"scale": "body=100mV/g,spool=100mV/g"}),
    ("book.xlsx", made.excel, {}),
    ("table.parquet", made.parquet, {}),
    ("stamped.parquet", made.stamped_parquet, {}),
    ("table.feather", made.feather, {}),
    ("five.mat", made.mat5, {}),
    ("struct.mat", made.mat5_struct, {}),
    ("matrix.mat", made.mat5_matrix, {"columns": "time_s=data/0,body_m_s2=data/1,spool_m_s2=data/2"}),
    ("seven.mat", made.mat73, {}),
    ("structs73.mat", made.mat73_structs, {"columns": "body_m_s2=rec(1)/data,spool_m_s2=rec(2)/data"}),
    ("cells73.mat", made.mat73_cells, {"columns": "time_s=#0,body_m_s2=#1,spool_m_s2=#2", **SI}),
    ("tree.h5", made.hdf5, {}),
    ("arrays.npz", made.npz, {}),
    ("matrix.npy", made.npy, {"columns": "time_s=data/0,body_m_s2=data/1,spool_m_s2=data/2"}),
    ("float.wav", made.wav(np.float32), {"scale": "body=5g/FS,spool=5g/FS", "columns": "body_m_s2=0,spool_m_s2=1"}),
    ("int32.wav", made.wav(np.int32), {"scale": "body=5g/FS,spool=5g/FS", "columns": "body_m_s2=0,spool_m_s2=1"}),
    ("press.tdms", made.tdms, {}),
    ("timed.tdms", made.tdms_time, {}),
    ("record.mf4", made.mf4, {}),
    ("groups.mf4", made.mf4_groups, {}),
    ("functions.uff", made.uff, {}),
    ("no_times.lvm", made.lvm, {}),
    ("one_time.lvm", partial(made.lvm, x="One"), {}),
    ("own_times.lvm", partial(made.lvm, x="Multi"), {}),
    ("segments.lvm", partial(made.lvm, segments=6), {}),
    ("named.txt", made.lvm, {}),
    ("keysight.csv", made.keysight, {"columns": "time=x-axis,body=1,spool=2", **VOLTS}),
    ("siglent.csv", made.siglent, {"columns": "body=CH1,spool=CH2", **VOLTS}),
    ("tektronix.csv", made.tektronix, {"columns": "body=CH1,spool=CH2", **VOLTS}),
    ("tektronix_old.csv", made.tektronix_old, {"columns": "time_s=#3,body=#4,spool=#5", "unit": "body=V,spool=V", **VOLTS}),
    ("rigol.csv", made.rigol, {"columns": "body=CH1,spool=CH2", **VOLTS}),
    ("rigol_new.csv", made.rigol_new, {"columns": "body=#0,spool=#1", **VOLTS}),
    ("four.mat", made.mat4, {}),
    ("structs.mat", made.mat5_structs, {"columns": "body_m_s2=rec(1)/data,spool_m_s2=rec(2)/data"}),
    ("cells.mat", made.mat5_cells, {"columns": "time_s=#0,body_m_s2=#1,spool_m_s2=#2"}),
    ("timetable.mat", made.timetable("v7"), SI),
    ("timetable73.mat", made.timetable("v7.3"), SI),
    ("compound.h5", made.hdf5_compound, {}),
    ("typed.parquet", made.typed_parquet, {}),
    ("imus", made.imu_bag(StoragePlugin.MCAP), IMUS),
    ("imus_sqlite", made.imu_bag(StoragePlugin.SQLITE3), IMUS),
    ("imus.bag", made.ros1_bag, IMUS),
    ("accels", made.accel_bag, {"topic": "body=/sensors:x,spool=/sensors:y"}),
    ("arrays", made.array_bag, {"topic": "body=/daq:0,spool=/daq:1", "unit": "body=m/s^2,spool=m/s^2"}),
]  # fmt: skip

REFUSED: list[tuple[str, Maker, dict[str, object], str]] = [
    ("unitless.csv", made.text("t [s],body,spool\n", in_g(made.rows())), {}, r"type --unit body=g,spool=g, or --unit body=m/s\^2,spool=m/s\^2"),
    ("volts.csv", made.text("t [s],body [mV],spool [mV]\n", in_mv(made.rows())), {}, "--scale body=100mV/g"),
    ("bare.parquet", made.bare_parquet, {}, "have no unit and could be in g"),
    ("bare.wav", made.wav(np.float32), {"columns": "body_m_s2=0,spool_m_s2=1"}, "--scale body=50g/FS"),
    ("mass.csv", made.text("t [s],body [kg],spool [kg]\n", made.rows()), {}, "no unit|kg"),
    ("path.csv", made.text("t [s],body [mm],spool [mm]\n", made.rows()), {}, r"are in mm, a unit of length and not of acceleration: .*--unit body=m/s\^2"),
    ("no_time.csv", made.text("body [g],spool [g]\n", "\n".join("1,2" for _ in range(9))), {}, "e.g. --rate 2000 for 2000 Hz"),
    ("lists.parquet", made.lists, {}, "body .several values in a row: write one sample a row"),
    ("formulas.xlsx", made.formulas, {}, r"row 2: body .m/s\^2. is the formula =B2\*1 without a value: open the workbook"),
    ("which.csv", made.text("t [s],body 1 [g],body 2 [g],spool [g]\n", made.rows().replace("\n", ",0\n")), {},
     "body 1 .g., body 2 .g. could be body_m_s2: choose one with --columns .body=body 1 .g.., or --columns"),
    ("names.csv", made.text("t [s],a [g],b [g]\n", made.rows()), {}, r"name columns, e\.g\. --columns .body=a .g.,spool=b .g.."),
    ("headless.csv", made.text("", made.rows()), {}, r"name columns, e\.g\. --columns time=0,body=1,spool=2"),
    ("rate.csv", made.text("t [s],body [g],spool [g]\n", made.rows()), {"rate": 1000.0}, "shows 2000 Hz: leave --rate out"),
    ("cut.xlsx", lambda path: path.write_bytes(b"PK\x03\x04 cut") and None, {}, "cannot be read as Excel"),
    ("cut.tdms", lambda path: path.write_bytes(b"TDSm" + bytes(40)) and None, {}, "cannot be read as NI TDMS"),
    ("cut.mf4", lambda path: path.write_bytes(b"MDF     4.10" + bytes(80)) and None, {}, "cannot be read as ASAM MDF"),
    ("cut.h5", lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(80)) and None, {}, "cannot be read"),
    ("cut.npz", lambda path: path.write_bytes(b"PK\x03\x04 cut") and None, {}, "cannot be read as NumPy"),
    ("pickled.npy", lambda path: np.save(path, np.array([{}], dtype=object)), {}, "cannot be read as NumPy"),
    ("cut.parquet", lambda path: path.write_bytes(b"PAR1" + bytes(80)) and None, {}, "cannot be read as Parquet"),
    ("picture.png", lambda path: path.write_bytes(b"\x89PNG\r\n" + bytes(80)) and None, {}, "unknown file format; supported:"),
    ("topics", made.imu_bag(StoragePlugin.MCAP), {}, "--topic body=/imu_1:z,spool=/imu_2:z"),
    ("axis", made.imu_bag(StoragePlugin.MCAP), {"topic": "body=/imu_1:w,spool=/imu_2:z"}, "has no axis 'w': name one of x, y, z"),
    ("unitless", made.array_bag, {"topic": "body=/daq:0,spool=/daq:1"}, "have no unit and could be in g"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "maker", "how"), READ, ids=[one[0] for one in READ])
def test_the_samples_come_through(tmp_path: Path, name: str, maker: Maker, how: dict[str, object]) -> None:
    path = tmp_path / name
    maker(path)
    result = import_record(path, tmp_path / "bag", how=choices(**how))
    assert result.samples == made.COUNT
    assert result.period == pytest.approx(1.0 / made.RATE, rel=1e-6)
    assert result.lost_blocks == 0
    blocks = list(BagReader(tmp_path / "bag").blocks("valve_1"))
    for found, truth in (
        (np.concatenate([block.body for block in blocks]), made.BODY),
        (np.concatenate([block.spool for block in blocks]), made.SPOOL),
    ):
        np.testing.assert_allclose(found, truth, rtol=1e-6, atol=1e-6)
    dated = ("iso.csv", "german_time.csv", "clock.csv", "record.mf4", "imus.bag", "imus", "imus_sqlite")
    if name in dated or name.startswith("epoch"):
        assert blocks[0].stamp == pytest.approx(made.START.timestamp() * 1e9, abs=1e3)


@pytest.mark.parametrize(("name", "maker", "how", "message"), REFUSED, ids=[one[0] for one in REFUSED])
def test_what_is_ambiguous_or_damaged_is_refused_with_what_to_type(
    tmp_path: Path, name: str, maker: Maker, how: dict[str, object], message: str
) -> None:
    path = tmp_path / name
    maker(path)
    with pytest.raises(InputError, match=message) as caught:
        import_record(path, tmp_path / "bag", how=choices(**how))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [name]


def test_dates_of_a_workbook_are_times(tmp_path: Path) -> None:
    made.excel_dates(tmp_path / "dates.xlsx")
    found = read_record(tmp_path / "dates.xlsx")
    assert found.period == pytest.approx(0.001)
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY[::2], atol=1e-9)


@pytest.mark.parametrize("kind", ["csv", "csv.gz", "parquet"])
def test_what_is_exported_comes_back(tmp_path: Path, kind: str) -> None:
    (tmp_path / "first.csv").write_text(CONTRACT + made.rows(), "utf-8")
    import_record(tmp_path / "first.csv", tmp_path / "bag")
    export_bag(tmp_path / "bag", tmp_path / f"out.{kind}")
    import_record(tmp_path / f"out.{kind}", tmp_path / "again")
    first, second = (
        [(b.stamp, b.sequence, b.body.tobytes(), b.spool.tobytes()) for b in BagReader(bag).blocks("valve_1")]
        for bag in (tmp_path / "bag", tmp_path / "again")
    )
    assert first == second


def test_a_bag_of_our_own_topics_is_read_by_its_roles(tmp_path: Path) -> None:
    (tmp_path / "first.csv").write_text(CONTRACT + made.rows(), "utf-8")
    import_record(tmp_path / "first.csv", tmp_path / "bag")
    found = read_record(tmp_path / "bag")
    np.testing.assert_allclose(found.columns["spool_m_s2"], made.SPOOL, rtol=1e-6, atol=1e-6)
