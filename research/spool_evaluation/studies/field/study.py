"""Field study of the gap workflow: what it says to records of real measuring chains."""

from __future__ import annotations

import json
import signal
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_blind.field.case import FieldCase, make_field
from spool_blind.field.writing import write_field
from spool_core.errors import InputError
from spool_sim.model import MODELS

from spool_evaluation.results.page import renew_json, study_command
from spool_evaluation.results.timing import Stopwatch
from spool_evaluation.studies.gap import BASE, CATALOGUE_NAMES
from spool_evaluation.studies.workers import spread

from .calibration import confidence_rule
from .diagnosis import diagnose
from .page import write_field_page
from .summary import FAILED, REFUSED, ChainFault, FieldVerdict, HiddenShare, field_targets, verdict_from

ROWS, RESULT = "field_cases.jsonl", "field_study.json"
#: Rule of the confidences, fitted where all seeds are of the calibration window; `spool_gap.report` ships it.
RULE, CALIBRATION = "confidence_rule.json", "calibration"
#: s of computing after which a case counts as one without a word: five times what the workflow may take.
LONGEST = 600.0


def run(
    cases: int, seed: int, out: Path, workers: int | None = None, *, diagnosing: bool = False
) -> list[FieldVerdict]:
    """Analyse ``cases`` field cases from ``seed`` on; write rows, page and diagram into ``out``.

    What the rows in ``out`` hold already is not analysed again. With ``diagnosing`` a second page states why
    each wrong verdict is wrong.
    """
    out.mkdir(parents=True, exist_ok=True)
    seeds = range(seed, seed + cases)
    found = {row.seed: row for row in kept(out / ROWS) if row.seed in seeds}
    missing = [number for number in seeds if number not in found]
    with (out / ROWS).open("a") as file:
        for row in spread(judge_field_seed, missing, f"{len(missing)} field cases", workers):
            found[row.seed] = row
            file.write(json.dumps(row.to_dict()) + "\n")
            file.flush()
    rows = [found[number] for number in seeds]
    renew_json(out / RESULT, field_result(rows))
    if {row.window for row in rows} == {CALIBRATION}:
        renew_json(out / RULE, confidence_rule(rows, study_command("field", cases, seed)))
    page = write_field_page(rows, out, study_command("field", cases, seed))
    _show(rows)
    print(f"{page}: every number, what went wrong and how to make it again")
    if diagnosing:
        diagnose(rows, out, f"{study_command('field', cases, seed)} --diagnose", workers)
    return rows


def kept(path: Path) -> list[FieldVerdict]:
    """Return the rows that ``path`` holds; a last line that was cut off is left out."""
    if not path.exists():
        return []
    lines = [line for line in path.read_text().splitlines() if line.endswith("}")]
    return [verdict_from(json.loads(line)) for line in lines]


def field_result(rows: Sequence[FieldVerdict]) -> dict[str, Any]:
    """Return everything the study found, for JSON."""
    return {
        "cases": len(rows),
        "targets": [
            {
                "name": target.name,
                "wanted": target.wanted,
                "count": target.share.count,
                "of": target.share.of,
                "interval": list(target.share.interval),
                "met": target.met if target.share.of else None,
            }
            for target in field_targets(rows)
        ],
        "rows": [row.to_dict() for row in rows],
    }


def _show(rows: Sequence[FieldVerdict]) -> None:
    table = Table("question", "target", "found (95 % interval)", "met", box=None, pad_edge=False)
    for target in field_targets(rows):
        table.add_row(target.name, target.wanted, str(target.share), target.answer)
    Console(width=140).print(table)


def judge_field_seed(seed: int) -> FieldVerdict:
    """Make the field case of ``seed`` and return what the workflow says to it."""
    return judge_field(make_field(seed))


