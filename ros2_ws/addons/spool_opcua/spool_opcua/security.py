"""Who may connect to the OPC UA server, what each request may do, and in whose name.

What asyncua lacks is here: a client's certificate is judged when the channel opens, not by what a session
claims; on a secured server a channel without encryption finds endpoints only; refused clients get an Error
message; connections and announced sizes are bounded; filters that cannot be evaluated are refused.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import operator
import socket
import ssl
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto import security_policies, uacrypto
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.uaprocessor import UaProcessor
from asyncua.server.user_managers import UserManager
from asyncua.ua.ua_binary import struct_from_binary, uatcp_to_binary
from asyncua.ua.uaprotocol_auto import DataChangeFilter
from spool_core.errors import InputError
from spool_core.events.language import LANGUAGES, Language
from spool_core.opcua_folder import CERTIFICATE, KEY, TRUSTED, KeptPassword, check_private, operators
from spool_report.outputs import package_version, suite_version
from spool_view.acts import WRONG, WRONG_AT_ONCE, RateLimit

#: URI of this product (OPC 10000-5, 12.4).
PRODUCT = "urn:spool-suite:opcua"
#: Methods that one request calls at most; a client that wants more calls again.
MOST_CALLED = 100
#: Connections at most; B of a chunk, of a request, and of answers that a client has not read.
MOST_CONNECTIONS, MOST_CHUNK, MOST_REQUEST, MOST_UNREAD = 100, 65_535, 1 << 20, 16 << 20
#: s that a refused client has to read why, before its connection ends: chosen, longer keeps a place taken.
LINGER = 2.0

_LOG = logging.getLogger("asyncua.refusals")  # below asyncua: the node shows what is logged there
_IDS, _CODES, _OPERATOR, _NULL = ua.ObjectIds, ua.StatusCodes, ua.FilterOperator, ua.Variant(None)


def _all(*values: Any) -> bool | None:
    """Return whether all are true, ``None`` where that is not known (OPC 10000-4, table 121)."""
    return False if False in values else None if None in values else all(values)


def _negated(value: Any) -> bool | None:
    return None if value is None else not value


#: Operators of filters with the numbers of their operands (OPC 10000-4, 7.7.3).
_OPERATORS: Mapping[ua.FilterOperator, tuple[int, Callable[..., bool | None]]] = {
    _OPERATOR.Equals: (2, operator.eq),
    _OPERATOR.IsNull: (1, lambda value: value is None),
    _OPERATOR.GreaterThan: (2, operator.gt),
    _OPERATOR.LessThan: (2, operator.lt),
    _OPERATOR.GreaterThanOrEqual: (2, operator.ge),
    _OPERATOR.LessThanOrEqual: (2, operator.le),
    _OPERATOR.Not: (1, _negated),
    _OPERATOR.Between: (3, lambda value, low, high: low <= value <= high),
    _OPERATOR.InList: (2, lambda value, *listed: value in listed),
    _OPERATOR.And: (2, _all),
    _OPERATOR.Or: (2, lambda *values: _negated(_all(*map(_negated, values)))),
    _OPERATOR.OfType: (1, lambda _: None),  # by the event
}
#: First bytes of what a client may send (OPC 10000-6, 7.1.2.2 and 6.7.2).
_MESSAGES = (b"HEL", b"OPN", b"MSG", b"CLO")
#: Requests that are answered; writing, history and changes of the address space are not. Which methods may be
#: called is up to ``PlantSession.call``.
ALLOWED = frozenset(
    ua.NodeId(getattr(_IDS, f"{name}Request_Encoding_DefaultBinary"))
    for name in (
        *("CreateSession", "CloseSession", "ActivateSession", "CloseSecureChannel"),
        *("FindServers", "GetEndpoints", "Read", "Browse", "TranslateBrowsePathsToNodeIds"),
        *("RegisterNodes", "UnregisterNodes", "CreateSubscription", "ModifySubscription"),
        *("DeleteSubscriptions", "CreateMonitoredItems", "DeleteMonitoredItems", "SetMonitoringMode"),
        *("SetPublishingMode", "Publish", "Republish", "Call"),
    )
)

_KINDS = ua.SecurityPolicyType
_POLICIES = [_KINDS.Basic256Sha256_SignAndEncrypt, _KINDS.Aes256Sha256RsaPss_SignAndEncrypt]


@dataclass(frozen=True, slots=True)
class Security:
    """Content of a security folder (:mod:`spool_core.opcua_folder`); ``trusted`` are certificates (DER)."""

    certificate: Path
    key: Path
    trusted: frozenset[bytes]
    operators: Mapping[str, KeptPassword]

    @classmethod
    def read(cls, folder: Path) -> Security:
        """Return what ``folder`` holds.

        Raises:
            InputError: a file is missing, is none, or can be read by others.
        """
        certificate, key = folder / CERTIFICATE, folder / KEY
        check_private(key)
        _der(certificate)
        listed = sorted(path for path in (folder / TRUSTED).glob("*") if path.suffix in (".pem", ".der"))
        return cls(certificate, key, frozenset(map(_der, listed)), operators(folder))


@dataclass(frozen=True)
class Only(PermissionRuleset):  # type: ignore[misc]  # asyncua carries no types
    """Ruleset of requests: those of the types ``allowed``, from any client; all find endpoints."""

    allowed: frozenset[ua.NodeId] = ALLOWED

    def check_validity(self, user: object, action_type: ua.NodeId, body: object) -> bool:  # noqa: ARG002
        """Return whether a request of that type is answered."""
        return action_type in self.allowed


@dataclass
class Users(UserManager):  # type: ignore[misc]
    """User manager: anonymous users look, those with an operator's password act; nobody administrates."""

    operators: Mapping[str, KeptPassword]
    _tries: RateLimit = field(default_factory=lambda: RateLimit(WRONG, WRONG_AT_ONCE))

    def get_user(
        self, _: object, username: str | None = None, password: str | None = None, certificate: object = None
    ) -> User | None:
        """Return the user; ``None`` where name and password do not fit. Only an operator has a name."""
        del certificate
        if username is None:
            return User(role=UserRole.User)
        kept = self.operators.get(username)
        fits = self._tries.take() and kept is not None and kept.fits(password or "")
        return User(role=UserRole.User, name=username) if fits else None


