"""Damage to unfinished bags: whatever it hits, every other chunk is saved and the loss is reported."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from spool_bag.information import describe
from spool_bag.mcap_record import FRAME, MAGIC
from spool_bag.metadata import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.reader import BagReader
from spool_bag.verification import RecoveryResult, recover
from spool_bag.writer import BagWriter
from spool_core.block import Block
from spool_core.cdr import OilTemperature, encode_block, encode_temperature
from spool_core.errors import InputError

START = 1_700_000_000_000_000_000
VALVES = ("valve_1", "valve_2")
#: Where damage begins and ends.
Region = tuple[int, int]


class Outcome(NamedTuple):
    """Chunks that the damage did not touch, how many of them were saved whole, and the true reports."""

    intact: int
    saved: int
    lost: int
    result: RecoveryResult


def unfinished_bag(folder: Path, seconds: int) -> Path:
    """Return what a killed recorder leaves of ``seconds`` of two valves, 50 blocks/s in chunks of 0.7 s."""
    with BagWriter(folder / "live", flush_interval=1e9) as writer:
        channels = {name: writer.add_topic(f"/{name}/acceleration", ACCELERATION_BLOCK) for name in VALVES}
        thermal = writer.add_topic("/valve_1/oil_temperature", TEMPERATURE)
        for sequence in range(50 * seconds):
            samples = np.random.default_rng(sequence).standard_normal((2, 40)).astype(np.float32)
            block = Block(START + sequence * 20_000_000, sequence, 0.0005, *samples)
            for name, channel in channels.items():
                writer.write(channel, block.stamp, encode_block(block, name))
            if sequence % 50 == 0:
                item = OilTemperature(block.stamp, 40.0)
                writer.write(thermal, block.stamp, encode_temperature(item, "valve_1"))
            if sequence % 35 == 34:
                writer.flush()
        shutil.copytree(folder / "live", folder / "killed")
    return folder / "killed"


def flip_a_bit(content: bytearray, at: int, bit: int) -> Region:
    """Flip one bit anywhere; return where the damage begins and ends."""
    at %= len(content)
    content[at] ^= 1 << bit
    return at, at + 1


def flip_a_bit_of_a_head(content: bytearray, at: int, bit: int) -> Region:
    """Flip one bit in the kind or length of a record."""
    record, byte = divmod(at, FRAME.size)
    starts = heads(bytes(content))
    return flip_a_bit(content, starts[record % len(starts)] + byte, bit)


def zero_a_page(content: bytearray, at: int, _: int) -> Region:
    """Zero a page of 4 kB, as a power loss leaves one."""
    begin = 4096 * (at % (len(content) // 4096))
    return wipe(content, begin, begin + 4096)


def wipe(content: bytearray, begin: int, end: int) -> Region:
    """Zero the bytes from ``begin`` to ``end``."""
    content[begin:end] = bytes(end - begin)
    return begin, end


def heads(content: bytes) -> list[int]:
    """Return where the records of an undamaged file begin."""
    at, found = len(MAGIC), []
    while at + FRAME.size <= len(content):
        found.append(at)
        at += FRAME.size + FRAME.unpack_from(content, at)[1]
    return found


def trial(bag: Path, folder: Path, damage: Callable[[bytearray], Region]) -> Outcome:
    """Damage a copy of ``bag`` in ``folder`` and recover it."""
    content = content_of(bag)
    chunks = [(at, at + FRAME.size + FRAME.unpack_from(content, at)[1]) for at in places(bag, Opcode.CHUNK)]
    held = _stamps(bag)
    begin, end = damage(content)
    untouched = [number for number, (at, after) in enumerate(chunks) if after <= begin or end <= at]
    with TemporaryDirectory(dir=folder) as name:
        result = recover(damaged(bag, Path(name), content), Path(name) / "recovered")
        kept = _kept(Path(name) / "recovered")
    saved = sum(held[number] <= kept for number in untouched)
    lost = len(set().union(*held)) - len(kept)
    return Outcome(len(untouched), saved, lost, result)


def _kept(bag: Path) -> set[tuple[str, int, bytes]]:
    return {(topic.name, record.log_time, record.data) for topic, record in BagReader(bag).records()}


def _stamps(bag: Path) -> list[set[tuple[str, int, bytes]]]:
    """Return the messages of each chunk, which hold 35 blocks of each valve's."""
    chunks: list[set[tuple[str, int, bytes]]] = [set()]
    blocks = 0
    for topic, record in BagReader(bag).records():
        if topic.type == ACCELERATION_BLOCK and blocks == 35 * len(VALVES):
            chunks.append(set())
            blocks = 0
        blocks += topic.type == ACCELERATION_BLOCK
        chunks[-1].add((topic.name, record.log_time, record.data))
    return chunks


@pytest.fixture(name="killed", scope="module")
def _killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unfinished_bag(tmp_path_factory.mktemp("bags"), 8)


def content_of(bag: Path) -> bytearray:
    return bytearray(next(bag.glob("*.mcap")).read_bytes())


def places(bag: Path, opcode: Opcode) -> list[int]:
    content = content_of(bag)
    return [at for at in heads(bytes(content)) if content[at] == opcode]


def damaged(bag: Path, folder: Path, content: bytes | bytearray) -> Path:
    """Return a copy of ``bag`` with other ``content`` of its file."""
    copy = folder / "damaged"
    shutil.copytree(bag, copy)
    next(copy.glob("*.mcap")).write_bytes(content)
    return copy


