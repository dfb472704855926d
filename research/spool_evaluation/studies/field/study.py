"""Field study of the gap workflow: what it says to records of real measuring chains."""

from __future__ import annotations

import signal
import tempfile
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from spool_blind.field.case import FieldCase, make_field
from spool_blind.field.logged import LOGGED, make_logged
from spool_blind.files import write
from spool_core.errors import InputError
from spool_gap.evidence.analyse import Run
from spool_sim.model import MODELS

from spool_evaluation.results.page import (
    Proportion,
    markdown_table,
    renew_json,
    save_picture,
    study_command,
    target_table,
    write_page,
)
from spool_evaluation.results.timing import Stopwatch
from spool_evaluation.studies.field.instrument import diagnosed, diagnosis_page, stretches_as_told
from spool_evaluation.studies.field.verdicts import (
    ENOUGH,
    FAILED,
    OUTCOMES,
    QUESTIONS,
    REFUSED,
    RIGHT,
    UNIMPORTANT,
    ChainFault,
    FieldVerdict,
    brier_scores,
    by_nuisance,
    by_parameter,
    counted,
    deciles,
    field_targets,
    reliability_figure,
    told_of,
)
from spool_evaluation.studies.workers import resumed

BASE = "fluid"
ROWS, DIAGNOSED, RESULT = "field_cases.jsonl", "field_cases_diagnosed.jsonl", "field_study.json"
#: s of computing after which a case counts as one without a word: five times what the workflow may take.
LONGEST = 600.0

PAGE, PICTURE = "field_study.md", "field_reliability.png"
TITLE = "Field study of the gap workflow"
#: What the tables count, for a reader who comes from elsewhere.
ABOUT = (
    "Records of a [second simulator](../../research/spool_blind/README.md#field-cases) behind a measuring "
    "chain with the faults of real ones, drawn without looking whether anything can be seen. Each channel "
    "is sampled behind a logger's low-pass: linear phase in 50 % of all records, causal in 30 %, the mean "
    "of a sample in 10 %, none in 10 %; in a quarter of those with a filter the channels' filters differ. "
    "*Right* is the whole verdict; *over-cautious*: the names are right, and something is called "
    "unexplained besides; *false*: a name of what is not there; *missed*: names are missing, none is "
    "false. A name is demanded where an effect changes the spool's acceleration by more than 0.25 % (rms, "
    "the base refitted) and a test that knows it sees it in the noise of that record. Intervals are 95 %, "
    "Wilson's."
)
NOT_REPORTED = (
    "These seeds are of the window **{window}**: choices may be made on such records. Errors to report are "
    "those of the window *report*, which no choice has seen."
)
REPORTED = "These seeds are of the window **report**, which no choice has seen."


def run(
    cases: int, seed: int, out: Path, workers: int | None = None, *, diagnosing: bool = False
) -> list[FieldVerdict]:
    """Analyse ``cases`` field cases from ``seed`` on; write rows, page and diagram into ``out``.

    What the rows in ``out`` hold already is not analysed again. With ``diagnosing`` a second page states why
    each wrong verdict is wrong, and the rows are kept in a separate file.
    """
    seeds = range(seed, seed + cases)
    work = partial(judge_field_seed, diagnosing=diagnosing)
    path = out / (DIAGNOSED if diagnosing else ROWS)
    done = resumed(path, FieldVerdict, lambda row: row.seed, work, seeds, "field cases", workers)
    rows = sorted(done, key=lambda row: row.seed)
    targets = field_targets(rows)
    found = {"cases": len(rows), "targets": [target.to_dict() for target in targets], "rows": rows}
    renew_json(out / RESULT, found)
    command = study_command("field", cases, seed)
    page = write_field_page(rows, out, command)
    print(target_table(targets))
    print(f"{page}: every number, what went wrong and how to make it again")
    if diagnosing:
        diagnosis_page(rows, out, f"{command} --diagnose")
    return rows


def judge_field_seed(seed: int, *, diagnosing: bool = False) -> FieldVerdict:
    """Make the field case of ``seed``; return what the workflow says to it, and why it is wrong if asked."""
    make = make_logged if seed in LOGGED else make_field
    return judge_field(make(seed), diagnosing=diagnosing)


def judge_field(case: FieldCase, *, diagnosing: bool = False) -> FieldVerdict:
    """Return what the workflow says to the files of ``case``, as `./spool gap` reads them.

    A crash is a row too, and so is a case that takes longer than ``LONGEST``.
    """
    runs: list[Run] = []
    with tempfile.TemporaryDirectory() as folder:
        record, valve = write(case, Path(folder))

        def analysed_in_time() -> dict[str, Any]:
            with _at_most(LONGEST):
                return analysed(record, valve, runs)

        result, seconds, message = answered(analysed_in_time)
    row = field_row(case, result, seconds, message.replace(f"{record}: ", ""))
    if not diagnosing:
        return row
    return replace(row, diagnosis=diagnosed(case, row, runs[0] if runs else None))


