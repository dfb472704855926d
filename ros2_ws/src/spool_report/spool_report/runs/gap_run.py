"""Gap analysis of records, with the files that come of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np
from rich.console import Console
from spool_bag import DISPLACEMENT, FORCE
from spool_core.errors import InputError
from spool_core.uncertainty import LEGEND, percent, with_interval
from spool_estimator.identification.determination import Determination, sentences
from spool_estimator.identification.fit import determined_before
from spool_estimator.identification.record import LARGEST, Record
from spool_estimator.plausibility import check_records
from spool_gap import report
from spool_gap.evidence.analyse import analyse
from spool_gap.force.analyse import analyse_forces
from spool_gap.force.balance import ForceRecord
from spool_gap.result import GapResult, GapSettings
from spool_report.fit_tables import LONGEST_NAME, save_model
from spool_report.outputs import ResultFiles, sources, write_file, write_json
from spool_report.records import record_loading
from spool_report.records.record_sources import is_table, record_of_table
from spool_report.requests import GapRequest, Selection
from spool_report.terminal import Table, progress, warn, wide_console
from spool_sim.model import Model, load_model
from spool_sim.valve import Valve, find_valve

#: Stretches of one kind of record.
Measured: TypeAlias = Sequence[Record] | Sequence[ForceRecord]

#: Scatter of the sampling steps of a force record, over their median, from which a warning speaks of
#: resampling: a step's worth of motion is then off by a hundredth.
UNEVEN = 0.01
#: Confidence at most where the record contradicts its valve file: its numbers are as likely wrong as right.
DOUBTED_CONFIDENCE = 0.5


def run_gap(
    request: GapRequest, selection: Selection, outputs: ResultFiles, console: Console | None = None
) -> int:
    """Find what the base lacks in the records and show it; return 0, whatever the verdict.

    ``console`` gets text and warnings; default: standard output and standard error.

    Raises:
        InputError: records, valve or model cannot be used, or, after all else, the model cannot be saved.
    """
    kind, valve = request.kind, request.valve
    model = load_model(request.base)
    described: Valve | None
    with progress("looking for the gap", 1.0, steady=False) as advance:
        tell = Shares(advance).tell
        if kind == "accelerations":
            measured: Measured
            result, described, measured = _of_accelerations(request, selection, model, tell, console)
        else:
            # Who imposes a motion measures the force on whatever is moved: no mass is known.
            described = find_valve(valve) if valve is not None and kind == "driven" else None
            mass = request.mass if described is None or request.mass is not None else described.moving_mass
            notes: list[str] = []
            forces, held = (
                _force_records(paths, kind, selection, notes) for paths in (request.records, request.holdout)
            )
            settings = _settings(request)
            result = analyse_forces(
                forces, model, kind, holdout=held, mass=mass, settings=settings, progress=tell
            )
            result = replace(result, warnings=(*dict.fromkeys(notes), *result.warnings))
            measured = [*forces, *held]
    # Files first: who reads only the first lines of what is shown (`| head`) has them all the same.
    made_from = sources([*request.records, *request.holdout], described) if outputs.report else []
    written = _write(result, outputs, made_from, model, described, measured)
    refused: InputError | None = None
    try:
        written += _write_model(result, outputs.model)
    except InputError as error:
        refused = error
    if kind != "accelerations":
        _print_determined(result.determinations, console)
    for warning in result.warnings:
        warn(warning, console)
    show(result, console or wide_console(140))
    for line in written:
        print(line)
    if refused is not None:
        raise refused
    return 0


@dataclass(slots=True)
class Shares:
    """Progress of a search that says how much of it is done, sometimes less than before."""

    advance: Callable[[float], None]
    done: float = 0.0

    def tell(self, _what: str, share: float) -> None:
        """Take the share that is done, 0 to 1."""
        self.advance(max(0.0, share - self.done))
        self.done = max(self.done, share)


def _of_accelerations(
    request: GapRequest,
    selection: Selection,
    model: Model,
    tell: Callable[[str, float], None],
    console: Console | None,
) -> tuple[GapResult, Valve, list[Record]]:
    """Return what ``model`` lacks in records of two accelerometers, their valve, and all of them."""
    bounded = replace(selection, longest=LARGEST)
    recordings, described = record_loading.load_recordings(request.records, request.valve, bounded)
    held = (
        record_loading.load_recordings(request.holdout, request.valve, bounded)[0] if request.holdout else []
    )
    for recording in held:
        record_loading.check(recording)
    fitted, others = record_loading.stretches_of(recordings), record_loading.stretches_of(held)
    doubts = record_loading.channel_doubts([*recordings, *held])
    determined = determined_before(fitted, model, described)
    _print_determined(determined, console)
    result = analyse(fitted, described, model, holdout=others, settings=_settings(request), progress=tell)
    result = replace(result, warnings=(*doubts, *result.warnings), determinations=determined)
    return doubted(result, check_records(described, fitted)), described, [*fitted, *others]


def _settings(request: GapRequest) -> GapSettings:
    return GapSettings(
        request.gain_tolerance, request.delay_tolerance, least_share=request.least_share,
        thorough=request.thorough, profiles=request.profiles,
    )  # fmt: skip


def _print_determined(found: Sequence[Determination], console: Console | None) -> None:
    for line in sentences(found):
        (console or wide_console(140)).print(line, markup=False, soft_wrap=True, highlight=False)


def _write(
    result: GapResult,
    outputs: ResultFiles,
    made_from: Sequence[tuple[str, str]],
    base: Model,
    valve: Valve | None,
    measured: Measured,
) -> list[str]:
    """Write the files that are wanted; return a line about each that people look for."""
    written = []
    if outputs.json is not None:
        write_json(outputs.json, report.result_to_dict(result))
    if outputs.report is not None:
        # Matplotlib is needed here only.
        from spool_report.evidence.collection import force_exhibits, gap_exhibits  # noqa: PLC0415
        from spool_report.gap_page import gap_page  # noqa: PLC0415

        forces = [entry for entry in measured if isinstance(entry, ForceRecord)]
        if forces or valve is None:
            evidence = force_exhibits(forces, result.curves)
        else:
            records = [entry for entry in measured if isinstance(entry, Record)]
            evidence = gap_exhibits(result, base, valve, records)
        write_file(outputs.report, gap_page(result, made_from, evidence), "--report")
        written.append(f"{outputs.report}: the report")
    return written


def _write_model(result: GapResult, path: Path | None) -> list[str]:
    """Write the model of ``result`` if wanted; return a line about it.

    Raises:
        InputError: the file cannot be written, or a reader would refuse it.
    """
    if path is None:
        return []
    found = f"{result.base_model} with the findings of the gap analysis of {result.record}: {result.verdict}"
    name = f"{result.model.name[:LONGEST_NAME]}_gap"
    correlated = (result.correlated, result.correlation)
    save_model(path, result.model, name, result.model.values, result.parameters, found, correlated)
    return [f"{path}: model with the named effects"]


def doubted(result: GapResult, doubts: Sequence[str]) -> GapResult:
    """Return ``result`` with what speaks against its valve file said first, and its confidence capped."""
    if not doubts:
        return result
    confidence = min(result.confidence, DOUBTED_CONFIDENCE)
    return replace(result, warnings=(*doubts, *result.warnings), confidence=confidence)


def _force_records(
    paths: Sequence[Path], kind: str, selection: Selection, notes: list[str]
) -> list[ForceRecord]:
    """Return the stretches of ``paths`` without a gap, evenly sampled; ``notes`` gets what was resampled."""
    found = []
    for path in paths:
        if not is_table(path):
            raise InputError(f"{path}: a record of kind {kind} is a file with displacement_m and force_N")
        table = record_of_table(path, kind, selection.columns, how=selection.how, regular=False)
        inside = (table.time - table.time[0] >= selection.start) & (
            table.time - table.time[0] < selection.stop
        )
        for begin, end in pairwise([0, *table.gaps.tolist(), table.time.size]):
            own = np.arange(begin, end)[inside[begin:end]]
            if own.size < 30:
                continue
            time = table.time[own]
            uneven = float(np.std(np.diff(time)) / table.period)
            if uneven > UNEVEN:
                notes.append(
                    f"{path}: unevenly sampled (steps of {1e3 * table.period:.4g} ms scatter by "
                    f"{percent(uneven)}): resampled by straight lines"
                )
            even = np.arange(time[0], time[-1] + 0.5 * table.period, table.period)
            rows = (np.interp(even, time, table.columns[name][own]) for name in (DISPLACEMENT, FORCE))
            found.append(ForceRecord(str(path), float(time[0]), table.period, *rows))
    if paths and not found:
        raise InputError(f"{paths[0]}: no stretch of 30 samples without a gap in it")
    return found


def show(result: GapResult, console: Console) -> None:
    """Print the verdict, what was found and how the hypotheses rank."""
    console.print(f"{result.verdict}  (confidence {result.confidence:.2f})", style="bold")
    lines = [f"{heading}: {sentence}" for heading, sentence in report.lead(result)]
    lines += [f"\n{result.sentence}"] if result.effects else []
    lines += [report.anomaly_sentence(anomaly)] if (anomaly := result.linear_anomaly) is not None else []
    lines.append(f"Gap location: {result.where.sentence}.")
    lines += [f"Suggested next measurement: {result.advice}."] if result.advice else []
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)
    Table(*report.explanations(result)).show(console)
    Table(*report.parameters(result)).show(console)
    console.print(LEGEND, markup=False, soft_wrap=True)
    for profile in result.profiles:
        console.print(profile.sentence, markup=False, soft_wrap=True)
    Table(*report.nuisances(result)).show(console)
    for small in result.small_effects:
        values = ", ".join(
            f"{q.name} {with_interval(q.value, q.standard_deviation, q.unit)}" for q in small.parameters
        )
        console.print(
            f"There is some {small.id.replace('_', ' ')} ({values}), which changes the acceleration by "
            f"{percent(small.share)}: too little to matter.",
            markup=False, soft_wrap=True,
        )  # fmt: skip
    Table(*report.hypotheses(result)).show(console)
