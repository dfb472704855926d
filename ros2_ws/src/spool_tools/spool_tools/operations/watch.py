"""What `./spool watch` shows: an application on a terminal, lines off it."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, ClassVar

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from spool_core.events.language import ENGLISH, Language
from spool_core.events.sentences import language_of
from spool_core.node.service_calls import ServiceCalls
from spool_core.uncertainty import LEGEND
from spool_monitor.listener import HeardValve, Listener
from spool_msgs.msg import Alarm, HealthEvent
from textual.app import App, ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import DataTable, Footer, Input, Label, Static

from spool_tools.operations import valve_rows
from spool_tools.operations.service_client import SERVICES, who_asks

#: s between two pictures.
PERIOD = 0.5
#: min that an alarm is shelved for by default.
SHELF = 30.0

#: s between lines off a terminal, and between looks for events.
LINES, LOOK = 5.0, 0.2
#: s between looks for valves that joined, and between steps of what is fetched and called.
LOOK_EVERY, WORK_EVERY = 1.0, 0.1
#: Events that are held until they are shown; the oldest go first.
EVENTS = 200


def watch(names: tuple[str, ...], who: str, seconds: float | None = None, language: str = "") -> None:
    """Show running valves until it is ended.

    Args:
        names: of valves; empty for all that are heard.
        who: stands in the log of what is done; empty: the user's name.
        seconds: after which it ends by itself off a terminal; ``None``: never.
        language: of sentences; see :func:`spool_core.events.sentences.language_of`.

    Raises:
        InputError: there is no such language.
    """
    chosen = language_of(language)
    listener = WatchNode(names)
    try:
        if sys.stdout.isatty():
            WatchApp(listener, who_asks(who), chosen).run()
        else:
            _lines(listener, seconds, chosen)
    finally:
        listener.close()


class WatchNode:
    """Node of a terminal in a separate thread: it listens, and passes an operator's acts to the monitors.

    Args:
        names: of valves; empty for all that are discovered.
    """

    def __init__(self, names: tuple[str, ...] = ()) -> None:
        self.events: deque[tuple[str, HealthEvent]] = deque(maxlen=EVENTS)
        rclpy.init()
        self._node = Node("spool_watch")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._calls = ServiceCalls(self._node)
        self._listener = Listener(
            self._node, names, on_event=lambda name, event: self.events.append((name, event))
        )
        self.valves = self._listener.valves
        self._node.create_timer(LOOK_EVERY, self._listener.look)
        self._node.create_timer(WORK_EVERY, self._work)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and leave the domain."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._listener.close()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _work(self) -> None:
        self._listener.fetch()
        self._calls.work()

    def acknowledge(self, valve: str, alarm: str, occurrence: int, who: str, comment: str) -> Future[str]:
        """Ask the monitor of ``valve`` to note that ``who`` has seen ``alarm``, as often as it was shown."""
        return self._ask(
            valve, "acknowledge_alarm", alarm=alarm, who=who, comment=comment, occurrence=occurrence
        )

    def shelve(
        self, valve: str, alarm: str, seconds: float, who: str, comment: str, *, shelved: bool
    ) -> Future[str]:
        """Ask the monitor of ``valve`` to put ``alarm`` aside for ``seconds``, or to take that back."""
        return self._ask(
            valve, "shelve_alarm", alarm=alarm, who=who, comment=comment, shelved=shelved, duration=seconds
        )

    def reset(self, valve: str, alarm: str, who: str, comment: str) -> Future[str]:
        """Ask the monitor of ``valve`` to reset the latched ``alarm``."""
        return self._ask(valve, "reset_alarms", alarm=alarm, who=who, comment=comment)

    def _ask(self, valve: str, service: str, **fields: object) -> Future[str]:
        """Return what is to be said to the operator, once it is known."""
        said: Future[str] = Future()

        def take(answer: Future[Any]) -> None:
            got = answer.result()
            if got is None:
                said.set_result(f"{valve}: its monitor does not answer")
            else:
                changed = ", ".join(got.changed) if got.success else got.reason
                said.set_result(f"{valve}: {service.replace('_', ' ')}: {changed}")

        kind = SERVICES[service]
        answer = self._calls.ask(f"/{valve}/monitor", service, kind.Request(**fields), kind)
        answer.add_done_callback(take)
        return said

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


class AskScreen(ModalScreen[tuple[float, str] | None]):
    """Question for minutes (where they matter) and a comment; Escape leaves everything as it is."""

    BINDINGS: ClassVar = [Binding("escape", "leave", "leave it")]
    CSS = (
        "AskScreen { align: center middle; } AskScreen > Vertical { width: 64; height: auto; border: round; }"
    )

    def __init__(self, title: str, *, minutes: bool) -> None:
        """Ask under ``title``, for ``minutes`` as well."""
        super().__init__()
        self._title, self._minutes = title, minutes

    def compose(self) -> ComposeResult:
        """Lay out the question."""
        with Vertical():
            yield Label(self._title, markup=False)
            if self._minutes:
                yield Label("minutes, 0: until the condition is over")
                yield Input(f"{SHELF:g}", id="minutes", type="number")
            yield Label("comment, Enter sends it, Escape leaves it")
            yield Input(id="comment", max_length=200)

    def on_mount(self) -> None:
        """Begin where something is to be typed."""
        self.query_one("#comment", Input).focus()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Hand over what was typed."""
        if event.input.id == "minutes":
            self.query_one("#comment", Input).focus()
            return
        minutes = SHELF
        if self._minutes:
            given = self.query_one("#minutes", Input)
            if not given.is_valid or not given.value:
                given.focus()
                return
            minutes = float(given.value)
        self.dismiss((max(0.0, minutes), self.query_one("#comment", Input).value))

    def action_leave(self) -> None:
        """Leave everything as it is."""
        self.dismiss(None)


