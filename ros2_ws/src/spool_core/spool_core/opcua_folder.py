"""Folder of an OPC UA server's security: certificate, key, trusted clients, operators' passwords."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import secrets
import stat
import sys
from dataclasses import dataclass
from pathlib import Path

from spool_core.errors import InputError
from spool_core.system import FILE_MODE, private_folder, write_durably

#: The server's certificate and key (PEM), operators, and the folder of trusted clients' certificates.
CERTIFICATE, KEY, OPERATORS, TRUSTED = "server.cert.pem", "server.key.pem", "operators.json", "trusted"

#: Costs of scrypt (RFC 7914), of the equal ones in OWASP's Password Storage Cheat Sheet those with 16 MiB.
_N, _R, _P, _MEMORY = 2**14, 8, 5, 2**26
_SALT, _HASH = 16, 32
#: Characters of a name, as of the page's operators, and the least of a password (NIST SP 800-63B, 5.1.1.1).
MOST_NAME, LEAST_PASSWORD = 60, 8


@dataclass(frozen=True, slots=True)
class KeptPassword:
    """Salt and scrypt hash of a password."""

    salt: bytes
    digest: bytes

    def fits(self, password: str) -> bool:
        """Return whether ``password`` is the one; takes some 0.2 s and 16 MiB."""
        return hmac.compare_digest(_digest(password, self.salt), self.digest)


def check_private(path: Path) -> None:
    """Refuse a file that others than its owner can read.

    Raises:
        InputError: it can't be read, or others can.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}: make it with ./spool secure --opcua") from error
    if sys.platform != "win32" and mode & 0o077:
        raise InputError(f"{path}: others can read it (mode {mode:o}): chmod 600 {path}")


def operators(folder: Path) -> dict[str, KeptPassword]:
    """Return the passwords of the operators in ``folder`` by name; empty where there are none.

    Raises:
        InputError: the file can be read by others, or is damaged.
    """
    path = folder / OPERATORS
    if not path.exists():
        return {}
    check_private(path)
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        return {
            str(name): KeptPassword(base64.b64decode(one["salt"]), base64.b64decode(one["scrypt"]))
            for name, one in kept.items()
        }
    except OSError as error:
        raise InputError(f"{path}: it can't be read: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: not a list of operators: remove it and add them again") from error


def keep_operator(folder: Path, name: str, password: str) -> None:
    """Add the operator ``name``, or give this operator a new password.

    Raises:
        InputError: the name or the password can't be taken.
        OSError: the file can't be written.
    """
    if not 0 < len(name) <= MOST_NAME or not name.isprintable() or name != name.strip():
        raise InputError(f"operator {name!r}: use 1 to {MOST_NAME} characters on one line")
    if len(password) < LEAST_PASSWORD:
        raise InputError(f"the password of {name} is too short: use {LEAST_PASSWORD} characters or more")
    salt = secrets.token_bytes(_SALT)
    kept = {**operators(folder), name: KeptPassword(salt, _digest(password, salt))}
    content = {
        one: {
            "salt": base64.b64encode(entry.salt).decode(),
            "scrypt": base64.b64encode(entry.digest).decode(),
        }
        for one, entry in kept.items()
    }
    private_folder(folder)
    write_durably(folder / OPERATORS, json.dumps(content, indent=1) + "\n", mode=FILE_MODE)


def _digest(password: str, salt: bytes) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=_N, r=_R, p=_P, maxmem=_MEMORY, dklen=_HASH)
