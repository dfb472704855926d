"""Files made to exhaust memory, time or the stack, or to steer a terminal: read within bounds and told."""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from lz4.frame import compress as lz4_compress
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from spool_bag.export import export_bag
from spool_bag.information import describe
from spool_bag.mcap_file import LARGEST_CHUNK
from spool_bag.mcap_record import CHUNK_HEAD, FRAME, MAGIC
from spool_bag.metadata import ACCELERATION_BLOCK, FILE_NAME, definition
from spool_bag.reader import BagReader
from spool_bag.verification import recover
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.errors import InputError

MakeBlock = Callable[..., Block]

DESCRIBE = """
import sys
from spool_bag.information import describe
found = describe(sys.argv[1])
print(len(found.damages), found.damages[0].reason if found.damages else "")
# Not ru_maxrss, which a process takes over from the one that started it.
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def chunk(records: bytes, packed: bytes, compression: bytes, size: int | None = None) -> bytes:
    head = CHUNK_HEAD.pack(
        1, 2, len(records) if size is None else size, zlib.crc32(records), len(compression)
    )
    content = head + compression + struct.pack("<Q", len(packed)) + packed
    return FRAME.pack(Opcode.CHUNK, len(content)) + content


def unfinished(path: Path, *chunks: bytes) -> Path:
    header = struct.pack("<I", 0) * 2
    path.write_bytes(MAGIC + FRAME.pack(Opcode.HEADER, len(header)) + header + b"".join(chunks))
    return path


def told_by_a_process(path: Path) -> tuple[str, int]:
    """Return what is reported of the file, and the memory (kB) that it took."""
    done = subprocess.run(
        [sys.executable, "-c", DESCRIBE, str(path)], capture_output=True, text=True, check=True
    )
    told, memory = done.stdout.splitlines()
    return told, int(memory)


@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
def test_a_chunk_that_unpacks_to_gigabytes_is_not_unpacked(tmp_path: Path, compression: bytes) -> None:
    zeros = bytes(LARGEST_CHUNK + 1)
    packed = zstandard.compress(zeros) if compression == b"zstd" else lz4_compress(zeros)
    honest = chunk(b"", packed, compression, size=len(zeros))
    lying = chunk(b"", packed, compression, size=1000)
    told, memory = told_by_a_process(unfinished(tmp_path / "bomb.mcap", *[honest] * 20, *[lying] * 20))
    assert told.startswith("40 a chunk claims")
    assert memory < 400_000


def test_many_large_chunks_in_a_small_file_are_refused_as_a_whole(tmp_path: Path) -> None:
    records = FRAME.pack(Opcode.ATTACHMENT, LARGEST_CHUNK // 2 - 9) + bytes(LARGEST_CHUNK // 2 - 9)
    packed = zstandard.compress(records)
    bomb = unfinished(tmp_path / "bomb.mcap", *[chunk(records, packed, b"zstd")] * 12)
    told, memory = told_by_a_process(bomb)
    assert "the file unpacks to more than" in told
    assert memory < 600_000


def test_large_blocks_within_the_window_are_not_all_held(tmp_path: Path) -> None:
    """20 000 messages of 1 MB of zeros each would fit into 10 s of stamps."""
    path = tmp_path / "blocks.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, 1 << 24, CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema(
            ACCELERATION_BLOCK, "ros2msg", definition(ACCELERATION_BLOCK).text.encode()
        )
        channel = writer.register_channel("/valve_1/acceleration", "cdr", schema)
        samples = struct.pack("<I", 125_000) + bytes(500_000)
        for at in range(450):
            head = b"\0\1\0\0" + struct.pack("<iII", 1_700_000_000, at, 1) + bytes(4)
            data = head + struct.pack("<Qd", at, 1e-6) + samples + samples
            writer.add_message(channel, at, data, at)
        writer.finish()
    assert path.stat().st_size < 500_000
    _, memory = told_by_a_process(path)
    assert memory < 800_000


def test_a_definition_that_is_repeated_in_other_words_does_not_fill_memory(tmp_path: Path) -> None:
    text = bytes(200_000)
    schemas = [
        struct.pack("<H", number + 1) + struct.pack("<I", 1) + b"a" + struct.pack("<I", 0)
        + struct.pack("<I", len(text)) + text
        for number in range(600)
    ]  # fmt: skip
    records = b"".join(FRAME.pack(Opcode.SCHEMA, len(schema)) + schema for schema in schemas)
    bomb = unfinished(tmp_path / "bomb.mcap", chunk(records, zstandard.compress(records), b"zstd"))
    told, _ = told_by_a_process(bomb)
    assert told.startswith("1 a definition of more than")


@pytest.mark.parametrize("length", [2**63, 2**64 - 1, 2**40])
def test_lengths_that_lie_are_stepped_over(bag: Path, length: int) -> None:
    file = bag / "whole_0.mcap"
    content = bytearray(file.read_bytes())
    start = next(at for at in range(len(MAGIC), len(content)) if content[at] == Opcode.CHUNK)
    content[start + 1 : start + 9] = struct.pack("<Q", length)
    file.write_bytes(content)
    found = describe(bag)
    assert found.damages
    assert found.valves[0].blocks == 180


@pytest.mark.parametrize("size", [2**27 + 1, 2**48, 2**64 - 1])
def test_an_unpacked_size_that_lies_costs_its_chunk_only(bag: Path, size: int) -> None:
    file = bag / "whole_0.mcap"
    content = bytearray(file.read_bytes())
    start = content.index(b"\x04\0\0\0zstd") - CHUNK_HEAD.size + 4
    content[start + 16 : start + 24] = struct.pack("<Q", size)
    file.write_bytes(content)
    found = describe(bag)
    assert [damage.reason.partition(" bytes")[0] for damage in found.damages] == [f"a chunk claims {size}"]
    assert (found.valves[0].blocks, found.lost_messages) == (180, 20)


NESTED = "[" * 20_000 + "]" * 20_000
ALIASES = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{later}: &{later} [{','.join(['*' + earlier] * 9)}]\n"
    for earlier, later in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize("text", [NESTED, ALIASES, "[1, 2]", "rosbag2_bagfile_information: 5"])
def test_metadata_beyond_the_bounds_is_told_and_the_bag_is_read(bag: Path, text: str) -> None:
    (bag / FILE_NAME).write_text(text, "utf-8")
    reader = BagReader(bag)
    assert "metadata.yaml cannot be read" in reader.warnings[0]
    assert len(list(reader.blocks("valve_1"))) == 200


def test_a_message_that_cannot_be_decoded_is_left_out_and_counted(tmp_path: Path, block: MakeBlock) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for sequence in range(100):
            data = encode_block(block(sequence), "valve_1")
            writer.write(channel, block(sequence).stamp, data[:30] if sequence == 40 else data)
    reader = BagReader(tmp_path / "bag")
    assert [one.sequence for one in reader.blocks("valve_1")] == [at for at in range(100) if at != 40]
    assert len(list(reader.messages("/valve_1/acceleration"))) == 99
    assert reader.undecodable == {"/valve_1/acceleration": 1}
    found = describe(tmp_path / "bag")
    assert (found.valves[0].blocks, found.valves[0].undecodable_blocks) == (99, 1)
    assert any("1 message left out: the bytes do not fit the type" in warning for warning in found.warnings)
    result = recover(tmp_path / "bag", tmp_path / "recovered")
    assert result.undecodable == {"/valve_1/acceleration": 1}
    assert describe(tmp_path / "recovered").undecodable_messages == {}


def foreign(path: Path, topic: str, block: MakeBlock) -> Path:
    with BagWriter(path) as writer:
        for name in (topic, "/valve_2/acceleration"):
            channel = writer.add_topic(name, ACCELERATION_BLOCK)
            for sequence in range(3):
                writer.write(channel, block(sequence).stamp, encode_block(block(sequence), "x"))
    return path


def test_names_that_steer_a_terminal_are_shown_as_text(tmp_path: Path, block: MakeBlock) -> None:
    bag = foreign(tmp_path / "bag", "/\x1b]0;owned\x07/acceleration", block)
    with pytest.raises(InputError) as caught:
        list(BagReader(bag).blocks("other"))
    assert str(caught.value).isprintable()
    with pytest.raises(InputError) as caught:
        list(BagReader(bag).messages("/other"))
    assert str(caught.value).isprintable()
    assert all(warning.isprintable() for warning in describe(bag).warnings)


@pytest.mark.parametrize("name", ["=1+1", "@sum", "+1", "-1", '=a,b"c\n'])
def test_a_name_is_no_formula_in_a_table(tmp_path: Path, name: str, block: MakeBlock) -> None:
    bag = foreign(tmp_path / "bag", f"/{name}/acceleration", block)
    export_bag(bag, tmp_path / "table.csv")
    cells = {line.split(",")[0] for line in (tmp_path / "table.csv").read_text("utf-8").splitlines()[1:]}
    assert len(cells) == 2
    assert all(cell[0] in "'v" for cell in cells)


def test_a_valve_without_a_namespace_is_read(tmp_path: Path, block: MakeBlock) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/acceleration", ACCELERATION_BLOCK)
        writer.write(channel, 1, encode_block(block(0), "valve"))
    reader = BagReader(tmp_path / "bag")
    assert reader.valves == [""]
    assert len(list(reader.blocks(""))) == reader.blocks_of("") == 1


def test_the_blocks_of_a_valve_are_its_own_and_of_their_type(tmp_path: Path, block: MakeBlock) -> None:
    counts = {"/a/acceleration": 3, "/b/acceleration": 2, "/a/copy/acceleration": 4, "/a/other": 5}
    with BagWriter(tmp_path / "bag") as writer:
        for topic, count in counts.items():
            channel = writer.add_topic(topic, ACCELERATION_BLOCK)
            for sequence in range(count):
                writer.write(channel, block(sequence).stamp, encode_block(block(sequence), "x"))
        text = writer.add_topic("/c/acceleration", "std_msgs/msg/String")
        writer.write(text, block(0).stamp, b"\0\1\0\0\2\0\0\0x\0")
    reader = BagReader(tmp_path / "bag")
    assert {valve: reader.blocks_of(valve) for valve in reader.valves} == {"a": 3, "b": 2, "a/copy": 4}
    assert all(len(list(reader.blocks(valve))) == reader.blocks_of(valve) for valve in reader.valves)


@pytest.mark.parametrize("name", ["../outside_0.mcap", "{folder}/outside_0.mcap", "../../etc/passwd"])
def test_a_bag_does_not_lead_out_of_its_folder(bag: Path, tmp_path: Path, name: str) -> None:
    outside = tmp_path / "outside_0.mcap"
    outside.write_bytes((bag / "whole_0.mcap").read_bytes())
    text = (bag / "metadata.yaml").read_text("utf-8")
    (bag / "metadata.yaml").write_text(text.replace("whole_0.mcap", name.format(folder=tmp_path)), "utf-8")
    reader = BagReader(bag)
    assert [file.path.parent for file in reader.files] == [bag]
    assert any("would lie outside of the bag" in warning for warning in reader.warnings)
