"""Replay of a record: estimator and monitor, the cores of the live nodes, driven by the recorded blocks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spool_bag.format.metadata import rate_std
from spool_bag.reading.information import MOST_STEPS
from spool_bag.reading.timeline import Timeline, duration_of, step_text
from spool_core.block_run import BlockRun
from spool_core.errors import InputError
from spool_core.format.cdr import OilTemperature
from spool_core.text.sentence import plural
from spool_estimator.identification.record import Record
from spool_estimator.identification.record_parts import PartKeeper
from spool_estimator.plausibility import ValveCheck, check_rate
from spool_estimator.refit import RefitSettings, WindowRefits
from spool_monitor.drift.drift_trace import DriftTrace
from spool_monitor.history.state_file import valve_folder
from spool_monitor.history.valve_state import ValveState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.model import load_model
from spool_sim.valve.description import Valve

from spool_tools.console.outputs import write_file
from spool_tools.console.progress import progress
from spool_tools.console.terminal import warn
from spool_tools.input.record_loading import Source, open_source
from spool_tools.input.record_span import span_of
from spool_tools.input.table_source import TableSource
from spool_tools.input.valve_choice import choose_valves
from spool_tools.report.provenance import sources
from spool_tools.report.replay_dictionary import valve_dictionary

from .replay_settings import SHIPPED, ReplaySettings, settings_from

#: Samples of a valve that its evidence is drawn from at most.
SHOWN = 400_000


@dataclass(frozen=True, slots=True)
class RefitRequest:
    """Refits that a replay is asked for: ``model`` by name or path, ``period`` and ``window`` in s."""

    model: str = "coulomb"
    period: float = 5.0
    window: float = 4.0

    def for_valve(self, valve: Valve) -> WindowRefits:
        """Return the collector of windows.

        Raises:
            InputError: no such model, or its values do not fit the valve.
        """
        model = load_model(self.model)
        model.values_for(valve)
        return WindowRefits(RefitSettings(valve, model, self.period, self.window))


def replay_bag(
    path: Path,
    valve_files: Sequence[str],
    *,
    baseline_time: float | None = None,
    refits: RefitRequest | None = None,
    method: str | None = None,
    params_file: Path | None = None,
    columns: str | None = None,
    report: Path | None = None,
    state: Path | None = None,
    when: tuple[str | None, str | None, str | None] = (None, None, None),
) -> dict[str, Any]:
    """Replay every valve of the record ``path``; return the contract's ``replay --json`` as a dictionary.

    Args:
        path: a bag or a logger's file.
        valve_files: as in ``choose_valves``.
        baseline_time: s; default: the monitor's.
        refits: what to refit during the replay.
        method: of the estimator; default: that of ``params_file``.
        params_file: parameters of the plant's nodes; default: the shipped ones.
        columns: a file's own names, as of ``--columns``.
        report: file to write as an HTML page with the evidence.
        state: folder in which the baseline of each valve is kept from record to record.
        when: since, until and around what, of a bag, as of the options.

    Raises:
        InputError: no valve in the record, or the valve files or the parameter file cannot be used.
    """
    reader = open_source(path, columns, span_of(path, *when))
    names = reader.valves
    if not names:
        raise InputError(f"{path}: no acceleration topic in it, so there is nothing to replay")
    valves = choose_valves(reader, names, valve_files)
    result: dict[str, Any] = {"bag": str(path), "duration_s": None, "valves": {}}
    times = {name: Timeline() for name in names}
    parts = {name: PartKeeper(SHOWN) for name in names} if report is not None else {}
    settings = {
        name: settings_from(params_file, name).changed(method=method, baseline_time=baseline_time)
        for name in names
    }
    replays: dict[str, Replay] = {}
    for name in names:
        replays[name] = result["valves"][name] = replay_valve(
            reader, name, valves[name].valve, settings[name],
            refits=refits, timeline=times[name], parts=parts.get(name), state=state,
        )  # fmt: skip
    first = min((timeline.spans[0].first for timeline in times.values() if timeline.spans), default=0)
    uncertain = reader.record.rate_std if isinstance(reader, TableSource) else rate_std(reader.path)
    for name, one in result["valves"].items():
        doubts = [] if one.check is None else one.check.doubts()
        warnings = [text for text in (valves[name].warning(name), *doubts) if text]
        result["valves"][name] = valve_dictionary(
            one, times[name], first, valves[name], settings[name].to_dict(), warnings, uncertain
        )
    result["duration_s"] = duration_of(list(times.values()))
    result["warnings"] = _warnings(reader, times)
    if report is not None:
        replayed = [
            (name, valves[name].valve, one, parts[name].records(name)) for name, one in replays.items()
        ]
        _write_report(report, result, replayed, first, path)
    return result


def _write_report(
    file: Path,
    result: Mapping[str, Any],
    replayed: Sequence[tuple[str, Valve, Replay, list[Record]]],
    first: int,
    path: Path,
) -> None:
    """Write the page of a replay; libraries that draw are loaded here."""
    from spool_tools.report.evidence.of_replay import Replayed, replay_exhibits  # noqa: PLC0415
    from spool_tools.report.replay_page import replay_page  # noqa: PLC0415

    with progress("drawing"):
        evidence = {}
        for name, valve, one, records in replayed:
            trace, latest = one.trace or DriftTrace(), one.estimator.latest
            shown = Replayed(name, valve, records, trace, one.events, latest, one.refitted, first)
            evidence[name] = replay_exhibits(shown)
        write_file(file, replay_page(result, evidence, sources([path])), "--report")


def _warnings(reader: Source, times: Mapping[str, Timeline]) -> list[str]:
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


def check_of_record(path: Path, valve: Valve, name: str | None, columns: str | None) -> ValveCheck | None:
    """Return what a record shows of ``valve``: the check of a replay of its valve ``name``, or its only one.

    Raises:
        InputError: no such record, or none or several valves in it and no ``name``.
    """
    reader = open_source(path, columns)
    names = reader.valves
    if name is not None and name.strip("/") not in names:
        raise InputError(f"{path}: no valve {name} in it; there are {', '.join(names) or 'none'}")
    if name is None and len(names) != 1:
        raise InputError(f"{path}: {len(names)} valves in it: name one with --name: {', '.join(names)}")
    return replay_valve(reader, names[0] if name is None else name.strip("/"), valve).check


def replay_valve(
    reader: Source,
    name: str,
    valve: Valve,
    settings: ReplaySettings = SHIPPED,
    *,
    keep: bool = False,
    refits: RefitRequest | None = None,
    timeline: Timeline | None = None,
    parts: PartKeeper | None = None,
    state: Path | None = None,
) -> Replay:
    """Replay one valve of a bag through fresh cores with ``settings``, by default those of the live nodes.

    ``timeline`` and ``parts`` are told the blocks; with the latter the drift tests are traced. Drift
    is judged by the baseline in the folder ``state``, or it is learned there.

    Raises:
        InputError: the baseline in ``state`` is another valve's or of another oil.
    """
    windows = refits.for_valve(valve) if refits is not None else None
    estimator = settings.make_estimator(valve, name)
    trace = DriftTrace() if parts is not None else None
    monitor = Monitor(settings.limits(valve))
    kept = None if state is None else ValveState(monitor, valve_folder(state, name), warn)
    if kept is not None:
        kept.open()
        kept.baseline.identify(valve.id, valve.oil or "")
    one = Replay(
        estimator, monitor, keep=keep, refits=windows, gap=settings.make_gap_watch(), trace=trace,
        check=ValveCheck(valve), learned=None if kept is None else kept.baseline.update,
    )  # fmt: skip
    expected = reader.count if isinstance(reader, TableSource) else reader.blocks_of(name)
    with progress(f"replaying {name}", expected) as advance:
        for item in reader.runs(name):
            if isinstance(item, OilTemperature):
                deviation = math.sqrt(item.variance) if item.variance > 0.0 else math.nan
                one.update_temperature(item.stamp, item.celsius, deviation)
                continue
            if one.samples == 0 and item.sample_period > 0.0:
                check_rate(f"{reader.path}: {name}", 1.0 / item.sample_period, valve)
            if isinstance(item, BlockRun):
                _take_run(one, item, timeline, parts)
                advance(len(item))
                continue
            if timeline is not None:
                timeline.take(item)
            if parts is not None:
                parts.take(item)
            one.update(item)
            advance(1)
    one.flush()
    if kept is not None:
        kept.keep_baseline()
        kept.close()
    return one


def _take_run(one: Replay, run: BlockRun, timeline: Timeline | None, parts: PartKeeper | None) -> None:
    """Let a replay, and those who are told the blocks, take ``run``."""
    if timeline is not None:
        timeline.take_run(run)
    if parts is not None:
        for block in run.blocks():
            parts.take(block)
    one.update_run(run)