class DetailsScreen(ModalScreen[None]):
    """Details of an alarm; Escape closes them."""

    BINDINGS: ClassVar = [Binding("escape,d,enter", "dismiss", "close")]
    CSS = """
    DetailsScreen { align: center middle; }
    DetailsScreen > Static { width: 90%; max-width: 110; height: auto; border: round; }
    """

    def __init__(self, text: str) -> None:
        """Show ``text``."""
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        """Lay out the text."""
        yield Static(self._text, id="details", markup=False)


class WatchApp(App[None]):
    """Valves above, worst first; alarms of the chosen one below; keys acknowledge, shelve and reset."""

    TITLE = "spool watch"
    CSS = """
    #valves { height: 2fr; }
    #alarms { height: 1fr; border-top: solid $secondary; }
    #said { height: auto; max-height: 4; }
    """
    BINDINGS: ClassVar = [
        Binding("d", "details", "details"),
        Binding("a", "acknowledge", "acknowledge"),
        Binding("s", "shelve", "shelve"),
        Binding("u", "unshelve", "take off the shelf"),
        Binding("r", "reset", "reset"),
        Binding("tab", "focus_next", "other table"),
        Binding("q", "quit", "quit"),
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, listener: WatchNode, who: str, language: Language = ENGLISH) -> None:
        """Show what ``listener`` hears; ``who`` stands in the log of what is done."""
        super().__init__()
        self._listener, self._who, self._language = listener, who, language
        self._awaited: list[Future[str]] = []

    def compose(self) -> ComposeResult:
        """Lay out the two tables."""
        yield DataTable(id="valves", cursor_type="row", zebra_stripes=True)
        yield DataTable(id="alarms", cursor_type="row")
        yield Static(LEGEND, id="said", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to show."""
        for name in valve_rows.VALVE_COLUMNS:
            self.query_one("#valves", DataTable).add_column(name, key=name)
        for name in valve_rows.ALARM_COLUMNS:
            self.query_one("#alarms", DataTable).add_column(name, key=name)
        self.query_one("#valves", DataTable).focus()
        self.set_interval(PERIOD, self.show)
        self.show()

    def show(self) -> None:
        """Bring both tables up to date; rows stay where they are unless a condition changed."""
        now = time.monotonic()
        valves = list(self._listener.valves.values())
        valves.sort(key=lambda one: (valve_rows.shown_condition(one, now).rank, one.name))
        _fill(
            self.query_one("#valves", DataTable),
            valve_rows.VALVE_COLUMNS,
            [(one.name, valve_rows.valve_row(one, now)) for one in valves],
        )
        alarms = valve_rows.shown_alarms(self._chosen())
        _fill(
            self.query_one("#alarms", DataTable),
            valve_rows.ALARM_COLUMNS,
            [(one.name, valve_rows.alarm_row(one, self._language)) for one in alarms],
        )
        for said in [one for one in self._awaited if one.done()]:
            self._awaited.remove(said)
            self._say(said.result())
        if not valves:
            self._say("no valve is heard yet: is a monitor running, with the same ROS_DOMAIN_ID?")

    def _chosen(self) -> HeardValve | None:
        key = _chosen_key(self.query_one("#valves", DataTable))
        return None if key is None else self._listener.valves.get(key)

    def _alarm(self) -> tuple[str, Alarm] | None:
        valve = self._chosen()
        key = _chosen_key(self.query_one("#alarms", DataTable))
        for one in valve_rows.shown_alarms(valve):
            if valve is not None and one.name == key:
                return valve.name, one
        self._say("no alarm is chosen")
        return None

    def _say(self, text: str) -> None:
        self.query_one("#said", Static).update(text)

    def _ask_then(
        self, verb: str, do: Callable[[str, Alarm, float, str], Future[str]], *, minutes: bool = False
    ) -> None:
        """Ask for a comment, then do something about the chosen alarm."""
        found = self._alarm()
        if found is None:
            return
        valve, alarm = found

        def done(given: tuple[float, str] | None) -> None:
            if given is not None:
                self._awaited.append(do(valve, alarm, *given))

        self.push_screen(AskScreen(f"{verb} {valve}: {alarm.name}", minutes=minutes), done)

    def action_details(self) -> None:
        """Show everything that is known of the chosen alarm."""
        found = self._alarm()
        if found:
            _, alarm = found
            lines = [
                valve_rows.alarm_headline(alarm, self._language),
                *valve_rows.alarm_details(alarm, self._language),
            ]
            self.push_screen(DetailsScreen("\n".join(lines)))

    def action_acknowledge(self) -> None:
        """Note that the chosen alarm was seen: the occurrence that is shown, no newer one."""
        self._ask_then(
            "acknowledge",
            lambda valve, alarm, _minutes, comment: self._listener.acknowledge(
                valve, alarm.name, alarm.occurrence, self._who, comment
            ),
        )

    def action_shelve(self) -> None:
        """Put the chosen alarm aside for a time."""
        self._shelve("shelve", shelved=True)

    def action_unshelve(self) -> None:
        """Take the chosen alarm off the shelf."""
        self._shelve("take off the shelf", shelved=False)

    def _shelve(self, verb: str, *, shelved: bool) -> None:
        self._ask_then(
            verb,
            lambda valve, alarm, minutes, comment: self._listener.shelve(
                valve, alarm.name, 60.0 * minutes, self._who, comment, shelved=shelved
            ),
            minutes=shelved,
        )

    def action_reset(self) -> None:
        """Reset the chosen latched alarm."""
        self._ask_then(
            "reset",
            lambda valve, alarm, _minutes, comment: self._listener.reset(
                valve, alarm.name, self._who, comment
            ),
        )


def _fill(
    table: DataTable[object], columns: tuple[str, ...], rows: list[tuple[str, tuple[object, ...]]]
) -> None:
    """Make ``table`` show ``rows`` (key, cells) in their order, with its cursor on the row where it was."""
    wanted = [key for key, _ in rows]
    if wanted != [key.value for key in table.rows]:
        chosen = _chosen_key(table)
        table.clear()
        for key, cells in rows:
            table.add_row(*cells, key=key)
        if chosen in wanted:
            table.move_cursor(row=wanted.index(chosen), animate=False)
        return
    for key, cells in rows:
        for column, cell in zip(columns, cells, strict=True):
            if table.get_cell(key, column) != cell:
                table.update_cell(key, column, cell, update_width=True)


def _chosen_key(table: DataTable[object]) -> str | None:
    if not table.row_count or not 0 <= table.cursor_row < table.row_count:
        return None
    return table.coordinate_to_cell_key(table.cursor_coordinate).row_key.value


def _lines(listener: WatchNode, seconds: float | None, language: Language) -> None:
    """Print each event at once, and a line for each valve now and then."""
    begun, last = time.monotonic(), -LINES
    print(f"estimates {LEGEND}", flush=True)
    try:
        while seconds is None or time.monotonic() - begun < seconds:
            while listener.events:
                name, event = listener.events.popleft()
                print(f"{name}  {valve_rows.event_line(event, language)}", flush=True)
            if time.monotonic() - last >= LINES:
                last = time.monotonic()
                for name in sorted(listener.valves):
                    print(valve_rows.line_of(listener.valves[name], last), flush=True)
            time.sleep(LOOK)
    except KeyboardInterrupt:
        return