@dataclass(frozen=True, slots=True)
class Watch:
    """Monitored item of events at the node ``notifier``, with the fields and the filter of its client."""

    notifier: ua.NodeId
    handle: int
    queue: int
    filter: ua.EventFilter

    def selected(self, fields: Mapping[str, ua.Variant]) -> ua.EventFieldList:
        """Return what the client selected of an event; null where there is no such field."""
        clauses = self.filter.SelectClauses or ()
        return ua.EventFieldList(self.handle, [fields.get(_name(one), _NULL) for one in clauses])

    def passes(self, fields: Mapping[str, ua.Variant], kinds: Sequence[ua.NodeId]) -> bool:
        """Return whether the filter lets an event of a type and those above (``kinds``) pass."""
        elements = self.filter.WhereClause.Elements or []
        found: dict[int, Any] = {len(elements): True}
        for number, element in reversed(list(enumerate(elements))):  # elements refer to later ones
            values = []
            for one in element.FilterOperands:
                if isinstance(one, ua.ElementOperand):
                    values.append(found[one.Index])
                else:
                    literal = isinstance(one, ua.LiteralOperand)
                    values.append((one.Value if literal else fields.get(_name(one), _NULL)).Value)
            try:
                found[number] = _OPERATORS[element.FilterOperator][1](*values)
            except TypeError:  # what cannot be compared is null
                found[number] = None
            if element.FilterOperator == _OPERATOR.OfType:
                found[number] = values[0] in kinds
        return found[0] is True


def _name(operand: Any) -> str:
    """Return the name of an event's field that ``operand`` selects; ``NodeId`` is the condition's."""
    if operand.BrowsePath:
        return "/".join(str(one.Name) for one in operand.BrowsePath)
    return "NodeId" if operand.AttributeId == ua.AttributeIds.NodeId else ""


def refusal(item: ua.MonitoredItemCreateRequest) -> ua.MonitoredItemCreateResult | None:
    """Return the refusal of an item whose filter cannot be served (OPC 10000-4, 7.22), else ``None``."""
    wanted, codes = item.RequestedParameters.Filter, list[int]()
    if item.ItemToMonitor.AttributeId != ua.AttributeIds.EventNotifier:
        plain = isinstance(wanted, DataChangeFilter) and wanted.DeadbandType != ua.DeadbandType.Percent
        code = 0 if wanted is None or plain else _CODES.BadMonitoredItemFilterUnsupported
    elif not isinstance(wanted, ua.EventFilter):
        code = _CODES.BadEventFilterInvalid
    else:
        elements = wanted.WhereClause.Elements or []
        codes = [_element(number, one, len(elements)) for number, one in enumerate(elements)]
        code = next(filter(None, codes), 0)
    if not code:
        return None
    result = ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(code))
    if codes:
        told = [ua.ContentFilterElementResult(StatusCode=ua.StatusCode(one)) for one in codes]
        result.FilterResult = ua.EventFilterResult(WhereClauseResult=ua.ContentFilterResult(told))
    return result


