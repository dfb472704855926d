"""Display of the demonstration: a line for each valve, and the events as they come."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from spool_core.uncertainty import LEGEND, with_interval
from spool_msgs.msg import HealthEvent, ModelEstimate, Quantity, ValveHealth

_LEVELS = {
    ValveHealth.LEVEL_OK: ("OK", "bold green"),
    ValveHealth.LEVEL_WARNING: ("WARNING", "bold yellow"),
    ValveHealth.LEVEL_ALARM: ("ALARM", "bold red"),
    ValveHealth.LEVEL_STALE: ("STALE", "bold magenta"),
}

_SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "ALARM"}

#: s between status lines off a terminal.
_LINE_INTERVAL = 5.0


@dataclass(slots=True)
class Display:
    """Display of what arrives; on a terminal a table that is renewed, off it a line now and then."""

    seconds: float
    names: tuple[str, ...]
    console: Console = field(default_factory=lambda: Console(highlight=False))
    estimates: dict[str, ModelEstimate] = field(default_factory=dict)
    health: dict[str, ValveHealth] = field(default_factory=dict)
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
                self.console.print(f"{elapsed:5.1f} s  {name}  {self._line(name)}", soft_wrap=True)

    def event(self, name: str, elapsed: float, event: HealthEvent) -> None:
        """Show an event above the status."""
        raised = event.state == HealthEvent.STATE_RAISED
        mark = "▲" if raised else "▼"
        style = "yellow" if raised and event.severity == HealthEvent.SEVERITY_WARNING else "red"
        kind = event.kind.replace("_", " ") + (f" ({event.cause.replace('_', ' ')})" if event.cause else "")
        what = f"{_SEVERITIES.get(event.severity, 'event')}: {kind}: " if raised else ""
        line = Text(f"{elapsed:5.1f} s  {mark} {name}  {what}", style=style if raised else "green")
        line.append(event.message, style="default")
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
        health, estimate = self.health.get(name), self.estimates.get(name)
        if health is None or estimate is None:
            return [Text("waiting", style="dim")]
        values = {quantity.name: quantity for quantity in estimate.parameters}
        level, style = _LEVELS.get(health.level, ("?", "dim"))
        return [
            Text(_frequency(health.dominant_frequency)),
            Text(_with_uncertainty(estimate.natural_frequency)),
            Text(_with_uncertainty(values.get("spring_stiffness"))),
            Text(_with_uncertainty(values.get("viscous_coefficient"))),
            Text(_with_uncertainty(values.get("coulomb_force"))),
            Text(level, style=style).append(f" {health.summary}", style="default"),
        ]

    def _line(self, name: str) -> str:
        return "  ".join(cell.plain for cell in self._cells(name))


def _frequency(quantity: Quantity) -> str:
    known = quantity.validity == Quantity.VALIDITY_VALID
    return f"{quantity.value:5.1f} Hz" if known else "no line "


def _with_uncertainty(quantity: Quantity | None) -> str:
    if quantity is None or quantity.validity == Quantity.VALIDITY_UNKNOWN:
        return "learning"
    held = " held" if quantity.validity == Quantity.VALIDITY_HELD else ""
    unit = quantity.unit.replace(" s", "·s")
    return f"{with_interval(quantity.value, quantity.standard_deviation, unit)}{held}"
