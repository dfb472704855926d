"""Keystore: certificates, permissions and keys of every enclave, in the folders that SROS 2 reads."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from spool_core.errors import InputError

from .access import Access
from .documents import governance, permissions

#: Time for which certificates hold: that of sros2.
VALID = timedelta(days=3650)


@dataclass(frozen=True, slots=True)
class _Authority:
    """Certificate authority: its certificate and key."""

    certificate: Any
    key: Any


def make_keystore(folder: Path, enclaves: Mapping[str, Access]) -> list[Path]:
    """Make the keystore ``folder``, or add ``enclaves`` (by name, ``/valve_1/monitor``) to the one there.

    Return the folders of the enclaves. The permissions of one that is there are renewed, its key is kept.

    Raises:
        InputError: the folder is something else, or cannot be written to.
    """
    now = datetime.now(timezone.utc).replace(microsecond=0)
    begin, end = now - timedelta(days=1), now + VALID
    try:
        authority = _authority(folder, begin, end)
        made = []
        for name, access in enclaves.items():
            made.append(_enclave(folder, authority, name, access, (begin, end)))
    except OSError as error:
        raise InputError(f"{error.filename or folder}: {error.strerror}") from error
    return made


def _authority(folder: Path, begin: datetime, end: datetime) -> _Authority:
    """Return the authority of the keystore, made where there is none."""
    from cryptography import x509  # noqa: PLC0415 - only who makes keystores needs it
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

    key_file, certificate_file = folder / "private" / "ca.key.pem", folder / "public" / "ca.cert.pem"
    if key_file.exists() and certificate_file.exists():
        return _Authority(
            x509.load_pem_x509_certificate(certificate_file.read_bytes()),
            load_pem_private_key(key_file.read_bytes(), password=None),
        )
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}: holds other things: name a folder that is new, or a keystore")
    name, key = _name("sros2CA"), _key()
    made = _Authority(_certificate(name, key.public_key(), name, key, (begin, end), authority=True), key)
    for place in ("public", "private", "enclaves"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    (folder / "private").chmod(0o700)
    _write(key_file, _pem_key(key), 0o600)
    _write(certificate_file, _pem(made.certificate))
    for kind in ("identity", "permissions"):
        shutil.copy2(certificate_file, folder / "public" / f"{kind}_ca.cert.pem")
        shutil.copy2(key_file, folder / "private" / f"{kind}_ca.key.pem")
    _write(folder / "enclaves" / "governance.xml", governance())
    _write(folder / "enclaves" / "governance.p7s", _signed(governance(), made))
    return made


def _enclave(
    folder: Path, authority: _Authority, name: str, access: Access, valid: tuple[datetime, datetime]
) -> Path:
    place = folder / "enclaves" / name.strip("/")
    place.mkdir(parents=True, exist_ok=True)
    if not (place / "key.pem").exists():
        key = _key()
        issuer = authority.certificate.subject
        certificate = _certificate(
            _name(name), key.public_key(), issuer, authority.key, valid, authority=False
        )
        _write(place / "key.pem", _pem_key(key), 0o600)
        _write(place / "cert.pem", _pem(certificate))
    for kind in ("identity", "permissions"):
        shutil.copy2(folder / "public" / f"{kind}_ca.cert.pem", place / f"{kind}_ca.cert.pem")
    shutil.copy2(folder / "enclaves" / "governance.p7s", place / "governance.p7s")
    text = permissions(name, access, *valid)
    _write(place / "permissions.xml", text)
    _write(place / "permissions.p7s", _signed(text, authority))
    return place


def _write(path: Path, content: bytes, mode: int = 0o644) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, mode)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)


def _key() -> Any:
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415

    return ec.generate_private_key(ec.SECP256R1())


def _name(common: str) -> Any:
    from cryptography import x509  # noqa: PLC0415

    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, common)])


def _certificate(
    subject: Any, public: Any, issuer: Any, key: Any, valid: tuple[datetime, datetime], *, authority: bool
) -> Any:
    from cryptography import x509  # noqa: PLC0415
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415

    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(public)
    builder = builder.serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(valid[0]).not_valid_after(valid[1])
    length = 1 if authority else None
    builder = builder.add_extension(x509.BasicConstraints(ca=authority, path_length=length), critical=True)
    return builder.sign(key, hashes.SHA256())


def _signed(content: bytes, authority: _Authority) -> bytes:
    """Return ``content`` with its signature as S/MIME, which DDS security reads."""
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import Encoding, pkcs7  # noqa: PLC0415

    builder = pkcs7.PKCS7SignatureBuilder().set_data(content)
    builder = builder.add_signer(authority.certificate, authority.key, hashes.SHA256())
    return bytes(builder.sign(Encoding.SMIME, [pkcs7.PKCS7Options.DetachedSignature]))


def _pem(certificate: Any) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding  # noqa: PLC0415

    return bytes(certificate.public_bytes(Encoding.PEM))


def _pem_key(key: Any) -> bytes:
    from cryptography.hazmat.primitives import serialization as pem  # noqa: PLC0415

    return bytes(key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption()))
