"""Blind study of the gap workflow: how often the missing effect is named right."""

from __future__ import annotations

import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import numpy as np
import yaml
from matplotlib.figure import Figure
from spool_blind.case import BlindCase, HiddenCase, make, valve_text
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_sim.model import MODELS
from spool_sim.valve import Valve, valve_from_mapping

from spool_evaluation.results.page import (
    TARGET_HEAD,
    Proportion,
    Target,
    markdown_table,
    renew_json,
    save_picture,
    show_targets,
    study_command,
    target_rows,
    write_page,
)
from spool_evaluation.results.timing import Stopwatch
from spool_evaluation.studies.workers import resumed

BASE = "fluid"
REFUSED, FAILED = "refused", "failed"
#: Names of the channels' truth in the catalogue, where they differ.
CATALOGUE_NAMES = {"gain_error": "spool_gain_error", "delay": "spool_delay", "full_scale": "saturation_limit"}

#: Share of the true value within which a fitted parameter counts as recovered.
RECOVERED = 0.10
#: The gap that is left counts as closed up to this many times the noise floor.
CLOSED = 1.3

PAGE, PICTURE = "gap_study.md", "gap_confusion.png"
TITLE = "Blind study of the gap workflow"
#: What the tables count, for a reader who comes from elsewhere.
ABOUT = (
    "Records of a [second simulator](../../research/spool_blind/README.md) that shares no law and no step "
    "with the one that ships. They are sampled at the instants, without the low-pass of a logger. What the "
    "figures mean, and what falls short: [how often it is right](../methods/gap.md#how-often-it-is-right)."
)


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[BlindVerdict]:
    """Analyse ``cases`` blind cases from ``seed`` on; write rows, confusion matrix and page into ``out``.

    What the rows in ``out`` hold already is not analysed again.
    """
    seeds = range(seed, seed + cases)
    done = resumed(
        out / "cases.jsonl", BlindVerdict, lambda row: row.seed, judge_seed, seeds, "blind cases", workers
    )
    rows = sorted(done, key=lambda row: row.seed)
    renew_json(out / "gap_study.json", summary(rows, targets(rows)))
    page = write_study(rows, out, study_command("gap", cases, seed))
    show_targets(targets(rows))
    print(f"{page}: every number, what went wrong and how to make it again")
    return rows


def summary(rows: Sequence[CaseVerdict], targets: Sequence[Target]) -> dict[str, Any]:
    """Return everything a study found, for JSON."""
    return {"cases": len(rows), "targets": [target.to_dict() for target in targets], "rows": rows}


def judge_seed(seed: int, hidden: str | None = None, factor: float | None = None) -> BlindVerdict:
    """Make the case of ``seed`` and return what the workflow says to it."""
    return judge(make(seed, hidden, factor=factor))


def judge(case: BlindCase, *, least_share: float | None = None) -> BlindVerdict:
    """Return what the workflow says to ``case``.

    ``least_share``: of the spool's acceleration, that a name must be worth; ``None`` takes the default.

    A crash is a row too, and counts as wrong.
    """
    from spool_gap.evidence.analyse import analyse  # noqa: PLC0415 - counting needs none of its kernels
    from spool_gap.report import result_to_dict  # noqa: PLC0415
    from spool_gap.result import GapSettings  # noqa: PLC0415

    record, valve = given(case)
    settings = GapSettings() if least_share is None else GapSettings(least_share=least_share)
    return row_of(
        case, *answered(lambda: result_to_dict(analyse([record], valve, MODELS[BASE], settings=settings)))
    )


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


def given(case: HiddenCase) -> tuple[Record, Valve]:
    """Return what the workflow gets to see: the record and the valve's description."""
    valve = valve_from_mapping(yaml.safe_load(valve_text(case)), f"case {case.seed}")
    period = 1.0 / case.condition.sample_rate
    return Record(f"case {case.seed}", 0, period, case.body, case.spool), valve


