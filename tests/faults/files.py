"""Faults of files that lie on a disk: cut off, a bit or a page changed, states that are garbage."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from spool_bag.mcap_file import McapFile
from spool_bag.mcap_record import FRAME, MAGIC
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.verification import RecoveryResult, recover, verify
from spool_bag.writer import BagWriter, PartLimits
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.errors import InputError
from spool_monitor.state_database import FILE
from spool_monitor.state_file import StateFile

from .outcome import Outcome

STEP = 0.02
START = 1_700_000_000_000_000_000
BLOCKS, FLUSH = 1000, 35


def block(number: int) -> Block:
    """Return a block that tells its number by its samples."""
    samples = np.random.default_rng(number).standard_normal((2, 40)).astype(np.float32)
    return Block(START + round(number * STEP * 1e9), number, 0.0005, samples[0], samples[1])


def recorded(folder: Path) -> Path:
    """Return a recording of 20 s in four parts, synced every 0.7 s, as the recorder does."""
    with BagWriter(folder, limits=PartLimits(duration=6.0), flush_interval=1e9) as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for number in range(BLOCKS):
            one = block(number)
            writer.write(channel, one.stamp, encode_block(one, "valve_1"))
            if number % FLUSH == 0:
                writer.flush()
    return folder


class Contents:
    """What a recording holds: blocks by number, and which records of its files hold them."""

    def __init__(self, bag: Path) -> None:
        self.bag = bag
        self.blocks = {one.sequence: one.body.tobytes() for one in BagReader(bag).blocks("valve_1")}
        self.records = {path.name: list(_records(path)) for path in sorted(bag.glob("*.mcap"))}

    def foreign(self, bag: Path) -> tuple[set[int], int]:
        """Return the blocks that ``bag`` holds, and how many of its messages are none of ours or twice."""
        kept: set[int] = set()
        foreign = 0
        for one in BagReader(bag, skip_damage=True).blocks("valve_1"):
            known = self.blocks.get(one.sequence)
            foreign += known is None or known != one.body.tobytes() or one.sequence in kept
            kept.add(one.sequence)
        return kept, foreign


def _records(path: Path) -> list[tuple[int, int, int]]:
    data, at, found = path.read_bytes(), len(MAGIC), []
    while at + FRAME.size <= len(data) - len(MAGIC):
        opcode, length = FRAME.unpack_from(data, at)
        found.append((opcode, at, at + FRAME.size + length))
        at += FRAME.size + length
    return found


def _saved(bag: Path, folder: Path) -> tuple[Path | None, RecoveryResult | None, str]:
    """Recover ``bag``; return where, and one line where nothing was recovered."""
    target = folder / "recovered"
    try:
        return target, recover(bag, target), ""
    except InputError as error:
        return None, None, str(error)


def _longest(missing: set[int]) -> int:
    longest = run = 0
    for number in range(BLOCKS):
        run = run + 1 if number in missing else 0
        longest = max(longest, run)
    return longest


def _judged(
    fault: str, seed: int, contents: Contents, bag: Path, folder: Path, promised: set[int], *, noticed: bool
) -> Outcome:
    target, result, refusal = _saved(bag, folder)
    if target is None or result is None:
        return Outcome(fault, seed, BLOCKS, BLOCKS * STEP, wrong=refusal)
    kept, foreign = contents.foreign(target)
    missing = set(contents.blocks) - kept
    stated = bool(result.lost or result.damages or result.warnings or not result.closed)
    wrong = ""
    if noticed and not verify(bag).wrong and not verify(bag).notes:
        wrong = "verify saw nothing"
    return Outcome(
        fault,
        seed,
        len(missing & promised),
        STEP * _longest(missing & promised),
        0 if stated else len(missing),
        foreign,
        wrong=wrong,
    )


def truncation(contents: Contents, folder: Path, seed: int) -> Outcome:
    """Cut a file off in or behind a record of any kind: all complete ones before it are kept."""
    draw = random.Random(seed)
    bag = Path(shutil.copytree(contents.bag, folder / "bag"))
    name = draw.choice(sorted(contents.records))
    kinds = sorted({record[0] for record in contents.records[name]})
    kind = draw.choice(kinds)
    _, begin, end = draw.choice([record for record in contents.records[name] if record[0] == kind])
    cut = draw.choice([begin, end, draw.randint(begin, end), draw.randint(begin, min(begin + 9, end))])
    data = (bag / name).read_bytes()[:cut]
    (bag / name).write_bytes(data)
    promised = set(contents.blocks) - _numbers(contents, name, lambda first, last: last > cut)
    if not any(opcode == Opcode.CHUNK and last <= cut for opcode, _, last in contents.records[name]):
        promised -= _numbers(contents, name, lambda first, last: True)
    return _judged("truncation", seed, contents, bag, folder, promised, noticed=True)


def _numbers(contents: Contents, name: str, wanted: Callable[[int, int], bool]) -> set[int]:
    """Return the blocks that lie in the chunks of a file at ``wanted`` places."""
    chunks = [(begin, end) for opcode, begin, end in contents.records[name] if opcode == Opcode.CHUNK]
    counts = [sum(1 for _ in McapFile(contents.bag / name).records(lambda _: True))]
    first = _first(contents, name)
    numbers: set[int] = set()
    at = first
    for (begin, end), count in zip(chunks, _per_chunk(contents.bag / name), strict=True):
        if wanted(begin, end):
            numbers |= set(range(at, at + count))
        at += count
    assert at - first == counts[0]
    return numbers


def _first(contents: Contents, name: str) -> int:
    return next(iter(BagReader(contents.bag / name).blocks("valve_1"))).sequence


def _per_chunk(path: Path) -> list[int]:
    file = McapFile(path)
    counts: list[int] = []
    for batch in file.batches(lambda _: True):
        counts.append(len(batch.places))
    return [count for count in counts if count]


def _changed(
    fault: str, contents: Contents, folder: Path, seed: int, change: Callable[[bytearray, random.Random], int]
) -> Outcome:
    draw = random.Random(seed)
    bag = Path(shutil.copytree(contents.bag, folder / "bag"))
    name = draw.choice(sorted(contents.records))
    data = bytearray((bag / name).read_bytes())
    before = bytes(data)
    change(data, draw)
    (bag / name).write_bytes(data)
    return _judged(fault, seed, contents, bag, folder, set(contents.blocks), noticed=bytes(data) != before)


def flipped_bit(contents: Contents, folder: Path, seed: int) -> Outcome:
    """Change one bit: it costs a chunk at most, which is reported, and ``verify`` names the file."""

    def change(data: bytearray, draw: random.Random) -> int:
        at = draw.randrange(len(data))
        data[at] ^= 1 << draw.randrange(8)
        return at

    return _changed("flipped bit", contents, folder, seed, change)


def zeroed_sector(contents: Contents, folder: Path, seed: int) -> Outcome:
    """Zero 512 bytes, as a disk does that lost a sector."""

    def change(data: bytearray, draw: random.Random) -> int:
        at = draw.randrange(0, len(data) - 512, 512)
        data[at : at + 512] = bytes(512)
        return at

    return _changed("zeroed sector", contents, folder, seed, change)


def corrupted_state(contents: Contents, folder: Path, seed: int) -> Outcome:
    """Damage the monitor's state: loading gives the newest whole one, or the one before, and says so."""
    draw = random.Random(seed)
    folder.mkdir(parents=True)
    path = folder / FILE
    writer = StateFile(folder, print)
    states = [{"alarms": [number] * 5, "baseline": {"k": 5847.0 + number}} for number in range(3)]
    for state in states:
        writer.save("state", state)
    writer.close()
    data = bytearray(path.read_bytes())
    kind = draw.randrange(5)
    if kind == 0:
        data = data[: draw.randrange(len(data))]
    elif kind == 1:
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    elif kind == 2:
        data = bytearray(draw.randbytes(len(data)))
    elif kind == 3:
        data = bytearray(b"[" * 20_000)
    else:
        data[60:64] = draw.randbytes(4)  # the version
    path.write_bytes(data)
    said: list[str] = []
    found = StateFile(folder, said.append).load(["state"]).get("state")
    wrong = "" if found in states[1:] else f"it loaded {str(found)[:80]}"
    if found != states[2] and not said:
        wrong = "nothing was said"
    return Outcome("corrupted state", seed, wrong=wrong)


#: Faults by their names.
FAULTS: dict[str, Callable[[Contents, Path, int], Outcome]] = {
    "truncation": truncation,
    "flipped bit": flipped_bit,
    "zeroed sector": zeroed_sector,
    "corrupted state": corrupted_state,
}
