"""Gap analysis of records, with the files that come of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from spool_core.discovery import from_add_on
from spool_core.errors import InputError
from spool_core.uncertainty import LEGEND, percent, with_interval
from spool_estimator.identification.determination import Determination, sentences
from spool_estimator.identification.fit import determined_before
from spool_estimator.identification.record import LARGEST, Record
from spool_estimator.plausibility import check_records
from spool_gap import report
from spool_gap.evidence.analyse import analyse
from spool_gap.result import GapResult, GapSettings, Progress
from spool_report.fit_tables import LONGEST_NAME, save_model
from spool_report.outputs import ResultFiles, sources, write_file, write_json
from spool_report.records import record_loading
from spool_report.requests import GapRequest, Selection
from spool_report.terminal import Table, progress, warn, wide_console
from spool_sim.model import Model, load_model
from spool_sim.valve import Valve

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
    model, of_forces = load_model(request.base), request.kind != "accelerations"
    settings = GapSettings(
        request.gain_tolerance, request.delay_tolerance, least_share=request.least_share,
        thorough=request.thorough, profiles=request.profiles,
    )  # fmt: skip
    find = from_add_on("spool_rigs", "gap") if of_forces else partial(_of_accelerations, console)
    with progress("looking for the gap", 1.0, steady=False) as advance:
        result, valve, measured = find(request, selection, model, settings, Shares(advance).tell)
    # Files first: who reads only the first lines of what is shown (`| head`) has them all the same.
    made_from = sources([*request.records, *request.holdout], valve) if outputs.report else []
    written = _write(result, outputs, made_from, model, valve, measured)
    refused: InputError | None = None
    try:
        written += _write_model(result, outputs.model)
    except InputError as error:
        refused = error
    if of_forces:
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
    console: Console | None,
    request: GapRequest,
    selection: Selection,
    model: Model,
    settings: GapSettings,
    tell: Progress,
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
    result = analyse(fitted, described, model, holdout=others, settings=settings, progress=tell)
    result = replace(result, warnings=(*doubts, *result.warnings), determinations=determined)
    return doubted(result, check_records(described, fitted)), described, [*fitted, *others]


def _print_determined(found: Sequence[Determination], console: Console | None) -> None:
    for line in sentences(found):
        (console or wide_console(140)).print(line, markup=False, soft_wrap=True, highlight=False)


def _write(
    result: GapResult,
    outputs: ResultFiles,
    made_from: Sequence[tuple[str, str]],
    base: Model,
    valve: Valve | None,
    measured: Sequence[Any],
) -> list[str]:
    """Write the files that are wanted; return a line about each that people look for."""
    written = []
    if outputs.json is not None:
        write_json(outputs.json, report.result_to_dict(result))
    if outputs.report is not None:
        # Matplotlib is needed here only.
        from spool_report.evidence.collection import gap_exhibits  # noqa: PLC0415
        from spool_report.gap_page import gap_page  # noqa: PLC0415

        if result.kind == "accelerations" and valve is not None:
            evidence = gap_exhibits(result, base, valve, measured)
        else:
            evidence = from_add_on("spool_rigs", "exhibits")(measured, result.curves)
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
