"""`./spool secure`: which node may use what, and the keystore that says so (OMG DDS-SECURITY 1.1).

With --opcua: who may connect to the OPC UA server, and who may act there.

ROS 2 names (design.ros2.org, "Topic and Service name mapping to DDS"): topics ``rt/``, requests of services
``rq/...Request``, replies ``rr/...Reply``.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from enum import Enum
from getpass import getpass
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree as Xml

import typer
from spool_core.errors import InputError
from spool_core.opcua_folder import CERTIFICATE, keep_operator, make_server, trust
from spool_core.system import OPEN_FLAGS

from spool_tools.command import Command, Force

#: Time for which certificates hold: that of sros2.
VALID = timedelta(days=3650)

_SPACE = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMA = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{}.xsd"
#: All domains that a host may use.
DOMAINS = (0, 232)

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
VALVE_NODES = tuple(_SENT)


class Source(Enum):
    """Source of a valve's blocks."""

    SIMULATOR = "simulator"
    ADAPTER = "adapter"


def secure(
    keystore: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keystore to make, or to add valves to.")
    ] = None,
    valves: Annotated[
        list[str] | None,
        typer.Option("--valve", metavar="NAMESPACE", help="Namespace of a valve; repeatable."),
    ] = None,
    source: Annotated[
        Source | None, typer.Option("--hosted-source", help="Source of blocks that the host runs itself.")
    ] = None,
    opcua: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Security folder of the OPC UA server.")
    ] = None,
    trust: Annotated[
        list[Path] | None,
        typer.Option(metavar="CERTIFICATE", help="OPC UA client that may connect; repeatable."),
    ] = None,
    operator: Annotated[
        str | None, typer.Option(metavar="NAME", help="OPC UA user who may act; asks for a password.")
    ] = None,
    _force: Force = False,
) -> None:
    """Make certificates and permissions for every node: who may receive, send and operate.

    Only /operator may call the services of the nodes; the recorder and /viewer only receive.

    Example: ./spool secure --keystore keystore --valve valve_1 --valve valve_2

    Example: ./spool secure --opcua opcua --trust scada.der --operator anna
    """
    if opcua is not None:
        _secure_opcua(opcua, trust or [], operator)
    elif trust or operator:
        raise InputError("--trust, --operator: name the folder of the OPC UA server with --opcua")
    if keystore is not None:
        _secure_nodes(keystore, valves, source)
    elif opcua is None:
        raise InputError("name a folder: --keystore for the nodes, --opcua for the OPC UA server")


def _secure_opcua(folder: Path, trusted: Sequence[Path], operator: str | None) -> None:
    """Make or extend the security folder of the OPC UA server."""
    try:
        made = make_server(folder)
        print(f"{folder / CERTIFICATE}: {'made' if made else 'kept'}; clients have to trust it")
        for file in trusted:
            print(f"{file}: trusted, SHA-256 {trust(folder, file)}")
        if operator is not None:
            terminal = sys.stdin.isatty()
            password = getpass(f"password of {operator}: ") if terminal else sys.stdin.readline().rstrip("\n")
            if terminal and getpass("the same again: ") != password:
                raise InputError("the passwords differ: nothing was changed")
            keep_operator(folder, operator, password)
            print(f"{operator}: may act on alarms")
    except OSError as error:
        raise InputError(f"{error.filename or folder}: {error.strerror}") from error
    start = f"./spool run spool_view opcua --ros-args -p security_folder:={folder.absolute()}"
    print(f"start the server with: {start}")


def _secure_nodes(keystore: Path, valves: Sequence[str] | None, source: Source | None) -> None:
    """Make the keystore of the nodes, or add valves to it."""
    from spool_bag import check_valve  # noqa: PLC0415 - slow to load

    names = [valve.strip("/") for valve in valves or ["valve_1"]]
    for name in names:
        check_valve(name)
    enclaves = {f"/{valve}/{node}": of_node(valve, node) for valve in names for node in VALVE_NODES}
    enclaves |= {
        "/host": of_host(names, source.value if source is not None else None),
        "/recorder": of_recorder(names),
        "/viewer": of_viewer(names),
        "/operator": of_operator(names),
    }
    make_keystore(keystore, enclaves)
    for name in enclaves:
        print(name)
    print(f"{keystore}: {len(enclaves)} enclaves; on a sourced ROS 2 start a node of them like this:")
    print(f"export ROS_SECURITY_KEYSTORE={keystore.absolute()} ROS_SECURITY_ENABLE=true")
    print("export ROS_SECURITY_STRATEGY=Enforce")
    print(f"ros2 run spool_monitor monitor --ros-args -r __ns:=/{names[0]} --enclave /{names[0]}/monitor")
    print(f"{keystore / 'private'}: keep it off the machine, who has it makes any certificate")


def make_keystore(folder: Path, enclaves: Mapping[str, Access]) -> list[Path]:
    """Make the keystore ``folder``, or add ``enclaves`` (by name, ``/valve_1/monitor``) to the one there.

    Return the folders of the enclaves. The permissions of one that is there are renewed, its key is kept.

    Raises:
        InputError: the folder is something else, or cannot be written to.
    """
    now = datetime.now(timezone.utc).replace(microsecond=0)
    valid = (now - timedelta(days=1), now + VALID)
    try:
        authority = _authority(folder, valid)
        made = []
        for name, access in enclaves.items():
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
            made.append(place)
    except OSError as error:
        raise InputError(f"{error.filename or folder}: {error.strerror}") from error
    return made


