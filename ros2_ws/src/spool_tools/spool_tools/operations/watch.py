"""What `./spool watch` shows: a table that refreshes on a terminal, lines off it."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Group
from rich.live import Live
from rich.table import Table
from spool_core.events.language import Language
from spool_core.events.sentences import language_of
from spool_core.uncertainty import LEGEND
from spool_monitor.listener import Listener
from spool_monitor.shown import in_order, shown
from spool_msgs.msg import HealthEvent

from spool_tools.operations import valve_rows

#: Pictures a second.
RATE = 2.0

#: s between lines off a terminal, and between looks for events.
LINES, LOOK = 5.0, 0.2
#: s between looks for valves that joined, and between steps of what is fetched.
LOOK_EVERY, WORK_EVERY = 1.0, 0.1
#: Events that are held until they are shown; the oldest go first.
EVENTS = 200


def watch(names: tuple[str, ...], seconds: float | None = None, language: str = "") -> None:
    """Show running valves until it is ended.

    Args:
        names: of valves; empty for all that are heard.
        seconds: after which it ends by itself off a terminal; ``None``: never.
        language: of sentences; see :func:`spool_core.events.sentences.language_of`.

    Raises:
        InputError: there is no such language.
    """
    chosen = language_of(language)
    listener = WatchNode(names)
    try:
        if sys.stdout.isatty():
            with Live(get_renderable=lambda: picture(listener, chosen), screen=True, refresh_per_second=RATE):
                threading.Event().wait()
        else:
            _lines(listener, seconds, chosen)
    except KeyboardInterrupt:
        return
    finally:
        listener.close()


class WatchNode:
    """Node of a terminal in a separate thread, which listens.

    Args:
        names: of valves; empty for all that are discovered.
    """

    def __init__(self, names: tuple[str, ...] = ()) -> None:
        self.events: deque[tuple[str, HealthEvent]] = deque(maxlen=EVENTS)
        rclpy.init()
        self._node = Node("spool_watch")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._listener = Listener(
            self._node, names, on_event=lambda name, event: self.events.append((name, event))
        )
        self.valves = self._listener.valves
        self._node.create_timer(LOOK_EVERY, self._listener.look)
        self._node.create_timer(WORK_EVERY, self._listener.fetch)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and leave the domain."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._listener.close()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


def picture(listener: WatchNode, language: Language) -> Group:
    """Return the valves, worst first, and below them their alarms in the same order."""
    now, unix_time = time.monotonic(), time.time()
    valves = in_order(shown(one, now, unix_time) for one in listener.valves.values())
    table, alarms = Table(*valve_rows.VALVE_COLUMNS), Table("valve", *valve_rows.ALARM_COLUMNS)
    for valve in valves:
        table.add_row(*valve_rows.valve_row(listener.valves[valve.name], valve))
        for alarm in valve.alarms:
            alarms.add_row(valve.name, *valve_rows.alarm_row(alarm, language))
    nobody = "no valve is heard yet: is a monitor running, with the same ROS_DOMAIN_ID?"
    return Group(table, alarms, LEGEND if valves else nobody)


def _lines(listener: WatchNode, seconds: float | None, language: Language) -> None:
    """Print each event at once, and a line for each valve now and then."""
    begun, last = time.monotonic(), -LINES
    print(f"estimates {LEGEND}", flush=True)
    while seconds is None or time.monotonic() - begun < seconds:
        while listener.events:
            name, event = listener.events.popleft()
            print(f"{name}  {valve_rows.event_line(event, language)}", flush=True)
        if time.monotonic() - last >= LINES:
            last = time.monotonic()
            for name in sorted(listener.valves):
                valve = listener.valves[name]
                print(valve_rows.line_of(valve, shown(valve, last, time.time())), flush=True)
        time.sleep(LOOK)
