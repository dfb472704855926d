from __future__ import annotations

import random
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from spool_bag.blocks import WINDOW
from spool_bag.information import describe
from spool_bag.metadata import ACCELERATION_BLOCK, TEMPERATURE, typestore
from spool_bag.reader import BagReader
from spool_bag.verification import recover
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import OilTemperature, encode_block, encode_temperature
from spool_core.errors import InputError
from spool_core.uncertainty import as_json

TOPIC = "/valve_1/acceleration"
MakeBlock = Callable[..., Block]


def test_others_open_it(bag: Path, block: MakeBlock) -> None:
    with Reader(bag) as reader:
        assert reader.message_count == 200
        assert reader.start_time == block(0).stamp
        assert reader.duration == block(199).stamp - block(0).stamp + 1
        assert reader.topics[TOPIC].msgtype == ACCELERATION_BLOCK
    with AnyReader([bag]) as reader:
        for sequence, (connection, stamp, data) in enumerate(reader.messages()):
            message = reader.deserialize(data, connection.msgtype)
            assert (message.sequence, stamp) == (sequence, block(sequence).stamp)
            np.testing.assert_array_equal(message.body, block(sequence).body)
        assert sequence == 199
    with (bag / "whole_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        schemas = {(schema.name, schema.encoding) for schema, _, _ in reader.iter_messages()}
        assert schemas == {(ACCELERATION_BLOCK, "ros2msg")}
        channel = next(iter(reader.get_summary().channels.values()))
        assert channel.message_encoding == "cdr"
        assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}


@pytest.mark.parametrize("of", [lambda bag: bag, lambda bag: bag / "whole_0.mcap"])
def test_reads_what_was_written(bag: Path, block: MakeBlock, of: Callable[[Path], Path]) -> None:
    reader = BagReader(of(bag))
    assert reader.closed
    assert reader.warnings == []
    assert reader.topics == {TOPIC: (ACCELERATION_BLOCK, 200)}
    assert reader.valves == ["valve_1"]
    blocks = list(reader.blocks("valve_1"))
    assert [item.sequence for item in blocks] == list(range(200))
    for item in blocks:
        expected = block(item.sequence)
        assert (item.stamp, item.sample_period) == (expected.stamp, expected.sample_period)
        np.testing.assert_array_equal(item.body, expected.body)
        np.testing.assert_array_equal(item.spool, expected.spool)
    assert [message.sequence for message in reader.messages(TOPIC)] == list(range(200))


def test_quality_of_service_is_kept(tmp_path: Path) -> None:
    time = QosTime(1, 5)
    qos = Qos(
        *(QosHistory.KEEP_LAST, 7, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, time, time),
        *(QosLiveliness.AUTOMATIC, time, False),
    )
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/valve_1/oil_temperature", TEMPERATURE, [qos])
        writer.write(channel, 5, encode_temperature(OilTemperature(5, 40.0), "valve_1"))
    with Reader(tmp_path / "bag") as reader:
        assert reader.connections[0].ext.offered_qos_profiles == [qos]
    recover(tmp_path / "bag", tmp_path / "copy")
    with Reader(tmp_path / "copy") as reader:
        assert reader.connections[0].ext.offered_qos_profiles == [qos]


def test_an_empty_bag_is_a_bag(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag").close()
    reader = BagReader(tmp_path / "bag")
    assert (reader.topics, reader.valves, reader.closed) == ({}, [], True)
    assert describe(tmp_path / "bag").duration_s is None
    with Reader(tmp_path / "bag") as other:
        assert other.message_count == 0


def test_an_existing_target_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="there exists already"):
        BagWriter(tmp_path / "there")


def test_another_type_on_a_topic_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        number = writer.add_topic(TOPIC, ACCELERATION_BLOCK)
        assert writer.add_topic(TOPIC, ACCELERATION_BLOCK) == number
        with pytest.raises(InputError, match=TOPIC):
            writer.add_topic(TOPIC, TEMPERATURE)


def test_a_chunk_is_closed_by_time(tmp_path: Path, block: MakeBlock) -> None:
    with BagWriter(tmp_path / "bag", flush_interval=0.0) as writer:
        channel = writer.add_topic(TOPIC, ACCELERATION_BLOCK)
        for sequence in range(5):
            writer.write(channel, 1, encode_block(block(sequence), "valve_1"))
            assert len(list(BagReader(tmp_path / "bag").blocks("valve_1"))) == sequence + 1


@pytest.fixture(name="unfinished")
def _unfinished(tmp_path: Path, block: MakeBlock) -> Path:
    """What a kill leaves: 20 blocks on the disk, 5 still in memory."""
    with BagWriter(tmp_path / "live", flush_interval=1e9) as writer:
        channel = writer.add_topic(TOPIC, ACCELERATION_BLOCK)
        for sequence in range(25):
            writer.write(channel, block(sequence).stamp, encode_block(block(sequence), "valve_1"))
            if sequence % 10 == 9:
                writer.flush()
        shutil.copytree(tmp_path / "live", tmp_path / "killed")
    return tmp_path / "killed"


