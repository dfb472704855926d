"""What a refusal of `import` tells people to type works as it stands, until the record is read."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat, wavfile
from spool_bag.information import describe
from spool_tools.cli import main

RATE, COUNT = 2000.0, 400
TIME = np.arange(COUNT) / RATE
BODY = np.random.default_rng(1).normal(0.0, 2.0, COUNT).round(3)
SPOOL = np.random.default_rng(2).normal(0.0, 2.0, COUNT).round(3)
OPTION = re.compile(r"--(?:columns|exclude|unit|scale|rate|topic) (?:'[^']*'|\S+)")

Maker = Callable[[Path], None]


def text(
    header: str, *, time: bool = True, scale: float = 1.0, more: str = "", encoding: str = "utf-8"
) -> Maker:
    """Return what writes a CSV file; ``more`` stands at each line's end."""

    def write(path: Path) -> None:
        pairs = zip(TIME, scale * BODY, scale * SPOOL, strict=True)
        rows = [
            ",".join([*([f"{t:.4f}"] if time else []), f"{b:.3f}", f"{s:.3f}"]) + more for t, b, s in pairs
        ]
        lines = ([header] if header else []) + rows
        path.write_bytes(("\n".join(lines) + "\n").encode(encoding))

    return write


def bad_oil(path: Path) -> None:
    text("time [s],body [g],spool [g],oil [degC]", more=",45.0")(path)
    path.write_text(path.read_text("utf-8").replace(",45.0\n", ",too hot\n", 9), "utf-8")


def two_sheets_of_time(path: Path) -> None:
    rows = [f"{t:.4f},{b},{t + 1:.4f},{s}" for t, b, s in zip(TIME, BODY, SPOOL, strict=True)]
    path.write_text("\n".join(["t [s],body [g],t [s],spool [g]", *rows]) + "\n", "utf-8")


def bag(*topics: str) -> Maker:
    """Return what writes topics of sensor_msgs/Imu."""

    def write(path: Path) -> None:
        store = get_typestore(Stores.ROS2_JAZZY)
        types, kind = store.types, "sensor_msgs/msg/Imu"
        vector, none = types["geometry_msgs/msg/Vector3"], np.zeros(9)
        turned = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic, row in zip(topics, (BODY, SPOOL), strict=False):
                channel = writer.add_connection(topic, kind, typestore=store)
                for at, value in enumerate(row):
                    stamp = 1_700_000_000_000_000_000 + round(at * 1e9 / RATE)
                    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
                    header = types["std_msgs/msg/Header"](stamp=time, frame_id="")
                    moved = vector(x=float(SPOOL[at]), y=0.0, z=float(value))
                    message = types[kind](
                        header, turned, none, vector(x=0.0, y=0.0, z=0.0), none, moved, none
                    )
                    writer.write(channel, stamp, store.serialize_cdr(message, kind))

    return write


def wav(path: Path) -> None:
    wavfile.write(path, int(RATE), (np.column_stack([BODY, SPOOL]) / 20.0).astype(np.float32))


def tdms(path: Path) -> None:
    with TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                ChannelObject("Press, left", name, row, {"unit_string": "g", "wf_increment": 1.0 / RATE})
                for name, row in (("a=1", BODY), ("a,2", SPOOL))
            ]
        )


def mat(path: Path) -> None:
    savemat(path, {"X118_DE_time": BODY, "X118_FE_time": SPOOL})


