"""CDR of an AccelerationBlock and of what is measured beside it: written and read without ROS.

Layout: OMG DDSI-RTPS 2.5, 10.2 (encapsulation) and XCDR1; every primitive is aligned to its own size
counted from the end of the four encapsulation bytes.
"""

from __future__ import annotations

import functools
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from spool_core.block import Block, Samples

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
NANOSECONDS = 1_000_000_000
#: B of a ``frame_id`` that are kept, as long as a file's name may be.
LONGEST_NAME = 256


class _Order:
    def __init__(self, mark: str) -> None:
        self.mark = mark
        self.head = struct.Struct(mark + "iII")
        self.counts = struct.Struct(mark + "QdI")
        self.count = struct.Struct(mark + "I")
        self.number = struct.Struct(mark + "d")
        self.pair = struct.Struct(mark + "dd")
        self.samples = np.dtype(mark + "f4")


_LITTLE, _BIG = _Order("<"), _Order(">")


class CdrError(ValueError):
    """CDR bytes are not those of the expected message."""


@dataclass(frozen=True, slots=True)
class OilTemperature:
    """``stamp`` in ns, ``celsius`` in deg C, ``variance`` in deg C squared, 0: unknown."""

    stamp: int
    celsius: float
    variance: float = 0.0


@dataclass(frozen=True, slots=True)
class Speed:
    """``stamp`` in ns, ``rpm`` of the machine's shaft in rev/min."""

    stamp: int
    rpm: float


@dataclass(frozen=True, slots=True)
class Command:
    """``stamp`` in ns, ``value`` of the solenoid's command in any unit; 0 is the position that is judged."""

    stamp: int
    value: float


#: Slow readings beside the blocks.
Reading = OilTemperature | Speed | Command


def header_stamp(data: bytes) -> int:
    """Return the stamp (ns) of a message whose first field is a std_msgs/Header.

    Raises:
        CdrError: the bytes are too short or not XCDR1.
    """
    return _header(data)[1]


def block_head(data: bytes) -> tuple[int, int]:
    """Return sequence and stamp (ns) in the CDR of an AccelerationBlock without decoding its samples.

    Raises:
        CdrError: the bytes are too short or not XCDR1.
    """
    order, stamp, _, at = _header(data)
    return _unpacked(order.counts, data, at, "not an AccelerationBlock")[0], stamp


def decode_block(data: bytes) -> Block:
    """Return the block in the CDR ``data`` of an AccelerationBlock; its samples are read-only views.

    Raises:
        CdrError: the bytes are too short or not XCDR1.
    """
    order = _order(data)
    try:
        return _block(order, data, 4)[0]
    except (struct.error, ValueError) as error:
        raise CdrError(f"not an AccelerationBlock: {error}") from error


def decode_blocks(data: bytes) -> list[tuple[str, Block]]:
    """Return each name and its block in the CDR ``data`` of an AccelerationBlocks; samples as of one block.

    Raises:
        CdrError: the bytes are too short or not XCDR1, or there is not one block for each name.
    """
    order, names, found = _order(data), [], []
    try:
        (count,), at = order.count.unpack_from(data, 4), 8
        for _ in range(count):
            (length,) = order.count.unpack_from(data, at)
            names.append(_text(data[at + 4 : at + 3 + min(length, LONGEST_NAME)]))
            at = (at + 7 + length) & ~3
        (blocks,), at = order.count.unpack_from(data, at), at + 4
        if blocks != count:
            raise ValueError(f"{count} names and {blocks} blocks")
        for name in names:
            block, at = _block(order, data, at)
            found.append((name, block))
    except (struct.error, ValueError) as error:
        raise CdrError(f"not an AccelerationBlocks: {error}") from error
    return found


def decode_vector(data: bytes, skipped: int, numbers: int) -> tuple[int, str, tuple[float, ...]]:
    """Return stamp (ns; 0 for no time), ``frame_id`` and ``numbers`` doubles of a message with a header.

    They begin ``skipped`` B behind the header, as the acceleration of an Imu (200), AccelStamped or
    Vector3Stamped (0) does.

    Raises:
        CdrError: the bytes are too short or not XCDR1.
    """
    order = _order(data)
    try:
        seconds, nanoseconds, length = order.head.unpack_from(data, 4)
        at = ((12 + length + 7) & ~7) + 4 + skipped
        found = struct.unpack_from(f"{order.mark}{numbers}d", data, at)
    except struct.error as error:
        raise CdrError(f"not a message of this type: {error}") from error
    stamp = seconds * NANOSECONDS + nanoseconds if nanoseconds < NANOSECONDS else 0
    return stamp, _text(data[16 : 15 + min(length, LONGEST_NAME)]), found


