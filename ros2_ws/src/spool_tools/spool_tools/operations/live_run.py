"""Nodes that a command starts, and what it shows of them until their run ends or is interrupted."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from spool_core.errors import InputError
from spool_core.events.language import Language
from spool_core.events.sentences import language_of
from spool_core.uncertainty import LEGEND
from spool_monitor.listener import HeardValve, Listener
from spool_msgs.msg import HealthEvent, Quantity, ValveHealth

from spool_tools.operations.node_processes import Nodes
from spool_tools.operations.valve_rows import estimate_cells, event_line

#: s, within which every node must be up and the first estimates be there.
START_UP = 60.0

_LEVELS = {
    ValveHealth.LEVEL_OK: ("OK", "bold green"),
    ValveHealth.LEVEL_WARNING: ("WARNING", "bold yellow"),
    ValveHealth.LEVEL_ALARM: ("ALARM", "bold red"),
    ValveHealth.LEVEL_STALE: ("STALE", "bold magenta"),
}

#: s between status lines off a terminal.
_LINE_INTERVAL = 5.0


@dataclass(slots=True)
class Display:
    """Display of what arrives; on a terminal a table that is renewed, off it a line now and then."""

    seconds: float
    names: tuple[str, ...]
    console: Console = field(default_factory=lambda: Console(highlight=False))
    language: Language = field(default_factory=language_of)
    valves: Mapping[str, HeardValve] = field(default_factory=dict)
    _live: Live | None = None
    _last: float = 0.0

    def __enter__(self) -> Display:
        self.say(f"estimates {LEGEND}")
        if self.console.is_terminal:
            self._live = Live(self._table(0.0), console=self.console, refresh_per_second=4)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def refresh(self, elapsed: float) -> None:
        """Show the state ``elapsed`` s after the start."""
        if self._live is not None:
            self._live.update(self._table(elapsed))
        elif time.monotonic() - self._last >= _LINE_INTERVAL:
            self._last = time.monotonic()
            for name in self.names:
                line = "  ".join(cell.plain for cell in self._cells(name))
                self.console.print(f"{elapsed:5.1f} s  {name}  {line}", soft_wrap=True)

    def event(self, name: str, elapsed: float, event: HealthEvent) -> None:
        """Show an event above the status."""
        raised = event.state == HealthEvent.STATE_RAISED
        mark = "▲" if raised else "▼"
        style = "yellow" if raised and event.severity == HealthEvent.SEVERITY_WARNING else "red"
        line = Text(f"{elapsed:5.1f} s  {mark} {name}  ", style=style if raised else "green")
        line.append(event_line(event, self.language), style="default")
        self.console.print(line, soft_wrap=True)

    def say(self, text: str) -> None:
        """Show a line of what is going on."""
        self.console.print(text, soft_wrap=True)

    def _table(self, elapsed: float) -> Group:
        table = Table(box=None, pad_edge=False)
        columns = ("valve", "shakes at", "natural", "stiffness", "viscous", "Coulomb", "health")
        for column in columns:
            table.add_column(column, no_wrap=True)
        for name in self.names:
            table.add_row(name, *self._cells(name))
        left = max(0.0, self.seconds - elapsed)
        return Group(Text(f"{elapsed:5.1f} s of {self.seconds:g} s, {left:.0f} s left", style="dim"), table)

    def _cells(self, name: str) -> list[Text]:
        valve = self.valves.get(name)
        if valve is None or valve.health is None or valve.estimate is None:
            return [Text("waiting", style="dim")]
        health = valve.health
        level, style = _LEVELS.get(health.level, ("?", "dim"))
        known = health.dominant_frequency.validity == Quantity.VALIDITY_VALID
        return [
            Text(f"{health.dominant_frequency.value:5.1f} Hz" if known else "no line "),
            *map(Text, estimate_cells(valve.estimate, "learning")),
            Text(level, style=style).append(f" {health.summary}", style="default"),
        ]


@dataclass(slots=True)
class LiveRun:
    """Run of node processes with a node of its own that listens to their valves.

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

    def elapsed(self) -> float:
        """Return the time (s) since the first estimates; 0 before."""
        return 0.0 if self.started is None else time.monotonic() - self.started

    def turn(self, wait: float = 0.1) -> None:
        """Hear and show what comes within ``wait`` s.

        Raises:
            InputError: a node ended.
        """
        rclpy.spin_once(self.node, timeout_sec=wait)
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
def live_run(name: str, display: Display, log: Path) -> Iterator[LiveRun]:
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