CASES: list[tuple[str, Maker, tuple[str, ...]]] = [
    ("no_units.csv", text("time [s],body,spool"), ()),
    ("one_unit.csv", text("time [s],body [g],spool"), ()),
    ("unknown_unit.csv", text("time [s],body [grunt],spool [grunt]"), ()),
    ("two_unknown.csv", text("time [s],body [xx],spool [yy]"), ()),
    ("level.csv", text("time [s],body [g pk],spool [g RMS]"), ()),
    ("velocity.csv", text("time [s],body [mm/s],spool [mm/s]"), ()),
    ("named_velocity.csv", text("time [s],b [mm/s],s [mm/s]"), ("--columns", "body=b [mm/s],spool=s")),
    ("over.csv", text("time [s],body (a/g),spool (a/g)"), ()),
    ("volts.csv", text("time [s],body [mV],spool [V]"), ()),
    ("counts.csv", text("time [s],body [LSB],spool [LSB]"), ()),
    ("current.csv", text("time [s],body [mA],spool [mA]"), ()),
    ("charge.csv", text("time [s],body [pC],spool [pC]"), ()),
    ("wrong_scale.csv", text("time [s],body [g],spool [g]"), ("--scale", "body=100mV/g,spool=100mV/g")),
    ("unknown_scale.csv", text("time [s],body [zz],spool [zz]"), ("--scale", "body=100mV/g,spool=100mV/g")),
    ("names.csv", text("time [s],a [g],b [g]"), ()),
    ("odd_names.csv", text('time [s],"a=1, left","b$(x), ""right"""'), ()),
    ("blank_names.csv", text("time [s],Acc 1 (m/s²),Acc 2 (m/s²)"), ()),
    ("same_names.csv", text("time [s],acc [g],acc [g]"), ()),
    ("same_body.csv", text("time [s],body [g],body [g]"), ()),
    ("same_named.csv", text("time [s],acc [g],acc [g]"), ("--columns", "body=acc [g],spool=#2")),
    ("several.csv", text("time [s],body 1 [g],body 2 [g],spool [g]", more=",1.5"), ()),
    ("no_header.csv", text(""), ()),
    ("by_number.csv", text("time [s],a [g],b [g]"), ("--columns", "body=1,spool=#2")),
    ("no_time.csv", text("body [g],spool [g]", time=False), ()),
    ("no_time_no_unit.csv", text("a,b", time=False), ()),
    ("bad_oil.csv", bad_oil, ()),
    ("hot_oil.csv", text("time [s],body [g],spool [g],oil [bar]", more=",45.0"), ("--columns", "oil=#3")),
    ("gbk.csv", text("时间 [s],阀体 [重力],阀芯 [重力]", encoding="gbk"), ()),
    ("times.csv", two_sheets_of_time, ()),
    ("bare.wav", wav, ()),
    ("odd.tdms", tdms, ()),
    ("cwru.mat", mat, ("--rate", "2000")),
    ("two_topics", bag("/imu_1", "/imu_2"), ()),
    ("one_topic", bag("/imu"), ()),
]  # fmt: skip


def imported(folder: Path, words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the refusal of an import, "" where there is none; its bag must then hold the samples."""
    out = folder / f"bag_{len(list(folder.iterdir()))}"
    code = main(["import", *words, "--out", str(out)])
    said = capsys.readouterr().err
    if code == 0:
        assert describe(out).valves[0].samples >= COUNT - 1
        return ""
    assert code == 2, said
    assert said.count("\n") == 1
    return said


@pytest.mark.parametrize(("name", "maker", "given"), CASES, ids=[one[0] for one in CASES])
def test_each_advice_can_be_typed_until_the_record_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, maker: Maker, given: tuple[str, ...]
) -> None:
    (tmp_path / "files").mkdir()
    path = tmp_path / "files" / name
    maker(path)
    start = [str(path), *given]
    open_ways = [start]
    tried = 0
    while open_ways:
        words = open_ways.pop()
        said = imported(tmp_path, words, capsys)
        if not said:
            continue
        tried += 1
        ways = [shlex.split(found.rstrip(",.;:\n")) for found in OPTION.findall(said.rpartition(name)[2])]
        assert ways, f"no advice in: {said}"
        assert len(words) < len(start) + 10, f"no end of refusals: {said}"
        open_ways += [[*words, *way] for way in ways]
    assert tried > 0, "it was not refused"