def _element(number: int, element: Any, count: int) -> int:
    """Return the status of the element ``number`` of ``count``: it may refer to later ones only."""
    kind, operands = element.FilterOperator, element.FilterOperands or []
    if kind not in _OPERATORS:
        return int(_CODES.BadFilterOperatorUnsupported)
    wanted = _OPERATORS[kind][0]
    if len(operands) < wanted or (len(operands) > wanted and kind != _OPERATOR.InList):
        return int(_CODES.BadFilterOperandCountMismatch)
    literal = all(isinstance(one, ua.LiteralOperand) and one.Value is not None for one in operands)
    known = all(
        number < one.Index < count if isinstance(one, ua.ElementOperand)
        else isinstance(one, ua.LiteralOperand | ua.SimpleAttributeOperand) for one in operands
    )  # fmt: skip
    fits = known and (literal or kind != _OPERATOR.OfType)
    return int(_CODES.Good if fits else _CODES.BadFilterOperandInvalid)


class PlantSession(InternalSession):  # type: ignore[misc]
    """Session that knows its client's language and decides on each method that it calls."""

    language: Language | None = None
    _peer: bytes | None = None

    def activate_session(self, params: Any, peer_certificate: bytes | None) -> Any:
        """Activate it: on a secured server on an encrypted channel, later only for the same client.

        asyncua numbers sessions in turn and would give one to any client that names its number.
        """
        unknown = peer_certificate is None or self._peer not in (None, peer_certificate)
        if self.external and self.iserver.secured and unknown:
            raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)
        result = super().activate_session(params, peer_certificate)
        self._peer = peer_certificate
        codes = [str(one).partition("-")[0].lower() for one in params.LocaleIds or ()]
        if codes:  # none: as it was, says Part 4 (5.6.3)
            self.language = next((LANGUAGES[code] for code in codes if code in LANGUAGES), None)
        return result

    async def create_monitored_items(self, params: Any) -> list[Any]:
        """Create each item whose filter can be served."""
        results = []
        for item in params.ItemsToCreate:
            result = refusal(item)
            if result is None:
                (result,) = await super().create_monitored_items(replace(params, ItemsToCreate=[item]))
                node, wanted = item.ItemToMonitor, item.RequestedParameters
                if result.StatusCode.is_good() and isinstance(wanted.Filter, ua.EventFilter):
                    _, watched = self.iserver.watched.setdefault(params.SubscriptionId, (self, {}))
                    watched[result.MonitoredItemId] = Watch(
                        node.NodeId, wanted.ClientHandle, result.RevisedQueueSize, wanted.Filter
                    )
            results.append(result)
        return results

    async def delete_monitored_items(self, params: Any) -> list[Any]:
        """Delete items."""
        results = list(await super().delete_monitored_items(params))
        _, watches = self.iserver.watched.get(params.SubscriptionId, (self, {}))
        for item, code in zip(params.MonitoredItemIds, results, strict=True):
            if code.is_good():
                watches.pop(item, None)
        return results

    async def call(self, params: Sequence[Any]) -> list[Any]:
        """Answer each method call."""
        if not self.external:
            return list(await super().call(params))
        if len(params) > MOST_CALLED:
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        codes = [await self.iserver.answer(self, request) for request in params]
        return [ua.CallMethodResult(StatusCode=ua.StatusCode(code)) for code in codes]


async def _no_method(session: PlantSession, request: Any) -> int:  # noqa: ARG001
    return int(ua.StatusCodes.BadUserAccessDenied)


class Plant(InternalServer):  # type: ignore[misc]
    """Internal server with such sessions; ``answer`` does what a client's method call asks for."""

    def __init__(self, security: Security | None) -> None:
        super().__init__(Users(security.operators if security is not None else {}))
        self.secured = security is not None
        self.answer: Callable[[PlantSession, Any], Awaitable[int]] = _no_method
        self.watched: dict[int, tuple[PlantSession, dict[int, Watch]]] = {}
        self.refusals = RateLimit(WRONG, WRONG_AT_ONCE)

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> PlantSession:
        """Return a new session."""
        user = user or User(role=UserRole.Anonymous)
        return PlantSession(self, self.aspace, self.subscription_service, name, user, external)

    def watches(self) -> Iterator[tuple[Any, PlantSession, dict[int, Watch]]]:
        """Yield each subscription that watches events, with its session, and its items by their numbers."""
        for number, (session, found) in list(self.watched.items()):
            subscription = self.subscription_service.subscriptions.get(number)
            if subscription is None:
                del self.watched[number]
            else:
                yield subscription, session, dict(found)


