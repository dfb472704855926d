"""Verification of a recording: what was edited, removed or exchanged since its parts were written."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spool_stream.errors import InputError
from spool_stream.files.yaml_file import YamlError, load_yaml

from spool_bag.format.metadata import FILE_NAME, ROOT
from spool_bag.mcap.mcap_file import McapFile
from spool_bag.mcap.part_chain import Ended, begin_of, end_of, file_hash

from .existing_parts import number_of, numbered
from .signing import is_signed


@dataclass(slots=True)
class Verification:
    """Verification of a recording: ``wrong`` what was done to it, ``notes`` what is to be known, a line each.

    ``parts`` were looked at, ``signed`` of these bear a signature by the key;
    ``newest`` is the hash of the last one, which stands for all.
    """

    folder: Path
    parts: int = 0
    signed: int = 0
    newest: str = ""
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def dictionary(self) -> dict[str, Any]:
        """Return the verification as JSON has it."""
        return {
            "recording": str(self.folder),
            "parts": self.parts,
            "signed": self.signed,
            "newest_sha256": self.newest,
            "wrong": self.wrong,
            "notes": self.notes,
        }


def verify(folder: Path, key: Path | None = None) -> Verification:
    """Return what was done to the recording in ``folder`` since it was written.

    A part is whole where the SHA-256 of its bytes is the one in its last record; parts follow each
    other where each one names the hash of that before it. With the public ``key`` each hash must be signed
    by its owner.

    Raises:
        InputError: there is no recording in parts, or the key is none.
    """
    files = numbered(folder) if folder.is_dir() else []
    if not files:
        raise InputError(f"{folder}: no recording in parts: name the folder that a recorder wrote")
    found = Verification(folder)
    link: str | None = None
    before: int | None = None
    kept = 0
    for number, path in files:
        try:
            begin, ended = begin_of(path), end_of(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        found.parts += 1
        last = path == files[-1][1]
        if begin is None and ended is None:
            found.wrong.append(f"{path.name}: it is no part of a recording, or its beginning was edited")
            link, before = None, number
            continue
        told = begin.number if begin is not None else number
        if told != number:
            found.wrong.append(
                f"{path.name}: it is part {told} by its own words: it was renamed or exchanged"
            )
        if begin is None:
            found.wrong.append(f"{path.name}: its beginning was edited")
        elif before is not None and number != before + 1:
            found.wrong.append(_missing(before + 1, number - 1))
        elif link is not None and begin.before != link:
            found.wrong.append(
                f"{path.name}: it does not follow the part before it: one of both was exchanged, "
                "edited or made anew"
            )
        if ended is None:
            _unfinished(found, path, last=last)
            link, before = file_hash(path), number
            continue
        end = ended.end
        _judge(found, path, ended, begin_before=begin.before if begin else end.before, key=key)
        kept = max(kept, end.oldest)
        link, before = end.link, number
    listed = _listed(folder)
    if listed > files[-1][0]:
        found.wrong.append(_missing(files[-1][0] + 1, listed) + ": metadata.yaml lists what is not there")
    found.newest = link or ""
    first = files[0][0]
    if first > max(kept, 0):
        found.wrong.insert(0, _missing(0 if kept <= 0 else kept, first - 1) + ", ahead of all others")
    elif first > 0:
        found.notes.append(f"parts 0 to {first - 1} went by the recorder's quota")
    return found


def _judge(found: Verification, path: Path, ended: Ended, *, begin_before: str, key: Path | None) -> None:
    """Judge one finished part by its last record."""
    end = ended.end
    if end.thinned:
        found.notes.append(f"{path.name}: the recorder thinned it: its accelerations were removed")
    if (end.thinned or end.content) != ended.content:
        found.wrong.append(f"{path.name}: its content was edited: its SHA-256 is not the one it ends with")
    elif not (ended.sound and _readable(path)):
        found.wrong.append(f"{path.name}: its index or its end was edited")
    if end.before != begin_before:
        found.wrong.append(f"{path.name}: beginning and end name different parts before it: it was edited")
    if key is None:
        return
    signed = bool(end.signature) and is_signed(end.link, end.signature, key)
    if signed and end.thinned:
        signed = is_signed(end.thinned_link, end.thinned_signature, key)
    if signed:
        found.signed += 1
    elif end.signature:
        found.wrong.append(f"{path.name}: its signature is not by the owner of {key.name}")
    else:
        found.wrong.append(f"{path.name}: it is not signed")


def _unfinished(found: Verification, path: Path, *, last: bool) -> None:
    """Judge a part without an end: the last one is being written or was cut off, others were."""
    if last:
        found.notes.append(
            f"{path.name}: it is not finished: it is being written, or the recorder was cut off"
        )
    else:
        found.notes.append(f"{path.name}: it was never finished; the next part tells whether it is as it was")


def _listed(folder: Path) -> int:
    """Return the largest number of a part that ``metadata.yaml`` lists, -1 where it lists none."""
    try:
        about = load_yaml((folder / FILE_NAME).read_text(encoding="utf-8"))
        names = [str(name) for name in about[ROOT]["relative_file_paths"]]
    except (OSError, YamlError, ValueError, KeyError, TypeError):
        return -1
    return max((number for name in names if (number := number_of(name)) is not None), default=-1)


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
