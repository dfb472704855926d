"""Verification of recordings: signatures, what was edited, removed or exchanged; recovery of damaged ones."""

from __future__ import annotations

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
from spool_bag.metadata import Definition, is_unfinished, part_of, qos_of, read_metadata
from spool_bag.part_records import FILE_NAME, UNDER_WAY, UNREADABLE, PartLine, file_hash, is_chained, parsed
from spool_bag.parts import numbered
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter

#: Times that a folder is looked at again, as a recorder writes and removes parts meanwhile.
TRIES = 5


@dataclass(slots=True)
class Verification:
    """Verification of a recording: ``wrong`` what was done to it, ``notes`` what is to be known, a line each.

    ``parts`` were looked at, ``signed`` of these are covered by a signature by the key; ``newest_sha256`` is
    the hash of the last finished one's line, which covers all lines before.
    """

    recording: Path
    parts: int = 0
    signed: int = 0
    newest_sha256: str = ""
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def verify(folder: Path, key: Path | None = None) -> Verification:
    """Return what was done to the recording in ``folder`` since it was written.

    A part is as it was written if the SHA-256 of its file is the one in the list of parts. With the public
    ``key`` the list must be signed by its owner.

    Raises:
        InputError: there is no recording in parts, an earlier release wrote it, or the key is none.
    """
    for _ in range(TRIES):
        listed = _list_in(folder)
        found = _verify(folder, listed, key)
        if not found.wrong or _list_in(folder) == listed:
            return found
    raise InputError(f"{folder}: it changed while it was verified: try again")


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


def _list_in(folder: Path) -> str | None:
    """Return the list of parts, ``None`` without one."""
    try:
        return (folder / FILE_NAME).read_text("ascii", "replace")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{folder / FILE_NAME}: cannot be read: {error.strerror}") from error


def _verify(folder: Path, text: str | None, key: Path | None) -> Verification:
    """Return what was done to the recording as it is now, by its list of parts."""
    files = dict(numbered(folder)) if folder.is_dir() else {}
    if not files and text is None:
        raise InputError(f"{folder}: no recording in parts: name the folder that a recorder wrote")
    if text is None and any(is_chained(path) for path in files.values()):
        raise InputError(
            f"{folder}: an earlier release recorded it, without {FILE_NAME}: verify it with that release"
        )
    found = Verification(folder, len(files))
    if text is None:
        found.wrong.append(f"{FILE_NAME}: it is missing: nothing shows whether parts were edited")
        return found
    listed = parsed(text)
    found.wrong.extend(listed.wrong)
    signed = key is not None and is_signed(listed.signed, listed.signature, key)
    if key is not None and not signed:
        by = f"its signature is not by the owner of {key.name}" if listed.signature else "it is not signed"
        found.wrong.append(f"{FILE_NAME}: {by}, or lines were edited, added or removed")
    lines = listed.lines
    oldest = lines[0].number if lines else listed.first
    if oldest > listed.first:
        found.notes.append(f"the recorder's quota removed parts {listed.first} to {oldest - 1}")
    owners = {line.sha256: line.number for line in lines}
    told, finished = _told(folder)
    for line in lines:
        path = files.pop(line.number, None)
        if path is not None:
            _judge(found, path, line, owners, finished=finished)
            found.signed += signed and line.sha256 != UNDER_WAY
        elif line.sha256 != UNDER_WAY or line.number in told:
            found.wrong.append(f"part {line.number} was removed")
        else:
            found.notes.append(f"part {line.number} was begun, and nothing of it reached the disk")
    for number, path in files.items():
        _judge_unlisted(found, path, ours=not finished and listed.first <= number < oldest)
    ended = [line for line in lines if line.sha256 != UNDER_WAY]
    found.newest_sha256 = ended[-1].link if ended else ""
    return found


def _judge(
    found: Verification, path: Path, line: PartLine, owners: Mapping[str, int], *, finished: bool
) -> None:
    """Judge the file of a part by its line."""
    if line.sha256 == UNDER_WAY:
        if finished:
            found.wrong.append(f"{path.name}: {FILE_NAME} has no hash of it though the recording is finished")
        else:
            found.notes.append(
                f"{path.name}: it is not finished: it is being written, or the recorder was cut off"
            )
        return
    if line.sha256 == UNREADABLE:
        found.notes.append(f"{path.name}: the recorder could not read it when it was started")
        return
    try:
        sha256 = file_hash(path)
    except FileNotFoundError:
        found.wrong.append(f"part {line.number} was removed")
        return
    except OSError as error:
        found.wrong.append(f"{path.name}: it cannot be read: {error.strerror}")
        return
    if sha256 == line.thinned:
        found.notes.append(f"{path.name}: the recorder thinned it: its accelerations were removed")
    elif sha256 != line.sha256:
        other = owners.get(sha256)
        what = "it was edited" if other is None else f"it is part {other}: it was renamed or exchanged"
        found.wrong.append(f"{path.name}: {what}: its SHA-256 is not the one in {FILE_NAME}")
    elif not _is_closed(path):
        found.notes.append(f"{path.name}: it was never finished: the recorder was cut off")


def _judge_unlisted(found: Verification, path: Path, *, ours: bool) -> None:
    """Judge a part that the list does not name; ``ours``: the recorder removes it."""
    if ours:
        found.notes.append(f"{path.name}: the recorder's quota removes it")
    elif is_chained(path):
        found.notes.append(
            f"{path.name}: an earlier release recorded it, which {FILE_NAME} does not cover: "
            "verify it with that release"
        )
    else:
        found.wrong.append(
            f"{path.name}: {FILE_NAME} does not name it: it was added, or its line was removed"
        )


def _told(folder: Path) -> tuple[set[int], bool]:
    """Return the numbers of the parts in ``metadata.yaml``, and whether it calls the recording finished."""
    try:
        names = [str(name) for name in read_metadata(folder)["relative_file_paths"]]
    except (OSError, YamlError, ValueError, KeyError, TypeError):
        return set(), False
    return {part[1] for name in names if (part := part_of(name)) is not None}, not is_unfinished(folder)


def _is_closed(path: Path) -> bool:
    """Return whether a file ends as a finished one does."""
    try:
        return McapFile(path).closed
    except InputError:
        return False


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