def row_of(
    case: BlindCase, result: dict[str, Any], seconds: tuple[float, float], message: str = ""
) -> BlindVerdict:
    """Return the row of ``case`` with ``result``, the workflow's own JSON."""
    visible = case.visibility
    condition = case.condition
    return BlindVerdict(
        **common_fields(case, result, seconds, message),
        factor=case.factor,
        visible=None if visible is None else visible.over_noise,
        evidence=None if visible is None else visible.evidence,
        threshold=None if visible is None else case.threshold,
        condition=f"{condition_text(case)}, gain {condition.gain:.3f}, delay {1e3 * condition.delay:+.2f} ms",
    )


def common_fields(
    case: HiddenCase, result: dict[str, Any], seconds: tuple[float, float], message: str
) -> dict[str, Any]:
    """Return the fields of a ``CaseVerdict`` but its condition; arguments as of ``row_of``."""
    gap = result.get("gap", {})
    return {
        "seed": case.seed,
        "kind": case.kind,
        "hidden": case.hidden,
        "accepted": case.accepted,
        "verdict": result["verdict"],
        "candidates": tuple(result.get("candidates") or ()),
        "confidence": result.get("confidence"),
        "truth": by_parameter(case.truth),
        "found": {
            f"{effect['id']}.{name}": (entry["value"], entry.get("std"))
            for effect in result.get("effects", [])
            for name, entry in effect["parameters"].items()
            if entry["value"] is not None
        },
        "before": gap.get("before", {}).get("nrmse"),
        "after": gap.get("after", {}).get("nrmse"),
        "floor": gap.get("noise_floor"),
        "seconds": seconds[0],
        "processor_seconds": seconds[1],
        "message": message,
    }


