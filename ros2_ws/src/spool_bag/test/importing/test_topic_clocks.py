"""Bags of two sensors' topics: which time counts, clocks that were set, compressed files."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from spool_bag.importing.bag_import import ImportResult, import_record
from spool_bag.importing.choices import choices
from spool_bag.importing.two_clocks import TopicTimes, check_one_time
from spool_bag.reader import BagReader
from spool_core.errors import InputError

STORE = get_typestore(Stores.ROS2_JAZZY)
IMU, VECTOR = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3Stamped"
START, RATE, SECONDS = 1_790_000_000_000_000_000, 500.0, 6.0
STEP = 2_000_000
COUNT = round(SECONDS * RATE)
LOG = START + STEP * np.arange(COUNT)
Stamps = np.ndarray
TOPICS = {"topic": "body=/imu_1:z,spool=/imu_2:z"}


def wave(times: np.ndarray) -> np.ndarray:
    return 5.0 * np.sin(2.0 * math.pi * 15.0 * times) + 4.0 * np.sin(2.0 * math.pi * 6.1 * times + 1.0)


def message(kind: str, stamp: int, value: float) -> Any:
    types = STORE.types
    time = types["builtin_interfaces/msg/Time"](int(stamp // 10**9), int(stamp % 10**9))
    header = types["std_msgs/msg/Header"](time, "imu")
    vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, float(value))
    if kind == VECTOR:
        return types[VECTOR](header, vector)
    none, zeros = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), np.zeros(9)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return types[IMU](header, turn, zeros, none, zeros, vector, zeros)


def write(
    path: Path,
    body: Stamps = LOG,
    spool: Stamps = LOG,
    *,
    kind: str = IMU,
    plugin: StoragePlugin = StoragePlugin.MCAP,
    compressed: CompressionMode = CompressionMode.NONE,
    order: np.ndarray | None = None,
) -> Path:
    """Write a bag of two topics with the given header stamps (ns); both sensors measure the same."""
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compressed is not CompressionMode.NONE:
        writer.set_compression(compressed, CompressionFormat.ZSTD)
    values = wave(1e-9 * (LOG - START))
    with writer:
        topics = [writer.add_connection(f"/imu_{n}", kind, typestore=STORE) for n in (1, 2)]
        for place, at in enumerate(np.arange(COUNT) if order is None else order):
            for number, stamps in enumerate((body, spool)):
                data = STORE.serialize_cdr(message(kind, int(stamps[at]), values[at]), kind)
                writer.write(topics[number], int(LOG[place]) + 20_000 * number, data)
    return path


def imported(
    path: Path, stamps: str | None = None, **how: Any
) -> tuple[ImportResult, np.ndarray, np.ndarray]:
    """Return the result of an import, and the samples of body and spool in its bag."""
    out = path.with_name(f"{path.name}_imported")
    result = import_record(path, out, how=choices(**(TOPICS | how), stamps=stamps))
    blocks = list(BagReader(out).blocks("valve_1"))
    return result, *(np.concatenate([getattr(one, name) for one in blocks]) for name in ("body", "spool"))


def check_right(path: Path, stamps: str | None = None, **how: Any) -> ImportResult:
    """Check that body and spool belong together and have the right rate."""
    result, body, spool = imported(path, stamps, **how)
    assert 1.0 / result.period == pytest.approx(RATE, rel=1e-5)
    assert result.lost_blocks == 0
    assert result.samples >= COUNT - 40
    np.testing.assert_allclose(body[50:-50], spool[50:-50], atol=0.02)
    return result


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("kind", [IMU, VECTOR])
def test_topics_of_any_storage_and_vector_type(tmp_path: Path, kind: str, plugin: StoragePlugin) -> None:
    check_right(write(tmp_path / "bag", kind=kind, plugin=plugin))


@pytest.mark.parametrize(
    "by", [-300_000_000, -4_000_000, 4_000_000, 400_000, -400_000, 300_000_000, 3_000_000]
)
def test_a_topic_whose_clock_was_set_is_refused_and_the_recorder_s_time_reads_it(
    tmp_path: Path, by: int
) -> None:
    bag = write(tmp_path / "bag", body=LOG + np.where(np.arange(COUNT) > COUNT // 2, by, 0))
    with pytest.raises(InputError, match="--stamps log") as refused:
        imported(bag)
    if by > 0 or by == -400_000:
        assert f"was set by {abs(by) / 1e6:.3g} ms at about 3" in str(refused.value)
    check_right(bag, "log")


def test_lost_messages_of_one_topic_are_a_gap_and_no_step(tmp_path: Path) -> None:
    bag, kept = tmp_path / "bag", np.delete(np.arange(COUNT), [1600, 1601, 1602])
    values = wave(1e-9 * (LOG - START))
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = [writer.add_connection(f"/imu_{n}", IMU, typestore=STORE) for n in (1, 2)]
        for at in range(COUNT):
            for number, topic in enumerate(topics):
                if number or at in kept:
                    data = STORE.serialize_cdr(message(IMU, int(LOG[at]), values[at]), IMU)
                    writer.write(topic, int(LOG[at]), data)
    result, body, spool = imported(bag)
    assert result.lost_blocks > 0
    np.testing.assert_allclose(body, spool, atol=1e-6)


def test_stamps_that_are_zero_need_the_flag_that_the_refusal_names(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", LOG * 0, LOG * 0)
    with pytest.raises(InputError, match="3000 of 3000 header stamps are 0: type --stamps log"):
        imported(bag)
    check_right(bag, "log")
    shutil.rmtree(tmp_path / "bag_imported")
    check_right(bag, "arrival")


def test_stamps_of_one_clock_that_was_never_set_never_overlap(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", body=LOG - START + 5_000_000_000)
    with pytest.raises(
        InputError, match=r"never overlap \(they begin at 5.000 and 1790000000.000 s\).*--stamps"
    ):
        imported(bag)
    check_right(bag, "log")


def test_stamps_since_a_start_of_the_machine_are_used_and_never_become_1970(tmp_path: Path) -> None:
    boot = LOG - START + 5_000_000_000
    result = check_right(write(tmp_path / "bag", boot, boot))
    assert any("have no date; type --start" in text for text in result.warnings)
    first = next(iter(BagReader(tmp_path / "bag_imported").blocks("valve_1")))
    assert first.stamp > 1_700_000_000_000_000_000


def test_a_few_messages_ahead_of_the_clock_are_left_out(tmp_path: Path) -> None:
    early = np.where(np.arange(COUNT) < 20, 0, LOG)
    result = check_right(write(tmp_path / "bag", early, early))
    assert any("20 messages left out: no stamp" in text for text in result.warnings)


def test_repeated_stamps_of_fresh_samples_and_packets_lose_nothing(tmp_path: Path) -> None:
    number = np.arange(COUNT)
    fourth = np.where(number % 4 == 3, LOG - STEP, LOG)
    check_right(write(tmp_path / "fourth", fourth, fourth))
    packets = START + number // 8 * 8 * STEP
    result = check_right(write(tmp_path / "packets", packets, packets))
    assert not any("out of order" in text for text in result.warnings)
    other = START + (number + 3) // 8 * 8 * STEP
    with pytest.raises(InputError, match="packets of 8 samples, which differ"):
        imported(write(tmp_path / "other", packets, other))


def test_messages_that_overtook_each_other_are_sorted(tmp_path: Path) -> None:
    order = np.arange(COUNT)
    for at in range(100, COUNT - 10, 97):
        order[at : at + 3] = order[at : at + 3][::-1]
    result = check_right(write(tmp_path / "bag", order=order))
    assert any("messages out of order: sorted by stamp" in text for text in result.warnings)


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags(tmp_path: Path, mode: CompressionMode) -> None:
    check_right(write(tmp_path / "bag", compressed=mode))


def test_a_compressed_file_and_a_bag_whose_storage_is_not_named(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag")
    (file,) = bag.glob("*.mcap")
    packed = tmp_path / f"{file.name}.zstd"
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    check_right(packed)
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text("utf-8"))
    metadata["rosbag2_bagfile_information"]["storage_identifier"] = ""
    (bag / "metadata.yaml").write_text(yaml.safe_dump(metadata), "utf-8")
    check_right(bag)


def test_a_choice_that_is_none_or_that_no_other_file_has(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="write header, log or arrival"):
        choices(stamps="received")
    (tmp_path / "a.csv").write_text("time_s,body_m_s2,spool_m_s2\n0,1,2\n0.001,2,3\n0.002,3,4\n", "utf-8")
    with pytest.raises(InputError, match="--stamps log: only messages with a header"):
        import_record(tmp_path / "a.csv", tmp_path / "out", how=choices(stamps="log"))


@pytest.mark.parametrize("apart", [0, 5_000_000_000])
def test_topics_too_short_to_show_a_step_are_judged_by_their_stamps_alone(apart: int) -> None:
    whole, lost = LOG[:80], np.delete(LOG[:80], 40)
    topics = TopicTimes("/imu_1", lost, lost), TopicTimes("/imu_2", whole, whole + apart)
    assert check_one_time(Path("bag"), *topics) == []


def received(rng: np.random.Generator, times: np.ndarray, delay: float, lumps: float) -> Stamps:
    """Return when samples are received: late by chance, or in lumps."""
    late = times + rng.exponential(delay, times.size) if delay else times
    late = np.ceil(late / lumps) * lumps if lumps else late
    return START + np.rint(1e9 * np.maximum.accumulate(late)).astype(np.int64)


@settings(max_examples=30, deadline=None)
@given(
    rate=st.sampled_from([200.0, 333.0, 500.0, 1000.0]),
    by=st.sampled_from([0.0, 2e-3, -2e-3, 5e-3, 0.3, -0.3, 7.3e-3]),
    delay=st.sampled_from([0.0, 1e-5, 2e-4]),
    lumps=st.sampled_from([0.0, 0.004]),
    jitter=st.sampled_from([0.0, 1e-5]),
    phase=st.floats(0.0, 0.9),
    seed=st.integers(0, 2**32 - 1),
)
def test_steps_of_one_clock_are_found_whatever_the_reception_does(
    rate: float, by: float, delay: float, lumps: float, jitter: float, phase: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pair: list[Callable[[np.ndarray], np.ndarray]] = [lambda t: t + np.where(t > 4.0, by, 0.0), lambda t: t]
    topics = []
    for number, clock in enumerate(pair):
        times = np.arange(round(8.0 * rate)) / rate + number * phase / rate
        shown = clock(times) + jitter * rng.uniform(-1.0, 1.0, times.size)
        stamps = START + np.rint(1e9 * shown).astype(np.int64)
        order = np.argsort(stamps, kind="stable") if by >= 0.0 else np.arange(times.size)
        topics.append(TopicTimes(f"/imu_{number}", stamps[order], received(rng, times, delay, lumps)[order]))
    if by == 0.0:
        assert check_one_time(Path("bag"), *topics) == []
    else:
        with pytest.raises(InputError, match="was set by"):
            check_one_time(Path("bag"), *topics)
