"""`./spool replay`: estimator and monitor over a record, their settings, and the result as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from spool_bag.importing.choices import columns_of
from spool_bag.information import MOST_STEPS, Timeline, duration_of, step_text
from spool_bag.metadata import rate_std
from spool_core.block import BlockRun
from spool_core.cdr import Command, OilTemperature, Reading, Speed
from spool_core.errors import InputError
from spool_core.events.language import ENGLISH, Language
from spool_core.events.sentences import details, headline, language_of
from spool_core.text import plural
from spool_core.uncertainty import LEGEND, as_json, at_uncertain_rate, by_name, with_interval
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, phase_of, settings_for
from spool_estimator.gap_watch import GapWatch
from spool_estimator.identification.record import LARGEST, PartKeeper, Record
from spool_estimator.plausibility import ValveCheck
from spool_estimator.record_judgement import check_rate
from spool_estimator.refit import Refit, RefitSettings, WindowRefits
from spool_monitor.detectors import JUDGEMENT_TEXTS, LIMITS, MonitorSettings, check_settings
from spool_monitor.detectors.base import BASELINE_TIME, NATURAL_FREQUENCY
from spool_monitor.drift_trace import DriftTrace
from spool_monitor.event import Event
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_monitor.state_file import valve_folder
from spool_monitor.valve_state import ValveState
from spool_report.outputs import sources, write_file
from spool_report.records import record_loading
from spool_report.records.record_sources import TableSource, span_of
from spool_report.requests import ReplayRequest, Selection
from spool_report.terminal import cell, progress, spoken, warn
from spool_sim.model import load_model
from spool_sim.valve import Valve

#: Samples of a valve that its evidence is drawn from at most.
SHOWN = 400_000

#: Parameters of the node `estimator` that change its estimates.
ESTIMATING = ("memory", "low_cut", "high_cut", "minimum_excitation", "period")


@dataclass(frozen=True, slots=True)
class ReplaySettings:
    """Settings of the replay of one valve: what differs from the shipped parameters, and why.

    ``monitor`` and ``estimator`` hold parameters of these nodes by name; ``file`` is the parameter file that
    they are from, empty where none was given.
    """

    monitor: Mapping[str, float] = field(default_factory=dict)
    estimator: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""

    def limits(self, valve: Valve) -> MonitorSettings:
        """Return the monitor's settings for ``valve``, whose frequency counts where no other is given."""
        frequency = self.monitor.get(NATURAL_FREQUENCY.name) or valve.natural_frequency
        return MonitorSettings(**{**self.monitor, NATURAL_FREQUENCY.name: frequency})

    def make_estimator(self, valve: Valve, name: str) -> Estimator:
        """Return the estimator of ``valve`` in the namespace ``name``."""
        changes = {key: value for key, value in self.estimator.items() if key in ESTIMATING}
        return Estimator(settings_for(valve, phase=phase_of(name), **changes))

    def make_gap_watch(self) -> GapWatch:
        """Return what watches the residual."""
        return GapWatch(**{key: value for key, value in self.estimator.items() if key == "gap_growth"})

    def to_dict(self) -> dict[str, Any]:
        """Return what `replay --json` has of the settings: source, sentence, each limit with its unit."""
        return {
            "source": self.file or "shipped",
            "sentence": self.sentence(),
            "values": {
                name: {
                    "value": self.monitor.get(name, limit.default),
                    "unit": limit.unit,
                    "shipped": limit.default,
                }
                for name, limit in LIMITS.items()
                if name != NATURAL_FREQUENCY.name or name in self.monitor
            },
            "estimator": dict(self.estimator),
        }

    @property
    def source(self) -> str:
        """Where the limits are from."""
        return f"limits of {self.file}" if self.file else "limits as shipped"

    def sentence(self) -> str:
        """Return which limits the monitor judged by, in words."""
        limits = [(LIMITS[name], value) for name, value in self.monitor.items()]
        changed = [
            f"{limit.name} {_shown(value, limit.unit)} (shipped: {_shown(limit.default, limit.unit)})"
            for limit, value in limits
            if value != limit.default
        ]
        changed += [f"the estimator's {name} {value}" for name, value in self.estimator.items()]
        if not self.file:
            return f"{self.source}{', except ' if changed else ''}{', '.join(changed)}"
        if changed:
            return f"{self.source}: {', '.join(changed)}; all others as shipped"
        if self.monitor:
            return f"{self.source}, the same as shipped"
        return f"limits as shipped: {self.file} has none for this valve's monitor"


