"""Security folder of an OPC UA server: certificate, key, trusted clients, operators' passwords."""

from __future__ import annotations

import base64
import hashlib
import hmac
import ipaddress
import json
import secrets
import socket
import stat
import sys
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

from spool_core.errors import InputError
from spool_core.system import FILE_MODE, private_folder, write_durably

#: The server's certificate and key (PEM), operators, and the folder of trusted clients' certificates.
CERTIFICATE, KEY, OPERATORS, TRUSTED = "server.cert.pem", "server.key.pem", "operators.json", "trusted"
#: Time for which the certificate holds, and bits of its key (both OPC UA policies take 2048 to 4096).
VALID, BITS = timedelta(days=3650), 3072
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


def make_server(folder: Path) -> bool:
    """Make key and certificate (OPC 10000-6, 6.2.2) in ``folder``; return ``False`` where they are kept.

    Raises:
        OSError: they can't be written.
    """
    from cryptography import x509  # noqa: PLC0415 - slow to load, as below
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
    from cryptography.hazmat.primitives import serialization as pem  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric import rsa  # noqa: PLC0415
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID  # noqa: PLC0415

    private_folder(folder / TRUSTED)
    if (folder / KEY).exists() and (folder / CERTIFICATE).exists():
        return False
    host, now = socket.gethostname(), datetime.now(timezone.utc).replace(microsecond=0)
    key = rsa.generate_private_key(public_exponent=65537, key_size=BITS)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "spool valves")])
    names = x509.SubjectAlternativeName(
        [
            x509.UniformResourceIdentifier(f"urn:{host}:spool-suite:opcua"),
            x509.DNSName(host),
            x509.DNSName("localhost"),
            x509.IPAddress(ipaddress.ip_address("127.0.0.1")),
        ]
    )
    usage = x509.KeyUsage(
        digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True,
        key_agreement=False, key_cert_sign=True, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(now - timedelta(days=1)).not_valid_after(now + VALID)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(names, critical=False).add_extension(usage, critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
    made = builder.sign(key, hashes.SHA256())
    own = key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())
    write_durably(folder / KEY, own, mode=FILE_MODE)
    write_durably(folder / CERTIFICATE, made.public_bytes(pem.Encoding.PEM), mode=0o644)
    return True


def trust(folder: Path, file: Path) -> str:
    """Let the client with the certificate ``file`` (PEM or DER) connect; return its fingerprint (SHA-256).

    Raises:
        InputError: it is no certificate, or can't be read.
        OSError: it can't be written.
    """
    from cryptography import x509  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import Encoding  # noqa: PLC0415

    try:
        content = file.read_bytes()
        load = x509.load_pem_x509_certificate if b"-----BEGIN" in content else x509.load_der_x509_certificate
        der = load(content).public_bytes(Encoding.DER)
    except OSError as error:
        raise InputError(f"{file}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{file}: not a certificate (PEM or DER)") from error
    fingerprint = hashlib.sha256(der).hexdigest()
    write_durably(folder / TRUSTED / f"{fingerprint[:16]}.der", der, mode=0o644)
    return fingerprint


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
