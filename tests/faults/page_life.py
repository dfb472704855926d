"""Life of the operator's page: browsers look at trends and journals, and an operator acts."""

from __future__ import annotations

import json
import socket
import time
import urllib.error
import urllib.request
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import rclpy
from rclpy.parameter import Parameter
from spool_monitor.listener import HeardValve
from spool_msgs.msg import Alarm, AlarmList, ValveHealth
from spool_view import kept
from spool_view.acts import Act, Outcome
from spool_view.page_node import PageNode

from .monitor_life import PROCESS as MONITOR

ACTS = 2
LOG, READ = (
    "web_page/operator_log.jsonl",
    ("/trend?valve=valve_1", "/history.json", "/history.csv", "/sparks"),
)


class Page(PageNode):
    """Page whose operators' acts are done as soon as they are asked for."""

    def _do(self, act: Act) -> Future[Outcome]:
        answer: Future[Outcome] = Future()
        answer.set_result(Outcome(True, act.alarm))
        return answer


class PageLife:
    """Page's node with its server, and a browser."""

    excuses = ("can't be read", "can't be written")

    def load(self) -> None:
        """Load what a monitor's life needs."""
        MONITOR.load()

    def prepare(self, disk: Path) -> None:
        """Let a monitor keep trends and a journal."""
        MONITOR.prepare(disk)

    def live(self, disk: Path) -> object:
        """Serve the page; return the status of every answer and the acts that were said to be done."""
        kept.HELD = 0.0
        rclpy.init(args=[])
        node = Page()
        values = {"state_folder": str(disk), "operator": True, "port": _free()}
        node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        got: list[object] = []
        done = rclpy.lifecycle.TransitionCallbackReturn.SUCCESS
        if node.trigger_configure() == done and node.trigger_activate() == done:
            got = self._browse(node, f"http://127.0.0.1:{values['port']}")
            node.trigger_deactivate()
        node.trigger_cleanup()
        node.destroy_node()
        rclpy.shutdown()
        return got

    def _browse(self, node: PageNode, address: str) -> list[object]:
        assert node._listener is not None
        assert node._token is not None
        alarm = Alarm(
            name="resonance", kind="resonance", code=100, state=Alarm.STATE_UNACKNOWLEDGED, severity=2
        )
        node._listener.valves["valve_1"] = HeardValve(
            "valve_1", ValveHealth(), time.monotonic(), alarms=AlarmList(alarms=[alarm])
        )
        headers = {
            "origin": address, "authorization": f"Bearer {node._token.path.read_text().strip()}",
            "content-type": "application/json",
        }  # fmt: skip
        got: list[object] = []
        for number in range(ACTS):
            got += [_answer(address + path, None, {})[:2] for path in READ]
            act = {
                "act": "acknowledge", "valve": "valve_1", "alarm": "resonance", "occurrence": 0,
                "who": f"Eva {number}", "comment": "",
            }  # fmt: skip
            got.append(_answer(f"{address}/act", json.dumps(act).encode(), headers))
        return got

    def kept(self, disk: Path) -> dict[str, dict[str, Any]]:
        """Return what the log holds of the acts."""
        lines = (disk / LOG).read_text("utf-8").splitlines() if (disk / LOG).exists() else []
        acts = [json.loads(line) for line in lines if line.endswith("}")]
        return {
            "acts": {f"{one['step']} {one['who']}": 1 for one in acts},
            **{f"monitor's {name}": kept for name, kept in MONITOR.kept(disk).items()},
        }

    def stated(self, said: str) -> set[str]:
        """Return the acts where the log of the node names them."""
        return {"acts"} if "can't be written" in said else set()


def _free() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def _answer(url: str, body: bytes | None, headers: dict[str, str]) -> tuple[int, int, str]:
    """Return the status, the length and, of an act, the text of an answer."""
    try:
        with urllib.request.urlopen(urllib.request.Request(url, body, headers), timeout=60.0) as answer:
            text = answer.read().decode()
            return answer.status, len(text) > 200, text if body else ""
    except urllib.error.HTTPError as error:
        return error.code, 0, error.read().decode() if body else ""


PROCESS = PageLife()
