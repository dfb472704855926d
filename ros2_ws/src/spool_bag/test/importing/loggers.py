"""Files as loggers write them, made by the formats' own libraries, all of one motion."""

from __future__ import annotations

import gzip
import warnings
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.feather as pa_feather
import pyarrow.parquet as pa_parquet
import pytest
import pyuff
from nptdms import ChannelObject, TdmsWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat, wavfile

RATE, COUNT = 2000.0, 600
GRAVITY = 9.80665
START = datetime(2026, 5, 4, 3, 2, 1, tzinfo=timezone.utc)
TIME = np.arange(COUNT) / RATE


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Return body and spool, m/s^2; whole numbers of 1e-4, which every text of four decimals holds."""
    body = 8.0 * np.sin(2.0 * np.pi * 14.0 * TIME) + np.random.default_rng(3).normal(0.0, 0.3, COUNT)
    spool = 1.5 * np.roll(body, 7) - 0.2 * body**2 / 8.0
    return body.round(4), spool.round(4)


BODY, SPOOL = motion()


def rows(mark: str = ".", between: str = ",", time: Callable[[float], str] | None = None) -> str:
    """Return the samples as text."""
    told = time or (lambda t: f"{t:.4f}".replace(".", mark))
    lines = (
        between.join([told(t), *(f"{x:.4f}".replace(".", mark) for x in (b, s))])
        for t, b, s in zip(TIME, BODY, SPOOL, strict=True)
    )
    return "\n".join(lines) + "\n"


def text(header: str, body: str, encoding: str = "utf-8") -> Callable[[Path], None]:
    """Return what writes a text file."""
    return lambda path: path.write_bytes((header + body).encode(encoding)) and None


def german(t: float) -> str:
    """Return a time of day as German loggers write it."""
    return (START + timedelta(seconds=t)).strftime("%d.%m.%Y %H:%M:%S,%f")


def iso(t: float) -> str:
    """Return a time by ISO 8601."""
    return (START + timedelta(seconds=t)).isoformat()


def epoch(size: float, decimals: int) -> Callable[[float], str]:
    """Return what writes times since 1970 in units of 1/size s."""
    return lambda t: f"{(START.timestamp() + t) * size:.{decimals}f}"


def excel(path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Measured on the press"])
    sheet.append([])
    sheet.append(["Zeit [s]", "Gehäuse [g]", "Schieber [g]", "Bemerkung"])
    for t, b, s in zip(TIME, BODY / GRAVITY, SPOOL / GRAVITY, strict=True):
        sheet.append([float(t), float(b), float(s), None])
    book.save(path)


def formulas(path: Path) -> None:
    """Write a workbook that no program has calculated."""
    book = openpyxl.Workbook()
    book.active.append(["t [s]", "raw", "body [m/s^2]", "spool [m/s^2]"])
    for at, (t, raw, value) in enumerate(zip(TIME, BODY, SPOOL, strict=True), start=2):
        book.active.append([t, raw, f"=B{at}*1", value])
    book.save(path)


def lists(path: Path) -> None:
    """Write a table with a block of samples in each row."""
    blocks = {name: [*row.reshape(-1, 10)] for name, row in (("body", BODY), ("spool", SPOOL))}
    pa_parquet.write_table(pa.table({"t0": TIME[::10], **blocks}), path)


def excel_dates(path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["time", "body (m/s²)", "spool (m/s²)"])
    for at, (b, s) in enumerate(zip(BODY[::2], SPOOL[::2], strict=True)):
        book.active.append([datetime(2026, 5, 4) + timedelta(milliseconds=at), float(b), float(s)])
    book.save(path)


def arrow_table(units: bool = True) -> pa.Table:
    names = ("time_s", "body", "spool")
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": unit} if units else None)
        for name, unit in zip(names, ("s", "m/s^2", "m/s^2"), strict=True)
    ]
    return pa.table([TIME, BODY, SPOOL], schema=pa.schema(fields))


def stamped_parquet(path: Path) -> None:
    stamps = (
        np.datetime64(START.replace(tzinfo=None), "ns") + (TIME * 1e9).astype("timedelta64[ns]")
    ).astype("datetime64[ns]")
    pa_parquet.write_table(pa.table({"timestamp": stamps, "body_m_s2": BODY, "spool_m_s2": SPOOL}), path)


def mat5(path: Path) -> None:
    savemat(path, {"t": TIME, "body_m_s2": BODY, "spool_m_s2": SPOOL})


def mat5_struct(path: Path) -> None:
    rec = {"fs": RATE, "body": BODY, "body_unit": "m/s^2", "spool": SPOOL, "spool_unit": "m/s^2"}
    savemat(path, {"rec": rec})


def mat5_matrix(path: Path) -> None:
    savemat(path, {"data": np.column_stack([TIME, BODY, SPOOL]), "operator": "Eva"})


def _mat73(path: Path, fill: Callable[[h5py.File], None]) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124))


def _of_class(entry: Any, name: str) -> Any:
    entry.attrs["MATLAB_class"] = np.bytes_(name)
    return entry


def _references(file: h5py.File, rows: Sequence[Any], name: str) -> np.ndarray:
    """Return references to arrays of MATLAB, as structure and cell arrays of version 7.3 hold them."""
    held = [
        _of_class(file.create_dataset(f"#refs#/{name}{at}", data=np.atleast_2d(row)), "double").ref
        for at, row in enumerate(rows)
    ]
    return np.array(held, dtype=h5py.ref_dtype).reshape(-1, 1)


def mat73(path: Path) -> None:
    def fill(file: h5py.File) -> None:
        for name, row in (("t", TIME), ("body_m_s2", BODY), ("spool_m_s2", SPOOL)):
            _of_class(file.create_dataset(name, data=row.reshape(1, -1)), "double")

    _mat73(path, fill)


def mat73_structs(path: Path) -> None:
    def fill(file: h5py.File) -> None:
        group = _of_class(file.create_group("rec"), "struct")
        group["data"] = _references(file, (BODY, SPOOL), "d")
        group["fs"] = _references(file, (RATE, RATE), "f")
        group["unit"] = np.array(
            [_of_class(file.create_dataset(f"#refs#/u{at}", data=unit), "char").ref for at in (0, 1)],
            dtype=h5py.ref_dtype,
        ).reshape(-1, 1)

    unit = np.array([[ord(letter)] for letter in "m/s^2"], np.uint16)
    _mat73(path, fill)


def mat73_cells(path: Path) -> None:
    def fill(file: h5py.File) -> None:
        _of_class(file.create_dataset("x", data=_references(file, (TIME, BODY, SPOOL), "d")), "cell")

    _mat73(path, fill)


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("measurement")
        group.attrs["sample_rate"] = RATE
        for name, row in (("body", BODY / GRAVITY), ("spool", SPOOL / GRAVITY)):
            group.create_dataset(name, data=row).attrs["units"] = "g"


def wav(dtype: type) -> Callable[[Path], None]:
    """Return what writes a WAV file whose full scale is 5 g."""

    def write(path: Path) -> None:
        share = np.column_stack([BODY, SPOOL]) / (5.0 * GRAVITY)
        data = share.astype(np.float32) if dtype is np.float32 else np.rint(share * 2**31).astype(np.int32)
        wavfile.write(path, int(RATE), data)

    return write


def tdms(path: Path) -> None:
    with TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                ChannelObject(
                    "Press", name, row, {"unit_string": "g", "wf_increment": 1.0 / RATE, "wf_samples": COUNT}
                )
                for name, row in (("body", BODY / GRAVITY), ("spool", SPOOL / GRAVITY))
            ]
        )


def tdms_time(path: Path) -> None:
    with TdmsWriter(str(path)) as writer:
        channels = (("Time", TIME, "s"), ("body", BODY, "m/s^2"), ("spool", SPOOL, "m/s^2"))
        writer.write_segment(
            [ChannelObject("A", name, row, {"unit_string": unit}) for name, row, unit in channels]
        )


def mf4(path: Path) -> None:
    from asammdf import MDF, Signal  # noqa: PLC0415 - slow to load

    with MDF() as file:
        file.header.start_time = START
        file.append(
            [Signal(row, TIME, name=name, unit="m/s^2") for name, row in (("body", BODY), ("spool", SPOOL))]
        )
        file.save(path, overwrite=True)


def mf4_groups(path: Path) -> None:
    """Each channel in its own group, as many systems write them; the clock is one."""
    from asammdf import MDF, Signal  # noqa: PLC0415 - slow to load

    with MDF() as file:
        for name, row in (("body", BODY), ("spool", SPOOL)):
            file.append([Signal(row / GRAVITY, TIME, name=name, unit="g")])
        file.save(path, overwrite=True)


def uff(path: Path) -> None:
    file = pyuff.UFF(str(path))
    whole = (
        "ver_num",
        "load_case_id",
        "ref_node",
        "ref_dir",
        "orddenom_spec_data_type",
        "z_axis_spec_data_type",
        *(
            f"{axis}_{unit}_unit_exp"
            for axis in ("abscissa", "ordinate", "orddenom", "z_axis")
            for unit in ("len", "force", "temp")
        ),
    )
    text = (
        "id2",
        "id3",
        "id4",
        "id5",
        "rsp_ent_name",
        "ref_ent_name",
        "abscissa_axis_lab",
        "ordinate_axis_lab",
        "orddenom_axis_lab",
        "orddenom_axis_units_lab",
        "z_axis_axis_lab",
        "z_axis_axis_units_lab",
    )
    for at, (name, row) in enumerate((("body", BODY), ("spool", SPOOL))):
        told = (
            dict.fromkeys(whole, 0)
            | dict.fromkeys(text, "NONE")
            | {
                "type": 58,
                "binary": 0,
                "func_type": 1,
                "id1": name,
                "rsp_node": at + 1,
                "rsp_dir": 3,
                "data": row,
                "x": TIME,
                "ord_data_type": 4,
                "num_pts": COUNT,
                "abscissa_spacing": 1,
                "abscissa_min": 0.0,
                "abscissa_inc": 1.0 / RATE,
                "z_axis_value": 0.0,
                "abscissa_spec_data_type": 17,
                "ordinate_spec_data_type": 12,
                "ordinate_axis_units_lab": "m/s^2",
                "abscissa_axis_units_lab": "s",
            }
        )
        file.write_sets(told, mode="add" if at else "overwrite")


def _stamp(store: object, at: int) -> object:
    whole = round((START.timestamp() + at / RATE) * 1e9)
    return store.types["builtin_interfaces/msg/Time"](sec=whole // 10**9, nanosec=whole % 10**9)


def imu(store: object, at: int, value: float, ros1: bool = False) -> object:
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    header = {"stamp": _stamp(store, at), "frame_id": "imu"} | ({"seq": at} if ros1 else {})
    return types["sensor_msgs/msg/Imu"](
        header=types["std_msgs/msg/Header"](**header),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(x=0.0, y=0.0, z=0.0),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(x=0.0, y=0.0, z=float(value)),
        linear_acceleration_covariance=np.zeros(9),
    )


def imu_bag(plugin: StoragePlugin) -> Callable[[Path], None]:
    """Return what writes two topics of sensor_msgs/Imu."""

    def write(path: Path) -> None:
        store = get_typestore(Stores.ROS2_JAZZY)
        with Writer2(path, version=9, storage_plugin=plugin) as writer:
            for topic, row in (("/imu_1", BODY), ("/imu_2", SPOOL)):
                channel = writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store)
                for at, value in enumerate(row):
                    message = imu(store, at, value)
                    stamp = round((START.timestamp() + at / RATE) * 1e9)
                    writer.write(channel, stamp, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))

    return write


def ros1_bag(path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        for topic, row in (("/imu_1", BODY), ("/imu_2", SPOOL)):
            channel = writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store)
            for at, value in enumerate(row):
                stamp = round((START.timestamp() + at / RATE) * 1e9)
                message = imu(store, at, value, ros1=True)
                writer.write(channel, stamp, store.serialize_ros1(message, "sensor_msgs/msg/Imu"))


def accel_bag(path: Path) -> None:
    """One topic of geometry_msgs/AccelStamped that holds both channels on two axes."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types, kind = store.types, "geometry_msgs/msg/AccelStamped"
    vector = types["geometry_msgs/msg/Vector3"]
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        channel = writer.add_connection("/sensors", kind, typestore=store)
        for at, (b, s) in enumerate(zip(BODY, SPOOL, strict=True)):
            accel = types["geometry_msgs/msg/Accel"](
                linear=vector(x=float(b), y=float(s), z=0.0), angular=vector(x=0.0, y=0.0, z=0.0)
            )
            header = types["std_msgs/msg/Header"](stamp=_stamp(store, at), frame_id="")
            stamp = round((START.timestamp() + at / RATE) * 1e9)
            writer.write(channel, stamp, store.serialize_cdr(types[kind](header=header, accel=accel), kind))


