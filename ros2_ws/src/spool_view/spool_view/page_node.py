"""Node of the operator's page."""

from __future__ import annotations

import ipaddress
import socket
import time
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value, rule
from spool_core.node.running import run
from spool_core.node.service_calls import ServiceCalls
from spool_core.system import expanded
from spool_monitor.listener import monitored_valves
from spool_monitor.state_file import default_folder
from spool_msgs.msg import AccelerationBlock, AlarmList, GapAnalysis, ModelEstimate, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm, TakeSnapshot
from std_srvs.srv import Trigger

from spool_view import operator as operating
from spool_view.application import ServerThread, application
from spool_view.operator import Act, Desk, Outcome
from spool_view.view import BAND, Board, HeardValve, alarms_of, bounds_of, spectrum_of

#: Folder of token and log below the state folder.
FOLDER = "web_page"

#: Nodes that do what the monitor does not.
_NODES = {operating.ANALYSE: "estimator", operating.SNAPSHOT: "recorder"}

#: s between two askings for the baseline and the limits of a valve whose page is open.
ASK_EVERY = 10.0
#: Valves whose pages are fed with samples and more at a time.
MOST_OPEN = 16

#: Services that can be called: node and type by name; there is no way to any other.
SERVICES: dict[str, tuple[str, Any]] = {
    "acknowledge_alarm": ("monitor", AcknowledgeAlarm),
    "shelve_alarm": ("monitor", ShelveAlarm),
    "reset_alarms": ("monitor", ResetAlarms),
    "manage_baseline": ("monitor", ManageBaseline),
    "get_parameters": ("monitor", GetParameters),
    "analyse_gap": ("estimator", Trigger),
    "take_snapshot": ("recorder", TakeSnapshot),
}
#: Nodes that serve all valves, outside of their namespaces.
SHARED = {"recorder"}

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
            "operator", False, "Whether who has the token may acknowledge, shelve, reset, and more.",
            structural=True,
        ),
        NodeParameter(
            "valves", [""], "Namespaces of the valves that are shown; empty: all that are heard.",
            structural=True,
        ),
        NodeParameter(
            "state_folder", "",
            "Where the monitors keep trends, and the page its token and log; empty: "
            "$XDG_STATE_HOME/spool, else ~/.local/state/spool.",
            structural=True,
        ),
    )  # fmt: skip

    def __init__(self) -> None:
        super().__init__("page")
        self._socket: socket.socket | None = None
        self._server: ServerThread | None = None
        self._listening: Listening | None = None
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
        folder = self._folder()
        address, port = self._socket.getsockname()[:2]
        if self.value("operator"):
            self._token = operating.OperatorToken(folder / FOLDER / f"token_{port}")
            self._log = operating.ActLog(folder / FOLDER / "operator_log.jsonl")
        board = Board()
        names = tuple(name.strip("/") for name in self.value("valves") if name.strip("/"))
        calls = self._calls = ServiceCalls(self)
        self._listening = Listening(self, board, calls, names)
        desk = Desk(
            board=board,
            address=address,
            state_folder=folder,
            spectrum=lambda blocks: spectrum_of(
                [deserialize_message(one, AccelerationBlock) for one in blocks]
            ),
            do=self._do,
            token=self._token,
            log=self._log,
            warn=self.get_logger().warning,
        )
        self._server = ServerThread(application(desk), self._socket)
        self._server.start()
        self.every(0.2, self._work, steady=True)
        self.every(2.0, self._listening.look, steady=True)
        self._listening.look()
        host = f"[{address}]" if ":" in address else address
        self.get_logger().info(f"the page is at http://{host}:{port}/")
        if self._token is not None:
            self.get_logger().info(f"operators: the token is in {self._token.path}")
        else:
            self.get_logger().info("it is read only: operators need --operator")

    def deactivate(self) -> None:
        """End every stream, then the rest."""
        if self._server is not None:
            self._server.stop()
        if self._listening is not None:
            self._listening.close()
        if self._calls is not None:
            self._calls.close()
        if self._token is not None:
            self._token.remove()
        if self._log is not None:
            self._log.close()
        self._server = self._listening = self._calls = self._token = self._log = None

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

    def _folder(self) -> Path:
        given = self.value("state_folder")
        try:
            return expanded(given) if given else default_folder()
        except RuntimeError as error:
            raise InputError("no home directory: set state_folder") from error

    def _work(self) -> None:
        """Bring forward what browsers asked for."""
        assert self._listening is not None
        assert self._calls is not None
        while self._changed:
            self._listening.ask_again(self._changed.pop())
        self._listening.fetch()
        self._listening.follow()
        self._calls.work()

    def _do(self, act: Act) -> Future[Outcome]:
        """Ask for ``act``; called by the server's thread."""
        assert self._calls is not None
        outcome = do(self._calls, act)
        if act.act in (operating.FREEZE, operating.LEARN):
            outcome.add_done_callback(lambda _: self._changed.append(act.valve))
        return outcome