def _shown(value: float, unit: str) -> str:
    return f"{value:g}" if unit in ("", "1") else f"{value:g} {unit}"


#: Settings of a replay that is given none.
SHIPPED = ReplaySettings()

#: ns by which an event's stamp may lie before that of the one before it.
ORDER = 10_000_000_000


def replay_bag(
    request: ReplayRequest, report: Path | None = None, baseline_time: float | None = None
) -> dict[str, Any]:
    """Replay every valve of a record; return the contract's ``replay --json`` as a dictionary.

    Args:
        request: record, and how it is replayed.
        report: file to write as an HTML page with the evidence.
        baseline_time: s; default: the monitor's.

    Raises:
        InputError: no valve in the record, or the valve files or the parameter file cannot be used, or there
            is no such language.
    """
    path, spoken = request.record, language_of(request.language)
    reader = record_loading.open_source(path, request.columns, span_of(path, request.when))
    names = reader.valves
    if not names:
        raise InputError(f"{path}: no acceleration topic in it, so there is nothing to replay")
    valves = record_loading.choose_valves(reader, names, request.valve)
    result: dict[str, Any] = {"bag": str(path), "duration_s": None, "valves": {}}
    times = {name: Timeline() for name in names}
    parts = {name: PartKeeper(SHOWN) for name in names} if report is not None else {}
    settings = {name: settings_from(request.params_file, name) for name in names}
    if baseline_time is not None:
        settings = {
            name: replace(one, monitor={**one.monitor, BASELINE_TIME.name: baseline_time})
            for name, one in settings.items()
        }
    replays: dict[str, Replay] = {}
    for name in names:
        replays[name] = result["valves"][name] = replay_valve(
            reader, name, valves[name].valve, settings[name], refits=_refits(request, valves[name].valve),
            timeline=times[name], parts=parts.get(name), state=request.state,
        )  # fmt: skip
    first = min((timeline.spans[0].first for timeline in times.values() if timeline.spans), default=0)
    uncertain = reader.record.rate_std if isinstance(reader, TableSource) else rate_std(reader.path)
    for name, one in result["valves"].items():
        doubts = [] if one.check is None else one.check.doubts()
        warnings = [text for text in (valves[name].warning(name), *doubts) if text]
        result["valves"][name] = valve_dictionary(
            one, times[name], first, valves[name], settings[name].to_dict(), warnings, uncertain, spoken
        )
    result["duration_s"] = duration_of(list(times.values()))
    result["warnings"] = _warnings(reader, times)
    if report is not None:
        replayed = [
            (name, valves[name].valve, one, parts[name].records(name)) for name, one in replays.items()
        ]
        _write_report(report, result, replayed, first, path)
    return result


def _refits(request: ReplayRequest, valve: Valve) -> RefitSettings | None:
    """Raises InputError where there is no such model, or its values do not fit the valve."""
    if not request.refits:
        return None
    model = load_model(request.refit_model)
    model.values_for(valve)
    return RefitSettings(valve, model, request.refit_period)


