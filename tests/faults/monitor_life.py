"""Life of a monitor: it takes up a standing alarm, follows two faults of a sensor, and operators act."""

from __future__ import annotations

import contextlib
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rclpy.parameter import Parameter
from spool_estimator.messages import to_description, to_message
from spool_monitor import valve_state
from spool_monitor.alarm import AlarmRefusedError
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.journal import entries_in
from spool_monitor.monitor import Monitor
from spool_monitor.monitor_node import MonitorNode
from spool_monitor.state_database import FILE
from spool_monitor.trend import DAY, TrendStore
from spool_monitor.valve_state import ValveState
from spool_monitor.warm_up import warm_up_monitor
from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm

from .story import PLOTS, VALVE, told

PLOT = "dead twice"
#: First block of the life; those before are of the process that ended before.
BEGIN = 130
#: Blocks between two looks of the monitor at its inputs.
LOOK = 2
#: What operators do at a block.
ACTS: dict[int, tuple[tuple[Any, dict[str, Any]], ...]] = {
    90: ((ManageBaseline, {"action": ManageBaseline.Request.FREEZE, "who": "Eva"}),),
    125: ((AcknowledgeAlarm, {"who": "Eva"}),),
    195: (
        (ResetAlarms, {"who": "Jan"}),
        (ShelveAlarm, {"alarm": "friction_drift", "duration": 3600.0, "shelved": True, "who": "Jan"}),
    ),
    225: ((AcknowledgeAlarm, {"who": "Jan", "comment": "cable"}),),
}


def _written(node: MonitorNode) -> None:
    """Wait for the writer of trends, whose calls are then in their order; what it raised is raised."""
    if node._trends is not None and node._trends._writing is not None:
        node._trends._writing.result()


class MonitorLife:
    """Monitor's node with blocks and estimates as fast as it takes them."""

    excuses = ("can't be read",)

    def load(self) -> None:
        """Simulate the valve and load the kernels."""
        told(PLOT)
        warm_up_monitor()

    def prepare(self, disk: Path) -> None:
        """Let a monitor learn its baseline and raise an alarm; an operator acknowledges it."""
        self._live(disk, range(BEGIN))

    def live(self, disk: Path) -> object:
        """Take up what was kept and go on; return the alarms as others see them at each block."""
        return self._live(disk, range(BEGIN, PLOTS[PLOT].blocks))

    def _live(self, disk: Path, numbers: range) -> list[object]:
        valve_state.RETRY = 0  # the record is faster than the clock
        rclpy.init(args=[])
        values = {
            "state_folder": str(disk), "baseline_time": 4.0, "natural_frequency": VALVE.natural_frequency,
        }  # fmt: skip
        node = MonitorNode("valve_1", parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
        seen: list[object] = []
        assert (
            node.trigger_configure()
            == node.trigger_activate()
            == rclpy.lifecycle.TransitionCallbackReturn.SUCCESS
        )
        node._take_description(to_description(VALVE))
        for number in numbers:
            node._take_blocks([told(PLOT).blocks[number]])
            for one in told(PLOT).estimates[number]:
                node._take_estimate(to_message(one, VALVE.id))
            _written(node)
            for kind, fields in ACTS.get(number, ()):
                services = node._alarms
                act = services._baseline if kind is ManageBaseline else partial(services._answer, kind)
                with contextlib.suppress(AlarmRefusedError):  # the alarm is not known: it could not be read
                    act(kind.Request(**fields), kind.Response())
            if number % LOOK == 0:
                node._watch()
            now = alarms(node._alarms._state.alarms)
            if not seen or seen[-1] != now:
                seen.append(now)
        node.trigger_deactivate()
        node.trigger_cleanup()
        node.destroy_node()
        rclpy.shutdown()
        return seen

    def kept(self, disk: Path) -> dict[str, dict[str, Any]]:
        """Return alarms, journal, trends and baseline, as a monitor, an operator and the page read them."""
        said: list[str] = []
        (file,) = disk.rglob(FILE)
        journal = Counter(
            f"{one.action} {one.alarm} {one.state} {one.occurrence} {one.who}" for one in entries_in(file)
        )
        store = TrendStore(file, read_only=True)
        counters = store.counters()
        counts = {name: sum(one.count for one in store.spans(name, DAY)) for name in store.units()}
        trends = {name: round(counters.get(name, count), 9) for name, count in counts.items()}
        store.close()
        state = ValveState(Monitor(), file.parent, said.append)
        state.open()
        baseline = {str(one.version): [one.stage.value, one.who] for one in state.baseline.records}
        found = alarms(state.alarms)
        state.close()
        return {"alarms": found, "journal": dict(journal), "baseline": baseline, "trends": trends}

    def stated(self, said: str) -> set[str]:
        """Return what the last lines of the log name as not kept."""
        state = {"alarms", "journal", "baseline"}
        if "can't be read" in said:  # then alarms are raised again
            return {*state, "trends"}
        lines = {
            "lost at a restart": (state, set()), "can be written again": (set(), state),
            "trends can't be written": ({"trends"}, set()), "trends are written again": (set(), {"trends"}),
            "not written and lost": (state, set()), "not written and is lost": ({"trends"}, set()),
        }  # fmt: skip
        found: set[str] = set()
        for line in said.splitlines():
            for words, (more, less) in lines.items():
                if words in line:
                    found = found - less | more
        return found


def alarms(store: AlarmStore) -> dict[str, Any]:
    """Return what an operator sees of the alarms that ever stood or are put aside."""
    return {
        one.name: [
            one.state.name, one.active, one.latched, one.severity.name, one.occurrence, one.acknowledged_by,
        ]
        for one in store.alarms.values()
        if one.occurrence or one.hidden
    }  # fmt: skip


PROCESS = MonitorLife()
