"""Chain of the parts of a recording: what makes removed, reordered or repeated pieces visible.

What is edited, removed or exchanged afterwards breaks the chain; with a signature (Ed25519, RFC 8032) nobody
without the key can repair it.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from spool_bag.mcap_record import FRAME, LARGEST_SUMMARY, MAGIC

#: Names of the metadata records at a part's beginning and end, wherever messages were lost, and before parts
#: go by the quota.
BEGIN, END, LOSSES, QUOTA = "spool_part", "spool_chain", "spool_losses", "spool_quota"
#: Used instead of the hash of a part that could not be read when the next one was begun.
UNREADABLE = "unreadable"
#: B of a metadata record that is read; ours have some hundred.
LARGEST = 1 << 16
_PIECE = 1 << 20
#: Kinds of records of a summary (MCAP specification, "Summary Section" and "Summary Offset Section").
_INDEX = {
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.CHUNK_INDEX,
    Opcode.STATISTICS, Opcode.SUMMARY_OFFSET,
}  # fmt: skip
#: What follows the last record: data ends here, without a checksum.
_DATA_END = FRAME.pack(Opcode.DATA_END, 4) + bytes(4)


@dataclass(frozen=True, slots=True)
class PartBegin:
    """Beginning of a part: its ``number``, the hash of the part ``before``, and what happened since that.

    ``repeated_at``: log time (ns) of latched messages that are repeated, 0 for none. ``lost``: messages that
    were not recorded since the part before, by what ``reason``. ``file``: hash of the whole file of the part
    before, its index included, where it was finished; ``oldest``: number of the oldest part then.
    ``cut_off``: the recorder before did not end, though its last part was finished.
    """

    number: int
    before: str = ""
    repeated_at: int = 0
    lost: int = 0
    reason: str = ""
    file: str = ""
    oldest: int = 0
    cut_off: bool = False

    def content(self) -> dict[str, str]:
        """Return what the metadata record holds."""
        return {
            "number": str(self.number),
            "previous_sha256": self.before,
            "repeated_at_ns": str(self.repeated_at),
            "lost_messages": str(self.lost),
            "lost_because": self.reason,
            "previous_file_sha256": self.file,
            "oldest_part": str(self.oldest),
            "cut_off": str(int(self.cut_off)),
        }

    @classmethod
    def of(cls, told: Mapping[str, str]) -> PartBegin:
        """Return what a metadata record says; numbers that are none are 0."""
        return cls(
            _number(told.get("number", "")),
            told.get("previous_sha256", ""),
            _number(told.get("repeated_at_ns", "")),
            _number(told.get("lost_messages", "")),
            told.get("lost_because", ""),
            told.get("previous_file_sha256", ""),
            _number(told.get("oldest_part", "")),
            told.get("cut_off", "") == "1",
        )


@dataclass(frozen=True, slots=True)
class PartEnd:
    """End of a part: SHA-256 of all bytes before it, the number of the oldest part then, the signature.

    A part that the recorder thinned later keeps these, and ``thinned`` is the hash of the remaining part.
    """

    number: int
    content: str
    before: str
    oldest: int
    signature: str = ""
    thinned: str = ""
    thinned_signature: str = ""

    @property
    def link(self) -> str:
        """Hash by which the next part names this one."""
        return link_of(self.number, self.content, self.before, self.oldest)

    @property
    def thinned_link(self) -> str:
        """Hash that is signed of a thinned part."""
        return hashlib.sha256(f"{self.link}\n{self.thinned}".encode()).hexdigest()

    def record(self) -> dict[str, str]:
        """Return what the metadata record holds."""
        told = {
            "number": str(self.number),
            "content_sha256": self.content,
            "previous_sha256": self.before,
            "oldest_part": str(self.oldest),
            "signature_ed25519": self.signature,
            "part_sha256": self.link,
        }
        if self.thinned:
            told |= {"thinned_sha256": self.thinned, "thinned_signature_ed25519": self.thinned_signature}
        return told

    @classmethod
    def of(cls, told: Mapping[str, str]) -> PartEnd:
        """Return what a metadata record says; numbers that are none are -1."""
        return cls(
            _number(told.get("number", ""), -1),
            told.get("content_sha256", ""),
            told.get("previous_sha256", ""),
            _number(told.get("oldest_part", ""), -1),
            told.get("signature_ed25519", ""),
            told.get("thinned_sha256", ""),
            told.get("thinned_signature_ed25519", ""),
        )


def link_of(number: int, content: str, before: str, oldest: int) -> str:
    """Return the hash that stands for a finished part."""
    return hashlib.sha256(f"{number}\n{content}\n{before}\n{oldest}".encode()).hexdigest()


def begin_of(path: Path) -> PartBegin | None:
    """Return what a part's first record says, ``None`` where it has none."""
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                return None
            for _ in range(2):  # the file's header, then ours
                opcode, length = FRAME.unpack(stream.read(FRAME.size))
                if length > LARGEST:
                    return None
                content = stream.read(length)
                if opcode == Opcode.METADATA:
                    name, told = _pairs(content)
                    if name == BEGIN:
                        return PartBegin.of(told)
    except (OSError, ValueError, struct.error):
        return None
    return None


