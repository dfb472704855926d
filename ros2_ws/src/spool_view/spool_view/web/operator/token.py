"""Token of the operator: made anew at each start, in a file that only this user can read."""

from __future__ import annotations

import contextlib
import hmac
import os
import secrets
from pathlib import Path

from spool_core.system import FILE_MODE, private_folder

#: Random bytes of a token: it can't be guessed.
RANDOM = 32


class OperatorToken:
    """Operator's token, kept in ``path`` (mode 0600) until :meth:`remove`.

    Raises:
        OSError: the file can't be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._token = secrets.token_urlsafe(RANDOM)
        private_folder(path.parent)
        new = path.with_name(f"{path.name}.new")
        new.unlink(missing_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
        with os.fdopen(os.open(new, flags, FILE_MODE), "w", encoding="ascii") as stream:
            stream.write(f"{self._token}\n")
        new.replace(path)

    def fits(self, header: str) -> bool:
        """Return whether an ``Authorization`` header bears the token; takes as long whatever it holds."""
        wanted = f"Bearer {self._token}".encode()
        return hmac.compare_digest(header.encode("utf-8", "replace"), wanted)

    def remove(self) -> None:
        """Take the file away, if it is still this one's."""
        with contextlib.suppress(OSError):
            if self.path.read_text(encoding="ascii").strip() == self._token:
                self.path.unlink()
