"""What a recorder writes about the parts of a recording: records in each part, and ``parts.sha256``."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import count
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata
from spool_core.system import sync_folder, write_durably

from spool_bag.mcap_record import BAD_BYTES, FRAME, MAGIC

#: Names of the metadata records at a part's beginning and wherever messages were lost.
BEGIN, LOSSES = "spool_part", "spool_losses"
#: B of a metadata record that is read; ours have some hundred.
LARGEST = 1 << 16
FILE_NAME = "parts.sha256"
#: The name of a list that the recorder found changed when it was started; it goes on with a new one.
DISTRUSTED = "parts.sha256.distrusted"
#: Used instead of a hash: of a part that is written, and of one that could not be read at a restart.
UNDER_WAY, UNREADABLE = "-", "0" * 64
#: The hash before the first line.
_NOTHING = "0" * 64
_HEAD = re.compile(r"spool_parts 1 from (\d{1,18})")
_LINE = re.compile(r"(\d{1,18}) (-|[0-9a-f]{64}) ([0-9a-f]{64})(?: ([0-9a-f]{64}))?")
_SIGNED = re.compile(r"signed ([0-9a-f]{128})")
_PIECE = 1 << 20


@dataclass(frozen=True, slots=True)
class PartBegin:
    """Beginning of a part: its ``number``, and what happened since the part before.

    ``repeated_at``: log time (ns) of latched messages that are repeated, 0 for none. ``lost``: messages that
    were not recorded since the part before, by what ``reason``. ``cut_off``: the recorder before did not end,
    though its last part was finished.
    """

    number: int
    repeated_at: int = 0
    lost: int = 0
    reason: str = ""
    cut_off: bool = False

    def content(self) -> dict[str, str]:
        """Return what the metadata record holds."""
        return {
            "number": str(self.number),
            "repeated_at_ns": str(self.repeated_at),
            "lost_messages": str(self.lost),
            "lost_because": self.reason,
            "cut_off": str(int(self.cut_off)),
        }

    @classmethod
    def of(cls, told: Mapping[str, str]) -> PartBegin:
        """Return what a metadata record says; numbers that are none are 0."""
        return cls(
            _number(told.get("number", "")),
            _number(told.get("repeated_at_ns", "")),
            _number(told.get("lost_messages", "")),
            told.get("lost_because", ""),
            told.get("cut_off", "") == "1",
        )


def begin_of(path: Path) -> PartBegin | None:
    """Return what a part's first record says, ``None`` where it has none."""
    told = _begin(path)
    return PartBegin.of(told) if told is not None else None


def losses_of(path: Path) -> list[dict[str, str]]:
    """Return what a part's records say was lost while it was written, in order."""
    return [record.metadata for record in _records(path) if record.name == LOSSES]


def is_chained(path: Path) -> bool:
    """Return whether a part bears the hash of the part before it, as those of earlier releases do."""
    return "previous_sha256" in (_begin(path) or {})


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


def _begin(path: Path) -> dict[str, str] | None:
    """Return what the record behind the file's header says."""
    return next((record.metadata for record in _records(path, 2) if record.name == BEGIN), None)


def _records(path: Path, most: int | None = None) -> Iterator[Metadata]:
    """Yield the metadata records of a file among the first ``most``, up to what cannot be read."""
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                return
            for _ in range(most) if most is not None else count():
                opcode, length = FRAME.unpack(stream.read(FRAME.size))
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    return
                if opcode == Opcode.METADATA and length <= LARGEST:
                    content = stream.read(length)
                    if len(content) < length:
                        return
                    yield Metadata.read(ReadDataStream(BytesIO(content)))
                else:
                    stream.seek(length, 1)
    except (OSError, *BAD_BYTES):
        return


def _number(text: str) -> int:
    """Return the number that ``text`` is, else 0."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0


@dataclass(frozen=True, slots=True)
class PartLine:
    """Line of a part: its ``number``, file's SHA-256, hash of the line ``before``, of its thinned file."""

    number: int
    sha256: str
    before: str
    thinned: str = ""

    @property
    def link(self) -> str:
        """Hash by which the next line names this one; thinning leaves it as it is."""
        return hashlib.sha256(f"{self.number} {self.sha256} {self.before}".encode()).hexdigest()

    def __str__(self) -> str:
        return f"{self.number} {self.sha256} {self.before} {self.thinned}".rstrip()


@dataclass(frozen=True, slots=True)
class PartLines:
    """Lines as read: the number ``first`` with which the list began, ``wrong`` lines, what is ``signed``."""

    first: int
    lines: tuple[PartLine, ...]
    wrong: tuple[str, ...]
    signed: str
    signature: str