def array_bag(path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    types, kind = store.types, "std_msgs/msg/Float64MultiArray"
    with Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        channel = writer.add_connection("/daq", kind, typestore=store)
        for at, pair in enumerate(np.column_stack([BODY, SPOOL])):
            layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            stamp = round((START.timestamp() + at / RATE) * 1e9)
            writer.write(channel, stamp, store.serialize_cdr(types[kind](layout=layout, data=pair), kind))


def lvm(path: Path, x: str = "No", segments: int = 1) -> None:
    """LabVIEW's measurement file with decimal comma; ``x``: its columns of times, No, One or Multi."""
    top = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n"
        f"Multi_Headings\tYes\nX_Columns\t{x}\nTime_Pref\tAbsolute\nOperator\tEva\nDate\t2026/05/04\n"
        "Time\t03:02:01,5\n***End_of_Header***\t\n"
    )
    size = COUNT // segments
    for part in range(segments):
        clock = f"03:02:0{1 + part * size / RATE:.4f}".replace(".", ",")
        beside = "\t" if x == "Multi" else ""
        both = (
            f"Samples\t{size}\t{beside}{size}\nDate\t2026/05/04\t{beside}2026/05/04\nTime\t{clock}\t{beside}{clock}\n"
            f"Y_Unit_Label\tg\t{beside}g\nX_Dimension\tTime\t{beside}Time\nX0\t0,0E+0\t{beside}0,0E+0\n"
            f"Delta_X\t5,0E-4\t{beside}5,0E-4\n***End_of_Header***\t\n"
        )
        second = "X_Value\t" if beside else ""
        top += f"\t\nChannels\t2\t\t\n{both}X_Value\tbody\t{second}spool\tComment\n"
        for at in range(part * size, (part + 1) * size):
            cells = ["" if x == "No" else f"{TIME[at]:.6f}", f"{BODY[at] / GRAVITY:.9f}"]
            cells += [cells[0], f"{SPOOL[at] / GRAVITY:.9f}"] if beside else [f"{SPOOL[at] / GRAVITY:.9f}"]
            top += "\t".join(cells).replace(".", ",") + "\n"
    path.write_text(top, "utf-8")


