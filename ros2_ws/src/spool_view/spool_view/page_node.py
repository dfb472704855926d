"""Node of the operator's page."""

from __future__ import annotations

import ipaddress
import math
import socket
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any, ClassVar

from rcl_interfaces.srv import GetParameters
from spool_core.cdr import decode_block
from spool_core.errors import InputError
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value, rule
from spool_core.node.running import run
from spool_core.node.service_calls import ServiceCalls
from spool_core.opcua_folder import KeptPassword, operators
from spool_core.system import expanded
from spool_monitor.listener import HeardValve, Listener
from spool_monitor.state_database import valves_in
from spool_monitor.state_file import default_folder
from spool_msgs.srv import ManageBaseline

from spool_view import operator as operating
from spool_view.acts import FREEZE, LEARN, Act, Outcome, ask, do
from spool_view.application import ServerThread, application
from spool_view.metrics import Metrics
from spool_view.operator import Desk
from spool_view.view import BAND, spectrum_of

#: Folder of token and log below the state folder.
FOLDER = "web_page"

#: s between two askings for baseline and limits of a valve with an open page: a change shows later by that.
ASK_EVERY = 10.0

#: s likewise of the others.
ASK_ALL_EVERY = 600.0

#: Port of the page where nobody names one.
PORT = 8765


class PageNode(ManagedNode):
    """Node ``page``: serves a page of all running valves to browsers on this host."""

    PARAMETERS: ClassVar = (
        NodeParameter("port", 8765, "Port of the page; 0: any that is free.", "", 0, 65535, structural=True),
        NodeParameter(
            "address", "127.0.0.1",
            "IP address to serve on; any but a loopback address lets the network read.", structural=True,
        ),
        NodeParameter(
            "operator", False, "Allow operators with the token to acknowledge, shelve, reset and more.",
            structural=True,
        ),
        NodeParameter(
            "security_folder", "",
            "Folder made by ./spool secure --opcua: its operators sign in by name and password; empty: by "
            "the token.",
            structural=True,
        ),
        NodeParameter("metrics", False, "Serve /metrics for Prometheus.", structural=True),
        NodeParameter(
            "valves", [""], "Namespaces of the valves to show; empty: all valves found.",
            structural=True,
        ),
        NodeParameter(
            "state_folder", "",
            "Folder of the monitors' trends and of the page's token and log; empty: "
            "$XDG_STATE_HOME/spool, else ~/.local/state/spool.",
            structural=True,
        ),
    )  # fmt: skip

    def __init__(self, **options: Any) -> None:
        super().__init__("page", **options)
        self._socket: socket.socket | None = None
        self._server: ServerThread | None = None
        self._listener: Listener | None = None
        self._open: list[str] = []
        self._asked: dict[str, float] = {}
        self._calls: ServiceCalls | None = None
        self._token: operating.OperatorToken | None = None
        self._log: operating.ActLog | None = None
        self._changed: list[str] = []

    def configure(self) -> None:
        """Take the port."""
        address, port = self.value("address"), self.value("port")
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((address, port))
        except OSError as error:
            raise InputError(f"port {port} of {address}: {error.strerror}: name another port") from error

    def activate(self) -> None:
        """Listen to the valves and serve the page."""
        assert self._socket is not None
        given = self.value("state_folder")
        try:
            folder = expanded(given) if given else default_folder()
        except RuntimeError as error:
            raise InputError("no home directory: set state_folder") from error
        address, port = self._socket.getsockname()[:2]
        if self.value("operator"):
            try:
                self._token = operating.OperatorToken(folder / FOLDER / f"token_{port}", self._passwords())
                self._log = operating.ActLog(folder / FOLDER / "operator_log.jsonl")
            except OSError as error:
                raise InputError(
                    f"state_folder: {folder / FOLDER} can't be written ({error.strerror or error}): "
                    "the page needs it for operators' token and log"
                ) from error
        names = tuple(name.strip("/") for name in self.value("valves") if name.strip("/"))
        self._calls = ServiceCalls(self)
        metrics = self.value("metrics")
        # A valve that has not spoken since a restart has its series, so that the alert rules fire.
        expected = valves_in(folder) if metrics and not names else ()
        self._listener = Listener(self, names, light=True, metrics=metrics, expected=expected)
        self._open = []
        desk = Desk(
            valves=self._listener.valves,
            open=self._open,
            address=address,
            state_folder=folder,
            spectrum=lambda blocks: spectrum_of([decode_block(one) for one in blocks]),
            do=self._do,
            token=self._token,
            log=self._log,
            warn=self.get_logger().warning,
            metrics=Metrics(self._listener.valves, self._listener.hosts) if metrics else None,
        )
        self._server = ServerThread(application(desk), self._socket)
        self._server.start()
        self.every(0.2, self._work, steady=True)
        self.every(2.0, self._listener.look, steady=True)
        host = f"[{address}]" if ":" in address else address
        self.get_logger().info(f"the page is at http://{host}:{port}/")
        if metrics:
            self.get_logger().info(f"metrics for Prometheus are at http://{host}:{port}/metrics")
        if self._token is not None and self._token.personal:
            self.get_logger().info("operators sign in by name and password")
        elif self._token is not None:
            self.get_logger().info(f"operators: the token is in {self._token.path}")
        else:
            self.get_logger().info("the page is read only: start it with --operator to let operators act")

    def _passwords(self) -> dict[str, KeptPassword]:
        if not self.value("security_folder"):
            return {}
        folder = expanded(self.value("security_folder"))
        found = operators(folder)
        if not found:
            raise InputError(
                f"security_folder: no operator in {folder}: ./spool secure --opcua {folder} --operator NAME"
            )
        return found

    def deactivate(self) -> None:
        """End every stream, then the rest."""
        if self._server is not None:
            self._server.stop()
        for one in (self._listener, self._calls, self._log):
            if one is not None:
                one.close()
        if self._token is not None:
            self._token.remove()
        self._server = self._listener = self._calls = self._token = self._log = None
        self._asked.clear()

    def cleanup(self) -> None:
        """Release the port."""
        if self._server is not None:  # activating failed half-way
            self.deactivate()
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        """Refuse what is no address, and operators over a network: the token would travel in clear."""
        address = str(changes.get("address", self.value("address")))
        try:
            loopback = ipaddress.ip_address(address).is_loopback
        except ValueError:
            return f"address: {address!r} is no IP address, e.g. 127.0.0.1"
        if changes.get("operator", self.value("operator")) and not loopback:
            return "operator: only on a loopback address; from elsewhere reach it by ssh -L"
        return None

    def _work(self) -> None:
        assert self._listener is not None
        assert self._calls is not None
        while self._changed:
            self._asked.pop(self._changed.pop(), None)
        self._listener.fetch()
        followed, now = self._listener.follow(list(self._open)), time.monotonic()
        self._listener.sample_bounds()
        due = [valve for valve in followed if now - self._asked.get(valve.name, -math.inf) >= ASK_EVERY]
        # Of the others one at a time: their tiles show baseline and limits, too.
        longest = min(self._listener.valves.values(), key=self._last_asked, default=None)
        if longest is not None and now - self._last_asked(longest) >= ASK_ALL_EVERY:
            due.append(longest)
        for valve in due:
            self._asked[valve.name] = now
            _ask_monitor(self._calls, valve)
        self._calls.work()

    def _last_asked(self, valve: HeardValve) -> float:
        return self._asked.get(valve.name, -math.inf)

    def _do(self, act: Act) -> Future[Outcome]:
        """Ask for ``act``; called by the server's thread."""
        assert self._calls is not None
        outcome = do(self._calls, act)
        if act.act in (FREEZE, LEARN):
            outcome.add_done_callback(lambda _: self._changed.append(act.valve))
        return outcome


