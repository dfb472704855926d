"""Who may connect to the OPC UA server, what each request may do, and in whose name.

Two checks that asyncua lacks are here: a client's certificate is judged when the channel opens, not by what a
session claims, and on a secured server a channel without encryption finds endpoints only.
"""

from __future__ import annotations

import ssl
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import security_policies
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from spool_core.errors import InputError
from spool_core.events.language import LANGUAGES, Language
from spool_core.opcua_folder import CERTIFICATE, KEY, TRUSTED, KeptPassword, check_private, operators

from spool_view.acts import WRONG, WRONG_AT_ONCE, RateLimit

#: Methods that one request calls at most; a client that wants more calls again.
MOST_CALLED = 100

_IDS = ua.ObjectIds
#: Requests that are answered; writing, history and changes of the address space are not. Which methods may be
#: called is up to ``PlantSession.call``.
ALLOWED = frozenset(
    ua.NodeId(number)
    for number in (
        _IDS.CreateSessionRequest_Encoding_DefaultBinary,
        _IDS.CloseSessionRequest_Encoding_DefaultBinary,
        _IDS.ActivateSessionRequest_Encoding_DefaultBinary,
        _IDS.CloseSecureChannelRequest_Encoding_DefaultBinary,
        _IDS.FindServersRequest_Encoding_DefaultBinary,
        _IDS.GetEndpointsRequest_Encoding_DefaultBinary,
        _IDS.ReadRequest_Encoding_DefaultBinary,
        _IDS.BrowseRequest_Encoding_DefaultBinary,
        _IDS.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary,
        _IDS.RegisterNodesRequest_Encoding_DefaultBinary,
        _IDS.UnregisterNodesRequest_Encoding_DefaultBinary,
        _IDS.CreateSubscriptionRequest_Encoding_DefaultBinary,
        _IDS.ModifySubscriptionRequest_Encoding_DefaultBinary,
        _IDS.DeleteSubscriptionsRequest_Encoding_DefaultBinary,
        _IDS.CreateMonitoredItemsRequest_Encoding_DefaultBinary,
        _IDS.DeleteMonitoredItemsRequest_Encoding_DefaultBinary,
        _IDS.SetMonitoringModeRequest_Encoding_DefaultBinary,
        _IDS.SetPublishingModeRequest_Encoding_DefaultBinary,
        _IDS.PublishRequest_Encoding_DefaultBinary,
        _IDS.RepublishRequest_Encoding_DefaultBinary,
        _IDS.CallRequest_Encoding_DefaultBinary,
    )
)

_POLICIES = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]


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


class LookOnly(PermissionRuleset):  # type: ignore[misc]  # asyncua carries no types
    """Ruleset of requests: those in ``ALLOWED``, from any client."""

    def check_validity(self, user: object, action_type: ua.NodeId, body: object) -> bool:  # noqa: ARG002
        """Return whether a request of that type is answered."""
        return action_type in ALLOWED


class FindOnly(PermissionRuleset):  # type: ignore[misc]
    """Ruleset of a channel without encryption where the server is secured: no request of a session."""

    def check_validity(self, user: object, action_type: ua.NodeId, body: object) -> bool:  # noqa: ARG002
        """Return ``False``; requests for endpoints are not asked about."""
        return False


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
        if not self._tries.take():
            return None
        if kept is None or not kept.fits(password or ""):
            return None
        return User(role=UserRole.User, name=username)


class PlantSession(InternalSession):  # type: ignore[misc]
    """Session that knows its client's language and decides on each method that it calls."""

    language: Language | None = None
    _peer: bytes | None = None

    def activate_session(self, params: Any, peer_certificate: bytes | None) -> Any:
        """Activate it: on a secured server on an encrypted channel, later only for the same client.

        asyncua numbers sessions in turn and would give one to any client that names its number.
        """
        if (
            self.external
            and self.iserver.secured
            and (peer_certificate is None or self._peer not in (None, peer_certificate))
        ):
            raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)
        result = super().activate_session(params, peer_certificate)
        self._peer = peer_certificate
        codes = [str(one).partition("-")[0].lower() for one in params.LocaleIds or ()]
        if codes:  # none: as it was, says Part 4 (5.6.3)
            self.language = next((LANGUAGES[code] for code in codes if code in LANGUAGES), None)
        return result

    async def call(self, params: Sequence[Any]) -> list[Any]:
        """Answer each method call."""
        if not self.external:
            return list(await super().call(params))
        if len(params) > MOST_CALLED:
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        results = []
        for request in params:
            code = await self.iserver.answer(self, request)
            results.append(ua.CallMethodResult(StatusCode=ua.StatusCode(code)))
        return results


async def _no_method(session: PlantSession, request: Any) -> int:  # noqa: ARG001
    return int(ua.StatusCodes.BadUserAccessDenied)


class Plant(InternalServer):  # type: ignore[misc]
    """Internal server with such sessions; ``answer`` does what a client's method call asks for."""

    def __init__(self, security: Security | None) -> None:
        super().__init__(Users(security.operators if security is not None else {}))
        self.secured = security is not None
        self.answer: Callable[[PlantSession, Any], Awaitable[int]] = _no_method

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> PlantSession:
        """Return a new session."""
        user = user or User(role=UserRole.Anonymous)
        return PlantSession(self, self.aspace, self.subscription_service, name, user, external)

    def language_of(self, session_id: ua.NodeId) -> Language | None:
        """Return the language that the client of a session asked for."""
        found = (one for one in self._external_sessions.values() if one.session_id == session_id)
        return getattr(next(found, None), "language", None)


class PlantServer(Server):  # type: ignore[misc]
    """Server that is open for looking, or, with ``security``, encrypted for trusted clients."""

    def __init__(self, security: Security | None) -> None:
        super().__init__(iserver=Plant(security))
        self._security = security

    async def init(self) -> None:
        """Fill the standard address space, then load certificate and key."""
        await super().init()
        self.allow_remote_admin(False)
        tokens: list[Any] = [ua.AnonymousIdentityToken]
        if self._security is None:
            self.set_security_policy([ua.SecurityPolicyType.NoSecurity], LookOnly())
        else:
            self.set_security_policy(_POLICIES, LookOnly())
            tokens += [ua.UserNameIdentityToken] if self._security.operators else []
            try:
                await self.load_certificate(self._security.certificate)
                await self.load_private_key(self._security.key)
            except OSError as error:
                raise InputError(f"{error.filename}: it can't be read: {error.strerror or error}") from error
            except (ValueError, TypeError) as error:
                raise InputError(f"{self._security.key}: not a private key in PEM") from error
            await self.set_application_uri(_application(self.iserver.certificate))
        self.set_identity_tokens(tokens)

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
                permission_ruleset=FindOnly(),
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