def by_parameter(truth: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return true values by "effect.parameter", in the names of the catalogue."""
    return {
        f"{effect}.{CATALOGUE_NAMES.get(name, name)}": value
        for effect, values in truth.items()
        for name, value in values.items()
    }


def condition_text(case: HiddenCase) -> str:
    """Return excitation, spring, rate and noise of a case, for looking up."""
    condition = case.condition
    return (
        f"{condition.excitation.kind} {condition.amplitude:.3g} m/s², "
        f"{condition.nominal_stiffness:.0f} N/m, c {case.plant['damping']:.2g}, "
        f"{condition.sample_rate:.0f} Hz, {condition.duration:.0f} s, "
        f"noise {100.0 * condition.noise_share:.2g} %"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseVerdict:
    """Verdict of the workflow on a case, with its truth.

    Attributes:
        seed, kind, hidden, accepted: of the case; see :mod:`spool_blind.case`.
        verdict: the verdict given; "refused" where the record was refused, "failed" where no verdict came.
        candidates: the class that was named together with "unexplained".
        confidence: 0 to 1.
        truth: values of the parameters by "effect.parameter"; SI.
        found: the fitted ones with their standard deviations, ``None`` where that is not known.
        before, after, floor: held-out gap and noise floor, rms over rms; ``None`` where unknown.
        seconds: taken by the workflow.
        processor_seconds: of them spent computing, which other work on the machine does not change.
        condition: excitation, spring, rate and so on, for looking up.
        message: why it was refused.
    """

    seed: int
    kind: str
    hidden: str
    accepted: tuple[str, ...]
    verdict: str
    candidates: tuple[str, ...] = ()
    confidence: float | None = None
    truth: dict[str, float] = field(default_factory=dict)
    found: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    before: float | None = None
    after: float | None = None
    floor: float | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0
    condition: str = ""
    message: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindVerdict(CaseVerdict):
    """Verdict of the workflow on one blind case, with its truth.

    Attributes:
        factor: size of what is hidden over the size that was drawn.
        visible: remainder after the base over the noise floor; ``None`` where nothing is hidden.
        evidence, threshold: of the likelihood-ratio test that knows what is hidden.
    """

    JSON_PROPERTIES: ClassVar = ("right", "errors")

    factor: float
    visible: float | None = None
    evidence: float | None = None
    threshold: float | None = None

    @property
    def right(self) -> bool:
        """Whether the verdict is one of those accepted; out of the catalogue a part may be unexplained."""
        said = frozenset(self.verdict.split("+"))
        if self.kind == "out_of_catalogue":
            return "unexplained" in said
        return any(said == frozenset(one.split("+")) for one in self.accepted)

    @property
    def errors(self) -> dict[str, float]:
        """Relative errors of the parameters that are known and were found."""
        return {
            name: self.found[name][0] / true - 1.0
            for name, true in self.truth.items()
            if name in self.found and true != 0.0
        }


def share_of(rows: Sequence[BlindVerdict], right: Callable[[BlindVerdict], bool]) -> Proportion:
    """Return how many of ``rows`` are ``right``."""
    return Proportion(sum(right(row) for row in rows), len(rows))


def targets(rows: Sequence[BlindVerdict]) -> list[Target]:
    """Return the study's questions with their answers."""

    def of(kind: str) -> list[BlindVerdict]:
        return [row for row in rows if row.kind == kind]

    named = [row for row in rows if row.kind in ("effect", "pair") and row.right]
    errors = [error for row in named for error in row.errors.values()]
    judged = [row for row in rows if row.right and row.kind != "out_of_catalogue" and row.after and row.floor]
    wrong = share_of(of("none"), lambda row: not row.right)
    single, pairs = share_of(of("effect"), lambda row: row.right), share_of(of("pair"), lambda row: row.right)
    outsiders = share_of(of("out_of_catalogue"), lambda row: row.right)
    recovered = Proportion(sum(abs(error) <= RECOVERED for error in errors), len(errors))
    closed = share_of(judged, lambda row: (row.after or 0.0) <= CLOSED * (row.floor or 0.0))
    return [
        Target("one effect, named right", "at least 98 %", single, (single.value or 0.0) >= 0.98),
        Target("nothing hidden, a false name", "at most 1 %", wrong, (wrong.value or 0.0) <= 0.01),
        Target(
            "two effects, both named and nothing else", "at least 95 %", pairs, (pairs.value or 0.0) >= 0.95
        ),
        Target(
            "out-of-catalogue effects not given a name alone",
            "at least 80 %",
            outsiders,
            (outsiders.value or 0.0) >= 0.80,
        ),
        Target("parameters within 10 %", "all", recovered, recovered.count == recovered.of),
        Target("gap after at most 1.3 times the floor", "all", closed, closed.count == closed.of),
    ]


def confusion(
    rows: Sequence[BlindVerdict],
) -> tuple[list[str], list[str], np.ndarray[Any, np.dtype[np.int64]]]:
    """Return (hidden, verdicts, counts) of cases with one thing hidden or none; pairs as "pair"."""

    def hidden_of(row: BlindVerdict) -> str:
        return "pair" if row.kind == "pair" else row.hidden

    def verdict_of(row: BlindVerdict) -> str:
        said = row.verdict.split("+")
        if row.kind == "pair":
            return (
                "right pair"
                if row.right
                else "part of it"
                if set(said) < set(row.hidden.split("+"))
                else "other"
            )
        if len(said) == 1:
            return row.verdict
        return "unexplained" if row.kind == "out_of_catalogue" and row.right else "more than one"

    order = {"none": 0, "effect": 1, "pair": 2, "out_of_catalogue": 3}
    names = sorted({(order[row.kind], hidden_of(row)) for row in rows})
    hidden = [name for _, name in names]
    last = ("more than one", "unexplained", "right pair", "part of it", "other", "refused", "failed")
    said = {verdict_of(row) for row in rows}
    verdicts = [name for name in hidden if name in said and name not in last]
    verdicts += sorted(said - set(verdicts) - set(last)) + [name for name in last if name in said]
    counts = np.zeros((len(hidden), len(verdicts)), dtype=np.int64)
    for (name, verdict), count in Counter((hidden_of(row), verdict_of(row)) for row in rows).items():
        counts[hidden.index(name), verdicts.index(verdict)] = count
    return hidden, verdicts, counts


def write_study(rows: Sequence[BlindVerdict], folder: Path, command: str) -> Path:
    """Write ``gap_study.md`` and its picture into ``folder``; return the page."""
    save_picture(confusion_figure(rows), folder / PICTURE, dpi=150)
    return write_page(folder / PAGE, TITLE, command, page_parts(rows))


def page_parts(rows: Sequence[BlindVerdict]) -> list[str]:
    """Return the page's paragraphs and tables, Markdown."""
    return [
        ABOUT,
        times_line(rows),
        markdown_table(TARGET_HEAD, target_rows(targets(rows))),
        f"![confusion matrix]({PICTURE})",
        "## By what was hidden",
        _by_hidden(rows),
        "## Parameters",
        _by_parameter(rows),
        "## What went wrong",
        _failures(rows),
    ]


def times_line(rows: Sequence[CaseVerdict]) -> str:
    """Return how many cases there are and how long they took."""
    times, computing = zip(*((row.seconds, row.processor_seconds) for row in rows), strict=True)
    return (
        f"{len(rows)} cases. A case: median {median(times):.1f} s ({median(computing):.1f} s of computing), "
        f"longest {max(times):.1f} s."
    )


def confusion_figure(rows: Sequence[BlindVerdict]) -> Figure:
    """Return the confusion matrix: rows are the hidden effects, columns the verdicts."""
    hidden, verdicts, counts = confusion(rows)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    size = (2.8 + 0.42 * len(verdicts), 1.8 + 0.3 * len(hidden))
    figure = Figure(figsize=size, layout="constrained")
    axis = figure.subplots()
    axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            colour = "white" if shares[row, column] > 0.6 else "black"
            axis.text(column, row, str(count), ha="center", va="center", fontsize=8, color=colour)
    axis.set_xticks(range(len(verdicts)), verdicts, rotation=60, ha="right", fontsize=8)
    axis.set_yticks(range(len(hidden)), hidden, fontsize=8)
    axis.set_xlabel("said")
    axis.set_ylabel("hidden")
    return figure


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.2g}"


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None