def test_an_unfinished_bag_is_read_and_said_to_be_one(unfinished: Path) -> None:
    reader = BagReader(unfinished)
    assert not reader.closed
    (warning,) = reader.warnings
    assert "not finished" in warning
    assert "spool recover" in warning
    assert "second" not in warning  # it promises nothing
    assert reader.topics == {TOPIC: (ACCELERATION_BLOCK, 20)}
    assert [block.sequence for block in reader.blocks("valve_1")] == list(range(20))
    metadata = yaml.safe_load((unfinished / "metadata.yaml").read_text("utf-8"))[
        "rosbag2_bagfile_information"
    ]
    (told,) = metadata["topics_with_message_count"]
    assert (metadata["version"], told["topic_metadata"]["name"]) == (9, TOPIC)
    found = describe(unfinished)
    assert (found.closed, found.valves[0].blocks, found.damages) == (False, 20, ())


@pytest.mark.parametrize("tail", ["cut", "zeros"])
def test_a_tail_of_power_loss_costs_its_chunk_only(unfinished: Path, tail: str) -> None:
    file = unfinished / "live_0.mcap"
    content = file.read_bytes()
    file.write_bytes(content[:-1500] if tail == "cut" else content + bytes(5000))
    kept = [block.sequence for block in BagReader(unfinished).blocks("valve_1")]
    assert kept == list(range(10 if tail == "cut" else 20))
    result = recover(unfinished, unfinished.with_name("recovered"))
    assert result.messages == {TOPIC: len(kept)}
    assert len(result.damages) == 1
    assert result.expected is None
    assert [block.sequence for block in BagReader(result.target).blocks("valve_1")] == kept


