"""Running valves as viewers hear them: their last messages, how old these are, and the condition."""

from __future__ import annotations

import contextlib
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from spool_core.cdr import CdrError, decode_blocks, encode_block
from spool_core.node import qos
from spool_msgs import msg

#: s without a word of the monitor, which speaks once a second, after which nothing is known.
SILENT = 2.5

ALARM, NO_WORD, STALE, WARNING = "alarm", "no_word", "stale", "warning"
UNKNOWN, LEARNING, AT_REST, GOOD = "unknown", "learning", "at_rest", "good"
#: Worst first.
CONDITIONS = (ALARM, NO_WORD, STALE, WARNING, UNKNOWN, LEARNING, AT_REST, GOOD)

_LEVELS = {
    msg.ValveHealth.LEVEL_ALARM: ALARM,
    msg.ValveHealth.LEVEL_WARNING: WARNING,
    msg.ValveHealth.LEVEL_STALE: STALE,
    msg.ValveHealth.LEVEL_UNKNOWN: UNKNOWN,
}
#: Detectors that compare the valve with its baseline: it is good only where all of them judge.
DRIFT = ("friction_drift", "spring_change")
#: Ends of a parameter's name in ``/diagnostics``, as ``coulomb_force_low_N``: beyond these values it warns.
ENDS = ("low", "high")
#: Times of strokes, and keys of what else it shows of them.
STROKE_TIMES = ("stroke_time", "return_time", "stroke_delay")
OF_STROKES = (
    "strokes_today", "judged_share", *(f"{name}{end}_s" for name in STROKE_TIMES for end in ("", "_healthy"))
)  # fmt: skip
#: What the monitor says of a detector (`ValveHealth.msg`, judgements), and what that makes of the valve.
_JUDGEMENTS = {"judged": GOOD, "learning": LEARNING, "not enough excitation": AT_REST}

#: Valves that are held at most, to bound what foreign topics fill; the first ones heard stay.
MOST_VALVES = 1000
#: Valves that are followed at a time, and blocks of samples held of each; 4 s at 50 blocks/s.
MOST_FOLLOWED, MOST_BLOCKS = 16, 200
#: Events of a valve that may wait to be taken: chosen, it bounds the memory.
EVENTS = 100
#: States in which an alarm waits for an operator.
WAITING = (
    msg.Alarm.STATE_UNACKNOWLEDGED,
    msg.Alarm.STATE_RETURNED_UNACKNOWLEDGED,
    msg.Alarm.STATE_LATCHED_UNACKNOWLEDGED,
)
_TYPES = {"estimate": msg.ModelEstimate, "alarms": msg.AlarmList, "gap": msg.GapAnalysis}
#: s between two moments in which the limits of all valves are heard, and how long one lasts.
BOUNDS_EVERY, BOUNDS_LASTING = 60.0, 2.5
#: s between two estimates that are taken of a valve for metrics: decoding each one costs more than all else.
ESTIMATES_EVERY = 10.0
#: s after which what a host said of its processes is not known any more.
KEPT_COSTS = 150.0
_HEALTH = re.compile(r"/(?P<valve>[A-Za-z0-9_/]+)/health")


@dataclass(frozen=True, slots=True)
class Cost:
    """What a process, or a valve in it, has taken of a processor (s) and takes of memory (B).

    ``at``: when that was heard, s (monotonic).
    """

    processor_time: float
    memory: float
    at: float


