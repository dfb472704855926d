"""Keystore of the nodes (OMG DDS-SECURITY 1.1): certificates, and permissions of who may use what.

ROS 2 names (design.ros2.org, "Topic and Service name mapping to DDS"): topics ``rt/``, requests of services
``rq/...Request``, replies ``rr/...Reply``.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives import serialization as pem
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7
from spool_core.errors import InputError
from spool_core.system import OPEN_FLAGS

#: Time for which certificates hold: that of sros2.
VALID = timedelta(days=3650)
#: Common name of the authority: that of sros2.
AUTHORITY = "sros2CA"

_SPACE = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMA = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{}.xsd"
#: Nobody without a certificate, everything encrypted, access by permissions; in all domains of a host.
_DOMAINS = {"min": "0", "max": "232"}
_OF_DOMAINS = {
    "allow_unauthenticated_participants": "false",
    "enable_join_access_control": "true",
    "discovery_protection_kind": "ENCRYPT",
    "liveliness_protection_kind": "ENCRYPT",
    "rtps_protection_kind": "SIGN",
}
_OF_TOPICS = {
    "topic_expression": "*",
    "enable_discovery_protection": "true",
    "enable_liveliness_protection": "true",
    "enable_read_access_control": "true",
    "enable_write_access_control": "true",
    "metadata_protection_kind": "ENCRYPT",
    "data_protection_kind": "ENCRYPT",
}

#: What every node of ROS 2 sends and hears.
_ALL_SEND = ("ros_discovery_info", "rt/rosout", "rt/parameter_events", "rt/diagnostics")
_ALL_HEAR = ("ros_discovery_info", "rt/clock", "rt/parameter_events")
#: Blocks of many valves, which their source sends together.
SHARED = "rt/accelerations"
#: Topics in a valve's namespace by who sends and who hears them.
_SENT = {
    "simulator": ("acceleration", "oil_temperature", "speed", "command"),
    "adapter": ("acceleration",),
    "estimator": ("estimate", "valve", "refit", "gap", "events", "command"),
    "monitor": ("health", "events"),
}
_HEARD = {
    "simulator": (),
    "adapter": ("*",),
    "estimator": ("acceleration", "oil_temperature", "events", "command"),
    "monitor": ("acceleration", "valve", "estimate", "speed", "command"),
}


@dataclass(frozen=True, slots=True)
class Access:
    """Access of an enclave: DDS topics that it may publish and subscribe, patterns with ``*`` allowed."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]

    def __add__(self, other: Access) -> Access:
        return Access(
            tuple(dict.fromkeys((*self.publish, *other.publish))),
            tuple(dict.fromkeys((*self.subscribe, *other.subscribe))),
        )


def enclaves_of(valves: Sequence[str], hosted: str | None = None) -> dict[str, Access]:
    """Return what each enclave of a machine needs: nodes of its valves, host, recorder, viewer, operator.

    ``hosted``: source of blocks that the host runs itself.
    """
    enclaves = {f"/{valve}/{node}": _of_node(valve, node) for valve in valves for node in _SENT}
    host = _managed("host") + _managed("host_*") + Access((), (SHARED,))
    for valve in valves:
        for node in ("estimator", "monitor", *((hosted,) if hosted is not None else ())):
            host += _of_node(valve, node)
    hears = ("rt/diagnostics", SHARED, *(f"rt/{valve}/*" for valve in valves))
    # A viewer hears, and may ask for nothing; an operator may call the services of the nodes as well.
    viewer = Access(("ros_discovery_info", "rt/rosout"), (*_ALL_HEAR, *hears))
    called = [f"{valve}/*" for valve in valves] + ["recorder/*", "host/*"]
    calls = Access(tuple(f"rq/{name}Request" for name in called), tuple(f"rr/{name}Reply" for name in called))
    return enclaves | {
        "/host": host,
        "/recorder": _managed("recorder") + Access((), hears),
        "/viewer": viewer,
        "/operator": viewer + calls,
    }


def _of_node(valve: str, node: str) -> Access:
    """Return what ``node`` of ``valve`` needs, its services included."""
    sent, heard = (tuple(f"rt/{valve}/{topic}" for topic in topics[node]) for topics in (_SENT, _HEARD))
    return _managed(f"{valve}/{node}") + Access(sent, heard)


def _managed(node: str) -> Access:
    """Return what a managed node sends, hears and offers as services."""
    return Access(
        (*_ALL_SEND, f"rr/{node}/*Reply", f"rt/{node}/transition_event"), (*_ALL_HEAR, f"rq/{node}/*Request")
    )


