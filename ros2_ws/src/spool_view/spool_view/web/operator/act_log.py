"""Log of acts: what operators asked for and what came of it, appended and brought to the disk."""

from __future__ import annotations

import json
import os
import threading
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spool_core.system import FILE_MODE, private_folder, restrict


class ActLog:
    """Log of acts in ``path``: a JSON object a line, only appended, on the disk when :meth:`write` returns.

    Raises:
        OSError: the file can't be made or written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        private_folder(path.parent)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._descriptor = os.open(path, flags, FILE_MODE)
        restrict(path, FILE_MODE)

    def write(self, **fields: Any) -> None:
        """Append a line with the time (UTC) and ``fields``.

        Raises:
            OSError: it is not on the disk.
        """
        time = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        line = (json.dumps({"time": time, **fields}, ensure_ascii=True) + "\n").encode("ascii")
        with self._lock:
            if os.write(self._descriptor, line) != len(line):
                raise OSError(f"{self.path}: a line was cut off: is the disk full?")
            os.fsync(self._descriptor)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._descriptor)
