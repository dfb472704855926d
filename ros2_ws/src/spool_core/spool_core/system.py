"""Calls of the operating system: private folders, locks, files written whole or not at all, scheduling.

The analysis of records also runs on Windows and macOS. This module alone knows their differences: no other
module that such an analysis imports uses what only Linux has (``tests/test_portable.py``).
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import mmap
import multiprocessing
import multiprocessing.connection
import os
import re
import shutil
import signal
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from spool_core.errors import InputError

if sys.platform == "win32":
    import msvcrt
    from types import ModuleType

    grp: ModuleType  # neither is there: the functions that ask them return before
    pwd: ModuleType
else:
    import fcntl
    import grp
    import pwd

#: Flags of every ``os.open`` that writes: children do not inherit the file, line ends stay as they are.
OPEN_FLAGS: int = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
FILE_MODE = 0o600
FOLDER_MODE = 0o700

_MARK = ".partial-"

#: Niceness of what gives way to the stream: where processors are short, Linux gives it a tenth of the time.
NICENESS = 10

_limit: int | None = None


def private_folder(folder: Path) -> None:
    """Make ``folder`` readable by its owner only, with those above it that are missing.

    Folders above it that exist are left as they are. A folder of another user's keeps its mode.

    Raises:
        OSError: it can't be made.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        path.mkdir(mode=FOLDER_MODE, exist_ok=True)
    if folder not in missing:
        restrict(folder, FOLDER_MODE)


def private_file(path: Path) -> None:
    """Make the file ``path``, or restrict it, so that its owner only can read and write it.

    Raises:
        OSError: it can't be made.
    """
    os.close(os.open(path, os.O_RDWR | os.O_CREAT | OPEN_FLAGS, FILE_MODE))
    restrict(path, FILE_MODE)


def restrict(path: Path, mode: int) -> None:
    """Set the permissions of ``path`` where it is this user's; nothing happens elsewhere.

    Windows has no such permissions: there the folder above decides.
    """
    if sys.platform == "win32":
        return
    try:
        status = path.stat()
        if status.st_uid == os.geteuid() and stat.S_IMODE(status.st_mode) != mode:
            path.chmod(mode)
    except OSError:
        return


def expanded(path: str | Path) -> Path:
    """Return ``path`` with ``~`` replaced by the home folder, which no shell does in files and parameters."""
    return Path(os.path.expanduser(path))


def private_temporary_folder(name: str) -> Path:
    """Return a folder below the system's temporary one that only this user can reach; the same at each call.

    Where another user took the place a new one is made.

    Raises:
        OSError: none can be made.
    """
    # Windows has no user numbers, and each user has a separate temporary folder: 0 will do.
    base = Path(tempfile.gettempdir()) / f"spool_{getattr(os, 'geteuid', int)()}"
    try:
        private_folder(base / name)
        restrict(base, FOLDER_MODE)
        if others_may_write(base / name) is None and os.access(base / name, os.W_OK):
            return base / name
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix=f"spool_{name}_"))


def others_may_write(folder: Path) -> str | None:
    """Return who besides this user and root may change what lies in ``folder``, ``None`` where nobody may.

    Every folder above it counts too: who may write there may put another one in its place, unless the sticky
    bit (``/tmp``) forbids it. A group without other members is the user's own. Windows keeps the
    folders of users apart: nobody may.
    """
    if sys.platform == "win32":
        return None
    try:
        path = folder.resolve()
    except (OSError, RuntimeError) as error:
        return f"{folder} can't be followed ({error})"
    # Of a folder that is not there yet those above it decide.
    there = [one for one in (path, *path.parents) if os.path.lexists(one)]
    for one in there:
        try:
            status = one.stat()
        except OSError as error:
            return f"{one} can't be looked at ({error.strerror})"
        if status.st_uid not in (0, os.geteuid()):
            return f"{one} belongs to {_name(status.st_uid)}"
        sticky = status.st_mode & stat.S_ISVTX and one != path
        if status.st_mode & stat.S_IWOTH and not sticky:
            return f"everybody may write in {one}"
        if status.st_mode & stat.S_IWGRP and not sticky and not _own_group(status.st_gid):
            return f"group {_name(status.st_gid, group=True)} may write in {one}"
    return None


