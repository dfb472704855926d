"""Output files: one rule for every command that writes.

What is there already is refused, unless ``--force`` was given; a link is never written through, not even
then; a file appears under its name when it is whole. ``-`` is standard output, for JSON only.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shlex
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TextIO

from spool_core.errors import InputError
from spool_core.files.staging import remove, staged

STANDARD_OUTPUT = Path("-")

_force: ContextVar[bool] = ContextVar("force", default=False)
_command_line: ContextVar[str] = ContextVar("command_line", default="")
_stdout: ContextVar[TextIO | None] = ContextVar("stdout", default=None)


@contextlib.contextmanager
def one_command(arguments: Sequence[str]) -> Iterator[None]:
    """Forget at the end what one call chose: that files are replaced, that text goes to stderr."""
    force, kept, stdout = _force.set(False), _stdout.set(None), sys.stdout
    line = _command_line.set(shlex.join(["./spool", *arguments]))
    try:
        yield
    finally:
        _command_line.reset(line)
        _force.reset(force)
        _stdout.reset(kept)
        sys.stdout = stdout


def command_line() -> str:
    """Return the call that is under way as it was typed, empty where there is none."""
    return _command_line.get()


def replace_existing(wanted: bool) -> bool:
    """Replace existing files from here on, where ``wanted``; the callback of ``--force``."""
    _force.set(wanted)
    return wanted


def check_output(path: Path | None, option: str) -> Path | None:
    """Return ``path`` if a file can be written there, so that no long work is done in vain.

    Raises:
        InputError: it is there and ``--force`` was not given, it is a link, or its folder is missing.
    """
    if path is None or _is_device(path):
        return path
    if path == STANDARD_OUTPUT:
        raise InputError(f"{option} -: only --json can write to standard output: name a file")
    if path.is_symlink():
        raise InputError(f"{option} {path}: it is a link: name the file itself")
    if path.is_dir():
        raise InputError(f"{option} {path}: it is a folder: name a file")
    if path.exists() and not _force.get():
        raise InputError(f"{option} {path}: it is there already: name another file, or replace it by --force")
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}: make it first")
    return path


def check_folder(path: Path, option: str = "--out") -> Path:
    """Return ``path`` if a command may fill it with files: it is new, empty, or ``--force`` was given.

    Raises:
        InputError: it is not so, or it is a link or a file.
    """
    if path.is_symlink():
        raise InputError(f"{option} {path}: it is a link: name the folder itself")
    if path.exists() and not path.is_dir():
        raise InputError(f"{option} {path}: it is a file: name a folder")
    if path.is_dir() and any(path.iterdir()) and not _force.get():
        raise InputError(f"{option} {path}: it is not empty: name another one, or fill it by --force")
    return path


def write_file(path: Path, content: str | bytes, option: str = "output") -> None:
    """Write ``content`` (text as UTF-8) to ``path`` by the rule of this module.

    Raises:
        InputError: it must not or cannot be written; nothing is left of it then.
    """
    data = content.encode() if isinstance(content, str) else content
    check_output(path, option)
    try:
        if _is_device(path):
            path.write_bytes(data)
        else:
            with staged(path, replace=_force.get()) as part, part.open("xb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
    except FileExistsError:  # it came up since
        check_output(path, option)
        raise InputError(f"{option} {path}: it is there already") from None
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be written: {error.strerror}") from error


def _is_device(path: Path) -> bool:
    """Return whether ``path`` is a pipe or a device, such as /dev/stdout: nothing is there to be lost."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) or stat.S_ISSOCK(mode)


@contextlib.contextmanager
def making_room(path: Path, option: str = "--out") -> Iterator[None]:
    """Move aside what is at ``path`` while the block makes a bag or a table there; ``--force`` only.

    What was there comes back where the block fails, and goes where it succeeds.

    Raises:
        InputError: it is there and ``--force`` was not given, it is a link, or a folder that is no bag.
    """
    if path.is_symlink():
        raise InputError(f"{option} {path}: it is a link: name the bag or the file itself")
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        yield
        return
    if not _force.get():
        raise InputError(f"{option} {path}: it is there already: name another one, or replace it by --force")
    if path.is_dir() and not any(path.glob("*.mcap")):
        raise InputError(f"{option} {path}: a folder that is no bag is not replaced: name another one")
    aside = path.with_name(f".{path.name}.replaced-{os.getpid()}")
    try:
        path.rename(aside)
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be replaced: {error.strerror}") from error
    try:
        yield
    except BaseException:
        remove(path)
        aside.rename(path)
        raise
    remove(aside)


def text_to_stderr() -> None:
    """Keep standard output for JSON: what is shown to people goes to standard error from here on."""
    _stdout.set(sys.stdout)
    sys.stdout = sys.stderr


def write_standard_output(text: str) -> None:
    """Write ``text``, and nothing else, to standard output."""
    stream = _stdout.get() or sys.stdout
    stream.write(text)
    stream.flush()


def write_json(path: Path, value: object) -> None:
    """Write ``value`` as JSON with null for numbers that are not finite; ``-`` is standard output.

    Raises:
        InputError: the file can't be written, or is there already.
    """
    text = json.dumps(_finite(value), indent=1, allow_nan=False) + "\n"
    if path == STANDARD_OUTPUT:
        write_standard_output(text)
    else:
        write_file(path, text, "--json")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