class Processor(UaProcessor):  # type: ignore[misc]
    """Processor whose refusals end the ``connection`` with an Error message."""

    connection: Connection
    _opened = False

    async def process(self, header: Any, body: Any) -> bool:
        """Process a chunk; return whether the connection stays."""
        if self.connection.refused:
            return True
        certificate, opens = b"", header.MessageType == ua.MessageType.SecureOpen
        try:
            if opens:
                asked = struct_from_binary(ua.AsymmetricAlgorithmHeader, body.copy(header.body_size))
                certificate = asked.SenderCertificate or b""
            stays = await super().process(header, body)
        except Exception as error:
            code = _CODES.BadTcpMessageTypeInvalid
            if opens or self._opened:
                code = _CODES.BadSecurityChecksFailed
            elif header.MessageType != ua.MessageType.Hello:
                code = _CODES.BadTcpSecureChannelUnknown
            said = f"{error}" or type(error).__name__
            if certificate:
                # OPC UA's thumbprint of a certificate (OPC 10000-4, 7.2) is a name, not a protection.
                said += f"; certificate {hashlib.sha1(certificate).hexdigest()} (SHA-1)"
            self.connection.refuse(code, said)
            return True
        self._opened |= opens
        return bool(stays)


class Connection(OPCUAProtocol):  # type: ignore[misc]
    """Connection of a client."""

    _held = b""
    refused = False

    def connection_made(self, transport: Any) -> None:
        """Take it; of too many, the oldest without a session ends (OPC 10000-4, 5.6.2)."""
        self._socket = transport
        if len(self.clients) >= MOST_CONNECTIONS:
            held = [(one, one.processor.session) for one in self.clients]
            idle = [one for one, session in held if session is None or not session.is_activated()]
            (idle[0] if idle else self).refuse(_CODES.BadTcpServerTooBusy, "too many connections", 0.0)
            if not idle:
                return
            self.clients.remove(idle[0])
        super().connection_made(transport)
        self.processor = Processor(self.iserver, transport, self.limits)
        self.processor.set_policies(self.policies)
        self.processor.connection = self

    def data_received(self, data: bytes) -> None:
        """Hand on whole chunks."""
        if self._socket.get_write_buffer_size() > MOST_UNREAD:
            self._socket.abort()
        self._held += data
        while not self.refused and len(self._held) >= 8:
            size = int.from_bytes(self._held[4:8], "little")
            if self._held[:3] not in _MESSAGES or size <= 12:
                self.refuse(_CODES.BadTcpMessageTypeInvalid, "not a message of OPC UA")
            elif size > MOST_CHUNK:
                self.refuse(_CODES.BadTcpMessageTooLarge, f"a chunk of {size} B is announced")
            elif len(self._held) < size:
                return
            else:
                chunk, self._held = self._held[:size], self._held[size:]
                super().data_received(chunk)
        if self.refused:
            self._held = b""

    def refuse(self, code: int, reason: str, linger: float = LINGER) -> None:
        """Send an Error message (OPC 10000-6, 7.1.5) and end the connection; log whose it is and the reason.

        What is wrong with a certificate is logged only: it would help an attacker (OPC 10000-4, 6.1.3).
        """
        if self.refused:
            return
        self.refused = True
        if self.iserver.refusals.take():
            peer = self._socket.get_extra_info("peername") or ("unknown",)
            _LOG.warning("client %s refused: %s", ":".join(map(str, peer[:2])), reason)
        told = "refused: the server's log says why" if code == _CODES.BadSecurityChecksFailed else reason
        message = ua.ErrorMessage(ua.StatusCode(code), told)
        self._socket.write(uatcp_to_binary(ua.MessageType.Error, message))
        # Without time to read, what the client still sends would reset the connection and lose the message.
        self._socket.write_eof()
        asyncio.get_running_loop().call_later(linger, self._socket.abort if linger else self._socket.close)


class Door(BinaryServer):  # type: ignore[misc]
    """Listener whose connections are of that kind."""

    def _make_protocol(self) -> Connection:
        return Connection(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)