class Ended(NamedTuple):
    """End of a part, the SHA-256 of the bytes before it, whether it and the kinds of records behind it are as
    written, the SHA-256 of the whole ``file``, and whether it is ``cut`` off behind its end."""

    end: PartEnd
    content: str
    sound: bool
    file: str
    cut: bool


def end_of(path: Path) -> Ended | None:
    """Return what a part's last record says, and what the bytes say; ``None`` without one.

    Raises:
        OSError: the file cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        digest.update(stream.read(len(MAGIC)))
        for opcode, head, length in _frames(stream):
            if opcode == Opcode.METADATA and length <= LARGEST:
                content = stream.read(length)
                try:
                    name, told = _pairs(content)
                except (ValueError, struct.error):
                    name, told = "", {}
                if name == END:
                    end = PartEnd.of(told)
                    before = digest.hexdigest()
                    rest = stream.read(LARGEST_SUMMARY + 1)
                    digest.update(head + content + rest)
                    sound, cut = _judge_tail(rest)
                    same = end.record() == told
                    return Ended(end, before, same and sound, digest.hexdigest(), same and cut)
                digest.update(head + content)
                continue
            digest.update(head)
            left = length
            while left:
                piece = stream.read(min(left, _PIECE))
                if not piece:
                    return None
                digest.update(piece)
                left -= len(piece)
    return None


def oldest_of(path: Path) -> int:
    """Return the number of the oldest part that the part at ``path`` tells of, 0 where it tells of none."""
    begin = begin_of(path)
    numbers = [_number(told.get("oldest_part", "")) for told in _told(path, QUOTA)]
    return max([begin.oldest if begin is not None else 0, *numbers])


def losses_of(path: Path) -> list[dict[str, str]]:
    """Return what a part's records say was lost while it was written, in order."""
    return _told(path, LOSSES)


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, by which a part is named that was never finished."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while piece := stream.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()


def is_stub(path: Path) -> bool:
    """Return whether a file ends within its first records, as a recorder leaves it that is killed there.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as stream:
        data = stream.read(2 * LARGEST)
    at = len(MAGIC)
    if not MAGIC.startswith(data[:at]):
        return False
    for expected in (Opcode.HEADER, Opcode.METADATA):
        if at + FRAME.size > len(data):
            return data[at : at + 1] in (b"", bytes([expected]))
        opcode, length = FRAME.unpack_from(data, at)
        if opcode != expected:
            return False
        at += FRAME.size + length
    return at > len(data)


def _judge_tail(rest: bytes) -> tuple[bool, bool]:
    """Return whether ``rest`` is the end of the data, index records alone, footer and magic, and whether it
    is the beginning of these."""
    at = len(_DATA_END)
    if not _DATA_END.startswith(rest[:at]):
        return False, False
    while at + FRAME.size <= len(rest):
        opcode, length = FRAME.unpack_from(rest, at)
        at += FRAME.size + length
        if opcode == Opcode.FOOTER:
            return rest[at:] == MAGIC, rest[at:] != MAGIC and MAGIC.startswith(rest[at:])
        if opcode not in _INDEX:
            return False, False
    return False, True


def _told(path: Path, wanted: str) -> list[dict[str, str]]:
    """Return the metadata records of a part that are named ``wanted``."""
    found: list[dict[str, str]] = []
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                return found
            for opcode, _, length in _frames(stream):
                if opcode == Opcode.METADATA and length <= LARGEST:
                    name, told = _pairs(stream.read(length))
                    if name == wanted:
                        found.append(told)
                else:
                    stream.seek(length, 1)
    except (OSError, ValueError, OverflowError, struct.error):
        return found
    return found


def _number(text: str, otherwise: int = 0) -> int:
    """Return the number that ``text`` is, else ``otherwise``."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else otherwise


def _frames(stream: BinaryIO) -> Iterator[tuple[int, bytes, int]]:
    """Yield opcode, head and length of each record; the caller reads the content of those that it takes."""
    while len(head := stream.read(FRAME.size)) == FRAME.size:
        opcode, length = FRAME.unpack(head)
        yield opcode, head, length
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return


def _pairs(content: bytes) -> tuple[str, dict[str, str]]:
    """Return name and pairs of a metadata record (MCAP specification, "Metadata")."""
    at = 0

    def text() -> str:
        nonlocal at
        (size,) = struct.unpack_from("<I", content, at)
        if at + 4 + size > len(content):
            raise ValueError("a text is longer than its record")
        found = content[at + 4 : at + 4 + size].decode("utf-8", "replace")
        at += 4 + size
        return found

    name = text()
    (size,) = struct.unpack_from("<I", content, at)
    at += 4
    end = at + size
    if end > len(content):
        raise ValueError("the pairs are longer than their record")
    pairs: dict[str, str] = {}
    while at < end:
        key = text()
        pairs[key] = text()
    return name, pairs
