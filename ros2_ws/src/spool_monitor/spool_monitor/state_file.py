"""Small state that survives a restart and the loss of power at any moment."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FORMAT = 1


@dataclass(slots=True)
class StateFile:
    """A JSON file with a checksum, the last good copy beside it.

    Saving writes ``NAME.new`` to the disk first, then renames the present file to ``NAME.last`` and the new
    one to ``NAME``: whatever a power loss interrupts, one whole state is there, and loading takes the newest.

    Attributes:
        warnings: what was found damaged when it was loaded, one line each.
    """

    path: Path
    warnings: list[str] = field(default_factory=list, init=False)
    _sequence: int = field(default=0, init=False)
    _sound: bool = field(default=False, init=False)

    def save(self, content: Any) -> None:
        """Write ``content``, which JSON can hold, to the disk; it is there when this returns.

        Raises:
            OSError: it could not be written; the state from before is kept.
            ValueError: JSON can't hold it.

        """
        self._sequence += 1
        text = _text(content)
        whole = {
            "format": FORMAT,
            "sequence": self._sequence,
            "sha256": _digest(self._sequence, text),
            "content": content,
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        new = self._beside("new")
        with new.open("w", encoding="utf-8") as stream:
            json.dump(whole, stream, allow_nan=False, indent=1)
            stream.flush()
            os.fsync(stream.fileno())
        if self._sound:  # a damaged file must not replace the good copy
            self.path.replace(self._beside("last"))
        new.replace(self.path)
        _sync_folder(self.path.parent)
        self._sound = True

    def load(self) -> Any | None:
        """Return the newest whole state, ``None`` where there is none; never raises for what it finds."""
        self.warnings.clear()
        found = {}
        for path in (self.path, self._beside("new"), self._beside("last")):
            try:
                sequence, content = _read(path)
            except FileNotFoundError:
                continue
            except (OSError, ValueError) as error:
                if path != self._beside("new"):  # half a new one is what a power loss leaves
                    self.warnings.append(f"{path}: {error}")
                continue
            found[path] = (sequence, content)
        self._sound = self.path in found
        if not found:
            return None
        newest = max(found, key=lambda path: found[path][0])
        self._sequence, content = found[newest]
        if self.warnings:
            self.warnings[-1] += f"; {newest.name} is used"
        return content

    def _beside(self, ending: str) -> Path:
        return self.path.with_name(f"{self.path.name}.{ending}")


class FolderLock:
    """Sole right to write in a folder, held until it is let go of or the process ends.

    Raises:
        OSError: the folder can't be made or written, or another process holds it (BlockingIOError).

    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._stream = (folder / "lock").open("w", encoding="utf-8")
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
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


def _read(path: Path) -> tuple[int, Any]:
    whole = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(whole, dict) or not {"format", "sequence", "sha256", "content"} <= set(whole):
        raise ValueError("it is not a state file")
    if whole["format"] != FORMAT:
        raise ValueError(f"it has format {whole['format']}, this version reads {FORMAT}")
    sequence = whole["sequence"]
    if not isinstance(sequence, int) or whole["sha256"] != _digest(sequence, _text(whole["content"])):
        raise ValueError("its checksum does not fit")
    return sequence, whole["content"]


def _text(content: Any) -> str:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _digest(sequence: int, text: str) -> str:
    return hashlib.sha256(f"{sequence}\n{text}".encode()).hexdigest()


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