def do(calls: ServiceCalls, act: Act) -> Future[Outcome]:
    """Ask for ``act``; the outcome comes once the valve's node has answered, or is not there."""
    service, request = _request(act)
    outcome: Future[Outcome] = Future()

    def take(answer: Future[Any]) -> None:
        outcome.set_result(_outcome(act, answer.result()))

    _ask(calls, act.valve, service, request).add_done_callback(take)
    return outcome


class Listening:
    """Listener of one node; everything but the board's own is touched on the node's thread only.

    Health comes once a second of each valve. It is fetched by :meth:`fetch`, with a node that no executor
    wakes up for: that costs a third of a callback for each message.
    """

    def __init__(self, node: Node, board: Board, calls: ServiceCalls, names: tuple[str, ...]) -> None:
        self._node, self._board, self._calls, self._names = node, board, calls, names
        self._quiet = Node(
            f"{node.get_name()}_listener", namespace=node.get_namespace(), context=node.context,
            enable_rosout=False, start_parameter_services=False, use_global_arguments=False,
        )  # fmt: skip
        self._health: dict[str, Any] = {}
        self._heard: dict[str, Any] = {}
        self._opened: dict[str, list[Any]] = {}
        self._asked: dict[str, float] = {}
        for name in names:
            self._join(name)

    def look(self) -> None:
        """Join the valves that appeared."""
        if self._names:
            return
        for name in monitored_valves(self._node):
            self._join(name)

    def fetch(self) -> None:
        """Fetch what the monitors said since the last time."""
        for name, subscription in self._health.items():
            with subscription.handle:
                taken = subscription.handle.take_message(ValveHealth, False)
            if taken is not None:
                valve = self._board.valves[name]
                valve.health, valve.health_at = taken[0], time.monotonic()
                valve.changes += 1

    def follow(self) -> None:
        """Take up and release what only pages that are open need."""
        wanted = [name for name in list(self._board.open) if name in self._heard][:MOST_OPEN]
        for name in [name for name in self._opened if name not in wanted]:
            self._close(name)
        now = time.monotonic()
        for name in wanted:
            if name not in self._opened:
                self._open(name)
            if now - self._asked.get(name, -ASK_EVERY) >= ASK_EVERY:
                self._asked[name] = now
                self._ask(self._board.valves[name])

    def ask_again(self, name: str) -> None:
        """Ask for baseline and limits of ``name`` soon: they were changed."""
        self._asked.pop(name, None)

    def close(self) -> None:
        """Destroy every subscription."""
        for name in list(self._opened):
            self._close(name)
        for one in self._heard.values():
            self._node.destroy_subscription(one)
        self._heard.clear()
        self._health.clear()
        self._quiet.destroy_node()

    def _join(self, name: str) -> None:
        if name in self._heard:
            return
        valve = self._board.join(name)
        if valve is None:
            return

        def take(message: AlarmList) -> None:
            _keep(valve, "alarms", alarms_of(message))

        self._heard[name] = self._node.create_subscription(AlarmList, f"/{name}/alarms", take, qos.state())
        # What is lost is said again a second later, so nothing has to be confirmed or sent again.
        quality = qos.samples_wanted(1)
        # A subscription has to have a callback; no executor calls this one.
        health = self._quiet.create_subscription(ValveHealth, f"/{name}/health", lambda _: None, quality)
        self._health[name] = health

    def _open(self, name: str) -> None:
        valve = self._board.valves[name]
        subscribe = self._node.create_subscription
        self._opened[name] = []

        def take_block(raw: bytes) -> None:  # rclpy refuses a method of deque: it has no signature
            valve.blocks.append(raw)

        for kind, topic, take, quality, raw in (
            (AccelerationBlock, "acceleration", take_block, qos.samples_wanted(), True),
            (ModelEstimate, "estimate", partial(_keep, valve, "estimate"), qos.state(), False),
            (GapAnalysis, "gap", partial(_keep, valve, "gap"), qos.state(), False),
        ):
            made = subscribe(kind, f"/{name}/{topic}", take, quality, raw=raw)
            self._opened[name].append(made)
        made = subscribe(DiagnosticArray, "/diagnostics", partial(_take_bounds, valve), qos.diagnostics())
        self._opened[name].append(made)

    def _close(self, name: str) -> None:
        for one in self._opened.pop(name):
            self._node.destroy_subscription(one)
        valve = self._board.valves[name]
        valve.blocks.clear()
        valve.gap = valve.estimate = None
        valve.bounds = {}
        self._asked.pop(name, None)

    def _ask(self, valve: HeardValve) -> None:
        def take_baseline(answer: Future[Any]) -> None:
            got = answer.result()
            _keep(valve, "baseline", got if got is not None and got.success else None)

        def take_limits(answer: Future[Any]) -> None:
            got = answer.result()
            _keep(valve, "limits", {BAND: float(got.values[0].double_value)} if got and got.values else {})

        show = ManageBaseline.Request(action=ManageBaseline.Request.SHOW)
        _ask(self._calls, valve.name, "manage_baseline", show).add_done_callback(take_baseline)
        limits = GetParameters.Request(names=[BAND])
        _ask(self._calls, valve.name, "get_parameters", limits).add_done_callback(take_limits)