@dataclass(slots=True)
class HeardValve:
    """Last messages of a valve, each ``None`` before it came. Fields are replaced: any thread may read them.

    Attributes:
        health_at: when ``health`` was fetched, s (monotonic).
        gap, blocks: kept only while the valve is followed; with ``light`` also ``estimate``.
        bounds: values beyond which the monitor warns, and of strokes, by their keys in ``/diagnostics``.
        blocks: serialized ``AccelerationBlock`` messages, oldest first.
        cost: of its nodes in a host; kept with ``metrics`` only.
        baseline, limits: the monitor's answers, if the user of the listener asked for them.
        changes: counts what was kept.
    """

    name: str
    health: msg.ValveHealth | None = None
    health_at: float = 0.0
    estimate: msg.ModelEstimate | None = None
    alarms: msg.AlarmList | None = None
    gap: msg.GapAnalysis | None = None
    cost: Cost | None = None
    baseline: Any = None
    limits: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    blocks: deque[bytes] = field(default_factory=lambda: deque(maxlen=MOST_BLOCKS))
    changes: int = 0

    def condition(self, now: float) -> str:
        """Return the condition, one of ``CONDITIONS``, at ``now`` (s, monotonic)."""
        return condition_of(self.health, now - self.health_at)

    def bound(self, parameter: str, end: str) -> float | None:
        """Return the value of ``parameter`` beyond which it warns at the ``end``, one of ``ENDS``."""
        begin = f"{parameter}_{end}"
        return next((value for key, value in self.bounds.items() if key.startswith(begin)), None)

    def keep(self, what: str, value: object) -> None:
        """Replace the field ``what``."""
        setattr(self, what, value)
        self.changes += 1