def judge_field(case: FieldCase) -> FieldVerdict:
    """Return what the workflow says to the files of ``case``, as `./spool gap` reads them.

    A crash is a row too, and so is a case that takes longer than ``LONGEST``.
    """
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        record, valve = write_field(case, Path(folder))
        watch = Stopwatch()
        try:
            with _at_most(LONGEST):
                result = analysed(record, valve)
        except InputError as error:
            return field_row(case, {"verdict": REFUSED}, watch.read(), str(error).replace(f"{record}: ", ""))
        except Exception:  # one crash must not end the study; its last lines are kept
            text = traceback.format_exc().strip().splitlines()
            return field_row(case, {"verdict": FAILED}, watch.read(), " ".join(text[-3:]))
    return field_row(case, result, watch.read())


def analysed(record: Path, valve: Path) -> dict[str, Any]:
    """Return the result of the gap workflow on a record and a valve file, types of JSON.

    Raises:
        InputError: the record is refused.
    """
    from spool_estimator.identification.record import LARGEST  # noqa: PLC0415
    from spool_estimator.plausibility import check_records  # noqa: PLC0415 - counting needs none of its kernels
    from spool_gap.report.serialisation import result_to_dict  # noqa: PLC0415
    from spool_gap.workflow.analyse import analyse  # noqa: PLC0415
    from spool_tools.input.record_loading import Selection, load_recordings, stretches_of  # noqa: PLC0415
    from spool_tools.operations.gap_run import doubted  # noqa: PLC0415

    recordings, described = load_recordings([record], str(valve), Selection(longest=LARGEST))
    stretches = stretches_of(recordings)
    result = doubted(analyse(stretches, described, MODELS[BASE]), check_records(described, stretches))
    nuisances = [
        {"id": one.id, "channel": one.channel, "size": one.size, "unit": one.unit}
        for one in getattr(result, "nuisances", ())
    ]
    return {**result_to_dict(result), "nuisances": nuisances}


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


def field_row(
    case: FieldCase, result: dict[str, Any], seconds: tuple[float, float], message: str = ""
) -> FieldVerdict:
    """Return the row of ``case`` with ``result``, the workflow's own JSON."""
    gap = result.get("gap", {})
    condition = case.condition
    return FieldVerdict(
        seed=case.seed,
        window=case.window,
        kind=case.kind,
        hidden=case.hidden,
        accepted=case.accepted,
        importance={
            name: HiddenShare(one.with_without, one.share, one.evidence / one.threshold, bool(one.matters))
            for name, one in case.importance.items()
        },
        nuisances=tuple(ChainFault(one.id, one.channel, one.size, one.unit) for one in case.nuisances),
        verdict=result["verdict"],
        told=tuple(
            ChainFault(one["id"], one["channel"], one["size"], one["unit"])
            for one in result.get("nuisances", [])
        ),
        candidates=tuple(result.get("candidates") or ()),
        confidence=result.get("confidence"),
        truth={
            f"{effect}.{CATALOGUE_NAMES.get(name, name)}": value
            for effect, values in case.truth.items()
            for name, value in values.items()
        },
        found={
            f"{effect['id']}.{name}": (entry["value"], entry["std"])
            for effect in result.get("effects", [])
            for name, entry in effect["parameters"].items()
            if entry["value"] is not None
        },
        before=gap.get("before", {}).get("nrmse"),
        after=gap.get("after", {}).get("nrmse"),
        floor=gap.get("noise_floor"),
        seconds=seconds[0],
        processor_seconds=seconds[1],
        condition=(
            f"{condition.excitation.kind} {condition.amplitude:.3g} m/s², "
            f"{condition.nominal_stiffness:.0f} N/m, c {case.plant['damping']:.2g}, "
            f"{condition.sample_rate:.0f} Hz, {condition.duration:.0f} s, "
            f"noise {100.0 * condition.noise_share:.2g} %, size {case.factor:.2g}"
        ),
        message=message,
        signs=result.get("confidence_from", {}),
    )