def volts(sign: str = "") -> list[str]:
    """Return the rows of an oscilloscope: time and readings of sensors of 0.1 V/(m/s^2)."""
    return [
        f"{t:{sign}.5E},{0.1 * b:{sign}.6E},{0.1 * s:{sign}.6E}"
        for t, b, s in zip(TIME, BODY, SPOOL, strict=True)
    ]


def keysight(path: Path) -> None:
    path.write_text("\n".join(["x-axis,1,2", "second,Volt,Volt", *volts("+")]) + "\n", "utf-8")


def siglent(path: Path) -> None:
    top = [
        "Record Length,Analog:600", "Sample Interval,Analog:5.000000e-04", "Vertical Units,CH1:V,CH2:V",
        "Vertical Scale,CH1:1.00,CH2:1.00", "Vertical Offset,CH1:0.00,CH2:0.00", "Horizontal Units,s",
        "Horizontal Scale,5.00E-02", "Model Number,SDS1204X-E", "Serial Number,SDSMMEBC4R0001",
        "Software Version,7.6.1.20", "Source,CH1,CH2", "Second,Volt,Volt",
    ]  # fmt: skip
    path.write_text("\n".join([*top, *volts()]) + "\n", "utf-8")


def tektronix(path: Path) -> None:
    top = [
        "Model,MSO44", "Label,,", "", "Waveform Type,ANALOG,", "Point Format,Y,", "Horizontal Units,s,",
        "Horizontal Scale,0.03,", "Horizontal Delay,0.0,", "Sample Interval,5e-04,", "Record Length,600,",
        "Gating,0.0% to 100.0%,", "Probe Attenuation,1,1", "Vertical Units,V,V", "Vertical Offset,0,0",
        "Vertical Scale,1,1", "Label,,", "TIME,CH1,CH2",
    ]  # fmt: skip
    path.write_text("\n".join([*top, *volts()]) + "\n", "utf-8")