def analysed(record: Path, valve: Path, runs: list[Run]) -> dict[str, Any]:
    """Return the result of the gap workflow on a record and a valve file, types of JSON.

    Its run, with everything that was fitted, is added to ``runs``.

    Raises:
        InputError: the record is refused.
    """
    from spool_estimator.plausibility import check_records  # noqa: PLC0415 - counting needs none of its kernels
    from spool_gap.evidence.analyse import searched  # noqa: PLC0415
    from spool_gap.report import result_to_dict  # noqa: PLC0415
    from spool_report.runs.gap_run import doubted  # noqa: PLC0415

    stretches, described = stretches_as_told(record, valve)
    run = searched(stretches, described, MODELS[BASE])
    runs.append(run)
    return result_to_dict(doubted(run.concluded(), check_records(described, stretches)))


def answered(work: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any], tuple[float, float], str]:
    """Return what the workflow says, the time it took (see ``Stopwatch.read``), and why it says nothing.

    One crash must not end a study: its last lines are kept.
    """
    watch = Stopwatch()
    try:
        return work(), watch.read(), ""
    except InputError as error:
        return {"verdict": REFUSED}, watch.read(), str(error)
    except Exception:
        text = traceback.format_exc().strip().splitlines()
        return {"verdict": FAILED}, watch.read(), " ".join(text[-3:])


def field_row(
    case: FieldCase, result: dict[str, Any], seconds: tuple[float, float], message: str = ""
) -> FieldVerdict:
    """Return the row of ``case`` with ``result``, the workflow's own JSON."""
    gap = result.get("gap", {})
    condition = case.condition
    return FieldVerdict(
        seed=case.seed,
        kind=case.kind,
        hidden=case.hidden,
        accepted=case.accepted,
        verdict=result["verdict"],
        candidates=tuple(result.get("candidates") or ()),
        confidence=result.get("confidence"),
        truth=by_parameter(case.truth),
        found={
            f"{effect['id']}.{name}": (entry["value"], entry.get("std"))
            for effect in result.get("effects", [])
            for name, entry in effect["parameters"].items()
            if entry["value"] is not None
        },
        before=gap.get("before", {}).get("nrmse"),
        after=gap.get("after", {}).get("nrmse"),
        floor=gap.get("noise_floor"),
        seconds=seconds[0],
        processor_seconds=seconds[1],
        message=message,
        window=case.window,
        importance=dict(case.importance),
        nuisances=tuple(ChainFault(one.id, one.channel, one.size, one.unit) for one in case.nuisances),
        told=tuple(
            ChainFault(one["id"], one["channel"], one["size"], one["unit"])
            for one in result.get("nuisances", [])
        ),
        sampled=case.sampled,
        condition=(
            f"{condition.excitation.kind} {condition.amplitude:.3g} m/s², "
            f"{condition.nominal_stiffness:.0f} N/m, c {case.plant['damping']:.2g}, "
            f"{condition.sample_rate:.0f} Hz, {condition.duration:.0f} s, "
            f"noise {100.0 * condition.noise_share:.2g} %, size {case.factor:.2g}"
        ),
        explained=tuple(
            tuple(one["effects"])
            for one in result.get("explanations", [])
            if "unexplained" not in one["effects"]
        ),
        signs=result.get("confidence_from", {}),
    )


def write_field_page(rows: Sequence[FieldVerdict], folder: Path, command: str) -> Path:
    """Write ``field_study.md`` and its picture into ``folder``; return the page."""
    save_picture(reliability_figure(rows), folder / PICTURE, dpi=150)
    return write_page(folder / PAGE, TITLE, command, field_parts(rows))


def field_parts(rows: Sequence[FieldVerdict]) -> list[str]:
    """Return the page's paragraphs and tables, Markdown."""
    return [
        ABOUT,
        window_line(rows),
        _times(rows),
        target_table(field_targets(rows)),
        "## By what was asked",
        _outcomes("asked", {name: [row for row in rows if row.question == name] for name in QUESTIONS}),
        "## By what was hidden",
        _outcomes("hidden", {name: [row for row in rows if row.hidden == name] for name in _hidden(rows)}),
        "## By nuisance",
        _outcomes("nuisance", by_nuisance(rows)),
        "Told by the workflow:",
        _told(rows),
        "## Confidence",
        _deciles(rows),
        f"A decile of fewer than {ENOUGH} verdicts says little.",
        _brier(rows),
        f"![reliability diagram]({PICTURE})",
        "## Parameters",
        _parameters(rows),
        "## How large the hidden effects are",
        _importance(rows),
        "## What went wrong",
        _failures(rows),
    ]