class Listener:
    """Listener to all valves whose monitors ``node`` discovers, or to those named; it sends nothing to them.

    Its methods belong on the node's thread: call :meth:`look` and :meth:`fetch` periodically. Health comes
    once a second of each valve. It is fetched, with a node that no executor wakes up for: that costs a third
    of a callback for each message.

    Args:
        node: that subscribes.
        names: of the valves; empty for all that are discovered.
        light: whether to spare the processor: health of a new valve comes within a second instead of
            immediately, and estimates are kept only of valves that are followed.
        metrics: whether to keep what metrics need besides, also with ``light``: an estimate of each valve
            every ``ESTIMATES_EVERY`` s, and every ``BOUNDS_EVERY`` s what its host tells.
        expected: valves that show as not heard until they are.
        on_event: takes the name of a valve and its event.

    Attributes:
        hosts: what the processes of hosts take, by the names of their nodes; with ``metrics`` only.
    """

    def __init__(
        self,
        node: Node,
        names: Sequence[str] = (),
        *,
        light: bool = False,
        metrics: bool = False,
        expected: Iterable[str] = (),
        on_event: Callable[[str, msg.HealthEvent], None] | None = None,
    ) -> None:
        self.valves: dict[str, HeardValve] = {}
        self.hosts: dict[str, Cost] = {}
        self._metrics = metrics
        self._node, self._names, self._on_event = node, names, on_event
        self._quiet = Node(
            f"{node.get_name()}_listener", namespace=node.get_namespace(), context=node.context,
            enable_rosout=False, start_parameter_services=False, use_global_arguments=False,
        )  # fmt: skip
        # A lost message is replaced by the next a second later, so nothing has to be confirmed or sent again.
        self._health_quality = qos.samples_wanted(1) if light else qos.state()
        self._topics = ("alarms",) if light else ("alarms", "estimate")
        self._more = ("estimate", "gap") if light else ("gap",)
        self._health: dict[str, Any] = {}
        self._estimates: dict[str, Any] = {}
        self._estimates_at: dict[str, float] = {}
        self._made: list[Any] = []
        self._followed: dict[str, list[Any]] = {}
        self._bounds: Any = None
        self._bounds_at = -BOUNDS_EVERY
        for name in (*names, *expected):
            self._join(name)
        self.look()

    def look(self) -> None:
        """Join the valves that appeared."""
        if self._names:
            return
        for topic, types in self._node.get_topic_names_and_types():
            match = _HEALTH.fullmatch(topic)
            if match and "spool_msgs/msg/ValveHealth" in types:
                self._join(match["valve"])

    def fetch(self) -> None:
        """Fetch what the monitors said since the last time."""
        for name, subscription in self._health.items():
            with subscription.handle:
                taken = subscription.handle.take_message(msg.ValveHealth, False)
            if taken is not None:
                self.valves[name].health_at = time.monotonic()
                self.valves[name].keep("health", taken[0])
        now = time.monotonic()
        for name, subscription in self._estimates.items():
            if now - self._estimates_at[name] < ESTIMATES_EVERY:
                continue
            with subscription.handle:
                taken = subscription.handle.take_message(msg.ModelEstimate, False)
            if taken is not None:
                self._estimates_at[name] = now
                self.valves[name].keep("estimate", taken[0])

    def follow(self, names: Iterable[str]) -> list[HeardValve]:
        """Keep more of the valves ``names`` until the next call: see :class:`HeardValve`.

        Returns:
            Those that are followed: of the valves that were heard, the first ``MOST_FOLLOWED``.
        """
        wanted = [name for name in names if name in self.valves][:MOST_FOLLOWED]
        for name in [name for name in self._followed if name not in wanted]:
            for one in self._followed.pop(name):
                self._node.destroy_subscription(one)
            valve = self.valves[name]
            valve.blocks.clear()
            for topic in self._more:
                if topic != "estimate" or not self._metrics:
                    valve.keep(topic, None)
        for name in wanted:
            if name not in self._followed:
                self._followed[name] = self._follow(self.valves[name])
        return [self.valves[name] for name in wanted]

    def sample_bounds(self) -> None:
        """Hear ``/diagnostics`` for a moment now and then, for the ``bounds`` of every valve.

        All nodes publish there each second: to decode all of it takes several times what all else takes.
        """
        now = time.monotonic()
        if self._bounds is None and now - self._bounds_at >= BOUNDS_EVERY:
            self._bounds_at = now
            self._bounds = self._node.create_subscription(
                DiagnosticArray, "/diagnostics", self._take_diagnostics, qos.diagnostics()
            )
        elif self._bounds is not None and now - self._bounds_at >= BOUNDS_LASTING:
            self._node.destroy_subscription(self._bounds)
            self._bounds = None

    def close(self) -> None:
        """Destroy every subscription."""
        if self._bounds is not None:
            self._node.destroy_subscription(self._bounds)
            self._bounds = None
        self.follow(())
        for one in self._made:
            self._node.destroy_subscription(one)
        self._made.clear()
        self._health.clear()
        self._estimates.clear()
        self._quiet.destroy_node()

    def _join(self, name: str) -> None:
        if name in self.valves or len(self.valves) >= MOST_VALVES:
            return
        valve = self.valves[name] = HeardValve(name)
        # A subscription has to have a callback; no executor calls this one.
        self._health[name] = self._quiet.create_subscription(
            msg.ValveHealth, f"/{name}/health", lambda _: None, self._health_quality
        )
        if self._metrics:
            self._estimates_at[name] = -ESTIMATES_EVERY
            self._estimates[name] = self._quiet.create_subscription(
                msg.ModelEstimate, f"/{name}/estimate", lambda _: None, self._health_quality
            )
        self._made += self._keep(valve, self._topics)
        if self._on_event is not None:
            take, quality = partial(self._on_event, name), qos.state(EVENTS)
            self._made.append(
                self._node.create_subscription(msg.HealthEvent, f"/{name}/events", take, quality)
            )

    def _keep(self, valve: HeardValve, topics: Sequence[str]) -> list[Any]:
        return [
            self._node.create_subscription(
                _TYPES[topic], f"/{valve.name}/{topic}", partial(valve.keep, topic), qos.state()
            )
            for topic in topics
        ]

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status if self._metrics else ():
            node, _, task = status.name.partition(": ")
            cost = cost_of(status) if node.rpartition("/")[2].startswith("host") else None
            if cost is not None and task == "host" and len(self.hosts) < MOST_VALVES:
                self.hosts[node] = cost
            elif cost is not None and task in self.valves:
                self.valves[task].cost = cost
        for status in message.status:
            name, _, task = status.name.partition("/monitor: ")
            valve = self.valves.get(name) if task == "condition" else None
            if valve is None:
                continue
            bounds = bounds_of(message.status, name)
            if bounds is not None and repr(bounds) != repr(valve.bounds):  # NaN is another one each time
                valve.keep("bounds", bounds)

    def _follow(self, valve: HeardValve) -> list[Any]:
        def take_block(raw: bytes) -> None:  # rclpy refuses a method of deque: it has no signature
            valve.blocks.append(raw)

        def take_blocks(raw: bytes) -> None:
            with contextlib.suppress(CdrError):
                found = [block for name, block in decode_blocks(raw) if name.strip("/") == valve.name]
                valve.blocks.extend(encode_block(block, block.source) for block in found)

        subscribe, blocks = self._node.create_subscription, f"/{valve.name}/acceleration"
        return [
            subscribe(msg.AccelerationBlock, blocks, take_block, qos.samples_wanted(), raw=True),
            subscribe(msg.AccelerationBlocks, "accelerations", take_blocks, qos.samples_wanted(), raw=True),
            subscribe(DiagnosticArray, "/diagnostics", self._take_diagnostics, qos.diagnostics()),
            *self._keep(valve, self._more),
        ]