def serve(
    *,
    port: int = PORT,
    operator: bool = False,
    metrics: bool = False,
    names: tuple[str, ...] = (),
    operators: Path | None = None,
) -> None:
    """Serve the page on this host until SIGINT or SIGTERM.

    Args:
        port: on the loopback address.
        operator: whether who has the token may acknowledge, shelve and more; else the page is read only.
        metrics: whether ``/metrics`` is served for Prometheus.
        names: of valves; empty for all that are heard.
        operators: folder made by ``./spool secure --opcua``, whose operators sign in by name and password.

    Raises:
        SystemExit: the page could not be served; what is wrong was said in one line.
    """
    values: dict[str, Value] = {
        "port": port, "operator": operator, "metrics": metrics, "valves": list(names) or [""],
        "security_folder": str(operators or ""),
    }  # fmt: skip
    words = [word for name, value in values.items() for word in rule(name, value)]
    code = run(PageNode, ["--ros-args", *words])
    if code:
        raise SystemExit(code)


def _ask_monitor(calls: ServiceCalls, valve: HeardValve) -> None:
    def take_baseline(answer: Future[Any]) -> None:
        got = answer.result()
        valve.keep("baseline", got if got is not None and got.success else None)

    def take_limits(answer: Future[Any]) -> None:
        got = answer.result()
        valve.keep("limits", {BAND: float(got.values[0].double_value)} if got and got.values else {})

    show = ManageBaseline.Request(action=ManageBaseline.Request.SHOW)
    ask(calls, valve.name, "manage_baseline", show).add_done_callback(take_baseline)
    limits = GetParameters.Request(names=[BAND])
    ask(calls, valve.name, "get_parameters", limits).add_done_callback(take_limits)