def window_line(rows: Sequence[FieldVerdict]) -> str:
    """Return what the seeds may be used for."""
    windows = sorted({row.window for row in rows})
    return REPORTED if windows == ["report"] else NOT_REPORTED.format(window=" and ".join(windows))


def _times(rows: Sequence[FieldVerdict]) -> str:
    """Return how many cases there are and how long they took."""
    times, computing = zip(*((row.seconds, row.processor_seconds) for row in rows), strict=True)
    return (
        f"{len(rows)} cases. A case: median {median(times):.1f} s ({median(computing):.1f} s of computing), "
        f"longest {max(times):.1f} s."
    )


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Raise TimeoutError where what is inside computes longer; only in a process's main thread."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"no verdict within {seconds:g} s of computing")

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _hidden(rows: Sequence[FieldVerdict]) -> list[str]:
    """Return what was hidden: nothing, single effects, laws, pairs."""
    order = {"none": 0, "effect": 1, "out_of_catalogue": 2, "pair": 3}
    return [name for _, name in sorted({(order[row.kind], row.hidden) for row in rows})]


def _outcomes(head: str, groups: dict[str, list[FieldVerdict]]) -> str:
    body = []
    for name, these in groups.items():
        if these:
            counts = counted(these)
            others = [str(counts[outcome].count) for outcome in OUTCOMES[1:]]
            body.append((name, str(counts[RIGHT]), *others))
    return markdown_table((head, *OUTCOMES), body)


def _told(rows: Sequence[FieldVerdict]) -> str:
    names = sorted({one.id for row in rows for one in (*row.nuisances, *row.told)})
    body = [(name, *(str(share) for share in told_of(rows, name))) for name in names]
    return markdown_table(("nuisance", "told where it is", "told where it is not"), body)


def _deciles(rows: Sequence[FieldVerdict]) -> str:
    body = [
        (
            f"{one.low:.1f} to {one.low + 0.1:.1f}",
            f"{one.mean:.3f}",
            str(one.share),
            "yes" if one.agrees else "no",
        )
        for one in deciles(rows)
    ]
    return markdown_table(("confidence", "mean", "right (95 % interval)", "mean within"), body)


def _brier(rows: Sequence[FieldVerdict]) -> str:
    body = [
        (one.verdicts, str(one.count), f"{one.score:.3f}", f"{one.base_rate:.3f}")
        for one in brier_scores(rows)
    ]
    return markdown_table(("verdicts", "count", "Brier score", "always the base rate"), body)


def _parameters(rows: Sequence[FieldVerdict]) -> str:
    held: dict[str, list[bool]] = defaultdict(list)
    errors: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        for name, inside in row.within.items():
            held[name].append(inside)
            errors[name].append(abs(row.found[name][0] / row.truth[name] - 1.0))
    body = [
        (name, str(Proportion(sum(found), len(found))), f"{100.0 * median(errors[name]):.2g}")
        for name, found in sorted(held.items())
    ]
    return markdown_table(("parameter", "interval holds the truth", "median size of the error, %"), body)


def _importance(rows: Sequence[FieldVerdict]) -> str:
    names = sorted({name for row in rows for name in row.importance})
    body = []
    for name in names:
        these = [row.importance[name] for row in rows if name in row.importance]
        shares = sorted(one.share for one in these)
        body.append((
            name,
            str(len(these)),
            str(sum(one.matters for one in these)),
            f"{100.0 * median(one.with_without for one in these):.2g}",
            f"{100.0 * median(shares):.2g}",
            f"{100.0 * shares[0]:.2g} to {100.0 * shares[-1]:.2g}",
        ))  # fmt: skip
    head = ("effect", "cases", "of importance", "with and without, %", "base refitted, %", "from to, %")
    return markdown_table(head, body)


def _failures(rows: Sequence[FieldVerdict]) -> str:
    body = [
        (
            str(row.seed),
            row.hidden,
            row.outcome + (f" ({UNIMPORTANT})" if row.question == UNIMPORTANT else ""),
            row.verdict + (f": {row.message}" if row.message else ""),
            "" if row.confidence is None else f"{row.confidence:.2f}",
            ", ".join(
                "" if one is None else f"{100.0 * one:.2g}" for one in (row.before, row.after, row.floor)
            ),
            ", ".join(_fault(one) for one in row.nuisances),
            ", ".join(_fault(one) for one in row.told),
            row.condition,
        )
        for row in sorted(rows, key=lambda row: row.seed)
        if row.outcome != RIGHT
    ]
    gap = "gap before, after, noise floor, %"
    head = ("seed", "hidden", "outcome", "verdict", "confidence", gap, "nuisances", "told", "condition")
    return markdown_table(head, body) if body else "Nothing."


def _fault(one: ChainFault) -> str:
    size = "" if one.size is None else f" {one.size:.2g} {one.unit}"
    return f"{one.id} ({one.channel}{size})"