def tektronix_old(path: Path) -> None:
    """Settings stand beside the first samples."""
    top = [
        ("Record Length", "6.0e+02"),
        ("Sample Interval", "5.0e-04"),
        ("Source", "CH1"),
        ("Vertical Units", "V"),
    ]
    beside = [f"{key},{value}" for key, value in top] + [","] * (COUNT - len(top))
    path.write_text(
        "\n".join(f"{one},,{row}" for one, row in zip(beside, volts(), strict=True)) + "\n", "utf-8"
    )


def rigol(path: Path) -> None:
    rows = [f"{at},{0.1 * b:.6e},{0.1 * s:.6e},," for at, (b, s) in enumerate(zip(BODY, SPOOL, strict=True))]
    top = ["X,CH1,CH2,Start,Increment,", "Sequence,Volt,Volt,-6.000000e-02,5.000000e-04"]
    path.write_text("\n".join([*top, *rows]) + "\n", "utf-8")


def rigol_new(path: Path) -> None:
    rows = [f"{0.1 * b:.6e},{0.1 * s:.6e},," for b, s in zip(BODY, SPOOL, strict=True)]
    path.write_text("\n".join(["CH1V,CH2V,t0 = -6.0e-02, tInc = 5.0e-04,", *rows]) + "\n", "utf-8")


