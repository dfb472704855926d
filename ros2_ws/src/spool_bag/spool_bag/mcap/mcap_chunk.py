"""Chunk of an MCAP file: decompression within bounds, whatever its head claims."""

from __future__ import annotations

import threading
import zlib

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from .mcap_record import ChunkHead

#: B of one chunk, packed or not. Writers close theirs at 1 MB (rosbag2: 768 kB, Foxglove: 4 MB) or after
#: one message.
LARGEST_CHUNK = 1 << 27
#: Unpacked over packed bytes of a file as a whole, beyond ``FREE_EXPANSION``; blocks of zeros give 40.
LARGEST_RATIO = 1000
FREE_EXPANSION = 1 << 28


class _Decompressor(threading.local):
    """Decompressor of a thread: to make one costs as much as to unpack a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_THREAD = _Decompressor()


class ChunkError(ValueError):
    """Chunk that is not what its head says."""


def unpack(head: ChunkHead, content: bytes) -> bytes:
    """Return the records in the chunk ``content`` (with its head).

    Raises:
        ChunkError: larger than ``LARGEST_CHUNK`` or than it claims, not unpackable, or a wrong checksum.
    """
    size = head.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ChunkError(f"a chunk claims {size} bytes, more than the {LARGEST_CHUNK} that are unpacked")
    packed = memoryview(content)[head.start :]
    if head.compression == "zstd":
        data = _zstd(packed, size)
    elif head.compression == "lz4":
        data = _lz4(packed, size)
    else:
        data = bytes(packed)
    if len(data) != size:
        raise ChunkError(f"a chunk holds {len(data)} bytes where it claims {size}")
    if head.uncompressed_crc and zlib.crc32(data) != head.uncompressed_crc:
        raise ChunkError("the checksum of a chunk is wrong")
    return data


def _zstd(packed: memoryview, size: int) -> bytes:
    try:
        claimed = zstandard.get_frame_parameters(packed).content_size
        if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ChunkError(f"a chunk unpacks to {claimed} bytes where it claims {size}")
        return _THREAD.zstd.decompress(packed, max_output_size=size) if size else b""
    except zstandard.ZstdError as error:
        raise ChunkError(f"a chunk cannot be unpacked ({error})") from error


def _lz4(packed: memoryview, size: int) -> bytes:
    try:
        return bytes(LZ4FrameDecompressor().decompress(bytes(packed), max_length=size + 1))
    except (RuntimeError, EOFError) as error:
        raise ChunkError(f"a chunk cannot be unpacked ({error})") from error