class PlantServer(Server):  # type: ignore[misc]
    """Server that is open for looking, or, with ``security``, encrypted for trusted clients."""

    def __init__(self, security: Security | None) -> None:
        super().__init__(iserver=Plant(security))
        self._security = security
        self.name, self.manufacturer_name, self.product_uri = "spool valves", "spool suite", PRODUCT
        self.application_type = ua.ApplicationType.Server
        self.limits = TransportLimits(MOST_CHUNK, MOST_CHUNK, MOST_REQUEST // MOST_CHUNK + 1, MOST_REQUEST)

    async def init(self) -> None:
        """Fill the standard address space, then load certificate and key."""
        await super().init()
        built = datetime.fromtimestamp(Path(__file__).stat().st_mtime, timezone.utc)
        names = self.product_uri, self.manufacturer_name, self.name
        await self.set_build_info(*names, package_version(), suite_version(), built)
        await self.get_node(ua.NodeId(_IDS.Server_Auditing)).write_value(False)
        application = f"urn:{socket.gethostname()}:spool-suite:opcua"
        self.allow_remote_admin(False)
        tokens: list[Any] = [ua.AnonymousIdentityToken]
        if self._security is None:
            self.set_security_policy([ua.SecurityPolicyType.NoSecurity], Only())
        else:
            self.set_security_policy(_POLICIES, Only())
            tokens += [ua.UserNameIdentityToken] if self._security.operators else []
            try:
                await self.load_certificate(self._security.certificate)
                await self.load_private_key(self._security.key)
            except OSError as error:
                raise InputError(f"{error.filename}: it can't be read: {error.strerror or error}") from error
            except (ValueError, TypeError) as error:
                raise InputError(f"{self._security.key}: not a private key in PEM") from error
            application = _application(self.iserver.certificate)
            uacrypto.check_certificate(self.iserver.certificate, application, socket.gethostname())
        await self.set_application_uri(application)
        self.set_identity_tokens(tokens)

    async def start(self) -> None:
        """Listen."""
        await self._setup_server_nodes()
        await self.iserver.start()
        self.bserver = Door(self.iserver, self.endpoint.hostname, self.endpoint.port, self.limits)
        self.bserver.set_policies(self._policies)
        try:
            await self.bserver.start()
        except OSError:
            await self.iserver.stop()
            raise

    async def _setup_server_nodes(self) -> None:
        await super()._setup_server_nodes()
        if self._security is None:
            return
        for factory in self._policies:
            factory.create = _trusting(factory.create, self._security.trusted)
        # Without an entry asyncua lets unencrypted channels do everything.
        self._policies.append(
            security_policies.SecurityPolicyFactory(
                security_policies.SecurityPolicyNone,
                ua.MessageSecurityMode.None_,
                permission_ruleset=Only(frozenset()),
            )
        )


def _trusting(create: Callable[[bytes], Any], trusted: frozenset[bytes]) -> Callable[[bytes], Any]:
    """Return ``create``, a policy by the peer's certificate, for trusted certificates alone."""
    from cryptography import x509  # noqa: PLC0415 - only a secured server needs it

    def judged(certificate: bytes) -> Any:
        if certificate not in trusted:
            raise ua.uaerrors.BadCertificateUntrusted
        one = x509.load_der_x509_certificate(certificate)
        if not one.not_valid_before_utc <= datetime.now(timezone.utc) <= one.not_valid_after_utc:
            raise ua.uaerrors.BadCertificateTimeInvalid
        return create(certificate)

    return judged


def _application(certificate: Any) -> str:
    """Return the application's URI: clients compare it with the certificate's (OPC 10000-6, 6.2.2)."""
    from cryptography import x509  # noqa: PLC0415

    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        return str(names.get_values_for_type(x509.UniformResourceIdentifier)[0])
    except (x509.ExtensionNotFound, IndexError) as error:
        raise InputError(
            f"{CERTIFICATE}: it names no application URI: make one with ./spool secure"
        ) from error


def _der(path: Path) -> bytes:
    try:
        content = path.read_bytes()
        return ssl.PEM_cert_to_DER_cert(content.decode("ascii")) if b"-----BEGIN" in content else content
    except OSError as error:
        advice = ": make it with ./spool secure --opcua" if isinstance(error, FileNotFoundError) else ""
        raise InputError(f"{path}: {error.strerror}{advice}") from error
    except ValueError as error:
        raise InputError(f"{path}: not a certificate") from error