def serve(*, port: int = PORT, operator: bool = False, names: tuple[str, ...] = ()) -> None:
    """Serve the page on this host until SIGINT or SIGTERM.

    Args:
        port: on the loopback address.
        operator: whether who has the token may acknowledge, shelve and more; else the page is read only.
        names: of valves; empty for all that are heard.

    Raises:
        SystemExit: the page could not be served; what is wrong was said in one line.
    """
    values: dict[str, Value] = {"port": port, "operator": operator, "valves": list(names) or [""]}
    words = [word for name, value in values.items() for word in rule(name, value)]
    code = run(PageNode, ["--ros-args", *words])
    if code:
        raise SystemExit(code)


def _ask(calls: ServiceCalls, valve: str, service: str, request: Any) -> Future[Any]:
    """Return the answer to come, ``None`` in it where no node answers; from any thread."""
    node, kind = SERVICES[service]
    return calls.ask(f"/{node}" if node in SHARED else f"/{valve}/{node}", service, request, kind)


def _request(act: Act) -> tuple[str, Any]:
    by = {"who": act.who, "comment": act.comment}
    if act.act == operating.ANALYSE:
        return "analyse_gap", Trigger.Request()
    if act.act == operating.SNAPSHOT:
        return "take_snapshot", TakeSnapshot.Request(valve=act.valve, **by)
    if act.act in (operating.FREEZE, operating.LEARN):
        kind = ManageBaseline.Request
        return "manage_baseline", kind(
            action=kind.FREEZE if act.act == operating.FREEZE else kind.LEARN, **by
        )
    by["alarm"] = act.alarm
    if act.act == operating.ACKNOWLEDGE:
        return "acknowledge_alarm", AcknowledgeAlarm.Request(occurrence=act.occurrence, **by)
    if act.act == operating.RESET:
        return "reset_alarms", ResetAlarms.Request(**by)
    shelved = act.act == operating.SHELVE
    return "shelve_alarm", ShelveAlarm.Request(shelved=shelved, duration=60.0 * act.minutes, **by)


def _outcome(act: Act, answer: Any) -> Outcome:
    if answer is None:
        node = _NODES.get(act.act, "monitor")
        return Outcome(False, f"{act.valve}: its {node} does not answer")
    if act.act == operating.ANALYSE:
        return Outcome(bool(answer.success), str(answer.message))
    if not answer.success:
        return Outcome(False, str(answer.reason))
    return Outcome(True, ", ".join(getattr(answer, "changed", ())) or str(getattr(answer, "stage", "")))


def _take_bounds(valve: HeardValve, message: DiagnosticArray) -> None:
    bounds = bounds_of(message.status, valve.name)
    if bounds is not None and repr(bounds) != repr(valve.bounds):  # NaN is another one each time
        _keep(valve, "bounds", bounds)


def _keep(
    valve: HeardValve,
    what: Literal["estimate", "alarms", "gap", "baseline", "limits", "bounds"],
    value: object,
) -> None:
    setattr(valve, what, value)
    valve.changes += 1
