"""Permissions: what is kept is the user's alone, and code is loaded from nobody else's folders."""

from __future__ import annotations

import grp
import os
import pwd
import stat
import tempfile
from pathlib import Path

FILE_MODE = 0o600
FOLDER_MODE = 0o700


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
    os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, FILE_MODE))
    restrict(path, FILE_MODE)


def restrict(path: Path, mode: int) -> None:
    """Set the permissions of ``path`` where it is this user's; nothing happens elsewhere."""
    try:
        status = path.stat()
        if status.st_uid == os.geteuid() and stat.S_IMODE(status.st_mode) != mode:
            path.chmod(mode)
    except OSError:
        return


def private_temporary_folder(name: str) -> Path:
    """Return a folder below the system's temporary one that only this user can reach; the same at each call.

    Where another user took the place a new one is made.

    Raises:
        OSError: none can be made.
    """
    base = Path(tempfile.gettempdir()) / f"spool_{os.geteuid()}"
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
    bit (``/tmp``) forbids it. A group without other members is the user's own.
    """
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
            return f"{one} belongs to {_user(status.st_uid)}"
        sticky = status.st_mode & stat.S_ISVTX and one != path
        if status.st_mode & stat.S_IWOTH and not sticky:
            return f"everybody may write in {one}"
        if status.st_mode & stat.S_IWGRP and not sticky and not _own_group(status.st_gid):
            return f"group {_group(status.st_gid)} may write in {one}"
    return None


def _own_group(number: int) -> bool:
    """Whether nobody but this user (and root) is in the group ``number``: Debian's user private groups."""
    if number == 0:
        return True
    try:
        user = pwd.getpwuid(os.geteuid())
        group = grp.getgrgid(number)
    except KeyError:
        return False
    return number == user.pw_gid and group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)
