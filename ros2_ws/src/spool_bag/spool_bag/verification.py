"""Verification of recordings: signatures, what was edited, removed or reordered; recovery of damaged ones."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from spool_core.block import Block
from spool_core.block_gate import BlockGate
from spool_core.errors import InputError
from spool_core.files import YamlError
from spool_core.system import OPEN_FLAGS, expanded
from spool_core.text import printable

from spool_bag.mcap_file import Damage, McapFile
from spool_bag.mcap_record import Topic
from spool_bag.metadata import Definition, part_of, qos_of, read_metadata
from spool_bag.part_chain import UNREADABLE, Ended, PartBegin, begin_of, end_of, file_hash, is_stub, oldest_of
from spool_bag.parts import numbered
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter

#: Times that a folder is looked at again, as parts of a running recording go by the quota meanwhile.
TRIES = 5


@dataclass(slots=True)
class Verification:
    """Verification of a recording: ``wrong`` what was done to it, ``notes`` what is to be known, a line each.

    ``parts`` were looked at, ``signed`` of these bear a signature by the key;
    ``newest_sha256`` is the hash of the last one, which stands for all.
    """

    recording: Path
    parts: int = 0
    signed: int = 0
    newest_sha256: str = ""
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def verify(folder: Path, key: Path | None = None) -> Verification:
    """Return what was done to the recording in ``folder`` since it was written.

    A part is whole where the SHA-256 of its bytes is the one in its last record; parts follow each
    other where each one names the hash of that before it. With the public ``key`` each hash must be signed
    by its owner.

    Raises:
        InputError: there is no recording in parts, or the key is none.
    """
    for _ in range(TRIES - 1):
        with contextlib.suppress(FileNotFoundError):
            return _verify(folder, key)
    try:
        return _verify(folder, key)
    except FileNotFoundError as error:
        raise InputError(f"{error.filename}: it disappeared during verification") from None


def make_keys(folder: Path) -> tuple[Path, Path]:
    """Write a new private and public key (PEM) into ``folder`` and return their paths.

    Raises:
        InputError: the folder cannot be written to, or has keys already.
    """
    from cryptography.hazmat.primitives import serialization as pem  # noqa: PLC0415 - only who signs needs it
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415

    private, public = folder / "spool_private.pem", folder / "spool_public.pem"
    key = Ed25519PrivateKey.generate()
    secret = key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())
    shown = key.public_key().public_bytes(pem.Encoding.PEM, pem.PublicFormat.SubjectPublicKeyInfo)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content, mode in ((private, secret, 0o600), (public, shown, 0o644)):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, mode)
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(content)
    except FileExistsError as error:
        raise InputError(f"{error.filename}: already exists: name another folder") from error
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror}") from error
    return private, public


def signer(key: str) -> Callable[[str], str] | None:
    """Return what signs a hash with the private key in the file ``key``, ``None`` without one.

    Raises:
        InputError: it is no such key.
    """
    if not key:
        return None
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

    path = expanded(key)
    try:
        found = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise InputError(f"signing_key: {path}: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise InputError(f"signing_key: {path}: no private key without a password in PEM") from error
    if not isinstance(found, Ed25519PrivateKey):
        raise InputError(
            f"signing_key: {path}: no Ed25519 key: make one with `./spool verify --make-keys DIR`"
        )
    return lambda link: found.sign(link.encode()).hex()


def is_signed(link: str, signature: str, key: Path) -> bool:
    """Return whether ``signature`` (hex) of ``link`` is by the public key in the file ``key``.

    Raises:
        InputError: it is no such key.
    """
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import load_pem_public_key  # noqa: PLC0415

    try:
        found = load_pem_public_key(key.read_bytes())
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{key}: no public key in PEM") from error
    if not isinstance(found, Ed25519PublicKey):
        raise InputError(f"{key}: no Ed25519 key")
    try:
        found.verify(bytes.fromhex(signature), link.encode())
    except (InvalidSignature, ValueError):
        return False
    return True


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """Result of a recovery: what was saved and what was not.

    ``messages`` counts by topic what the new bag holds, as read back from it. ``undecodable`` counts messages
    whose bytes do not fit their definition; they are left out. ``expected`` counts by topic what the old bag
    says it held, ``None`` where it says nothing (a killed recording). ``lost`` are the messages that the old
    bag held and the new one does not: by those counts, else by the index behind each damaged chunk, else, and
    then ``estimated`` is true, by the damaged places' sizes. ``missing`` counts the blocks that jumps in
    ``sequence`` show by valve, whether they were lost here or never arrived. ``damages`` are the old bag's,
    ``closed`` says whether its recording was finished.
    """

    source: Path
    target: Path
    messages: Mapping[str, int]
    undecodable: Mapping[str, int]
    expected: Mapping[str, int] | None
    lost: int
    estimated: bool
    missing: Mapping[str, int]
    damages: tuple[Damage, ...]
    warnings: tuple[str, ...]
    closed: bool


def recover(source: Path | str, target: Path | str) -> RecoveryResult:
    """Copy every readable message of the bag ``source`` into the new bag ``target`` and read that again.

    Raises:
        InputError: there is nothing to recover from, or ``target`` exists.
        RecordingError: ``target`` cannot be written on.
    """
    reader = BagReader(source, skip_damage=True)
    counted = all(file.counts is not None for file in reader.files)
    expected = {name: topic.messages for name, topic in reader.topics.items()} if counted else None
    undecodable: dict[str, int] = {}
    warnings = list(reader.warnings)
    with BagWriter(target, staged=True) as writer:
        channels: dict[tuple[str, str], int | None] = {}
        for topic, record in reader.records():
            key = (topic.name, topic.type)
            if key not in channels:
                channels[key] = _channel(writer, topic, warnings)
            channel = channels[key]
            if channel is None or not reader.decodable(topic, record.data):
                undecodable[topic.name] = undecodable.get(topic.name, 0) + 1
                continue
            writer.write(channel, record.log_time, record.data, record.publish_time, record.sequence)
        written = writer.counts
        writer.finish()
        read, missing = _read_back(writer.file, written)
        if read != written:
            raise OSError(f"{target}: what was written could not be read back: the disk may be failing")
    lost, estimated = _lost(reader, read, undecodable, expected)
    return RecoveryResult(
        Path(source),
        Path(target),
        read,
        undecodable,
        expected,
        lost,
        estimated,
        missing,
        tuple(reader.damages),
        tuple(warnings),
        reader.closed,
    )


def _verify(folder: Path, key: Path | None) -> Verification:
    """Return what was done to the recording as it is now.

    Raises:
        FileNotFoundError: a part went by the quota meanwhile.
    """
    # Before the parts: a recorder that writes adds some meanwhile.
    listed = _listed(folder)
    files = numbered(folder) if folder.is_dir() else []
    if not files:
        raise InputError(f"{folder}: no recording in parts: name the folder that a recorder wrote")
    chain = _Chain(Verification(folder), key, files[-1][1])
    for number, path in files:
        chain.take(number, path)
    found, (first, _), (newest, _) = chain.found, files[0], files[-1]
    chain.judge_unsigned()
    if listed is None:
        found.notes.append("metadata.yaml cannot be read: removed newest parts cannot be detected")
    elif listed > newest:
        found.wrong.append(_missing(newest + 1, listed) + ": still listed in metadata.yaml")
    found.newest_sha256 = chain.link or ""
    if first > chain.oldest:
        found.wrong.insert(0, _missing(chain.oldest, first - 1) + ", ahead of all others")
    elif first > 0:
        found.notes.append(f"the recorder's quota removed parts 0 to {first - 1}")
    return found


@dataclass(slots=True)
class _Chain:
    """Chain of parts as far as it was followed: the ``link`` of the last one, and what it says.

    ``oldest``: number of the oldest part that any tells of. ``unsigned``: unfinished parts that no signed one
    has named yet.
    """

    found: Verification
    key: Path | None
    last: Path
    link: str | None = None
    oldest: int = 0
    _before: int | None = None
    _ended: tuple[Path, Ended] | None = None
    unsigned: list[Path] = field(default_factory=list)

    def take(self, number: int, path: Path) -> None:
        """Judge the next part."""
        self.found.parts += 1
        if self._before is not None and number != self._before + 1:
            self.found.wrong.append(_missing(self._before + 1, number - 1))
            self.link = self._ended = None
        try:
            begin, ended = begin_of(path), end_of(path)
            self.oldest = max(self.oldest, oldest_of(path))
            begun = begin is not None or ended is not None or not (path == self.last and is_stub(path))
        except FileNotFoundError:
            raise
        except OSError as error:
            self._break(number, f"{path.name}: it cannot be read: {error.strerror}")
            return
        if not begun:
            self.found.notes.append(f"{path.name}: it is empty: the recorder was cut off")
            return
        if begin is None and ended is None:
            self._break(number, f"{path.name}: it is no part of a recording, or its beginning was edited")
            return
        self._judge_place(number, path, begin)
        if ended is None:
            self.unsigned.append(path)
            self.found.notes.append(
                f"{path.name}: it is not finished: it is being written, or the recorder was cut off"
                if path == self.last
                else f"{path.name}: it was never finished; the next part shows whether it was edited"
            )
            self.link, self._ended = file_hash(path), None
        else:
            judged = len(self.found.wrong)
            self._judge(path, ended, begin.before if begin is not None else ended.end.before)
            self.oldest = max(self.oldest, ended.end.oldest)
            sound = len(self.found.wrong) == judged
            self.link, self._ended = ended.end.link, (path, ended) if sound else None
        self._before = number

    def judge_unsigned(self) -> None:
        """Judge the unfinished parts that nobody vouches for, where a key is given."""
        if self.key is None:
            return
        for path in self.unsigned:
            if path == self.last:
                self.found.notes.append(f"{path.name}: not signed yet")
            else:
                said = f"{path.name}: it was never finished, and no later signed part names it"
                self.found.wrong.append(said)

    def _break(self, number: int, wrong: str) -> None:
        self.found.wrong.append(wrong)
        self.link, self._before, self._ended = None, number, None

    def _judge_place(self, number: int, path: Path, begin: PartBegin | None) -> None:
        """Judge what a part says of its number and of the part before it."""
        wrong = self.found.wrong
        if begin is None:
            wrong.append(f"{path.name}: its beginning was edited")
            return
        if begin.number != number:
            wrong.append(
                f"{path.name}: its content names it part {begin.number}: it was renamed or exchanged"
            )
        if begin.before == UNREADABLE:
            self.found.notes.append(f"{path.name}: the recorder could not read the part before it")
        elif self.link is not None and begin.before != self.link:
            wrong.append(
                f"{path.name}: it does not follow the part before it: one of both was exchanged, "
                "edited or made again"
            )
        elif self._ended is not None and begin.file:
            before, ended = self._ended
            if begin.file != ended.file and not ended.end.thinned:
                wrong.append(f"{before.name}: its index was edited")

    def _judge(self, path: Path, ended: Ended, begin_before: str) -> None:
        """Judge one finished part by its last record."""
        end, found = ended.end, self.found
        if end.thinned:
            vouched = "" if self.key is not None else "; without a key this looks like an edit"
            found.notes.append(
                f"{path.name}: the recorder thinned it: its accelerations were removed{vouched}"
            )
        if (end.thinned or end.content) != ended.content:
            found.wrong.append(
                f"{path.name}: its content was edited: its SHA-256 is not the one it ends with"
            )
        elif ended.cut:
            found.notes.append(f"{path.name}: it has no index: the recorder was cut off")
        elif not (ended.sound and _readable(path)):
            found.wrong.append(f"{path.name}: its index or its end was edited")
        if end.before != begin_before:
            found.wrong.append(
                f"{path.name}: beginning and end name different parts before it: it was edited"
            )
        if self.key is None:
            return
        signed = bool(end.signature) and is_signed(end.link, end.signature, self.key)
        if signed and end.thinned:
            signed = is_signed(end.thinned_link, end.thinned_signature, self.key)
        if signed:
            found.signed += 1
            self.unsigned.clear()  # it names them, so that its signature is theirs
        elif end.signature:
            found.wrong.append(f"{path.name}: its signature is not by the owner of {self.key.name}")
        else:
            found.wrong.append(f"{path.name}: it is not signed")


def _listed(folder: Path) -> int | None:
    """Return the largest number of a part that ``metadata.yaml`` lists, ``None`` where it cannot be read."""
    try:
        names = [str(name) for name in read_metadata(folder)["relative_file_paths"]]
    except (OSError, YamlError, ValueError, KeyError, TypeError):
        return None
    return max((part[1] for name in names if (part := part_of(name)) is not None), default=-1)


def _readable(path: Path) -> bool:
    """Return whether index and end of a part are as mcap wrote them, by their checksum."""
    try:
        file = McapFile(path)
    except InputError:
        return False
    return file.closed and file.counts is not None


def _missing(first: int, last: int) -> str:
    which = f"part {first} was" if first == last else f"parts {first} to {last} were"
    return f"{which} removed"


def _lost(
    reader: BagReader,
    saved: Mapping[str, int],
    undecodable: Mapping[str, int],
    expected: Mapping[str, int] | None,
) -> tuple[int, bool]:
    """Return the messages lost in addition to those not decodable, and whether that is estimated."""
    found = sum(saved.values()) + sum(undecodable.values())
    if expected is not None:
        return max(sum(expected.values()) - found, 0), False
    lost, estimated = reader.lost()
    # metadata.yaml of a recording under way is some seconds old: it holds that many at least.
    return max(lost, reader.told - found), estimated


def _read_back(file: Path, written: Mapping[str, int]) -> tuple[dict[str, int], dict[str, int]]:
    """Return the messages by topic in ``file``, and the blocks missing in between by valve."""
    again = BagReader(file)
    read: dict[str, int] = dict.fromkeys(written, 0)
    for topic, _ in again.records():
        read[topic.name] += 1
    gates: dict[str, BlockGate] = {}
    for valve, item in again.streams():
        if isinstance(item, Block):
            gates.setdefault(valve, BlockGate()).judge(item)
    return read, {valve: gate.lost for valve, gate in gates.items() if gate.lost}


def _channel(writer: BagWriter, topic: Topic, warnings: list[str]) -> int | None:
    if topic.encoding != "cdr" or not topic.schema:
        name, encoding = printable(topic.name, 80), printable(topic.encoding, 40)
        warnings.append(f"{name}: encoding {encoding!r} without a ROS 2 definition is left out")
        return None
    described = Definition(topic.type, topic.schema, topic.digest, topic.schema_encoding)
    try:
        return writer.add_topic(topic.name, topic.type, qos_of(topic.qos), described)
    except InputError as error:
        warnings.append(str(error))
        return None
