"""Claim on the folder of a recording: one recorder at a time writes in it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from spool_core.errors import InputError


class FolderClaim:
    """Claim on ``folder`` (flock(2)), until it is let go of or the process ends, however that ends.

    Raises:
        InputError: another recorder has it.
        OSError: the folder cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise InputError(
                f"{folder}: another recorder writes in it: end that one, or name another output"
            ) from None
        except OSError:  # a file system without locks
            return

    def release(self) -> None:
        """Let others write; once more does nothing."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)
