"""Bags of other tools: every message is read whatever index and metadata say, or the bag is refused."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from spool_bag.importing.choices import choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_bag.metadata import in_order
from spool_bag.reader import BagReader
from spool_bag.verification import verify
from spool_core.errors import InputError

from . import loggers as made

STORE = get_typestore(Stores.ROS2_JAZZY)
KIND = "sensor_msgs/msg/Imu"
TEXT, _ = STORE.generate_msgdef(KIND, ros_version=2)
BEGIN = round(made.START.timestamp() * 1e9)


def read(path: Path, **how: object) -> LoggerRecord:
    return read_record(path, how=choices(topic="body=/imu_1:z,spool=/imu_2:z", **how))  # type: ignore[arg-type]


def whole(path: Path) -> None:
    """Check that every message of both topics is read."""
    found = read(path)
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY, atol=1e-6)
    np.testing.assert_allclose(found.columns["spool_m_s2"], made.SPOOL, atol=1e-6)
    assert found.gaps.size == 0


def imu(at: int, value: float, *, frame: str = "imu", covariance: float = 0.0, gravity: float = 0.0) -> bytes:
    message = made.imu(STORE, at, value)
    message.header.frame_id = frame
    message.linear_acceleration.x = gravity
    message.linear_acceleration_covariance[0] = covariance
    return bytes(STORE.serialize_cdr(message, KIND))


def mcap(
    path: Path,
    *,
    index: IndexType = IndexType.ALL,
    later: IndexType | None = None,
    profile: str = "ros2",
    text: str = TEXT,
    statistics: bool = True,
    beside: str = "",
    rows: range = range(made.COUNT),
    qos: str = "reliable",
    of: Callable[[int, float], bytes] = imu,
) -> None:
    """Write two topics; ``later``: index of the second half, ``beside``: encoding of another topic."""
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            index_types=index,
            compression=CompressionType.ZSTD,
            use_statistics=statistics,
            chunk_size=1 << 13,
        )
        writer.start(profile=profile, library="test")
        kind = writer.register_schema(KIND, "ros2msg" if text else "", text.encode())
        channels = [
            writer.register_channel(topic, "cdr", kind, {"offered_qos_profiles": f"- reliability: {qos}"})
            for topic in ("/imu_1", "/imu_2")
        ]
        if beside:
            other = writer.register_channel("/press", beside, writer.register_schema("press", beside, b"{}"))
            writer.add_message(other, BEGIN, b"{}", BEGIN)
        name = next(one for one in vars(writer) if one.endswith("index_types"))
        for at in rows:
            if later is not None and at == made.COUNT // 2:
                setattr(writer, name, later)
            stamp = BEGIN + round(at * 1e9 / made.RATE)
            for channel, row in zip(channels, (made.BODY, made.SPOOL), strict=True):
                writer.add_message(channel, stamp, of(at, float(row[at])), stamp, at)
        writer.finish()


@pytest.mark.parametrize(
    "how",
    [
        {"index": IndexType.CHUNK},
        {"index": IndexType.CHUNK, "statistics": False},
        {"later": IndexType.CHUNK},
        {"profile": ""},
        {"text": ""},
        {"beside": "json"},
    ],
    ids=["no_message_index", "no_statistics", "partly_indexed", "no_profile", "no_definition", "json_topic"],
)
def test_a_file_is_read_as_a_whole_whatever_index_and_other_topics_it_has(
    tmp_path: Path, how: dict[str, object]
) -> None:
    mcap(tmp_path / "one.mcap", **how)  # type: ignore[arg-type]
    whole(tmp_path / "one.mcap")


@pytest.mark.parametrize(
    "names", [("rec_0", "rec_1"), ("0_rec_2026_05_04-10_00_59", "1_rec_2026_05_04-10_01_00")]
)
@pytest.mark.parametrize("listed", [0, 1, 2])
def test_parts_are_read_whatever_their_quality_of_service_and_metadata(
    tmp_path: Path, names: tuple[str, str], listed: int
) -> None:
    half = made.COUNT // 2
    for name, rows, qos in zip(
        names, (range(half), range(half, made.COUNT)), ("reliable", "best_effort"), strict=True
    ):
        mcap(tmp_path / f"{name}.mcap", rows=rows, qos=qos)
    if listed:
        files = "".join(f"\n  - {name}.mcap" for name in names[:listed])
        counts = "".join(
            f"\n  - topic_metadata: {{name: {topic}, type: {KIND}}}\n    message_count: 0"
            for topic in ("/imu_1", "/imu_2")
        )
        (tmp_path / "metadata.yaml").write_text(
            "rosbag2_bagfile_information:\n  version: 99\n  storage_identifier: mcap\n  message_count: 0\n"
            f"  relative_file_paths:{files}\n  topics_with_message_count:{counts}\n",
            "utf-8",
        )
    whole(tmp_path)
    assert {name: topic.messages for name, topic in BagReader(tmp_path).topics.items()} == dict.fromkeys(
        ("/imu_1", "/imu_2"), made.COUNT
    )


def test_parts_named_as_by_lyrical_are_ordered_by_number_and_none_counts_as_removed(tmp_path: Path) -> None:
    names = [f"{at}_rec_2026_05_04-10_00_{59 - at:02d}.mcap" for at in range(12)]
    assert in_order(sorted(names)) == names
    for name in names[:3]:
        mcap(tmp_path / name, rows=range(9))
    assert not [text for text in verify(tmp_path).wrong if "removed" in text]


def test_missing_parts_are_named(tmp_path: Path) -> None:
    made.imu_bag(StoragePlugin.MCAP)(tmp_path / "bag")
    told = tmp_path / "bag" / "metadata.yaml"
    text = told.read_text("utf-8").replace("  - bag.mcap", "  - bag.mcap\n  - bag_1.mcap")
    told.write_text(
        text.replace(f"message_count: {made.COUNT}", f"message_count: {made.COUNT + 50}"), "utf-8"
    )
    said = read(tmp_path / "bag").warnings
    assert any("bag_1.mcap is missing" in one for one in said)
    assert any(
        f"/imu_1: the file states {made.COUNT + 50} messages, and {made.COUNT} are read" in one
        for one in said
    )


@pytest.mark.parametrize("folder", ["press #4", "50% open", "a?b", "20%20 open"])
def test_the_path_of_a_bag_in_sqlite_may_hold_any_character(tmp_path: Path, folder: str) -> None:
    made.imu_bag(StoragePlugin.SQLITE3)(tmp_path / "bag")
    shutil.move(tmp_path / "bag", tmp_path / folder)
    (tmp_path / folder / "metadata.yaml").unlink()
    whole(tmp_path / folder)


def test_messages_that_a_recorder_had_not_moved_into_its_database_are_read(tmp_path: Path) -> None:
    made.imu_bag(StoragePlugin.SQLITE3)(tmp_path / "bag")
    file = next((tmp_path / "bag").glob("*.db3"))
    base = sqlite3.connect(file)
    base.execute("PRAGMA journal_mode=WAL")
    last = base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id DESC LIMIT 1").fetchone()
    base.execute("DELETE FROM messages WHERE id = (SELECT max(id) FROM messages)")
    base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", last)
    base.commit()
    assert file.with_name(f"{file.name}-wal").stat().st_size > 0
    whole(tmp_path / "bag")
    base.close()


@pytest.mark.parametrize(
    ("of", "why"),
    [
        (lambda at, value: imu(at, value, covariance=-1.0), "contain no acceleration"),
        (lambda at, value: imu(at, value, frame=f"imu_{at % 2}"), "several publishers wrote this topic"),
        (lambda at, value: imu(at // 2, value), "several publishers on one topic"),
        (lambda at, value: imu(at, value / 9.80665, gravity=1.0), "show .* as gravity.*type --unit body=g"),
        (lambda at, _: b"\0\1\0\0" + bytes(at % 7), "none of its .* messages is a sensor_msgs/msg/Imu"),
    ],
    ids=["gyroscope", "two_frames", "two_drivers", "in_g", "other_bytes"],
)
def test_a_topic_that_is_not_the_acceleration_of_one_sensor_in_its_unit_is_refused(
    tmp_path: Path, of: Callable[[int, float], bytes], why: str
) -> None:
    rows = np.random.default_rng(1).normal(0.0, 1.0, made.COUNT)
    level = 9.0 * (np.arange(made.COUNT) % 2) if why.startswith("several publishers on") else 0.0
    mcap(tmp_path / "one.mcap", of=lambda at, _: of(at, float((rows + level)[at])))
    with pytest.raises(InputError, match=why):
        read(tmp_path / "one.mcap")


def test_a_unit_that_is_typed_stands_over_what_gravity_shows(tmp_path: Path) -> None:
    mcap(tmp_path / "one.mcap", of=lambda at, value: imu(at, value / 9.80665, gravity=1.0))
    found = read(tmp_path / "one.mcap", unit="body=g,spool=g")
    np.testing.assert_allclose(found.columns["body_m_s2"], made.BODY, atol=1e-6)
