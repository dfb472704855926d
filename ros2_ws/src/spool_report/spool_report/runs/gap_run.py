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


@dataclass(frozen=True, slots=True)
class FoundGap:
    """Result of an analysis, its base, the valve if one is described, and all stretches of the records."""

    result: GapResult
    base: Model
    valve: Valve | None
    measured: Sequence[Any]


def run_gap(request: GapRequest, selection: Selection, outputs: ResultFiles) -> int:
    """Find what the base lacks in the records and show it; return 0, whatever the verdict.

    Raises:
        InputError: records, valve or model cannot be used, or, after all else, the model cannot be saved.
    """
    found = find_gap(request, selection, print_determined)
    # Files first: who reads only the first lines of what is shown (`| head`) has them all the same.
    written = []
    if outputs.json is not None:
        write_json(outputs.json, report.result_to_dict(found.result))
    if outputs.report is not None:
        made_from = sources([*request.records, *request.holdout], found.valve)
        write_file(outputs.report, page_of(found, made_from), "--report")
        written.append(f"{outputs.report}: the report")
    refused: InputError | None = None
    try:
        if outputs.model is not None:
            save_found(outputs.model, found.result)
            written.append(f"{outputs.model}: model with the named effects")
    except InputError as error:
        refused = error
    if found.result.kind != "accelerations":
        print_determined(found.result.determinations)
    for warning in found.result.warnings:
        warn(warning)
    show(found.result, wide_console(140))
    for line in written:
        print(line)
    if refused is not None:
        raise refused
    return 0


def find_gap(
    request: GapRequest,
    selection: Selection,
    tell: Callable[[Sequence[Determination]], None] = lambda _determined: None,
) -> FoundGap:
    """Return what the base lacks in the records.

    ``tell`` takes what records of accelerometers determine, before the search; for records of forces that
    follows from the result.

    Raises:
        InputError: records, valve or model cannot be used.
    """
    model = load_model(request.base)
    settings = GapSettings(
        request.gain_tolerance, request.delay_tolerance, least_share=request.least_share,
        thorough=request.thorough, profiles=request.profiles,
    )  # fmt: skip
    of_accelerations = request.kind == "accelerations"
    find = partial(_of_accelerations, tell) if of_accelerations else from_add_on("spool_rigs", "gap")
    with progress("looking for the gap", 1.0, steady=False) as advance:
        result, valve, measured = find(request, selection, model, settings, Shares(advance).tell)
    return FoundGap(result, model, valve, measured)


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
    tell: Callable[[Sequence[Determination]], None],
    request: GapRequest,
    selection: Selection,
    model: Model,
    settings: GapSettings,
    advance: Progress,
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
    tell(determined)
    result = analyse(fitted, described, model, holdout=others, settings=settings, progress=advance)
    result = replace(result, warnings=(*doubts, *result.warnings), determinations=determined)
    return doubted(result, check_records(described, fitted)), described, [*fitted, *others]


def print_determined(found: Sequence[Determination], console: Console | None = None) -> None:
    """Print what records determine, by default on standard output."""
    for line in sentences(found):
        (console or wide_console(140)).print(line, markup=False, soft_wrap=True, highlight=False)


def page_of(found: FoundGap, made_from: Sequence[tuple[str, str]]) -> str:
    """Return the page with pictures and tables; ``made_from``: :func:`spool_report.outputs.sources`."""
    # Matplotlib is needed here only.
    from spool_report.evidence.collection import gap_exhibits  # noqa: PLC0415
    from spool_report.gap_page import gap_page  # noqa: PLC0415

    if found.result.kind == "accelerations" and found.valve is not None:
        evidence = gap_exhibits(found.result, found.base, found.valve, found.measured)
    else:
        evidence = from_add_on("spool_rigs", "exhibits")(found.measured, found.result.curves)
    return gap_page(found.result, made_from, evidence)


def save_found(path: Path, result: GapResult) -> None:
    """Write the base with what was found as a model file.

    Raises:
        InputError: the file cannot be written, or a reader would refuse it.
    """
    found = f"{result.base_model} with the findings of the gap analysis of {result.record}: {result.verdict}"
    name = f"{result.model.name[:LONGEST_NAME]}_gap"
    correlated = (result.correlated, result.correlation)
    save_model(path, result.model, name, result.model.values, result.parameters, found, correlated)


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