def governance() -> bytes:
    """Return the governance: nobody without a certificate, everything encrypted, access by permissions."""
    root = Xml.Element("dds", _schema("governance"))
    rule = Xml.SubElement(Xml.SubElement(root, "domain_access_rules"), "domain_rule")
    _domains(rule)
    for name, value in (
        ("allow_unauthenticated_participants", "false"),
        ("enable_join_access_control", "true"),
        ("discovery_protection_kind", "ENCRYPT"),
        ("liveliness_protection_kind", "ENCRYPT"),
        ("rtps_protection_kind", "SIGN"),
    ):
        Xml.SubElement(rule, name).text = value
    topic = Xml.SubElement(Xml.SubElement(rule, "topic_access_rules"), "topic_rule")
    for name, value in (
        ("topic_expression", "*"),
        ("enable_discovery_protection", "true"),
        ("enable_liveliness_protection", "true"),
        ("enable_read_access_control", "true"),
        ("enable_write_access_control", "true"),
        ("metadata_protection_kind", "ENCRYPT"),
        ("data_protection_kind", "ENCRYPT"),
    ):
        Xml.SubElement(topic, name).text = value
    return _text(root)


def permissions(enclave: str, access: Access, begin: datetime, end: datetime) -> bytes:
    """Return the permissions of ``enclave``: what ``access`` says from ``begin`` to ``end``, else nothing."""
    root = Xml.Element("dds", _schema("permissions"))
    grant = Xml.SubElement(Xml.SubElement(root, "permissions"), "grant", {"name": enclave})
    Xml.SubElement(grant, "subject_name").text = f"CN={enclave}"
    validity = Xml.SubElement(grant, "validity")
    for name, moment in (("not_before", begin), ("not_after", end)):
        Xml.SubElement(validity, name).text = moment.strftime("%Y-%m-%dT%H:%M:%S")
    rule = Xml.SubElement(grant, "allow_rule")
    _domains(rule)
    for name, topics in (("publish", access.publish), ("subscribe", access.subscribe)):
        listed = Xml.SubElement(Xml.SubElement(rule, name), "topics")
        for topic in topics:
            Xml.SubElement(listed, "topic").text = topic
    Xml.SubElement(grant, "default").text = "DENY"
    return _text(root)


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


def of_node(valve: str, node: str) -> Access:
    """Return what ``node`` (one of :data:`VALVE_NODES`) of ``valve`` needs, its services included."""
    own = f"{valve}/{node}"
    topics = Access(
        tuple(f"rt/{valve}/{topic}" for topic in _SENT[node]),
        tuple(f"rt/{valve}/{topic}" for topic in _HEARD[node]),
    )
    return _common(own) + topics


def of_host(valves: Sequence[str], source: str | None = None) -> Access:
    """Return what a host of estimators and monitors needs, and for a ``source`` of blocks that it runs."""
    access = _common("host") + _common("host_*") + Access((), (SHARED,))
    for valve in valves:
        for node in ("estimator", "monitor", *((source,) if source is not None else ())):
            access += of_node(valve, node)
    return access


def of_recorder(valves: Sequence[str]) -> Access:
    """Return what the recorder needs: it hears everything and sends nothing but its own state."""
    hears = ("rt/diagnostics", SHARED, *(f"rt/{valve}/*" for valve in valves))
    return _common("recorder") + Access((), hears)


def of_viewer(valves: Sequence[str]) -> Access:
    """Return what a viewer needs: it hears, and may ask for nothing."""
    hears = ("rt/diagnostics", SHARED, *(f"rt/{valve}/*" for valve in valves))
    return Access(("ros_discovery_info", "rt/rosout"), (*_ALL_HEAR, *hears))


def of_operator(valves: Sequence[str]) -> Access:
    """Return what an operator needs: a viewer who may call the services of the nodes."""
    called = [f"{valve}/*" for valve in valves] + ["recorder/*", "host/*"]
    calls = Access(tuple(f"rq/{name}Request" for name in called), tuple(f"rr/{name}Reply" for name in called))
    return of_viewer(valves) + calls


@dataclass(frozen=True, slots=True)
class _Authority:
    """Its certificate and key."""

    certificate: Any
    key: Any


def _authority(folder: Path, valid: tuple[datetime, datetime]) -> _Authority:
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
    made = _Authority(_certificate(name, key.public_key(), name, key, valid, authority=True), key)
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


def _write(path: Path, content: bytes, mode: int = 0o644) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | OPEN_FLAGS, mode)
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


def _schema(name: str) -> dict[str, str]:
    return {"xmlns:xsi": _SPACE, "xsi:noNamespaceSchemaLocation": _SCHEMA.format(name)}


def _domains(parent: Xml.Element) -> None:
    low, high = DOMAINS
    span = Xml.SubElement(Xml.SubElement(parent, "domains"), "id_range")
    Xml.SubElement(span, "min").text, Xml.SubElement(span, "max").text = str(low), str(high)


def _text(root: Xml.Element) -> bytes:
    Xml.indent(root)
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _common(node: str) -> Access:
    """Return what a managed node sends, hears and offers as services."""
    return Access(
        (*_ALL_SEND, f"rr/{node}/*Reply", f"rt/{node}/transition_event"), (*_ALL_HEAR, f"rq/{node}/*Request")
    )


COMMAND = Command(secure, place=245, line="a keystore for secured DDS, with the permissions of every node")