def make_keystore(folder: Path, enclaves: Mapping[str, Access]) -> None:
    """Make the keystore ``folder``, or add ``enclaves`` (by name, ``/valve_1/monitor``) to the one there.

    The permissions of one that is there are renewed, its key is kept.

    Raises:
        InputError: the folder is something else, or cannot be written to.
    """
    now = datetime.now(timezone.utc).replace(microsecond=0)
    valid = (now - timedelta(days=1), now + VALID)
    try:
        authority = _authority(folder, valid)
        for name, access in enclaves.items():
            place = folder / "enclaves" / name.strip("/")
            place.mkdir(parents=True, exist_ok=True)
            if not (place / "key.pem").exists():
                key = ec.generate_private_key(ec.SECP256R1())
                certificate = _certificate(name, key.public_key(), valid, authority.key)
                _write(place / "key.pem", _pem_key(key), 0o600)
                _write(place / "cert.pem", certificate.public_bytes(pem.Encoding.PEM))
            for kind in ("identity", "permissions"):
                shutil.copy2(folder / "public" / f"{kind}_ca.cert.pem", place / f"{kind}_ca.cert.pem")
            shutil.copy2(folder / "enclaves" / "governance.p7s", place / "governance.p7s")
            authority.write_signed(place / "permissions", _permissions(name, access, valid))
    except OSError as error:
        raise InputError(f"{error.filename or folder}: {error.strerror}") from error


@dataclass(frozen=True, slots=True)
class _Authority:
    """Authority of a keystore: its certificate and key."""

    certificate: x509.Certificate
    key: Any

    def write_signed(self, path: Path, root: Xml.Element) -> None:
        """Write a document as XML, and with its signature as S/MIME, which DDS security reads."""
        Xml.indent(root)
        content = bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))
        builder = pkcs7.PKCS7SignatureBuilder().set_data(content)
        builder = builder.add_signer(self.certificate, self.key, hashes.SHA256())
        _write(path.with_suffix(".xml"), content)
        signed = builder.sign(pem.Encoding.SMIME, [pkcs7.PKCS7Options.DetachedSignature])
        _write(path.with_suffix(".p7s"), signed)


def _authority(folder: Path, valid: tuple[datetime, datetime]) -> _Authority:
    """Return the authority of the keystore, made where there is none."""
    key_file, certificate_file = folder / "private" / "ca.key.pem", folder / "public" / "ca.cert.pem"
    if key_file.exists() and certificate_file.exists():
        return _Authority(
            x509.load_pem_x509_certificate(certificate_file.read_bytes()),
            pem.load_pem_private_key(key_file.read_bytes(), password=None),
        )
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}: holds other things: name a folder that is new, or a keystore")
    key = ec.generate_private_key(ec.SECP256R1())
    made = _Authority(_certificate(AUTHORITY, key.public_key(), valid, key, depth=1), key)
    for place in ("public", "private", "enclaves"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    (folder / "private").chmod(0o700)
    _write(key_file, _pem_key(key), 0o600)
    _write(certificate_file, made.certificate.public_bytes(pem.Encoding.PEM))
    for kind in ("identity", "permissions"):
        shutil.copy2(certificate_file, folder / "public" / f"{kind}_ca.cert.pem")
        shutil.copy2(key_file, folder / "private" / f"{kind}_ca.key.pem")
    root = _document("governance")
    rule = _within(root, "domain_access_rules", "domain_rule")
    _fill(_within(rule, "domains", "id_range"), _DOMAINS)
    _fill(rule, _OF_DOMAINS)
    _fill(_within(rule, "topic_access_rules", "topic_rule"), _OF_TOPICS)
    made.write_signed(folder / "enclaves" / "governance", root)
    return made


def _permissions(enclave: str, access: Access, valid: tuple[datetime, datetime]) -> Xml.Element:
    """Return the permissions of ``enclave``: what ``access`` says while it is ``valid``, else nothing."""
    root = _document("permissions")
    grant = _within(root, "permissions", "grant")
    grant.set("name", enclave)
    _fill(grant, {"subject_name": f"CN={enclave}"})
    begin, end = (moment.strftime("%Y-%m-%dT%H:%M:%S") for moment in valid)
    _fill(_within(grant, "validity"), {"not_before": begin, "not_after": end})
    rule = _within(grant, "allow_rule")
    _fill(_within(rule, "domains", "id_range"), _DOMAINS)
    for name, topics in (("publish", access.publish), ("subscribe", access.subscribe)):
        listed = _within(rule, name, "topics")
        for topic in topics:
            _fill(listed, {"topic": topic})
    _fill(grant, {"default": "DENY"})
    return root


def _document(name: str) -> Xml.Element:
    schema = {"xmlns:xsi": _SPACE, "xsi:noNamespaceSchemaLocation": _SCHEMA.format(name)}
    return Xml.Element("dds", schema)


def _within(parent: Xml.Element, *names: str) -> Xml.Element:
    for name in names:
        parent = Xml.SubElement(parent, name)
    return parent


def _fill(parent: Xml.Element, values: Mapping[str, str]) -> None:
    for name, text in values.items():
        Xml.SubElement(parent, name).text = text


def _certificate(
    subject: str, public: Any, valid: tuple[datetime, datetime], key: Any, *, depth: int | None = None
) -> x509.Certificate:
    """Return the certificate of a node, or of the authority, which ``depth`` others may follow."""
    names = [x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, one)]) for one in (subject, AUTHORITY)]
    builder = x509.CertificateBuilder().subject_name(names[0]).issuer_name(names[1]).public_key(public)
    builder = builder.serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(valid[0]).not_valid_after(valid[1])
    limits = x509.BasicConstraints(ca=depth is not None, path_length=depth)
    return builder.add_extension(limits, critical=True).sign(key, hashes.SHA256())


def _pem_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())


def _write(path: Path, content: bytes, mode: int = 0o644) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | OPEN_FLAGS, mode)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)