def test_a_lost_metadata_file_is_told_and_lived_with(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    reader = BagReader(bag)
    assert "metadata.yaml is missing" in reader.warnings[0]
    assert len(list(reader.blocks("valve_1"))) == 200


def chunk_in_the_middle(bag: Path) -> tuple[int, int]:
    with (bag / "whole_0.mcap").open("rb") as stream:
        index = make_reader(stream).get_summary().chunk_indexes[4]
    return index.chunk_start_offset, index.chunk_length


@pytest.mark.parametrize("place", ["length", "head", "data", "checksum"])
def test_a_damaged_chunk_costs_itself_only(bag: Path, place: str, tmp_path: Path) -> None:
    start, length = chunk_in_the_middle(bag)
    at = {"length": 3, "head": 9 + 29, "data": length // 2, "checksum": 9 + 24}[place]
    file = bag / "whole_0.mcap"
    content = bytearray(file.read_bytes())
    content[start + at] ^= 0x55
    file.write_bytes(content)
    with pytest.raises(InputError, match=f"whole_0.mcap: damaged at byte {start} .*recover"):
        list(BagReader(bag).blocks("valve_1"))
    found = describe(bag)
    assert [damage.offset for damage in found.damages] == [start]
    assert (found.valves[0].blocks, found.valves[0].lost_blocks) == (180, 20)
    result = recover(bag, tmp_path / "recovered")
    assert result.messages == {TOPIC: 180}
    assert (result.lost, result.estimated, result.missing) == (20, False, {"valve_1": 20})
    kept = [block.sequence for block in BagReader(tmp_path / "recovered").blocks("valve_1")]
    assert kept == [*range(80), *range(100, 200)]


def test_a_chunk_that_is_called_something_else_is_told_and_read(bag: Path, tmp_path: Path) -> None:
    start, _ = chunk_in_the_middle(bag)
    file = bag / "whole_0.mcap"
    content = bytearray(file.read_bytes())
    content[start] ^= 0x80
    file.write_bytes(content)
    with pytest.raises(InputError, match=f"whole_0.mcap: damaged at byte {start} .*recover"):
        list(BagReader(bag).blocks("valve_1"))
    result = recover(bag, tmp_path / "recovered")
    assert [damage.lost for damage in result.damages] == [0]
    assert [block.sequence for block in BagReader(tmp_path / "recovered").blocks("valve_1")] == list(
        range(200)
    )


#: Place as a share of the file, and what happens there: a byte becomes another, or so many are gone.
EDIT = st.tuples(
    st.floats(0.0, 1.0, exclude_max=True), st.binary(min_size=1, max_size=1) | st.integers(1, 3000)
)


@pytest.mark.fuzz
@pytest.mark.parametrize("examples", [25, pytest.param(300, marks=pytest.mark.slow)])
def test_any_corruption_gives_the_data_or_one_plain_error(bag: Path, examples: int, block: MakeBlock) -> None:
    sound = (bag / "whole_0.mcap").read_bytes()

    @settings(max_examples=examples)
    @given(st.lists(EDIT, min_size=1, max_size=4))
    def check(edits: list[tuple[float, bytes | int]]) -> None:
        content = bytearray(sound)
        for share, change in edits:
            at = int(share * len(content))
            size, put = (change, b"") if isinstance(change, int) else (1, change)
            content[at : at + size] = put
        (bag / "whole_0.mcap").write_bytes(content)
        told, blocks = "", []
        try:
            blocks = list(BagReader(bag).blocks("valve_1"))
        except InputError as error:
            told = str(error)
        assert not told or str(bag) in told
        assert "\n" not in told
        for item in blocks:
            np.testing.assert_array_equal(item.body, block(item.sequence).body)
        whole = [item.sequence for item in blocks] == list(range(200))
        assert told or whole or not BagReader(bag).closed

    check()


@pytest.mark.parametrize("content", [b"", b"time_s,body", b"\x89MCAP0\r\n"])
def test_what_is_no_bag_is_told(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(InputError, match=r"x\.mcap"):
        list(BagReader(tmp_path / "x.mcap").blocks("valve_1"))


def test_what_is_not_there_is_told(tmp_path: Path, bag: Path) -> None:
    with pytest.raises(InputError, match="no such bag"):
        BagReader(tmp_path / "nothing")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"no \.mcap file"):
        BagReader(tmp_path / "folder")
    with pytest.raises(InputError, match="no valve 'valve_9': the bag has valve_1"):
        list(BagReader(bag).blocks("valve_9"))
    with pytest.raises(InputError, match="no topic /valve_1/health"):
        list(BagReader(bag).messages("/valve_1/health"))


def write(path: Path, blocks: list[Block], temperatures: list[OilTemperature] | None = None) -> BagReader:
    with BagWriter(path) as writer:
        channel = writer.add_topic(TOPIC, ACCELERATION_BLOCK)
        thermal = writer.add_topic("/valve_1/oil_temperature", TEMPERATURE)
        for log_time, item in enumerate(blocks):
            writer.write(channel, log_time, encode_block(item, "valve_1"))
        for item in temperatures or []:
            writer.write(thermal, len(blocks), encode_temperature(item, "valve_1"))
    return BagReader(path)


def test_order_is_by_stamp_and_sequence_within_the_window(tmp_path: Path, block: MakeBlock) -> None:
    generator = random.Random(7)
    blocks = [block(sequence) for sequence in range(2000)]
    shuffled = sorted(blocks, key=lambda item: item.stamp + generator.random() * WINDOW)
    warm = [OilTemperature(blocks[at].stamp, float(at)) for at in (0, 1000, 1999)]
    reader = write(tmp_path / "bag", shuffled, warm[:0])
    assert [item.sequence for item in reader.blocks("valve_1")] == list(range(2000))
    stream = list(write(tmp_path / "warm", blocks[:100], warm[:1]).stream("valve_1"))
    assert stream[0] == warm[0]
    assert [item.sequence for item in stream[1:] if isinstance(item, Block)] == list(range(100))
    late = write(tmp_path / "late", blocks, warm)
    assert list(late.temperatures("valve_1")) == [(item.stamp, item.celsius) for item in warm]


def test_a_new_start_of_time_is_passed_on_where_it_stands(tmp_path: Path, block: MakeBlock) -> None:
    played = [block(sequence) for sequence in range(1000)]
    reader = write(tmp_path / "bag", played * 2)
    assert [item.sequence for item in reader.blocks("valve_1")] == [*range(1000), *range(1000)]


def test_equal_stamps_come_by_sequence_and_the_queue_is_bounded(tmp_path: Path, block: MakeBlock) -> None:
    one = block(0, size=1)
    blocks = [Block(one.stamp, at ^ 1, one.sample_period, one.body, one.spool) for at in range(30_000)]
    reader = write(tmp_path / "bag", blocks)
    assert [item.sequence for item in reader.blocks("valve_1")] == list(range(30_000))


def test_bags_of_rosbags_in_several_files_are_read(tmp_path: Path, block: MakeBlock) -> None:
    for part in range(2):
        with Writer(tmp_path / f"part_{part}", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            thermal = writer.add_connection("/valve_1/oil_temperature", TEMPERATURE, typestore=typestore())
            channel = writer.add_connection(TOPIC, ACCELERATION_BLOCK, typestore=typestore())
            for sequence in range(50 * part, 50 * part + 50):
                stamp = block(sequence).stamp
                warm = OilTemperature(stamp, float(sequence))
                writer.write(channel, stamp, encode_block(block(sequence), "valve_1"))
                writer.write(thermal, stamp, encode_temperature(warm, "valve_1"))
    joined = tmp_path / "joined"
    shutil.copytree(tmp_path / "part_0", joined)
    shutil.copy(tmp_path / "part_1" / "part_1.mcap", joined)
    text = (joined / "metadata.yaml").read_text("utf-8")
    (joined / "metadata.yaml").write_text(
        text.replace("  - part_0.mcap\n", "  - part_0.mcap\n  - part_1.mcap\n"), "utf-8"
    )
    reader = BagReader(joined)
    assert reader.topics == {TOPIC: (ACCELERATION_BLOCK, 100), "/valve_1/oil_temperature": (TEMPERATURE, 100)}
    assert [item.sequence for item in reader.blocks("/valve_1")] == list(range(100))
    assert [celsius for _, celsius in reader.temperatures("valve_1")] == list(range(100))
    (joined / "part_1.mcap").unlink()
    assert "part_1.mcap is missing" in BagReader(joined).warnings[0]


def test_other_storage_is_refused_with_the_way_out(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3):
        pass
    with pytest.raises(InputError, match=r"storage 'sqlite3' is not supported here: type `\./spool import "):
        BagReader(tmp_path / "bag")


def test_a_bag_compressed_as_a_whole_and_one_without_a_storage_name(tmp_path: Path, block: MakeBlock) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for number in range(5):
            writer.write(channel, 1 + number, encode_block(block(number), "valve"))
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(
        metadata.read_text("utf-8").replace("storage_identifier: mcap", "storage_identifier: ''"), "utf-8"
    )
    assert len(list(BagReader(tmp_path / "bag").blocks("valve_1"))) == 5
    (file,) = (tmp_path / "bag").glob("*.mcap")
    packed = file.with_name(f"{file.name}.zstd")
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    text = metadata.read_text("utf-8").replace("compression_mode: ''", "compression_mode: FILE")
    metadata.write_text(text.replace(file.name, packed.name), "utf-8")
    assert len(list(BagReader(tmp_path / "bag").blocks("valve_1"))) == 5
    metadata.unlink()
    assert len(list(BagReader(packed).blocks("valve_1"))) == 5
    packed.write_bytes(b"no zstd at all, but long enough to be looked at")
    with pytest.raises(InputError, match="cannot be decompressed"):
        BagReader(packed)


def test_information_counts_losses_and_refusals(tmp_path: Path, block: MakeBlock) -> None:
    bad = block(11)
    blocks = [
        *(block(sequence) for sequence in (0, 1, 2, 7, 8)),
        Block(bad.stamp, bad.sequence, -1.0, bad.body, bad.spool),
        block(12),
    ]
    write(tmp_path / "bag", blocks, [OilTemperature(block(3).stamp, 40.0)])
    found = describe(tmp_path / "bag")
    (valve,) = found.valves
    assert (valve.blocks, valve.samples, valve.lost_blocks, valve.refused_blocks) == (7, 240, 7, 1)
    assert (valve.first_stamp_ns, valve.end_stamp_ns) == (block(0).stamp, block(13).stamp)
    assert valve.sample_rate == pytest.approx(2000.0)
    assert valve.temperatures == 1
    assert found.duration_s == pytest.approx(13 * 0.02)
    content = as_json(found)
    assert content["valves"]["valve_1"]["sample_rate_Hz"] == pytest.approx(2000.0)
    assert content["topics"][0]["rate_per_s"] == pytest.approx(7 / 0.26)


FILL = """
import resource, sys
from spool_core.cdr import encode_block
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.writer import BagWriter, RecordingError
from spool_core.block import Block
import numpy as np
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
writer = BagWriter(sys.argv[1], flush_interval=0.0)
channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
noise = np.random.default_rng(0).standard_normal(400).astype(np.float32)
try:
    for sequence in range(1000):
        block = Block(10**18 + sequence, sequence, 0.0005, noise + sequence, noise)
        writer.write(channel, 1, encode_block(block, "valve_1"))
except RecordingError as error:
    print(sequence)
    print(error, file=sys.stderr)
    writer.close()
"""


def test_a_full_disk_is_reported_and_keeps_what_was_recorded(tmp_path: Path) -> None:
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    done = subprocess.run(
        [sys.executable, "-c", FILL, str(tmp_path / "bag")], capture_output=True, text=True, check=True
    )
    assert "bag_0.mcap" in done.stderr
    assert "earlier data is kept" in done.stderr
    sequences = [block.sequence for block in BagReader(tmp_path / "bag").blocks("valve_1")]
    assert sequences == list(range(int(done.stdout)))
    assert len(sequences) > 5
    assert recover(tmp_path / "bag", tmp_path / "recovered").damages == ()
