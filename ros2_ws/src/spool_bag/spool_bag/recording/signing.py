"""Signing of a recording's parts: Ed25519 keys that the operator makes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from spool_core.errors import InputError


def make_keys(folder: Path) -> tuple[Path, Path]:
    """Write a new private and public key (PEM) into ``folder`` and return their paths.

    Raises:
        InputError: the folder cannot be written to, or has keys already.
    """
    from cryptography.hazmat.primitives import serialization as pem  # noqa: PLC0415 - only who signs needs it
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415

    private, public = folder / "spool_private.pem", folder / "spool_public.pem"
    key = Ed25519PrivateKey.generate()
    secret = key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())
    shown = key.public_key().public_bytes(pem.Encoding.PEM, pem.PublicFormat.SubjectPublicKeyInfo)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content, mode in ((private, secret, 0o600), (public, shown, 0o644)):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(content)
    except FileExistsError as error:
        raise InputError(f"{error.filename}: is there already: name another folder") from error
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror}") from error
    return private, public


def signer(key: str) -> Callable[[str], str] | None:
    """Return what signs a hash with the private key in the file ``key``, ``None`` without one.

    Raises:
        InputError: it is no such key.
    """
    if not key:
        return None
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

    path = Path(key).expanduser()
    try:
        found = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise InputError(f"signing_key: {path}: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise InputError(f"signing_key: {path}: no private key without a password in PEM") from error
    if not isinstance(found, Ed25519PrivateKey):
        raise InputError(
            f"signing_key: {path}: no Ed25519 key: make one with `./spool verify --make-keys DIR`"
        )
    return lambda link: found.sign(link.encode()).hex()


def is_signed(link: str, signature: str, key: Path) -> bool:
    """Return whether ``signature`` (hex) of ``link`` is by the public key in the file ``key``.

    Raises:
        InputError: it is no such key.
    """
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import load_pem_public_key  # noqa: PLC0415

    try:
        found = load_pem_public_key(key.read_bytes())
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{key}: no public key in PEM") from error
    if not isinstance(found, Ed25519PublicKey):
        raise InputError(f"{key}: no Ed25519 key")
    try:
        found.verify(bytes.fromhex(signature), link.encode())
    except (InvalidSignature, ValueError):
        return False
    return True
