"""Documents of DDS security: governance and permissions (OMG DDS-SECURITY 1.1, 9.4.1)."""

from __future__ import annotations

from datetime import datetime
from xml.etree import ElementTree as Xml

from .access import Access

_SPACE = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMA = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{}.xsd"
#: All domains that a host may use.
DOMAINS = (0, 232)


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


def _schema(name: str) -> dict[str, str]:
    return {"xmlns:xsi": _SPACE, "xsi:noNamespaceSchemaLocation": _SCHEMA.format(name)}


def _domains(parent: Xml.Element) -> None:
    low, high = DOMAINS
    span = Xml.SubElement(Xml.SubElement(parent, "domains"), "id_range")
    Xml.SubElement(span, "min").text, Xml.SubElement(span, "max").text = str(low), str(high)


def _text(root: Xml.Element) -> bytes:
    Xml.indent(root)
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))
