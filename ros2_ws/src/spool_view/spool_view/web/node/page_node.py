"""Node ``page``: shows running valves to browsers on this host, and passes an operator's acts on."""

from __future__ import annotations

import ipaddress
import socket
from concurrent.futures import Future
from pathlib import Path
from typing import Any, ClassVar

from rclpy.serialization import deserialize_message
from spool_core.errors import InputError
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value
from spool_monitor.history.state_file import default_folder
from spool_msgs.msg import AccelerationBlock
from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm, TakeSnapshot
from spool_view.web.node.listening import Calls, Listening
from spool_view.web.server.application import ServerThread, application
from spool_view.web.server.operating import Desk
from spool_view.web.server.operator import (
    ACKNOWLEDGE,
    ANALYSE,
    FREEZE,
    LEARN,
    RESET,
    SHELVE,
    SNAPSHOT,
    Act,
    ActLog,
    OperatorToken,
    Outcome,
)
from spool_view.web.server.view import Board, spectrum_of
from std_srvs.srv import Trigger

#: Folder of token and log below the state folder.
FOLDER = "web_page"

#: Nodes that do what the monitor does not.
_NODES = {ANALYSE: "estimator", SNAPSHOT: "recorder"}


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
        self._calls: Calls | None = None
        self._token: OperatorToken | None = None
        self._log: ActLog | None = None
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
            self._token = OperatorToken(folder / FOLDER / f"token_{port}")
            self._log = ActLog(folder / FOLDER / "operator_log.jsonl")
        board = Board()
        names = tuple(name.strip("/") for name in self.value("valves") if name.strip("/"))
        calls = self._calls = Calls(self)
        self._listening = Listening(self, board, calls, names)
        desk = Desk(
            board=board,
            address=address,
            state_folder=folder,
            spectrum=_spectrum,
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
        """Let go of the port."""
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
            return Path(given).expanduser() if given else default_folder()
        except RuntimeError as error:
            raise InputError("state_folder: there is no home folder: name a folder") from error

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
        if act.act in (FREEZE, LEARN):
            outcome.add_done_callback(lambda _: self._changed.append(act.valve))
        return outcome


def do(calls: Calls, act: Act) -> Future[Outcome]:
    """Ask for ``act``; the outcome comes once the valve's node has answered, or is not there."""
    service, request = _request(act)
    outcome: Future[Outcome] = Future()

    def take(answer: Future[Any]) -> None:
        outcome.set_result(_outcome(act, answer.result()))

    calls.ask(act.valve, service, request).add_done_callback(take)
    return outcome


def _spectrum(blocks: list[bytes]) -> dict[str, Any] | None:
    """Return the spectrum of serialised blocks."""
    return spectrum_of([deserialize_message(one, AccelerationBlock) for one in blocks])


def _request(act: Act) -> tuple[str, Any]:
    by = {"who": act.who, "comment": act.comment}
    if act.act == ANALYSE:
        return "analyse_gap", Trigger.Request()
    if act.act == SNAPSHOT:
        return "take_snapshot", TakeSnapshot.Request(valve=act.valve, **by)
    if act.act in (FREEZE, LEARN):
        kind = ManageBaseline.Request
        return "manage_baseline", kind(action=kind.FREEZE if act.act == FREEZE else kind.LEARN, **by)
    by["alarm"] = act.alarm
    if act.act == ACKNOWLEDGE:
        return "acknowledge_alarm", AcknowledgeAlarm.Request(occurrence=act.occurrence, **by)
    if act.act == RESET:
        return "reset_alarms", ResetAlarms.Request(**by)
    shelved = act.act == SHELVE
    return "shelve_alarm", ShelveAlarm.Request(shelved=shelved, duration=60.0 * act.minutes, **by)


def _outcome(act: Act, answer: Any) -> Outcome:
    if answer is None:
        node = _NODES.get(act.act, "monitor")
        return Outcome(False, f"{act.valve}: its {node} does not answer")
    if act.act == ANALYSE:
        return Outcome(bool(answer.success), str(answer.message))
    if not answer.success:
        return Outcome(False, str(answer.reason))
    return Outcome(True, ", ".join(getattr(answer, "changed", ())) or str(getattr(answer, "stage", "")))