def encode_block(block: Block, frame_id: str) -> bytes:
    """Return ``block`` as little-endian CDR of an AccelerationBlock."""
    head = _encode_header(block.stamp, frame_id)
    counts = struct.pack("<QdI", block.sequence, block.sample_period, block.body.size)
    rest = struct.pack("<I", block.spool.size)
    return b"".join((head, counts, _little(block.body), rest, _little(block.spool)))


def encode_temperature(item: OilTemperature, frame_id: str) -> bytes:
    """Return ``item`` as little-endian CDR of a sensor_msgs/Temperature."""
    return _encode_header(item.stamp, frame_id) + struct.pack("<dd", item.celsius, item.variance)


def decode_temperature(data: bytes) -> OilTemperature:
    """Return the oil temperature in the CDR of a sensor_msgs/Temperature.

    Raises:
        CdrError: the bytes are too short or not XCDR1.
    """
    order, stamp, _, at = _header(data)
    return OilTemperature(stamp, *_unpacked(order.pair, data, at, "not a Temperature"))


def encode_speed(item: Speed) -> bytes:
    """Return ``item`` as little-endian CDR of a std_msgs/Float64, which has no stamp."""
    return LITTLE_ENDIAN + struct.pack("<d", item.rpm)


def decode_speed(data: bytes, stamp: int) -> Speed:
    """Return the speed at ``stamp`` (ns) in the CDR of a std_msgs/Float64.

    Raises:
        CdrError: the bytes are too short or not XCDR1.
    """
    return Speed(stamp, _decode_number(data))


def decode_command(data: bytes, stamp: int) -> Command:
    """Return the command at ``stamp`` (ns) in the CDR of a std_msgs/Float64; errors as of a speed."""
    return Command(stamp, _decode_number(data))


def _decode_number(data: bytes) -> float:
    return float(_unpacked(_order(data).number, data, 4, "not a Float64")[0])


def _unpacked(layout: struct.Struct, data: bytes, at: int, fault: str) -> tuple[Any, ...]:
    try:
        return layout.unpack_from(data, at)
    except struct.error as error:
        raise CdrError(f"{fault}: {error}") from error


def _order(data: bytes) -> _Order:
    if data[:4] == LITTLE_ENDIAN:  # as nearly all are
        return _LITTLE
    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise CdrError("unknown CDR encapsulation")
    return _LITTLE if data[1] else _BIG


def _block(order: _Order, data: bytes, at: int) -> tuple[Block, int]:
    """Return the block that begins at ``at``, and where it ends."""
    seconds, nanoseconds, length = order.head.unpack_from(data, at)
    source = _text(data[at + 12 : at + 11 + min(length, LONGEST_NAME)])
    at = ((at + 8 + length + 7) & ~7) + 4
    sequence, period, count = order.counts.unpack_from(data, at)
    at += 20
    body = np.frombuffer(data, order.samples, count, at)
    at += 4 * count
    (count,) = order.count.unpack_from(data, at)
    spool = np.frombuffer(data, order.samples, count, at + 4)
    if order is _BIG:
        body, spool = body.astype(np.float32), spool.astype(np.float32)
    stamp = seconds * NANOSECONDS + nanoseconds
    return Block(stamp, sequence, period, body, spool, source), at + 4 + 4 * count


def _header(data: bytes) -> tuple[_Order, int, int, int]:
    """Return byte order, stamp (ns), length of the ``frame_id``, where an 8-byte field behind it starts."""
    order = _order(data)
    seconds, nanoseconds, length = _unpacked(order.head, data, 4, "message is shorter than a header")
    return order, seconds * NANOSECONDS + nanoseconds, length, ((12 + length + 7) & ~7) + 4


def _encode_header(stamp: int, frame_id: str) -> bytes:
    """Return encapsulation and header, padded for an eight-byte field to follow."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    name = frame_id.encode() + b"\x00"
    head = struct.pack("<iII", seconds, nanoseconds, len(name)) + name
    return LITTLE_ENDIAN + head + b"\x00" * (-len(head) % 8)


@functools.lru_cache(maxsize=1024)
def _text(name: bytes) -> str:
    """Return a ``frame_id``; the same few come with every block."""
    return name.decode("utf-8", "replace")


def _little(samples: Samples) -> bytes:
    return np.ascontiguousarray(samples, "<f4").tobytes()