def partial_name(target: Path) -> Path:
    """Return where ``target`` is written until it is whole: ``.NAME.partial-PID`` beside it."""
    return target.with_name(f".{target.name}{_MARK}{os.getpid()}")


def leftovers(target: Path) -> list[Path]:
    """Return what processes that ended before they were done left of ``target``."""
    pattern = re.compile(re.escape(f".{target.name}{_MARK}") + r"(\d{1,10})")
    try:
        found = [(entry, pattern.fullmatch(entry.name)) for entry in target.absolute().parent.iterdir()]
    except OSError:
        return []
    return sorted(entry for entry, name in found if name and not _running(int(name[1])))


def remove(path: Path) -> None:
    """Remove a file or folder, whatever of it is there; a link is removed, not what it points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def staged(target: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yield the path to write to; it gets the name ``target`` at the end, or is removed on any exception.

    Remains of ``target`` from a process that was killed are removed first.

    Raises:
        FileExistsError: at the end, where something has the name ``target`` and ``replace`` is false.
    """
    for left in leftovers(target):
        remove(left)
    part = partial_name(target)
    remove(part)
    try:
        yield part
        if replace:
            part.replace(target)
            return
        try:
            os.link(part, target, follow_symlinks=False)
        except FileExistsError:
            raise
        except OSError:  # a file system without hard links
            if os.path.lexists(target):
                raise FileExistsError(target) from None
            part.rename(target)
    finally:
        remove(part)


def end_with_parent() -> None:
    """End this process of a pool when its parent ends, in whatever way."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def write_durably(path: Path, content: str | bytes, *, mode: int = 0o666, replace: bool = True) -> None:
    """Write the file ``path`` so that at any moment the old or the new one is there, whole; text as UTF-8.

    The disk has the content when this returns, and the name after :func:`sync_folder`.

    Raises:
        FileExistsError: something has the name ``path`` and ``replace`` is false.
        OSError: it cannot be written; ``path`` is as before.
    """
    with staged(path, replace=replace) as part:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, mode)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())


def give_way() -> None:
    """Begin a process that works beside the stream: it gives way to it, and leaves Ctrl-C to its parent.

    It ends with its parent, however that ends: a pool's process would wait for work forever.
    """
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "linux":
        return
    if os.sched_getscheduler(0) != os.SCHED_OTHER:  # of a parent that runs before all others
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICENESS)


def processor_list(text: str) -> set[int]:
    """Return the processors of a list such as ``2,4-6``.

    Raises:
        InputError: it is no such list, or names a processor that this process may not use.
    """
    if sys.platform != "linux":
        raise InputError("cpus: only Linux binds a process to processors: leave it out")
    found: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", part.strip())
        if match is None:
            raise InputError(f"cpus: {text!r} is no list of processors: write 2 or 2,3 or 2-3")
        found |= set(range(int(match[1]), int(match[2] or match[1]) + 1))
    allowed = os.sched_getaffinity(0)
    if not found or found - allowed:
        named = ", ".join(map(str, sorted(allowed)))
        raise InputError(f"cpus: {text!r}: this process may use {named}")
    return found


def use_processors(text: str) -> None:
    """Bind this process, and what it starts, to the processors of a list such as ``2,4-6``.

    Raises:
        InputError: as of :func:`processor_list`.
    """
    chosen = processor_list(text)
    if sys.platform == "linux":
        os.sched_setaffinity(0, chosen)


def run_before_others(priority: int) -> None:
    """Run this process, and threads that it starts, under SCHED_FIFO at ``priority``, 1 to 99.

    Raises:
        InputError: the priority is none, or the system does not grant it.
    """
    if not 1 <= priority <= 99:
        raise InputError(f"priority: {priority} is out of range for SCHED_FIFO: use 1 to 99")
    if sys.platform != "linux":
        raise InputError("priority: only Linux has SCHED_FIFO: leave it out")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        raise InputError(
            f"priority: SCHED_FIFO {priority} is not granted ({error.strerror}): it needs CAP_SYS_NICE or a "
            f"limit of at least {priority} (LimitRTPRIO= of the service, rtprio in /etc/security/limits.conf)"
        ) from None


class ThreadTimes(NamedTuple):
    """What a thread has ``used`` of a processor and ``waited`` for one, s; ``ready``: it has or wants one."""

    used: float
    waited: float
    ready: bool


def thread_times(number: int) -> ThreadTimes | None:
    """Return the times of the thread of this process with this number; ``None`` where no system tells."""
    folder = Path("/proc/self/task") / str(number)
    try:
        used, waited, _ = (folder / "schedstat").read_text(encoding="ascii").split()
        state = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except (OSError, ValueError, IndexError):
        return None
    return ThreadTimes(1e-9 * int(used), 1e-9 * int(waited), state == "R")


def resident_memory() -> int:
    """Return the memory of this process that is resident, B."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        return int(stream.read().split()[1]) * mmap.PAGESIZE