def judge(outcome: Outcome) -> None:
    assert outcome.saved == outcome.intact
    assert (outcome.lost == 0) == (outcome.result.lost == 0)
    if outcome.lost:
        assert outcome.result.damages
        assert outcome.result.lost == outcome.lost or outcome.result.estimated


@pytest.mark.fuzz
@pytest.mark.parametrize("examples", [8, pytest.param(80, marks=pytest.mark.slow)])
@pytest.mark.parametrize("damage", [flip_a_bit, flip_a_bit_of_a_head, zero_a_page])
def test_other_chunks_are_saved_and_the_loss_is_told(
    killed: Path, tmp_path: Path, damage: Callable[[bytearray, int, int], Region], examples: int
) -> None:
    @settings(max_examples=examples, phases=(Phase.explicit, Phase.reuse, Phase.generate))
    @given(st.integers(0, 2**24), st.integers(0, 7))
    def check(at: int, bit: int) -> None:
        judge(trial(killed, tmp_path, lambda content: damage(content, at, bit)))

    check()


@pytest.mark.parametrize("other", [0x0F, 0x02, 0x05, 0x87])
def test_an_index_that_is_called_something_else_costs_nothing(
    killed: Path, tmp_path: Path, other: int
) -> None:
    at = places(killed, Opcode.MESSAGE_INDEX)[4]

    def rename(content: bytearray) -> Region:
        content[at] = other
        return at, at + 1

    outcome = trial(killed, tmp_path, rename)
    assert (outcome.saved, outcome.lost) == (outcome.intact, 0)
    judge(outcome)


@pytest.mark.parametrize("size", [8, 4096])
def test_a_lost_beginning_costs_its_chunk_only(killed: Path, tmp_path: Path, size: int) -> None:
    judge(trial(killed, tmp_path, lambda content: wipe(content, 0, size)))
    broken = damaged(killed, tmp_path, bytes(size) + content_of(killed)[size:])
    with pytest.raises(InputError, match=r"damaged at byte 0 .*recover"):
        list(BagReader(broken).blocks("valve_1"))


def test_two_wiped_chunks_and_their_indexes_are_told_by_their_size(killed: Path, tmp_path: Path) -> None:
    begin, end = places(killed, Opcode.CHUNK)[2], places(killed, Opcode.CHUNK)[4]
    outcome = trial(killed, tmp_path, lambda content: wipe(content, begin, end))
    assert outcome.saved == outcome.intact
    assert outcome.result.estimated
    assert outcome.result.lost == pytest.approx(outcome.lost, rel=0.2)
    assert outcome.result.missing == dict.fromkeys(VALVES, 70)


def test_a_file_cut_in_half_is_told_by_what_the_metadata_counts(killed: Path, tmp_path: Path) -> None:
    content = content_of(killed)
    cut = damaged(killed, tmp_path, content[: len(content) // 2])
    text = (cut / "metadata.yaml").read_text("utf-8")
    counted = re.sub(r"(?m)^  message_count: \d+$", "  message_count: 700", text)
    (cut / "metadata.yaml").write_text(counted, "utf-8")
    found = describe(cut)
    kept = sum(topic.messages for topic in found.topics)
    assert 200 < kept < 600
    lost = found.lost_messages
    assert any(f"at least {700 - kept - lost} more are missing" in warning for warning in found.warnings)
    assert recover(cut, tmp_path / "recovered").lost == 700 - kept


def test_an_unfinished_bag_is_recognisable_and_a_finished_one_has_no_mark(killed: Path, bag: Path) -> None:
    def custom(folder: Path) -> object:
        return yaml.safe_load((folder / "metadata.yaml").read_text("utf-8"))["rosbag2_bagfile_information"][
            "custom_data"
        ]

    assert custom(killed) == {"recording": "not finished"}
    assert custom(bag) is None


def test_definitions_are_repeated_and_others_read_them(killed: Path, tmp_path: Path) -> None:
    chunks, content = places(killed, Opcode.CHUNK), content_of(killed)
    later = damaged(killed, tmp_path, content[: chunks[0]] + content[chunks[3] :])
    assert BagReader(later).valves == list(VALVES)
    result = recover(later, tmp_path / "recovered")
    assert result.damages == ()
    with Reader(tmp_path / "recovered") as reader:
        assert reader.message_count == sum(result.messages.values())
    with next((tmp_path / "recovered").glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == set(result.messages)
    assert len(summary.schemas) == 2


def test_a_seldom_topic_does_not_lose_its_definition_with_its_first_chunk(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "live", flush_interval=1e9) as writer:
        often = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        seldom = writer.add_topic("/valve_1/oil_temperature", TEMPERATURE)
        samples = np.zeros(40, np.float32)
        for chunk in range(40):
            block = Block(START + chunk * 20_000_000, chunk, 0.0005, samples, samples)
            writer.write(often, block.stamp, encode_block(block, "valve_1"))
            if chunk in (0, 29):
                item = OilTemperature(block.stamp, 40.0)
                writer.write(seldom, block.stamp, encode_temperature(item, "valve_1"))
            writer.flush()
        shutil.copytree(tmp_path / "live", tmp_path / "killed")
    first, second = places(tmp_path / "killed", Opcode.CHUNK)[:2]

    content = content_of(tmp_path / "killed")
    wipe(content, first, second)
    result = recover(damaged(tmp_path / "killed", tmp_path, content), tmp_path / "recovered")
    assert result.messages == {"/valve_1/acceleration": 39, "/valve_1/oil_temperature": 1}