def parsed(text: str) -> PartLines:
    """Return the lines of a list; each wrong one is described."""
    rows = text.split("\n")
    signature = ""
    if rows[-1]:
        rows.append("")  # its last line was cut, which the pattern of a line shows
    rows.pop()
    if rows and (match := _SIGNED.fullmatch(rows[-1])):
        signature = match[1]
        rows.pop()
    head = _HEAD.fullmatch(rows[0]) if rows else None
    first = int(head[1]) if head else 0
    wrong = [] if head else [f"{FILE_NAME}, line 1: it was edited"]
    lines: list[PartLine] = []
    for place, row in enumerate(rows[1:], 2):
        match = _LINE.fullmatch(row)
        if match is None:
            wrong.append(f"{FILE_NAME}, line {place}: it was edited")
            continue
        line = PartLine(int(match[1]), match[2], match[3], match[4] or "")
        if lines:
            before = lines[-1]
            follows = (line.before, before.sha256 == UNDER_WAY) == (before.link, False)
            follows = follows and line.number > before.number
        else:
            follows = line.number > first or (line.number == first and line.before == _NOTHING)
        if not follows:
            wrong.append(
                f"{FILE_NAME}, line {place}: it does not follow line {place - 1}: one of both was edited, "
                "or lines between them were removed"
            )
        lines.append(line)
    return PartLines(first, tuple(lines), tuple(wrong), _digest(rows), signature)


class PartList:
    """List of the parts of the recording in ``folder``, as its recorder keeps it.

    It shows parts that were edited, removed or exchanged: a line a part with its number, the SHA-256 of its
    file (``-`` while it is written), the hash of the line before, and the SHA-256 of the file that replaced a
    thinned part. The last line is a signature of all others (Ed25519, RFC 8032), so nobody without the key
    can write another list.

    A list that is damaged, or not signed by ``sign``, is set aside: the next signature would vouch for it.
    ``files`` are the existing parts by number; those before ``oldest`` were removed by the recorder.

    Attributes:
        next: number of the next part.

    Raises:
        OSError: from any method, if the folder cannot be read or written.
    """

    def __init__(
        self, folder: Path, sign: Callable[[str], str] | None, files: Sequence[tuple[int, Path]], oldest: int
    ) -> None:
        self._path, self._sign = folder / FILE_NAME, sign
        self._first = self.next = files[-1][0] + 1 if files else 0
        self._lines: list[PartLine] = []
        try:
            found: PartLines | None = parsed(self._path.read_text("ascii", "replace"))
        except FileNotFoundError:
            return
        except OSError:
            found = None
        if found is None or found.wrong or (sign is not None and sign(found.signed) != found.signature):
            self._path.replace(folder / DISTRUSTED)
            return
        self._first, self._lines = found.first, list(found.lines)
        if self._lines and self._lines[-1].sha256 == UNDER_WAY:  # the recorder before did not end it
            path = dict(files).get(self._lines.pop().number)
            if path is not None:
                sha256 = UNREADABLE
                with suppress(OSError):
                    sha256 = file_hash(path)
                self._lines.append(replace(found.lines[-1], sha256=sha256))
        self.next = max(self.next, self._first, *(line.number + 1 for line in self._lines[-1:]))
        self._lines = [line for line in self._lines if line.number >= oldest]

    def begin(self, number: int, ended: str = "") -> None:
        """Name the next part, before its file exists, and the hash of the part that was ``ended``."""
        if ended:
            self._close(ended)
        self._lines.append(PartLine(number, UNDER_WAY, self._lines[-1].link if self._lines else _NOTHING))
        self._write()

    def end(self, sha256: str) -> None:
        """State the hash of the last part."""
        self._close(sha256)
        self._write()

    def forget(self, oldest: int) -> None:
        """Leave out the parts before ``oldest``, before their files are removed."""
        self._lines = [line for line in self._lines if line.number >= oldest]
        self._write()

    def thin(self, number: int, sha256: str) -> None:
        """State the hash of the file that is about to replace a part."""
        self._lines = [
            replace(line, thinned=sha256) if line.number == number else line for line in self._lines
        ]
        self._write()

    def hashes(self, number: int) -> tuple[str, ...]:
        """Return the SHA-256 that the file of a part may have."""
        return next(((line.sha256, line.thinned) for line in self._lines if line.number == number), ())

    def _close(self, sha256: str) -> None:
        self._lines[-1] = replace(self._lines[-1], sha256=sha256)

    def _write(self) -> None:
        rows = [f"spool_parts 1 from {self._first}", *map(str, self._lines)]
        if self._sign is not None:
            rows.append(f"signed {self._sign(_digest(rows))}")
        write_durably(self._path, "\n".join(rows) + "\n")
        sync_folder(self._path.parent)


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        OSError: it cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while piece := stream.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()


def _digest(rows: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()
