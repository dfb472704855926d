"""Certificate of the OPC UA server and the list of clients that it trusts (OPC 10000-6, 6.2.2)."""

from __future__ import annotations

import hashlib
import ipaddress
import socket
from datetime import datetime, timedelta, timezone
from pathlib import Path

from spool_core.errors import InputError
from spool_core.opcua_folder import CERTIFICATE, KEY, TRUSTED
from spool_core.system import FILE_MODE, private_folder, write_durably

#: Time for which the certificate holds, and bits of its key (both OPC UA policies take 2048 to 4096).
VALID, BITS = timedelta(days=3650), 3072


def make_server(folder: Path) -> bool:
    """Make key and certificate of the server in ``folder``; return ``False`` where they exist and are kept.

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
    """Trust the client with the certificate ``file`` (PEM or DER); return its fingerprint (SHA-256).

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
