"""Replay of a record: estimator and monitor, the cores of the live nodes, driven by the recorded blocks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spool_bag.reading.information import MOST_STEPS
from spool_bag.reading.timeline import Timeline, duration_of, step_text
from spool_estimator.estimator import phase_of, settings_for
from spool_estimator.estimators import make_estimator
from spool_estimator.plausibility import ValveCheck, check_rate
from spool_estimator.refit import RefitSettings, WindowRefits
from spool_identification.record import Record
from spool_identification.record_parts import PartKeeper
from spool_monitor.detectors import MonitorSettings
from spool_monitor.drift.drift_trace import DriftTrace
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.model import load_model
from spool_sim.valve.description import Valve
from spool_stream.block import Block
from spool_stream.errors import InputError

from spool_tools.console.outputs import write_file
from spool_tools.console.progress import progress
from spool_tools.input.csv_blocks import CsvSource
from spool_tools.input.record_loading import Source, open_source
from spool_tools.input.valve_choice import choose_valves
from spool_tools.report.provenance import sources
from spool_tools.report.replay_dictionary import valve_dictionary

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
    method: str = "prediction",
    columns: str | None = None,
    report: Path | None = None,
) -> dict[str, Any]:
    """Replay every valve of the record ``path``; return the contract's ``replay --json`` as a dictionary.

    Args:
        path: a bag or a CSV file.
        valve_files: as in ``choose_valves``.
        baseline_time: s; default: the monitor's.
        refits: what to refit during the replay.
        method: of the estimator.
        columns: a CSV file's names, as of ``--columns``.
        report: file to write as an HTML page with the evidence.

    Raises:
        InputError: no valve in the record, or the valve files cannot be used.
    """
    reader = open_source(path, columns)
    names = reader.valves
    if not names:
        raise InputError(f"{path}: no acceleration topic in it, so there is nothing to replay")
    valves = choose_valves(reader, names, valve_files)
    result: dict[str, Any] = {"bag": str(path), "duration_s": None, "valves": {}}
    times = {name: Timeline() for name in names}
    parts = {name: PartKeeper(SHOWN) for name in names} if report is not None else {}
    replays: dict[str, Replay] = {}
    for name in names:
        replays[name] = result["valves"][name] = replay_valve(
            reader, name, valves[name].valve,
            baseline_time=baseline_time, refits=refits, method=method, timeline=times[name],
            parts=parts.get(name),
        )  # fmt: skip
    first = min((timeline.spans[0].first for timeline in times.values() if timeline.spans), default=0)
    for name, one in result["valves"].items():
        doubts = [] if one.check is None else one.check.doubts()
        warnings = [text for text in (valves[name].warning(name), *doubts) if text]
        result["valves"][name] = valve_dictionary(one, times[name], first, valves[name], warnings)
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
    left_out = {} if isinstance(reader, CsvSource) else reader.undecodable
    told += [
        f"{topic}: {count} messages are not what their type says and are left out: "
        "`./spool recover` makes a bag without them"
        for topic, count in left_out.items()
    ]
    return told


def replay_valve(
    reader: Source,
    name: str,
    valve: Valve,
    *,
    baseline_time: float | None = None,
    keep: bool = False,
    refits: RefitRequest | None = None,
    method: str = "prediction",
    timeline: Timeline | None = None,
    parts: PartKeeper | None = None,
) -> Replay:
    """Replay one valve of a bag through fresh cores with the live nodes' default settings.

    ``timeline`` and ``parts`` are told the blocks; with the latter the drift tests are traced.
    """
    settings = MonitorSettings(natural_frequency=valve.natural_frequency)
    if baseline_time is not None:
        settings = MonitorSettings(natural_frequency=valve.natural_frequency, baseline_time=baseline_time)
    windows = refits.for_valve(valve) if refits is not None else None
    estimator = make_estimator(method, settings_for(valve, phase=phase_of(name)))
    trace = DriftTrace() if parts is not None else None
    one = Replay(
        estimator, Monitor(settings), keep=keep, refits=windows, check=ValveCheck(valve), trace=trace
    )
    expected = reader.count if isinstance(reader, CsvSource) else reader.blocks_of(name)
    with progress(f"replaying {name}", expected) as advance:
        for item in reader.stream(name):
            if isinstance(item, Block):
                if one.samples == 0 and item.sample_period > 0.0:
                    check_rate(f"{reader.path}: {name}", 1.0 / item.sample_period, valve)
                if timeline is not None:
                    timeline.take(item)
                if parts is not None:
                    parts.take(item)
                one.update(item)
                advance(1)
            else:
                deviation = math.sqrt(item.variance) if item.variance > 0.0 else math.nan
                one.update_temperature(item.stamp, item.celsius, deviation)
    one.flush()
    return one
