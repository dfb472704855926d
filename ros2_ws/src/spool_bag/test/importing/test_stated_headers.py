"""Formats with their own headers: each attribute is applied, refused, or named; random files of each.

``SPOOL_DRAWN`` sets how many files are drawn.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyuff
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import read_record
from spool_core.errors import InputError

from . import loggers as made
from .test_stated import DRAWN, outcome

RATE, COUNT = made.RATE, made.COUNT
G = made.GRAVITY
UNITS = {"g": G, "m/s^2": 1.0, "mm/s^2": 1e-3, "mV": 1.0, "foo": 1.0}
TEXTS = st.text("abcdefgh", min_size=3, max_size=12)


@dataclass
class Case:
    """A file with one attribute drawn: what may be named instead, and whether it must be.

    ``rate``: the stated one. ``how``: options of the import.
    """

    named: str = "\0"
    must: bool = False
    rate: float = RATE
    how: dict[str, Any] = field(default_factory=dict)


Maker = Callable[[Path, Callable[[st.SearchStrategy[Any]], Any]], Case]
SCALE = {"columns": "body=0,spool=1", "scale": "body=5g/FS,spool=5g/FS"}


def wav(path: Path, draw: Callable[[st.SearchStrategy[Any]], Any]) -> Case:
    share = np.column_stack([made.BODY, made.SPOOL]) / (5.0 * G)
    bits, rate, chunks, size, fact = 32, int(RATE), b"", COUNT, COUNT
    change = draw(st.sampled_from(["bits", "rate", "note", "size", "fact"]))
    case = Case(how=SCALE)
    if change == "bits":
        bits = draw(st.sampled_from([16, 24, 32]))
    elif change == "rate":
        rate = draw(st.sampled_from([500, 1000, 2500, 51_200]))
        case.rate = rate
    elif change == "note":
        text = draw(TEXTS)
        kind = draw(st.sampled_from([b"LIST", b"bext", b"iXML", b"smpl", b"note"]))
        held = (b"INFOICMT" + struct.pack("<I", len(text)) if kind == b"LIST" else b"") + text.encode()
        chunks = kind + struct.pack("<I", len(held)) + held + b"\0" * (len(held) % 2)
        case.named, case.must = text, True
    elif change == "size":
        size = draw(st.integers(COUNT + 1, 2 * COUNT))
        case.named, case.must = f"of {size}", True
    else:
        fact = draw(st.integers(COUNT + 1, 2 * COUNT))
        case.named, case.must = f"states {fact} samples", True
    whole = np.clip(np.rint(share * 2.0 ** (bits - 1)), -(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1)
    data = whole.astype("<i4").tobytes()
    if bits < 32:
        data = np.frombuffer(data, np.uint8).reshape(-1, 4)[:, : bits // 8].tobytes()
    frame = bits // 4
    form = struct.pack("<HHIIHH", 1, 2, rate, rate * frame, frame, bits)
    inside = b"WAVEfmt " + struct.pack("<I", 16) + form + b"fact" + struct.pack("<II", 4, fact) + chunks
    inside += b"data" + struct.pack("<I", size * frame) + data
    path.write_bytes(b"RIFF" + struct.pack("<I", len(inside)) + inside)
    return case


def lvm(path: Path, draw: Callable[[st.SearchStrategy[Any]], Any]) -> Case:
    step, unit, counts, begins = [1 / RATE] * 2, ["m/s^2"] * 2, [COUNT] * 2, [0.0, 0.0]
    clocks, dimension, note, body, spool = [1.5, 1.5], ["Time"] * 2, "", made.BODY, made.SPOOL
    change = draw(
        st.sampled_from(["step", "unit", "count", "begin", "clock", "dimension", "note", "decimal"])
    )
    case, mark = Case(), ","
    if change == "step":
        case.rate = draw(st.sampled_from([400.0, 1250.0, 5000.0]))
        step = [1.0 / case.rate] * 2
    elif change == "unit":
        unit[0] = draw(st.sampled_from(sorted(UNITS)))
        body = body / UNITS[unit[0]]
        case.named = unit[0]
    elif change == "count":
        counts = [draw(st.integers(COUNT - 300, COUNT + 300).filter(lambda one: one != COUNT))] * 2
        case.named, case.must = f"{counts[0]}", True
    elif change in ("begin", "clock"):
        late = draw(st.integers(20, 200))
        body, spool, counts = body[:-late], spool[late:], [COUNT - late] * 2
        (begins if change == "begin" else clocks)[1] += late / RATE
    elif change == "dimension":
        dimension = [draw(st.sampled_from(["Frequency", "Angle", "Distance"]))] * 2
        case.named, case.must = dimension[0], True
    elif change == "note":
        key = draw(st.sampled_from(["Operator", "Sensitivity", "Filter", "Test_Name"]))
        note, case.named, case.must = f"{key}\t{draw(TEXTS)}\n", key, True
    else:
        mark = draw(st.sampled_from([".", ","]))
    above = draw(st.booleans())  # a note of the file, or of the segment

    def line(key: str, values: list[Any]) -> str:
        return f"{key}\t" + "\t".join(str(one) for one in values) + "\t\n"

    top = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t{mark}\nMulti_Headings\tYes\nX_Columns\tNo\nTime_Pref\tAbsolute\n"
        f"{note if above else ''}Date\t2026/05/04\nTime\t03:02:01,5\n***End_of_Header***\t\n\t\n"
        + line("Channels", [2]) + line("Samples", counts) + line("Date", ["2026/05/04"] * 2)
        + line("Time", [f"03:02:{one:09.6f}".replace(".", ",") for one in clocks])
        + line("Y_Unit_Label", unit) + line("X_Dimension", dimension)
        + line("X0", [f"{one:.9f}".replace(".", ",") for one in begins])
        + line("Delta_X", [f"{one:.9f}".replace(".", ",") for one in step])
        + ("" if above else note) + "***End_of_Header***\t\nX_Value\tbody\tspool\tComment\n"
    )  # fmt: skip
    rows = zip(body, spool, strict=True)
    path.write_text(top + "".join(f"\t{b:.9f}\t{s:.9f}\n".replace(".", ",") for b, s in rows), "utf-8")
    return case


_UFF_NUMBERS: dict[str, tuple[str, list[float], str]] = {
    "kind": ("ordinate_spec_data_type", [8, 11, 13, 15], "kind of data"),
    "direction": ("rsp_dir", [-3, 1, 2, -1], "rsp_dir"),
    "function": ("func_type", [2, 3, 4, 6, 9], "of function type"),
    "amplitude": ("z_axis_value", [1.5, 2e3], "z_axis_value"),
}


def uff(path: Path, draw: Callable[[st.SearchStrategy[Any]], Any]) -> Case:
    sets = {"body": {"data": made.BODY, "x": made.TIME}, "spool": {"data": made.SPOOL, "x": made.TIME}}  # type: dict[str, dict[str, Any]]
    every: dict[str, Any] = {"ordinate_axis_units_lab": "m/s^2", "abscissa_axis_units_lab": "s"}
    case, spool = Case(), sets["spool"]
    changes = ["rate", "abscissa", "begin", "unit", "note", "units", *_UFF_NUMBERS]
    change = draw(st.sampled_from(changes))
    if change == "rate":
        case.rate = draw(st.sampled_from([400.0, 1250.0, 5000.0]))
        for one in sets.values():
            one["x"] = np.arange(COUNT) / case.rate
    elif change == "abscissa":
        label, size = draw(st.sampled_from([("ms", 1e-3), ("us", 1e-6), ("rev", 1.0), ("mm", 1.0)]))
        every["abscissa_axis_units_lab"] = label
        for one in sets.values():
            one["x"] = made.TIME / size
        case.named = label
    elif change == "begin":
        late = draw(st.integers(20, 200))
        sets["body"] = {"data": made.BODY[:-late], "x": made.TIME[:-late]}
        sets["spool"] = {"data": made.SPOOL[late:], "x": made.TIME[late:]}
    elif change == "unit":
        unit = draw(st.sampled_from(sorted(UNITS)))
        spool |= {"data": made.SPOOL / UNITS[unit], "ordinate_axis_units_lab": unit}
        case.named = unit
    elif change in _UFF_NUMBERS:
        key, numbers, case.named = _UFF_NUMBERS[change]
        spool[key], case.must = draw(st.sampled_from(numbers)), True
    elif change == "note":
        case.named, case.must = draw(TEXTS), True
        spool[draw(st.sampled_from(["id2", "id3", "id4", "id5", "ordinate_axis_lab"]))] = case.named
    file = pyuff.UFF(str(path))
    if change == "units":
        case.named, case.must = "dataset 164", True
        units = {"type": 164, "units_code": draw(st.sampled_from([2, 5, 9])), "units_description": "other"}
        units |= {"length": 3.28, "force": 0.22, "temp": 1.8, "temp_offset": 459.67, "temp_mode": 1}
        file.write_sets(units, mode="overwrite")
    for at, (name, own) in enumerate(sets.items()):
        told = {"type": 58, "binary": 0, "func_type": 1, "id1": name, "rsp_node": at + 1, "rsp_dir": 3}
        told |= {"ref_node": 0, "ref_dir": 0, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0}
        told |= {"abscissa_spacing": 1, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 12}
        file.write_sets(told | every | own, mode="add" if at or change == "units" else "overwrite")
    return case


def mf4(path: Path, draw: Callable[[st.SearchStrategy[Any]], Any]) -> Case:
    from asammdf import MDF, Signal  # noqa: PLC0415 - slow to load

    body: dict[str, Any] = {"samples": made.BODY, "timestamps": made.TIME, "unit": "m/s^2"}
    spool: dict[str, Any] = {"samples": made.SPOOL, "timestamps": made.TIME, "unit": "m/s^2"}
    case, comment, group = Case(), "", {}
    change = draw(
        st.sampled_from(["conversion", "unit", "comment", "file", "group", "begin", "rate", "master"])
    )
    if change == "conversion":
        size, offset = draw(st.sampled_from([1e-3, 1e-4])), draw(st.floats(-5.0, 5.0))
        spool["samples"] = np.rint((made.SPOOL - offset) / size).astype(np.int32)
        spool["conversion"] = {"a": size, "b": offset}
    elif change == "unit":
        unit = draw(st.sampled_from(sorted(UNITS)))
        spool |= {"samples": made.SPOOL / UNITS[unit], "unit": unit}
        case.named = unit
    elif change in ("comment", "file", "group"):
        case.named, case.must = draw(TEXTS), True
        if change == "comment":
            spool["comment"] = case.named
        elif change == "file":
            comment = case.named
        else:
            group = {"comment": case.named}
    elif change == "begin":
        late = draw(st.integers(20, 200))
        body |= {"samples": made.BODY[:-late], "timestamps": made.TIME[:-late]}
        spool |= {"samples": made.SPOOL[late:], "timestamps": made.TIME[late:]}
    elif change == "rate":
        case.rate = draw(st.sampled_from([400.0, 1250.0, 5000.0]))
        body["timestamps"] = spool["timestamps"] = np.arange(COUNT) / case.rate
    else:
        kind = draw(st.sampled_from([2, 3, 4]))
        for one in (body, spool):
            one["master_metadata"] = ("crank", kind)
        case.named, case.must = "crank", True
    with MDF() as file:
        file.header.start_time = made.START
        if comment:
            file.header.comment = comment
        signals = [Signal(name="body", **body), Signal(name="spool", **spool)]
        for one in [signals] if change != "begin" else [signals[:1], signals[1:]]:
            file.append(one, **group)
        file.save(path, overwrite=True)
    return case


def bag(path: Path, draw: Callable[[st.SearchStrategy[Any]], Any]) -> Case:
    store = get_typestore(Stores.ROS2_JAZZY)
    types, kind = store.types, "sensor_msgs/msg/Imu"
    case = Case(how={"topic": "body=/imu_1:z,spool=/imu_2:z"})
    late, unit, gravity, covariance, turn, counted = 0, 1.0, 0.0, 0.0, 0, 0
    change = draw(
        st.sampled_from(["rate", "begin", "unit", "covariance", "frame", "counted", "array", "labels"])
    )
    if change == "rate":
        case.rate = draw(st.sampled_from([400.0, 1250.0, 5000.0]))
    elif change == "begin":
        late = draw(st.integers(20, 200))
    elif change == "unit":
        unit, gravity = draw(st.sampled_from([(G, 1.0), (1e-3 * G, 1000.0), (1e-3, 9806.65)]))
    elif change == "covariance":
        covariance = draw(st.sampled_from([-1.0, 0.01]))
    elif change == "frame":
        turn, case.must = draw(st.integers(1, COUNT - 1)), True
    elif change == "counted":
        counted = draw(st.integers(COUNT + 1, 2 * COUNT))
        case.named, case.must = f"states {counted} messages", True
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        if change in ("array", "labels"):
            kind = "std_msgs/msg/Float64MultiArray"
            offset = draw(st.integers(1, 3)) if change == "array" else 0
            label = draw(TEXTS) if change == "labels" else ""
            case.how = {"topic": "body=/daq:0,spool=/daq:1", "unit": "body=m/s^2,spool=m/s^2"}
            case.named, case.must = label or "data_offset", bool(label)
            channel = writer.add_connection("/daq", kind, typestore=store)
            for at, pair in enumerate(np.column_stack([made.BODY, made.SPOOL])):
                dims = [types["std_msgs/msg/MultiArrayDimension"](label=label, size=2, stride=2)] * bool(
                    label
                )
                layout = types["std_msgs/msg/MultiArrayLayout"](dim=dims, data_offset=offset)
                held = types[kind](layout=layout, data=np.concatenate([np.full(offset, 3.0), pair]))
                stamp = round((made.START.timestamp() + at / RATE) * 1e9)
                writer.write(channel, stamp, store.serialize_cdr(held, kind))
            return case
        for topic, row, first in (("/imu_1", made.BODY, 0), ("/imu_2", made.SPOOL, late)):
            channel = writer.add_connection(topic, kind, typestore=store)
            for at in range(first, COUNT if first or not late else COUNT - late):
                message: Any = made.imu(store, at, row[at] / unit)
                stamp = round((made.START.timestamp() + at / case.rate) * 1e9)
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
                message.header.frame_id = "other" if turn and at >= turn else "imu"
                message.linear_acceleration.x = gravity
                message.linear_acceleration_covariance[0] = covariance
                writer.write(channel, stamp, store.serialize_cdr(message, kind))
    if counted:
        told = path / "metadata.yaml"
        told.write_text(
            told.read_text("utf-8").replace(f"message_count: {COUNT}", f"message_count: {counted}"), "utf-8"
        )
    return case


FORMATS: dict[str, Maker] = {"x.wav": wav, "x.lvm": lvm, "x.uff": uff, "x.mf4": mf4, "bag": bag}


@settings(max_examples=DRAWN, deadline=None)
@given(name=st.sampled_from(sorted(FORMATS)), data=st.data())
def test_one_changed_attribute_of_a_header_is_read_right_refused_or_named(
    name: str, data: st.DataObject
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        case = FORMATS[name](path, data.draw)
        try:
            found = read_record(path, how=choices(**case.how))
        except InputError:
            return
    named, right = outcome(found, case.named, case.rate)
    assert named or (right and not case.must), (name, case, found.notes, found.warnings)