def _by_hidden(rows: Sequence[BlindVerdict]) -> str:
    body = []
    hidden, _, _ = confusion(rows)
    for name in hidden:
        these = [row for row in rows if name in (row.hidden, row.kind)]
        visible = _median([row.visible for row in these])
        body.append((
            name,
            str(share_of(these, lambda row: row.right)),
            _percent(_median([row.before for row in these])),
            _percent(_median([row.after for row in these])),
            _percent(_median([row.floor for row in these])),
            "" if visible is None else f"{visible:.1f}",
        ))  # fmt: skip
    head = ("hidden", "right", "gap before, %", "after, %", "noise floor, %", "hidden over noise, rms")
    return markdown_table(head, body)


def _by_parameter(rows: Sequence[BlindVerdict]) -> str:
    errors: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        if row.right and row.kind == "effect":
            for name, error in row.errors.items():
                errors[name].append(error)
    body = []
    for name, found in sorted(errors.items()):
        sizes = [abs(error) for error in found]
        body.append((
            name,
            str(len(found)),
            f"{100.0 * median(found):+.1f}",
            f"{100.0 * median(sizes):.1f}",
            f"{100.0 * max(sizes):.1f}",
            f"{sum(size <= RECOVERED for size in sizes)}/{len(sizes)}",
        ))  # fmt: skip
    head = ("parameter", "cases", "median error, %", "median size, %", "largest, %", "within 10 %")
    return markdown_table(head, body)


def _failures(rows: Sequence[BlindVerdict]) -> str:
    body = [
        (
            str(row.seed),
            row.hidden,
            row.verdict + (f": {row.message}" if row.message else ""),
            "" if row.confidence is None else f"{row.confidence:.2f}",
            ", ".join(_percent(value) for value in (row.before, row.after, row.floor)),
            "" if row.visible is None else f"{row.visible:.1f}",
            row.condition,
        )
        for row in sorted(rows, key=lambda row: row.seed)
        if not row.right
    ]
    gap = "gap before, after, noise floor, %"
    head = ("seed", "hidden", "verdict", "confidence", gap, "hidden over noise", "condition")
    return markdown_table(head, body) if body else "Nothing."
