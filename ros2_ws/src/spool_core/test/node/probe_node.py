"""A node that uses all that the shell offers and says what happens to it."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import time
from typing import ClassVar

from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value
from spool_core.node.running import run
from spool_core.node.stop import STOP
from std_msgs.msg import String
from std_srvs.srv import Trigger


class Probe(ManagedNode):
    PARAMETERS: ClassVar = (
        NodeParameter("gain", 1.0, "A number that may change while running.", "N", 0.0, 10.0),
        NodeParameter("limit", 5.0, "Never below gain.", "N", 0.0, 10.0),
        NodeParameter("count", 3, "A whole number.", "", 1, 5),
        NodeParameter("mode", "slow", "A word.", choices=("slow", "fast")),
        NodeParameter("size", 2, "A whole number that what is built depends on.", "", 1, 9, structural=True),
        NodeParameter("label", "probe", "Fixed at start.", read_only=True),
        NodeParameter("failing", "", "Hook that raises; with a ! an error of the user's input."),
    )

    def __init__(self) -> None:
        super().__init__("probe")

    def _pass(self, hook: str) -> None:
        print(hook, flush=True)
        failing = self.value("failing")
        while failing == f"{hook} until a signal":
            time.sleep(0.01)
        while failing == f"{hook} until two signals" and STOP.count < 2:
            time.sleep(0.01)
        if failing == "exit":  # a signal while the interpreter takes itself down
            atexit.register(os.kill, os.getpid(), signal.SIGTERM)
        if failing == hook:
            raise RuntimeError(f"{hook} broke")
        if failing == f"{hook}!":
            raise InputError(f"{hook}: repair this")

    def configure(self) -> None:
        self._publisher = self.create_lifecycle_publisher(String, "said", qos.state(50))
        self.serve(Trigger, "~/answer", self._answer)
        self._pass("configure")

    def activate(self) -> None:
        self.subscribe(String, "told", self._hear, qos.samples_wanted())
        self.every(0.05, self._tick, steady=True)
        self._pass("activate")

    def deactivate(self) -> None:
        self._pass("deactivate")

    def cleanup(self) -> None:
        print("cleanup", flush=True)
        self.destroy_publisher(self._publisher)

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        gain, limit = (changes.get(name, self.value(name)) for name in ("gain", "limit"))
        return f"gain: {gain} is above limit ({limit})" if gain > limit else None

    def apply_change(self, changes: dict[str, Value]) -> None:
        print("applied", sorted(changes), flush=True)

    def _tick(self) -> None:
        self._publisher.publish(String(data="tick"))

    def _answer(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response

    def _hear(self, message: String) -> None:
        if message.data == "raise":
            raise RuntimeError("heard a word that breaks")
        self._publisher.publish(String(data=f"heard {message.data}"))


if __name__ == "__main__":
    sys.exit(run(Probe))