def print_replay(result: Mapping[str, Any], console: Console) -> None:
    """Show what a replay gave, a paragraph for each valve."""
    for name, valve in result["valves"].items():
        losses = f"{valve['lost_blocks']} lost" if valve["lost_blocks"] else "none lost"
        text = f": {valve['blocks']} blocks, {losses}; {valve['valve']['sentence']}"
        console.print(cell(name, "bold") + cell(text), soft_wrap=True)
        console.print(cell(f"  {valve['limits']['sentence']}"), soft_wrap=True)
        state = str(valve["estimate"]["state"] or "no estimate").replace("_", " ")
        console.print(f"  final estimate: {state} ({LEGEND})", highlight=False, soft_wrap=True)
        for parameter, quantity in valve["estimate"]["parameters"].items():
            console.print(f"  {spoken(parameter):22} {_number(quantity)}", highlight=False)
        for found in valve.get("refits", ()):
            fitted = ", ".join(
                f"{spoken(name)} {_number(found['parameters'][name])}" for name in found["fitted"]
            )
            text = f"refit {found['state'].replace('_', ' ')}: {fitted or found['reason']}"
            console.print(cell(f"  {found['t_s']:8.1f} s  {text}"), soft_wrap=True)
        for event in valve["events"]:
            text = f"{event['severity']} {event['state']}: {event['message']}"
            console.print(cell(f"  {event['t_s']:8.1f} s  {text}"), soft_wrap=True)


def _number(quantity: Mapping[str, Any]) -> str:
    return with_interval(quantity["value"], quantity["std"], quantity["unit"])


def check_of_record(
    path: Path, valve: Valve, name: str | None, columns: str | None
) -> tuple[ValveCheck | None, tuple[str, ...]]:
    """Return what a record shows of ``valve``, and what is doubtful about the record, a sentence each.

    The check is that of a replay of the record's valve ``name``, or of its only one.

    Raises:
        InputError: as ``load_data``.
    """
    selection = Selection(name, columns_of(columns), longest=LARGEST)
    doubts = record_loading.load_data([path], valve, selection, springs=False).doubts
    reader = record_loading.open_source(path, columns)
    return replay_valve(reader, record_loading.valve_in(reader, name), valve).check, doubts


def replay_valve(
    reader: record_loading.Source,
    name: str,
    valve: Valve,
    settings: ReplaySettings = SHIPPED,
    *,
    keep: bool = False,
    refits: RefitSettings | None = None,
    timeline: Timeline | None = None,
    parts: PartKeeper | None = None,
    state: Path | None = None,
) -> Replay:
    """Replay one valve of a bag through fresh cores with ``settings``, by default those of the live nodes.

    ``timeline`` and ``parts`` get the blocks; with the latter the drift tests are traced. Drift
    is judged by the baseline in the folder ``state``, or it is learned there.

    Raises:
        InputError: the baseline in ``state`` is another valve's or of another oil.
    """
    estimator = settings.make_estimator(valve, name)
    trace = DriftTrace() if parts is not None else None
    monitor = Monitor(settings.limits(valve))
    monitor.detection.orders.components = valve.components
    kept = None if state is None else ValveState(monitor, valve_folder(state, name), warn)
    if kept is not None:
        kept.open()
        kept.baseline.identify(valve.id, valve.oil or "")
    one = Replay(
        estimator, monitor, keep=keep, refits=None if refits is None else WindowRefits(refits),
        gap=settings.make_gap_watch(), trace=trace, check=ValveCheck(valve),
        learned=None if kept is None else kept.baseline.update,
    )  # fmt: skip
    expected = reader.count if isinstance(reader, TableSource) else reader.blocks_of(name)
    with progress(f"replaying {name}", expected) as advance:
        for item in reader.runs(name):
            if isinstance(item, OilTemperature | Speed | Command):
                _take_reading(one, item)
                continue
            if one.samples == 0 and item.sample_period > 0.0:
                check_rate(f"{reader.path}: {name}", 1.0 / item.sample_period, valve)
            if isinstance(item, BlockRun):
                if timeline is not None:
                    timeline.take_run(item)
            elif timeline is not None:
                timeline.take(item)
            if parts is not None:
                for block in item.blocks() if isinstance(item, BlockRun) else (item,):
                    parts.take(block)
            one.update(item)
            advance(len(item) if isinstance(item, BlockRun) else 1)
    one.flush()
    if kept is not None:
        kept.keep_baseline()
        kept.close()
    return one


