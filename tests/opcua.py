"""Clients of the OPC UA server: their certificates, and what they hear."""

from __future__ import annotations

import asyncio
import inspect
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto import security_policies
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography.x509.oid import ExtendedKeyUsageOID

from .clocked import PATIENCE

OPERATOR = {"name": "anna", "password": "a good secret"}


def free_port(address: str = "127.0.0.1") -> int:
    with socket.socket() as probe:
        probe.bind((address, 0))
        return int(probe.getsockname()[1])


def listens(port: int, address: str = "127.0.0.1") -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((address, port)) == 0


async def until(met: Callable[[], Any], what: str) -> Any:
    """Return what is ``met`` at last; it may be awaited."""
    end = time.monotonic() + PATIENCE
    while True:
        found = met()
        if found := await found if inspect.isawaitable(found) else found:
            return found
        assert time.monotonic() < end, f"waited in vain: {what}"
        await asyncio.sleep(0.05)


async def identity(folder: Path) -> tuple[Path, Path]:
    """Make key and certificate of a client; return certificate and key."""
    folder.mkdir()
    certificate, key = folder / "client.der", folder / "client.pem"
    await setup_self_signed_certificate(
        key, certificate, "urn:test:client", "localhost", [ExtendedKeyUsageOID.CLIENT_AUTH], {}
    )
    return certificate, key


async def secured(
    url: str,
    security: Path,
    who: tuple[Path, Path],
    policy: str = "Basic256Sha256",
    languages: Sequence[str] = (),
    **user: str,
) -> Client:
    """Return a client, not connected yet, of the server with that ``security`` folder."""
    client = Client(url, timeout=PATIENCE, watchdog_intervall=PATIENCE)
    client.application_uri = "urn:test:client"
    await client.set_security(
        getattr(security_policies, f"SecurityPolicy{policy}"), *map(str, who),
        server_certificate=str(security / "server.cert.pem"), mode=ua.MessageSecurityMode.SignAndEncrypt,
    )  # fmt: skip
    client.set_locale(list(languages))
    if user:
        client.set_user(user["name"])
        client.set_password(user["password"])
    return client


@dataclass
class Heard:
    """Events of a subscription, and the number of its item."""

    item: int = 0
    events: list[Any] = field(default_factory=list)

    def event_notification(self, event: Any) -> None:
        self.events.append(event)

    async def first(self, name: str, met: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the first event of an alarm that is ``met``."""

        def found() -> Any:
            named = (one for one in self.events if getattr(one, "ConditionName", None) == name)
            return next((one for one in named if met(one)), None)

        return await until(found, f"an event of {name}")


async def subscribed(client: Client, node: Any) -> tuple[Any, Heard]:
    """Subscribe to all alarms of ``node`` by their type alone, and ask for a refresh."""
    heard = Heard()
    subscription = await client.create_subscription(50, heard)
    heard.item = await subscription.subscribe_alarms_and_conditions(node, ua.ObjectIds.AlarmConditionType)
    kind = client.get_node(ua.ObjectIds.ConditionType)
    number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
    await kind.call_method("0:ConditionRefresh", number)
    return subscription, heard