def bounds_of(statuses: Sequence[DiagnosticStatus], name: str) -> dict[str, float] | None:
    """Return where the monitor of the valve ``name`` warns, and its strokes; ``None`` if it is silent.

    Args:
        statuses: of a message of ``/diagnostics``.
        name: namespace of the valve.
    """
    said = next((one.values for one in statuses if one.name == f"{name}/monitor: condition"), None)
    if said is None:
        return None
    return {
        one.key: float(one.value)
        for one in said
        if any(f"_{end}" in one.key for end in ENDS) or one.key in OF_STROKES
    }


def cost_of(status: DiagnosticStatus) -> Cost | None:
    """Return what a host says with ``status`` that it, or a valve, takes; ``None`` where it says nothing."""
    said = {one.key: one.value for one in status.values if one.key in ("cpu_time_s", "resident_B")}
    try:
        return Cost(float(said["cpu_time_s"]), float(said["resident_B"]), time.monotonic())
    except (KeyError, ValueError):
        return None


def condition_of(health: msg.ValveHealth | None, age: float) -> str:
    """Return the condition, one of ``CONDITIONS``, by the monitor's last word, which came ``age`` s ago.

    It is good only where the monitor spoke lately, has a baseline and judges drift against it, of one
    parameter of each detector at least: the summary names those that it cannot judge. A level or a judgement
    that nobody knows is unknown.
    """
    if health is None or age > SILENT:
        return NO_WORD
    if health.level != msg.ValveHealth.LEVEL_OK:
        return _LEVELS.get(health.level, UNKNOWN)
    if health.baseline != msg.ValveHealth.BASELINE_FROZEN:
        return LEARNING
    said = dict(judgement.partition(": ")[::2] for judgement in health.judgements)
    return min((_drift(name, said) for name in DRIFT), key=CONDITIONS.index)


def moves(health: msg.ValveHealth) -> bool | None:
    """Return whether the valve moves, by its detectors of drift; ``None``: not known."""
    said = {judgement.rpartition(": ")[2] for judgement in health.judgements if judgement.startswith(DRIFT)}
    return True if "judged" in said else False if "not enough excitation" in said else None


def _drift(name: str, said: dict[str, str]) -> str:
    """Return the condition by what was ``said`` of the detector ``name`` and its parameters."""
    partly = [judgement for one, judgement in said.items() if one.startswith(f"{name}/")]
    return GOOD if "judged" in partly else _JUDGEMENTS.get(said.get(name, ""), UNKNOWN)