def _take_reading(replay: Replay, item: Reading) -> None:
    if isinstance(item, OilTemperature):
        deviation = math.sqrt(item.variance) if item.variance > 0.0 else math.nan
        replay.update_temperature(item.stamp, item.celsius, deviation)
    elif isinstance(item, Command):
        replay.update_command(item.stamp, item.value)
    else:
        # The order tracker looks up speeds by their stamps: blocks that wait need not be passed on.
        replay.monitor.update_speed(item.stamp, item.rpm)


def settings_from(file: Path | None, name: str) -> ReplaySettings:
    """Return the settings that the parameter file ``file`` gives the nodes in the namespace ``name``.

    Raises:
        InputError: the nodes would refuse the file.
    """
    if file is None:
        return SHIPPED
    # The nodes' own tables, which need ROS.
    from spool_estimator.estimator_node import EstimatorNode  # noqa: PLC0415
    from spool_monitor.monitor_node import MonitorNode  # noqa: PLC0415

    space = f"/{name.strip('/')}"
    monitor = MonitorNode.read_file(file, f"{space}/monitor")
    estimator = EstimatorNode.read_file(file, f"{space}/estimator")
    limits = {key: value for key, value in monitor.items() if key in LIMITS and isinstance(value, float)}
    try:
        check_settings(MonitorSettings(**limits))
    except InputError as error:
        raise InputError(f"{file}: {space}/monitor: {error}") from None
    own = {key: estimator[key] for key in (*ESTIMATING, "gap_growth") if key in estimator}
    defaults = {parameter.name: parameter.default for parameter in EstimatorNode.PARAMETERS}
    return ReplaySettings(
        limits, {key: value for key, value in own.items() if value != defaults[key]}, str(file)
    )


@dataclass(slots=True)
class Clock:
    """Clock of a record: time since its first stamp, across the steps of a clock that was set.

    Attributes:
        timeline: of the valve.
        first: the record's first stamp, ns.
    """

    timeline: Timeline
    first: int
    _told: int = 0

    def since(self, stamp: int) -> float:
        """Return the time (s) of ``stamp`` (ns); stamps come in the order in which they were told."""
        if not self.timeline.spans:
            return (stamp - self.first) * 1e-9
        passed = self.timeline.since(stamp, self._told)
        self._told = max(self._told, passed - ORDER)
        return (passed + self.timeline.spans[0].first - self.first) * 1e-9


def valve_dictionary(
    one: Replay,
    timeline: Timeline,
    first: int,
    chosen: record_loading.ChosenValve,
    limits: Mapping[str, Any],
    warnings: Sequence[str],
    rate_std: float = 0.0,
    language: Language = ENGLISH,
) -> dict[str, Any]:
    """Return the entry of one valve in ``replay --json``.

    Args:
        one: its replay.
        timeline: of its blocks.
        first: the record's first stamp, ns.
        chosen: its description and where that came from.
        limits: that the monitor judged by, and where they came from.
        warnings: about it.
        rate_std: relative standard deviation of the record's sampling rate, which enters those of parameters.
        language: of the events' sentences.
    """
    gate = one.estimator.gate
    events, refits = Clock(timeline, first), Clock(timeline, first)
    found: dict[str, Any] = as_json(
        {
            "blocks": gate.accepted,
            "lost_blocks": gate.lost,
            "samples": one.samples,
            "estimate": _estimate(one.estimator.latest, rate_std),
            "health": {
                "level": one.monitor.health.level,
                "baseline": one.monitor.health.baseline.text,
                "summary": one.monitor.health.summary,
                "judgements": {
                    name: JUDGEMENT_TEXTS[judgement] for name, judgement in one.monitor.health.judgements
                },
            },
            "events": [event_dictionary(event, events, language) for event in one.events],
            **({} if one.refits is None else {"refits": [_refit(found, refits) for found in one.refitted]}),
            "valve": {
                "id": chosen.valve.id,
                "source": chosen.source,
                "file": chosen.file or None,
                "moving_mass_kg": chosen.valve.moving_mass,
                "natural_frequency_Hz": chosen.valve.natural_frequency,
                "sentence": chosen.sentence(),
            },
            "limits": limits,
            "warnings": warnings,
        }
    )
    return found


