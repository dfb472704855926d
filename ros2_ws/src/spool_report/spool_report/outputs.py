"""What a command writes: result files, JSON, losses in words, the version.

An existing file is refused, unless ``--force`` was given; a link is never written through, not even
then; a file appears under its name when it is whole. ``-`` is standard output, for JSON only.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shlex
import stat
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TextIO
from xml.etree import ElementTree

from spool_core.errors import InputError, removed_folder
from spool_core.system import remove, write_durably
from spool_core.text import plural, printable
from spool_core.uncertainty import as_json

if TYPE_CHECKING:
    from spool_bag.mcap_file import Damage
    from spool_sim.valve import Valve


STANDARD_OUTPUT = Path("-")

_force: ContextVar[bool] = ContextVar("force", default=False)
_command_line: ContextVar[str] = ContextVar("command_line", default="")
_stdout: ContextVar[TextIO | None] = ContextVar("stdout", default=None)

#: s, which a git command may take.
PATIENCE = 5.0

#: Files of one bag whose checksums are shown at most.
MOST_FILES = 20


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


def fail(text: str, code: int = 2) -> int:
    """Say on standard error in one line what is wrong; return the exit code."""
    line = printable(" ".join(text.split()))
    gone = "" if "working folder" in line else removed_folder()
    print(f"spool: {line}{gone}", file=sys.stderr)
    return code


def replace_existing(wanted: bool) -> bool:
    """Replace existing files from here on, where ``wanted``; the callback of ``--force``."""
    _force.set(wanted)
    return wanted


@contextlib.contextmanager
def replacing(wanted: bool) -> Iterator[None]:
    """Replace existing files inside, where ``wanted``."""
    token = _force.set(wanted)
    try:
        yield
    finally:
        _force.reset(token)


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
        raise InputError(f"{option} {path}: already exists: name another file, or overwrite it with --force")
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: missing folder {path.parent}: make it first")
    return path


def check_folder(path: Path) -> Path:
    """Return ``path`` if a command may fill it with files: it is new, empty, or ``--force`` was given.

    Raises:
        InputError: it is not so, or it is a link or a file.
    """
    if path.is_symlink():
        raise InputError(f"--out {path}: it is a link: name the folder itself")
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: it is a file: name a folder")
    if path.is_dir() and any(path.iterdir()) and not _force.get():
        raise InputError(f"--out {path}: it is not empty: name another one, or fill it by --force")
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
            write_durably(path, data, replace=_force.get())
    except FileExistsError:  # it came up since
        check_output(path, option)
        raise InputError(f"{option} {path}: already exists") from None
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be written: {error.strerror}") from error


@contextlib.contextmanager
def making_room(path: Path) -> Iterator[None]:
    """Move aside what is at ``path`` while the block makes a bag or a table there; ``--force`` only.

    The old file comes back where the block fails, and is removed where it succeeds.

    Raises:
        InputError: it is there and ``--force`` was not given, it is a link, or a folder that is no bag.
    """
    if path.is_symlink():
        raise InputError(f"--out {path}: it is a link: name the bag or the file itself")
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        yield
        return
    if not _force.get():
        kind = "folder" if path.is_dir() else "file"
        raise InputError(f"--out {path}: already exists: name another {kind}, or overwrite it with --force")
    if path.is_dir() and not any(path.glob("*.mcap")):
        raise InputError(f"--out {path}: a folder that is no bag is not replaced: name another one")
    aside = path.with_name(f".{path.name}.replaced-{os.getpid()}")
    try:
        path.rename(aside)
    except OSError as error:
        raise InputError(f"--out {path}: cannot be replaced: {error.strerror}") from error
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
    """Write ``value`` as :func:`spool_core.uncertainty.as_json` has it; ``-`` is standard output.

    Raises:
        InputError: the file can't be written, or is there already.
    """
    text = json.dumps(as_json(value), indent=1, allow_nan=False) + "\n"
    if path == STANDARD_OUTPUT:
        write_standard_output(text)
    else:
        write_file(path, text, "--json")


@dataclass(frozen=True, slots=True)
class ResultFiles:
    """Files to write, ``None`` for those not wanted; ``folder`` gives those a place that are not named."""

    json: Path | None = None
    report: Path | None = None
    model: Path | None = None
    folder: Path | None = None

    def within(self, stem: str, *, model: bool = False) -> ResultFiles:
        """Return these with every file of ``folder`` named; the folder is made.

        Raises:
            InputError: the folder cannot be made, or a file in it is there already.
        """
        if self.folder is None:
            return self
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--out {self.folder}: cannot be made: {error.strerror}") from error
        named = ResultFiles(
            self.json or self.folder / f"{stem}.json",
            self.report or self.folder / f"{stem}.html",
            self.model or (self.folder / "model.yaml" if model else None),
        )
        for path in (named.json, named.report, named.model):
            if path != STANDARD_OUTPUT:
                check_output(path, "--out")
        return named


def damaged_places(damages: Sequence[Damage]) -> str:
    """Return how many places of a bag are damaged, and how much of it."""
    return f"{plural(len(damages), 'damaged place')} ({sum(damage.size for damage in damages)} bytes)"


def lost_messages(count: int, *, estimated: bool) -> str:
    """Return how many messages were lost, as well as it is known."""
    if estimated:
        return f"about {count}" if count else "an unknown number of"
    return str(count)


@cache
def suite_version() -> str:
    """Return like ``0.1.0 (commit 1a2b3c4d5e6f)``; a ``+`` behind the commit: sources were changed since."""
    folder = Path(__file__).resolve().parent
    revision = _git(folder, "rev-parse", "--short=12", "HEAD")
    sources = (":/ros2_ws/src", ":/ros2_ws/addons", ":/research", ":/requirements")
    if not revision:
        return package_version()
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", *sources) != ""
    return f"{package_version()} (commit {revision}{'+' if changed else ''})"


def provenance() -> list[tuple[str, str]]:
    """Return label and value of what every report says: date, version, command."""
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    rows = [("written", now), ("by", f"spool {suite_version()}")]
    return [*rows, ("command", command_line())] if command_line() else rows


def sources(records: Sequence[Path], valve: Valve | None = None) -> list[tuple[str, str]]:
    """Return label and value for each file of ``records`` with its checksum, and for the valve."""
    rows = []
    for path in records:
        for file in sorted(path.glob("*.mcap"))[:MOST_FILES] if path.is_dir() else [path]:
            try:
                checksum = sha256_of([file])
            except OSError as error:
                checksum = f"not known: {error.strerror}"
            rows.append(("record", f"{file}, SHA-256 {checksum}"))
    if valve is not None:
        numbers = f"{valve.moving_mass:g} kg, {valve.spring_stiffness:g} N/m"
        rows.append(("valve", f"{valve.id}: {numbers}, {valve.natural_frequency:.3g} Hz"))
    return rows


def sha256_of(files: Iterable[Path]) -> str:
    """Return the SHA-256 of the content of ``files``, one after the other.

    Raises:
        OSError: one cannot be read.
    """
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while piece := stream.read(1 << 20):
                digest.update(piece)
    return digest.hexdigest()


def _is_device(path: Path) -> bool:
    """Return whether ``path`` is a pipe or a device, such as /dev/stdout: nothing is there to be lost."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) or stat.S_ISSOCK(mode)


def package_version() -> str:
    """Return the version that package.xml gives, or what is installed."""
    manifest = Path(__file__).resolve().parents[1] / "package.xml"
    if manifest.is_file():
        return ElementTree.parse(manifest).findtext("version", "unknown")
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - loads email and zipfile

    for name in ("spool_report", "spool-valves"):  # built by colcon, or the wheel
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "unknown"


def _git(folder: Path, *words: str) -> str | None:
    """Return what git says, ``None`` where there is none or it fails."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True, text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
