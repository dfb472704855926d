"""Run of the terminal view: the application on a terminal, lines off it."""

from __future__ import annotations

import signal
import sys
import time
from types import FrameType

from spool_core.uncertainty import LEGEND

from spool_tools.operations.service_client import who_asks
from spool_tools.watch.heard import line_of

from .heard import Listener

#: s between lines off a terminal, and between looks for events.
LINES, LOOK = 5.0, 0.2


def watch(names: tuple[str, ...], who: str, seconds: float | None = None) -> None:
    """Show running valves until it is ended.

    Args:
        names: of valves; empty for all that are heard.
        who: stands in the log of what is done; empty: the user's name.
        seconds: after which it ends by itself off a terminal; ``None``: never.
    """
    listener = Listener(names)
    try:
        if sys.stdout.isatty():
            from .app import WatchApp  # noqa: PLC0415 - needed on a terminal only

            WatchApp(listener, who_asks(who)).run()
        else:
            _lines(listener, seconds)
    finally:
        listener.close()


def _lines(listener: Listener, seconds: float | None) -> None:
    """Print each event at once, and a line for each valve now and then."""
    before = signal.signal(signal.SIGTERM, _as_interrupt)
    begun, last = time.monotonic(), -LINES
    print(f"estimates {LEGEND}", flush=True)
    try:
        while seconds is None or time.monotonic() - begun < seconds:
            while listener.events:
                name, event = listener.events.popleft()
                print(f"{name}  {event.kind}: {event.message}", flush=True)
            if time.monotonic() - last >= LINES:
                last = time.monotonic()
                for name in sorted(listener.valves):
                    print(line_of(listener.valves[name], last), flush=True)
            time.sleep(LOOK)
    except KeyboardInterrupt:
        return
    finally:
        signal.signal(signal.SIGTERM, before)


def _as_interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