def event_dictionary(event: Event, clock: Clock, language: Language) -> dict[str, Any]:
    """Return an event in ``replay --json``; ``value`` to ``limit`` are in ``unit``, times in s."""
    facts, at = event.facts, clock.since(event.stamp)
    judged = facts if facts.parameter else event.quantity
    return {
        "t_s": at,
        "kind": event.kind,
        "state": event.state,
        "severity": event.severity,
        "cause": event.cause or None,
        "code": event.code,
        "source": event.source or None,
        "parameter": facts.parameter or None,
        "value": judged.value,
        "unit": judged.unit,
        "low": facts.low,
        "high": facts.high,
        "baseline": facts.baseline,
        "change": facts.change,
        "limit": facts.limit,
        "began_s": at - 1e-9 * (event.stamp - facts.began) if facts.began else None,
        "causes": facts.causes,
        "probabilities": facts.probabilities,
        "false_alarm_interval": facts.false_alarm_interval,
        "urgency": facts.urgency,
        "time_to_limit": facts.time_to_limit,
        "advice": facts.advice or None,
        "subject": facts.subject or None,
        "note": facts.note or None,
        "evidence": by_name(facts.evidence),
        "message": headline(event, language),
        "details": [str(one) for one in details(event, language)],
    }


def _write_report(
    file: Path,
    result: Mapping[str, Any],
    replayed: Sequence[tuple[str, Valve, Replay, list[Record]]],
    first: int,
    path: Path,
) -> None:
    """Write the page of a replay; libraries that draw are loaded here."""
    from spool_report.evidence.collection import Replayed, replay_exhibits  # noqa: PLC0415
    from spool_report.recording_report import replay_page  # noqa: PLC0415

    with progress("drawing"):
        evidence = {}
        for name, valve, one, records in replayed:
            trace, latest = one.trace or DriftTrace(), one.estimator.latest
            shown = Replayed(name, valve, records, trace, one.events, latest, first)
            evidence[name] = replay_exhibits(shown)
        write_file(file, replay_page(result, evidence, sources([path])), "--report")


def _warnings(reader: record_loading.Source, times: Mapping[str, Timeline]) -> list[str]:
    """Return what is not as it should be in the record itself, one line each."""
    told = list(reader.warnings)
    for name, timeline in times.items():
        told += [step_text(name, step) for step in timeline.steps[:MOST_STEPS]]
    left_out = {} if isinstance(reader, TableSource) else reader.undecodable
    told += [
        f"{topic}: {plural(count, 'message')} left out: the bytes do not fit the type; "
        "`./spool recover` makes a bag without them"
        for topic, count in left_out.items()
    ]
    return told


def _refit(found: Refit, clock: Clock) -> dict[str, Any]:
    return {
        "t_s": clock.since(found.stamp),
        "model": found.model,
        "state": found.state,
        "reason": found.reason,
        "parameters": by_name(found.parameters),
        "fitted": found.fitted,
        "correlations": np.reshape(found.correlations, (len(found.fitted),) * 2),
        "objective": found.objective.value,
        "amplitude_ratio": found.amplitude_ratio.value,
        "nrmse": found.nrmse.value,
    }


def _estimate(estimate: Estimate | None, rate_std: float) -> dict[str, Any]:
    if estimate is None:
        nothing = dict.fromkeys(("model", "state", "natural_frequency_Hz", "damping_ratio", "nrmse"))
        return {**nothing, "parameters": {}}
    return {
        "model": estimate.model,
        "state": estimate.state,
        "parameters": by_name(at_uncertain_rate(one, rate_std) for one in estimate.parameters),
        "natural_frequency_Hz": estimate.natural_frequency.value,
        "damping_ratio": estimate.damping_ratio.value,
        "nrmse": estimate.residual.value,
    }
