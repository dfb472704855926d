"""Metrics of all valves in Prometheus' text format, version 0.0.4 (prometheus.io, "Exposition formats")."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from spool_core.node.diagnostics import key
from spool_core.system import resident_memory
from spool_core.uncertainty import Z_95
from spool_monitor.listener import (
    CONDITIONS,
    ENDS,
    KEPT_COSTS,
    NO_WORD,
    STROKE_TIMES,
    WAITING,
    Cost,
    HeardValve,
)
from spool_monitor.shown import ACTIVE, PUT_ASIDE, shown
from starlette.requests import Request
from starlette.responses import Response

from spool_view.view import BAND, known, margin_of

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

#: Numbers of the states: 0 is good, the worst is 7; 8: somebody put the alarms aside.
NUMBERS = {condition: number for number, condition in enumerate((*reversed(CONDITIONS), PUT_ASIDE))}
_LIST = ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in NUMBERS.items())

#: Type and help of each metric; those of estimates (:func:`estimates_name`) join them.
METRICS = {
    "spool_valves": ("gauge", "Valves whose monitors were heard since the page started."),
    "spool_valve_condition": ("gauge", f"Condition: {_LIST}."),
    "spool_valve_namur_status": (
        "gauge", "Status by NAMUR NE 107: 0 unknown, 1 normal, 2 maintenance required, 3 out of "
        "specification, 4 function check, 5 failure.",
    ),
    "spool_resonance_margin_ratio": (
        "gauge", "Distance of the strongest line to the natural frequency, over the latter; negative: below.",
    ),
    "spool_resonance_band_ratio": ("gauge", "Size of the margin at and below which the monitor warns."),
    "spool_strokes_today": ("gauge", "Strokes of the solenoid since midnight (UTC)."),
    "spool_judged_ratio": ("gauge", "Share of this day's time that is judged, strokes left out."),
    "spool_stroke_seconds": ("gauge", "Times of strokes: now, healthy, and where the monitor warns."),
    "spool_alarms_active": ("gauge", "Alarms that are active and not put aside, by number."),
    "spool_alarms_waiting": ("gauge", "Alarms that wait for an operator, by number."),
    "spool_health_timestamp_seconds": ("gauge", "When the monitor was heard last, Unix time."),
    "spool_block_timestamp_seconds": (
        "gauge", "Acquisition time of the newest block that the estimator had received, Unix time.",
    ),
    "spool_blocks_lost_total": ("counter", "Blocks lost on their way to the estimator."),
    "spool_blocks_refused_total": ("counter", "Blocks that the estimator refused."),
    "spool_valve_cpu_seconds_total": ("counter", "Processor time of a hosted valve's nodes."),
    "spool_valve_resident_memory_bytes": ("gauge", "Share of a hosted valve in its process's memory."),
    "spool_process_cpu_seconds_total": ("counter", "Processor time of the page and of hosts."),
    "spool_process_resident_memory_bytes": ("gauge", "Resident memory of the page and of hosts."),
}  # fmt: skip

#: Units of estimates in names of metrics (prometheus.io, "Metric and label naming"); others are as in
#: ``/diagnostics``.
_UNITS = {
    "": "ratio", "1": "ratio", "Hz": "hertz", "N": "newtons", "N/m": "newtons_per_meter",
    "N s/m": "newton_seconds_per_meter", "m": "meters", "m/s": "meters_per_second", "s": "seconds",
    "kg": "kilograms", "Pa": "pascals", "Pa s": "pascal_seconds", "rad": "radians", "1/s": "per_second",
}  # fmt: skip

#: Metrics of strokes, the keys in ``/diagnostics`` that they are of, and further labels.
_STROKES: tuple[tuple[str, str, dict[str, str]], ...] = (
    ("spool_strokes_today", "strokes_today", {}),
    ("spool_judged_ratio", "judged_share", {}),
    *(
        ("spool_stroke_seconds", f"{time}{end}_s", {"parameter": time, "bound": end.strip("_") or "now"})
        for time in STROKE_TIMES
        for end in ("", "_healthy", *(f"_{one}" for one in ENDS))
    ),
)

#: Estimates of a valve that are served at most: what a message of others holds is bounded.
MOST_ESTIMATES = 16

_ESCAPES = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


@dataclass(frozen=True, slots=True)
class Metrics:
    """Metrics of one page.

    Attributes:
        valves: that are heard.
        hosts: what processes of hosts take, by their names.
    """

    valves: Mapping[str, HeardValve]
    hosts: Mapping[str, Cost]

    async def answer(self, _request: Request) -> Response:
        """Answer a scrape."""
        text = exposition(self.valves, self.hosts, time.monotonic(), time.time())
        return Response(text, headers={"content-type": CONTENT_TYPE})


def exposition(
    valves: Mapping[str, HeardValve], hosts: Mapping[str, Cost], now: float, unix_time: float
) -> str:
    """Return all metrics as text; what is not known has no sample.

    Args:
        valves: that are heard.
        hosts: what processes of hosts take, by their names.
        now: s, monotonic.
        unix_time: s since 1970, at the same moment.
    """
    found = _Samples()
    found.add("spool_valves", sum(one.health is not None for one in valves.values()))
    for name, valve in list(valves.items()):
        _add_valve(found, name, valve, now, unix_time)
    own = Cost(time.process_time(), resident_memory(), now)
    for process, cost in {"page": own, **hosts}.items():
        if now - cost.at <= KEPT_COSTS:
            found.add("spool_process_cpu_seconds_total", cost.processor_time, process=process)
            found.add("spool_process_resident_memory_bytes", cost.memory, process=process)
    return found.text()


def estimates_name(unit: str) -> str:
    """Return the name of the metric of estimates in ``unit``."""
    return f"spool_estimate_{_UNITS.get(unit) or key('', unit).strip('_').lower() or 'ratio'}"


@dataclass(slots=True)
class _Samples:
    """Samples by metric and labels, so that no series comes twice."""

    _by_metric: dict[str, dict[str, float]] = field(default_factory=dict)

    def add(self, metric: str, value: float | None, **labels: str) -> None:
        """Add a sample, to the one of the same labels where there is one."""
        if value is not None and math.isfinite(value):
            text = ",".join(f'{name}="{label.translate(_ESCAPES)}"' for name, label in labels.items())
            samples, series = self._by_metric.setdefault(metric, {}), f"{{{text}}}" if text else ""
            samples[series] = samples.get(series, 0) + value

    def text(self) -> str:
        lines = []
        for metric, samples in self._by_metric.items():
            kind, told = METRICS.get(metric) or ("gauge", "Estimates with the ends of their 95 % intervals.")
            lines += [f"# HELP {metric} {told}", f"# TYPE {metric} {kind}"]
            lines += [f"{metric}{labels} {value}" for labels, value in samples.items()]
        return "\n".join(lines) + "\n"


def _add_valve(found: _Samples, name: str, valve: HeardValve, now: float, unix_time: float) -> None:
    state, health, estimate = shown(valve, now, unix_time), valve.health, valve.estimate
    found.add("spool_valve_condition", NUMBERS[state.state], valve=name)
    for alarm in state.alarms:
        for metric, states in (("spool_alarms_active", ACTIVE), ("spool_alarms_waiting", WAITING)):
            found.add(metric, int(alarm.state in states), valve=name, code=str(alarm.code))
    if health is not None:
        found.add("spool_health_timestamp_seconds", unix_time - (now - valve.health_at), valve=name)
    if estimate is not None:
        stamp = estimate.header.stamp
        if stamp.sec:
            found.add("spool_block_timestamp_seconds", stamp.sec + 1e-9 * stamp.nanosec, valve=name)
        found.add("spool_blocks_lost_total", estimate.lost_blocks, valve=name)
        found.add("spool_blocks_refused_total", estimate.refused_blocks, valve=name)
    if valve.cost is not None and now - valve.cost.at <= KEPT_COSTS:
        found.add("spool_valve_cpu_seconds_total", valve.cost.processor_time, valve=name)
        found.add("spool_valve_resident_memory_bytes", valve.cost.memory, valve=name)
    if health is None or state.state == NO_WORD:  # the last message need not hold any more
        return
    found.add("spool_valve_namur_status", health.namur, valve=name)
    found.add("spool_resonance_margin_ratio", margin_of(health), valve=name)
    found.add("spool_resonance_band_ratio", valve.limits.get(BAND), valve=name)
    for metric, said, labels in _STROKES:
        found.add(metric, valve.bounds.get(said), valve=name, **labels)
    if estimate is None:
        return
    listed = (*estimate.parameters[:MOST_ESTIMATES], estimate.natural_frequency)
    for quantity in {one.name: one for one in listed}.values():
        if not known(quantity):
            continue
        metric, half = estimates_name(quantity.unit), Z_95 * quantity.standard_deviation
        for bound, value in (("estimate", 0.0), ("low", -half), ("high", half)):
            found.add(metric, quantity.value + value, valve=name, parameter=quantity.name, bound=bound)