def processors() -> int:
    """Return the number of processors that the system lets this process run on, at least 1."""
    allowed = getattr(os, "sched_getaffinity", None)  # Linux only
    found = len(allowed(0)) if allowed else os.cpu_count() or 1
    return found if _limit is None else min(found, _limit)


def limit_processors(most: int) -> None:
    """Limit this process, one of several workers that share the processors, to ``most`` of them."""
    global _limit  # noqa: PLW0603 - it is of the process
    _limit = most


def lock_file(descriptor: int, *, wait: bool = True) -> None:
    """Lock the open file or folder ``descriptor`` for this process alone, until it is closed.

    Raises:
        BlockingIOError: another process holds it and ``wait`` is false.
        OSError: the file system has no locks.
    """
    if sys.platform == "win32":
        os.lseek(descriptor, 0, os.SEEK_SET)
        while True:
            try:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            except PermissionError:
                if not wait:
                    raise BlockingIOError("another process holds the lock") from None
                time.sleep(0.05)
            else:
                return
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


def open_folder(folder: Path) -> int | None:
    """Return a descriptor of ``folder``, ``None`` on Windows, which opens no folders.

    Raises:
        OSError: it cannot be opened.
    """
    if sys.platform == "win32":
        return None
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | OPEN_FLAGS)


def sync_folder(folder: Path) -> None:
    """Bring the names of the files in ``folder`` to the disk; Windows does so by itself.

    Raises:
        OSError: the disk does not take them.
    """
    descriptor = open_folder(folder)
    if descriptor is None:
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _own_group(number: int) -> bool:
    """Whether nobody but this user (and root) is in the group ``number``: Debian's user private groups."""
    if sys.platform == "win32":
        return True
    if number == 0:
        return True
    try:
        user = pwd.getpwuid(os.geteuid())
        group = grp.getgrgid(number)
    except KeyError:
        return False
    return number == user.pw_gid and group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}


def _name(number: int, *, group: bool = False) -> str:
    """Return the name of a user or a group, its number where it has none."""
    if sys.platform != "win32":
        with contextlib.suppress(KeyError):
            return grp.getgrgid(number).gr_name if group else pwd.getpwuid(number).pw_name
    return str(number) if group else f"user {number}"


def _running(process: int) -> bool:
    if sys.platform == "win32":  # os.kill would end it
        kernel, still_active, query = ctypes.windll.kernel32, 259, 0x1000
        handle, code = kernel.OpenProcess(query, False, process), ctypes.c_ulong()
        running = bool(handle and kernel.GetExitCodeProcess(handle, ctypes.byref(code)))
        kernel.CloseHandle(handle)
        return running and code.value == still_active
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _end_with(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


@dataclass(slots=True)
class RefitBudget:
    """Processor time that the refits of all trackers of a process may take; starts are not counted.

    A process that is ``behind`` with its blocks has none for them, and thins spectra: estimates come first.

    Valves that start together ask for their refits together, which would make the blocks of all of them late.
    A refit that is refused is asked for again with the next chunk. Without a limit, as in a replay, what a
    tracker does depends on its samples alone.

    Attributes:
        share: s of refits in a second.
        behind: whether blocks wait for too long.
    """

    share: float = math.inf
    behind: bool = False
    _saved: float = 1.0
    _since: float = field(default_factory=time.monotonic)

    def allows(self) -> bool:
        """Whether a refit may begin now; at most the share of one second is saved up."""
        if math.isinf(self.share) or self.behind:
            return not self.behind
        now = time.monotonic()
        self._saved = min(self.share, self._saved + self.share * (now - self._since))
        self._since = now
        return self._saved > 0.0

    def spend(self, seconds: float) -> None:
        """Count a refit that took so many ``seconds``."""
        if not math.isinf(self.share):
            self._saved -= seconds


#: Budget of this process.
BUDGET = RefitBudget()