def mat4(path: Path) -> None:
    savemat(path, {"t": TIME, "body_m_s2": BODY, "spool_m_s2": SPOOL}, format="4")


def mat5_structs(path: Path) -> None:
    both = np.zeros(2, dtype=[("data", object), ("name", object)])
    both[0], both[1] = (BODY, "body"), (SPOOL, "spool")
    savemat(path, {"rec": both, "fs": RATE})


def mat5_cells(path: Path) -> None:
    both = np.empty(3, dtype=object)
    both[:] = [TIME, BODY, SPOOL]
    savemat(path, {"channels": both})


def timetable(version: str) -> Callable[[Path], None]:
    """Return what writes a timetable of MATLAB."""

    def write(path: Path) -> None:
        matio = pytest.importorskip("matio")
        pandas = pytest.importorskip("pandas")
        index = pandas.to_timedelta(np.round(TIME * 1e9).astype(np.int64), unit="ns")
        frame = pandas.DataFrame({"body": BODY, "spool": SPOOL}, index=index)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matio.save_to_mat(str(path), {"TT": frame}, version=version)

    return write


def hdf5_compound(path: Path) -> None:
    table = np.zeros(COUNT, dtype=[("time", "f8"), ("body", "f8"), ("spool", "f4"), ("tag", "S4")])
    table["time"], table["body"], table["spool"] = TIME, BODY / GRAVITY, SPOOL / GRAVITY
    with h5py.File(path, "w") as file:
        entry = file.create_dataset("log/table", data=table)
        entry.attrs["units"] = ["s", "g", "g", ""]


def typed_parquet(path: Path) -> None:
    """Durations, decimals and single precision."""
    spans = pa.array(np.round(TIME * 1e9).astype("timedelta64[ns]"))
    exact = pa.array([Decimal(f"{value:.4f}") for value in BODY])
    pa_parquet.write_table(
        pa.table({"time": spans, "body_m_s2": exact, "spool_m_s2": SPOOL.astype(np.float32)}), path
    )


def gz(path: Path) -> None:
    path.write_bytes(gzip.compress(("time_s,body_m_s2,spool_m_s2\n" + rows()).encode()))


def feather(path: Path) -> None:
    pa_feather.write_feather(arrow_table(), path)


def npz(path: Path) -> None:
    np.savez_compressed(path, t=TIME, body_m_s2=BODY, spool_m_s2=SPOOL)


def npy(path: Path) -> None:
    np.save(path, np.column_stack([TIME, BODY, SPOOL]))


def quoted(path: Path) -> None:
    pa_csv.write_csv(pa.table({"time (s)": TIME, "body (m/s^2)": BODY, "spool (m/s^2)": SPOOL}), path)


def parquet(path: Path) -> None:
    pa_parquet.write_table(arrow_table(), path)


def bare_parquet(path: Path) -> None:
    pa_parquet.write_table(arrow_table(units=False), path)
