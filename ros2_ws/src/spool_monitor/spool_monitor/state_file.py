"""State file: survives a restart, the loss of power at any moment, and another version of the suite."""

from __future__ import annotations

import hashlib
import json
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from spool_core.system import (
    FILE_MODE,
    OPEN_FLAGS,
    lock_file,
    private_folder,
    restrict,
    sync_folder,
    write_synced,
)

#: Written by this version; it reads older ones. A later version that changes what a key means counts up.
FORMAT = 1

#: B; a valve's alarms and baselines take 100 kB at most: anything larger is no state.
MOST_BYTES = 16_000_000

#: Endings of the file that is being written, of the copy before and of what could not be read.
NEW, LAST, DAMAGED = "new", "last", "damaged"


class Found(NamedTuple):
    """State found on the disk; ``sequence`` -1: of a later version whose checksum this one can't form."""

    format: int
    sequence: int
    content: Any


@dataclass(slots=True)
class StateFile:
    """JSON with a checksum, the last good copy next to it.

    Saving writes ``NAME.new`` to the disk first, then renames the present file to ``NAME.last`` and the new
    one to ``NAME``: whatever a power loss interrupts, one whole state is there, and loading takes the newest.
    What can't be read is kept as ``NAME.damaged``. Where ``NAME`` was written in a format that is newer than
    this version's it is read as far as it is understood and left untouched: this version keeps its own state
    in ``NAME.format1``, whose content later versions take up where it is the newer one. Only the owner may
    read the files.

    Attributes:
        warnings: what was found damaged or unknown when it was loaded, one line each.
    """

    path: Path
    warnings: list[str] = field(default_factory=list, init=False)
    _target: Path = field(init=False)
    _sequence: int = field(default=0, init=False)
    _sound: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._target = self.path

    def save(self, content: Any) -> None:
        """Write ``content``, which JSON can hold, to the disk; it is there when this returns.

        Raises:
            OSError: it could not be written; the state from before is kept.
            ValueError: JSON can't hold it.

        """
        self._sequence += 1
        text = _text(content)
        head = {"format": FORMAT, "sequence": self._sequence, "sha256": _digest(self._sequence, text)}
        private_folder(self._target.parent)
        new = _beside(self._target, NEW)
        new.unlink(missing_ok=True)
        write_synced(new, f'{json.dumps(head)[:-1]}, "content": {text}}}\n', FILE_MODE)
        if self._target.exists():  # a damaged file must not replace the good copy
            self._target.replace(_beside(self._target, LAST if self._sound else DAMAGED))
        new.replace(self._target)
        sync_folder(self._target.parent)
        self._sound = True

    def load(self) -> Any | None:
        """Return the newest whole state, ``None`` where there is none; never raises for what it finds."""
        self.warnings.clear()
        self._target = self.path
        found = self._look(self.path)
        newer = max((one.format for one in found.values()), default=0)
        if newer > FORMAT:
            self._target = _beside(self.path, f"format{FORMAT}")
            self.warnings.append(
                f"{self.path}: a later version of the suite wrote it (format {newer}, this one writes "
                f"{FORMAT}): it is left and read as far as it is understood, {self._target.name} is kept"
            )
        for path in self._of_other_formats():
            found |= self._look(path)
        self._sound = self._target in found
        newest = max(found, key=lambda path: found[path].sequence, default=None)
        if newest is None or found[newest].sequence < 0:
            return None
        self._sequence = found[newest].sequence
        if any("damaged" in warning for warning in self.warnings):
            self.warnings[-1] += f"; {newest.name} is used"
        return found[newest].content

    def refuse(self, reason: str) -> None:
        """Take note that what :meth:`load` gave can't be used: saving keeps it as ``NAME.damaged``."""
        kept = f"; it will be kept as {_beside(self._target, DAMAGED).name}" if self._sound else ""
        self.warnings.append(f"{self._target}: {reason}{kept}")
        self._sound = False

    def _look(self, path: Path) -> dict[Path, Found]:
        """Return the whole states of ``path`` and of the copies next to it; what is damaged is warned of."""
        found = {}
        for one in (path, _beside(path, NEW), _beside(path, LAST)):
            try:
                found[one] = _read(one)
            except FileNotFoundError:
                continue
            except (OSError, ValueError) as error:
                if one != _beside(path, NEW):  # half a new one is what a power loss leaves
                    self.warnings.append(f"{one}: damaged: {error}")
        return found

    def _of_other_formats(self) -> list[Path]:
        """Return the files that versions with formats up to this one's kept while a later one's was there."""
        pattern = re.compile(re.escape(self.path.name) + r"\.format(\d+)")
        names = os.listdir(self.path.parent) if self.path.parent.is_dir() else []
        numbers = [match[1] for match in map(pattern.fullmatch, names) if match]
        return [_beside(self.path, f"format{number}") for number in sorted(numbers) if int(number) <= FORMAT]


class FolderLock:
    """Lock of a folder: sole right to write in it, held until it is released or the process ends.

    Raises:
        OSError: the folder can't be made or written, or another process holds it (BlockingIOError).

    """

    def __init__(self, folder: Path) -> None:
        private_folder(folder)
        descriptor = os.open(folder / "lock", os.O_WRONLY | os.O_CREAT | OPEN_FLAGS, FILE_MODE)
        self._stream = os.fdopen(descriptor, "w", encoding="utf-8")
        for path in folder.iterdir():  # of versions that left them readable to others
            if path.is_file() and not path.is_symlink():
                restrict(path, FILE_MODE)
        try:
            lock_file(self._stream.fileno(), wait=False)
        except OSError:
            self._stream.close()
            raise

    def release(self) -> None:
        """Let others write."""
        self._stream.close()


def default_folder() -> Path:
    """Return where the suite keeps state: ``$XDG_STATE_HOME/spool``, else ``~/.local/state/spool``.

    Raises:
        RuntimeError: there is neither and no home either.

    """
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".local" / "state") / "spool"


def valve_folder(base: Path, namespace: str) -> Path:
    """Return the folder of the valve in ``namespace`` (``/press/left``) below ``base``."""
    return base.joinpath(*(part for part in namespace.split("/") if part not in ("", ".", ".."))) / "monitor"


def _read(path: Path) -> Found:
    """Return the state in ``path``.

    Raises:
        OSError: it can't be read.
        ValueError: it holds no whole state; the reason is given.

    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES // 1_000_000} MB")
    try:
        whole = json.loads(path.read_text(encoding="utf-8"))
        text = _text(whole["content"]) if isinstance(whole, dict) and "content" in whole else ""
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(whole, dict) or not {"format", "sequence", "sha256", "content"} <= set(whole):
        raise ValueError("it is not a state file")
    written, sequence = whole["format"], whole["sequence"]
    if type(written) is not int or written < 1:
        raise ValueError(f"its format is {written!r}, no whole number from 1 on")
    if type(sequence) is not int or whole["sha256"] != _digest(sequence, text):
        if written > FORMAT:
            return Found(written, -1, None)
        raise ValueError("its checksum does not fit")
    return Found(written, sequence, whole["content"])


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(f"{path.name}.{ending}")


def _text(content: Any) -> str:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _digest(sequence: int, text: str) -> str:
    return hashlib.sha256(f"{sequence}\n{text}".encode()).hexdigest()
