"""Node ``opcua``: an OPC UA server with state and alarms of all valves; nothing comes in through it."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import Future
from functools import partial
from typing import ClassVar

from asyncua import Server, ua
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter
from spool_monitor.node.valve_condition import monitored_valves
from spool_msgs.msg import AlarmList, ModelEstimate, ValveHealth
from spool_tools.watch.heard import HeardValve

from .access import LookOnly, Onlookers
from .address_space import NAMESPACE, AddressSpace

#: s between updates of the address space and looks for valves that joined; that the server may take to start.
PERIOD, LOOK, START = 0.5, 1.0, 20.0
LOOPBACK = "127.0.0.1"


class OpcUaNode(ManagedNode):
    """Node ``opcua``: what is heard of all valves of this ROS domain, for OPC UA clients on this host."""

    PARAMETERS: ClassVar = (
        NodeParameter(
            "address", LOOPBACK,
            "Address that is listened on; another than loopback lets the network read without a password.",
            structural=True,
        ),
        NodeParameter("port", 4840, "TCP port.", "", 1, 65535, structural=True),
    )  # fmt: skip

    def __init__(self) -> None:
        super().__init__("opcua")
        self._valves: dict[str, HeardValve] = {}
        self._loop = asyncio.new_event_loop()
        self._thread: threading.Thread | None = None
        self._server: Server | None = None
        self._space: AddressSpace | None = None
        self._update: Future[int] | None = None

    def configure(self) -> None:
        """Start the server.

        Raises:
            InputError: the address can't be listened on.
        """
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        address, port = self.value("address"), self.value("port")
        if address != LOOPBACK:
            self.get_logger().warning(f"address {address}: all who reach it read all valves, unencrypted")
        try:
            asyncio.run_coroutine_threadsafe(self._serve(address, port), self._loop).result(START)
        except OSError as error:
            raise InputError(f"port {port}: {error.strerror or error}: another server on it?") from error
        self.get_logger().info(f"serving opc.tcp://{address}:{port}, read only")

    async def _serve(self, address: str, port: int) -> None:
        server = Server(user_manager=Onlookers())
        await server.init()
        server.set_endpoint(f"opc.tcp://{address}:{port}")
        server.set_server_name("spool valves")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity], LookOnly())
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        server.allow_remote_admin(False)
        index = await server.register_namespace(NAMESPACE)
        await server.start()
        self._server, self._space = server, AddressSpace(server, index)

    def activate(self) -> None:
        """Listen to every valve, those that join later as well."""
        self._valves.clear()
        self.every(LOOK, self._look, steady=True)
        self.every(PERIOD, self._push, steady=True)
        self._look()

    def cleanup(self) -> None:
        """Stop the server."""
        if self._server is not None:
            asyncio.run_coroutine_threadsafe(self._server.stop(), self._loop).result(5.0)
        self._server = self._space = None
        if self._thread is not None:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(timeout=5.0)
        self._thread = None

    def _look(self) -> None:
        for name in monitored_valves(self):
            if name in self._valves:
                continue
            valve = self._valves[name] = HeardValve(name)
            self.subscribe(ValveHealth, f"/{name}/health", partial(self._on_health, valve), qos.state())
            self.subscribe(
                ModelEstimate, f"/{name}/estimate", partial(setattr, valve, "estimate"), qos.state()
            )
            self.subscribe(AlarmList, f"/{name}/alarms", partial(setattr, valve, "alarms"), qos.state())

    @staticmethod
    def _on_health(valve: HeardValve, message: ValveHealth) -> None:
        valve.health, valve.health_at = message, time.monotonic()

    def _push(self) -> None:
        """Hand what was heard to the server, unless it still works on the last."""
        if self._space is None or (self._update is not None and not self._update.done()):
            return
        if self._update is not None and self._update.exception() is not None:
            self.get_logger().error(f"the address space was not updated: {self._update.exception()}")
        work = self._space.update(list(self._valves.values()), time.monotonic())
        self._update = asyncio.run_coroutine_threadsafe(work, self._loop)
