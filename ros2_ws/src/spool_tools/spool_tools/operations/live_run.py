"""Nodes that a command starts, and what it shows of them until their run ends or is interrupted."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.live import Live
from rich.text import Text
from spool_core.errors import InputError
from spool_core.events.language import Language
from spool_core.events.sentences import language_of
from spool_core.uncertainty import LEGEND
from spool_monitor.listener import HeardValve, Listener
from spool_msgs.msg import HealthEvent

from spool_tools.operations import valve_rows
from spool_tools.operations.node_processes import Nodes

#: s, within which every node must be up and the first estimates be there.
START_UP = 60.0

#: s between status lines off a terminal.
_LINE_INTERVAL = 5.0
#: s between looks for valves that joined.
_LOOK_INTERVAL = 1.0


@dataclass(slots=True)
class Display:
    """Display of what arrives; on a terminal a table that is renewed, off it a line now and then."""

    seconds: float | None
    names: tuple[str, ...] = ()
    console: Console = field(default_factory=lambda: Console(highlight=False))
    language: Language = field(default_factory=language_of)
    valves: Mapping[str, HeardValve] = field(default_factory=dict)
    _live: Live | None = None
    _last: float = 0.0

    def __enter__(self) -> Display:
        self.say(f"estimates {LEGEND}")
        if self.console.is_terminal:
            self._live = Live(console=self.console, refresh_per_second=4)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def refresh(self, elapsed: float) -> None:
        """Show the state ``elapsed`` s after the start."""
        if self._live is not None:
            left = max(0.0, (self.seconds or 0.0) - elapsed)
            above = [f"{elapsed:5.1f} s of {self.seconds:g} s, {left:.0f} s left"] if self.seconds else []
            self._live.update(valve_rows.picture(self.valves, self.language, *above))
        elif time.monotonic() - self._last >= _LINE_INTERVAL:
            self._last = time.monotonic()
            for line in valve_rows.lines_of(self.valves):
                self.console.print(f"{elapsed:5.1f} s  {line}", soft_wrap=True)

    def event(self, name: str, elapsed: float, event: HealthEvent) -> None:
        """Show an event above the status."""
        raised = event.state == HealthEvent.STATE_RAISED
        mark = "▲" if raised else "▼"
        style = "yellow" if raised and event.severity == HealthEvent.SEVERITY_WARNING else "red"
        line = Text(f"{elapsed:5.1f} s  {mark} {name}  ", style=style if raised else "green")
        line.append(valve_rows.event_line(event, self.language), style="default")
        self.console.print(line, soft_wrap=True)

    def say(self, text: str) -> None:
        """Show a line of what is going on."""
        self.console.print(text, soft_wrap=True)


@dataclass(slots=True)
class LiveRun:
    """Run of node processes with a separate node that listens to their valves.

    Attributes:
        node: of this process.
        nodes: the processes.
        listener: to the valves.
        display: what is shown of them.
        asked: signals that asked for the end; empty while nobody did.
        events: the events as they came, each with its valve.
    """

    node: Node
    nodes: Nodes
    listener: Listener
    display: Display
    asked: list[int]
    events: list[tuple[str, HealthEvent]]
    started: float | None = None
    _looked: float = 0.0

    def elapsed(self) -> float:
        """Return the time (s) since the first estimates; 0 before."""
        return 0.0 if self.started is None else time.monotonic() - self.started

    def turn(self, wait: float = 0.1) -> None:
        """Hear and show what comes within ``wait`` s.

        Raises:
            InputError: a node ended.
        """
        rclpy.spin_once(self.node, timeout_sec=wait)
        if time.monotonic() - self._looked > _LOOK_INTERVAL:
            self._looked = time.monotonic()
            self.listener.look()
        self.listener.fetch()
        self.display.refresh(self.elapsed())
        self.check()

    def check(self) -> None:
        """Check that all processes run.

        Raises:
            InputError: one ended.
        """
        dead = self.nodes.dead()
        if dead:
            raise InputError(f"node {dead[0]} ended unexpectedly: see {self.nodes.log}")

    def wait_for_estimates(self) -> None:
        """Wait until each valve has an estimate; the run is counted from then.

        Raises:
            InputError: a node ended, or there was none in time.
        """
        deadline = time.monotonic() + START_UP
        while any(valve.estimate is None for valve in self.display.valves.values()) and not self.asked:
            rclpy.spin_once(self.node, timeout_sec=0.1)
            self.check()
            if time.monotonic() > deadline:
                raise InputError(
                    f"no estimates after {START_UP:g} s: see {self.nodes.log}, or try ./spool doctor"
                )
        self.started = time.monotonic()


@contextmanager
def live_run(name: str, display: Display, log: Path = Path(os.devnull)) -> Iterator[LiveRun]:
    """Give a run whose node is called ``name``; its processes end with it and write to ``log``."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # Taken note of: an exception might be raised, and lost, while something is finalised.
    asked: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: asked.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    node = Node(name)
    events: list[tuple[str, HealthEvent]] = []

    def on_event(valve: str, message: HealthEvent) -> None:
        events.append((valve, message))
        display.event(valve, run.elapsed(), message)

    listener = Listener(node, display.names, on_event=on_event)
    display.valves = listener.valves
    try:
        with Nodes(log) as nodes, display:
            run = LiveRun(node, nodes, listener, display, asked, events)
            yield run
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        listener.close()
        node.destroy_node()
        rclpy.try_shutdown()


def watch(names: tuple[str, ...], seconds: float | None = None, language: str = "") -> None:
    """Show running valves until somebody asks for the end.

    Args:
        names: of valves; empty for all that are heard.
        seconds: after which it ends by itself; ``None``: never.
        language: of sentences; see :func:`spool_core.events.sentences.language_of`.

    Raises:
        InputError: there is no such language.
    """
    with live_run("spool_watch", Display(seconds, names, language=language_of(language))) as run:
        run.started = time.monotonic()
        while not run.asked and (seconds is None or run.elapsed() < seconds):
            run.turn()
