"""Blind study of the gap workflow: how often the missing effect is named right."""

from __future__ import annotations

import json
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table
from spool_blind.case import BlindCase, make
from spool_blind.writing import truth_of, valve_text
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_sim.model import MODELS
from spool_sim.valve.description import Valve, valve_from_mapping
from spool_tools.console.outputs import write_json

from spool_evaluation.results.page import study_command
from spool_evaluation.results.timing import Stopwatch

from .gap_page import write_study
from .gap_summary import BlindVerdict, targets
from .workers import spread

BASE = "fluid"
REFUSED, FAILED = "refused", "failed"
#: Names of the channels' truth in the catalogue, where they differ.
CATALOGUE_NAMES = {"gain_error": "spool_gain_error", "delay": "spool_delay", "full_scale": "saturation_limit"}


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[BlindVerdict]:
    """Analyse ``cases`` blind cases from ``seed`` on; write rows, confusion matrix and page into ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    rows: list[BlindVerdict] = []
    with (out / "cases.jsonl").open("w") as file:
        for row in spread(judge_seed, range(seed, seed + cases), f"{cases} blind cases", workers):
            rows.append(row)
            file.write(json.dumps(row.to_dict()) + "\n")
            file.flush()
    rows.sort(key=lambda row: row.seed)
    write_json(out / "gap_study.json", summary(rows))
    page = write_study(rows, out, study_command("gap", cases, seed))
    show(rows)
    print(f"{page}: every number, what went wrong and how to make it again")
    return rows


def summary(rows: Sequence[BlindVerdict]) -> dict[str, Any]:
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
            for target in targets(rows)
        ],
        "rows": [row.to_dict() for row in rows],
    }


def show(rows: Sequence[BlindVerdict]) -> None:
    """Print the study's questions with their answers."""
    table = Table("question", "target", "found (95 % interval)", "met", box=None, pad_edge=False)
    for target in targets(rows):
        table.add_row(target.name, target.wanted, str(target.share), target.answer)
    Console(width=140).print(table)


def judge_seed(seed: int, hidden: str | None = None, factor: float | None = None) -> BlindVerdict:
    """Make the case of ``seed`` and return what the workflow says to it."""
    return judge(make(seed, hidden, factor=factor))


def judge(
    case: BlindCase, left_out: frozenset[str] = frozenset(), *, least_share: float | None = None
) -> BlindVerdict:
    """Return what the workflow, without the stages ``left_out``, says to ``case``.

    ``least_share``: of the spool's acceleration, that a name must be worth; ``None`` takes the default.

    A crash is a row too, and counts as wrong.
    """
    from spool_gap.report.serialisation import result_to_dict  # noqa: PLC0415
    from spool_gap.result import GapSettings  # noqa: PLC0415
    from spool_gap.workflow.analyse import analyse  # noqa: PLC0415 - counting needs none of its kernels

    record, valve = given(case)
    settings = GapSettings(left_out=left_out)
    if least_share is not None:
        settings = replace(settings, least_share=least_share)
    watch = Stopwatch()
    try:
        found = analyse([record], valve, MODELS[BASE], settings=settings)
        result = result_to_dict(found) | {"changed_by": sorted({change.stage for change in found.trace})}
    except InputError as error:
        return row_of(case, {"verdict": REFUSED}, watch.read(), str(error))
    except Exception:  # one crash must not end the study; its last lines are kept
        text = traceback.format_exc().strip().splitlines()
        return row_of(case, {"verdict": FAILED}, watch.read(), " ".join(text[-3:]))
    return row_of(case, result, watch.read())


def given(case: BlindCase) -> tuple[Record, Valve]:
    """Return what the workflow gets to see: the record and the valve's description."""
    valve = valve_from_mapping(yaml.safe_load(valve_text(case)), f"case {case.seed}")
    period = 1.0 / case.condition.sample_rate
    return Record(f"case {case.seed}", 0, period, case.body, case.spool), valve


def row_of(
    case: BlindCase, result: dict[str, Any], seconds: tuple[float, float], message: str = ""
) -> BlindVerdict:
    """Return the row of ``case`` with ``result``, the workflow's own JSON."""
    truth = truth_of(case)
    wanted = {
        f"{effect}.{CATALOGUE_NAMES.get(name, name)}": value
        for effect, values in truth["effects"].items()
        for name, value in values.items()
    }
    found = {
        f"{effect['id']}.{name}": entry["value"]
        for effect in result.get("effects", [])
        for name, entry in effect["parameters"].items()
        if entry["value"] is not None
    }
    gap = result.get("gap", {})
    visible = case.visibility
    condition = case.condition
    return BlindVerdict(
        seed=case.seed,
        kind=case.kind,
        hidden=case.hidden,
        accepted=case.accepted,
        factor=case.factor,
        verdict=result["verdict"],
        candidates=tuple(result.get("candidates") or ()),
        confidence=result.get("confidence"),
        truth=wanted,
        found=found,
        before=gap.get("before", {}).get("nrmse"),
        after=gap.get("after", {}).get("nrmse"),
        floor=gap.get("noise_floor"),
        seconds=seconds[0],
        processor_seconds=seconds[1],
        visible=None if visible is None else visible.over_noise,
        evidence=None if visible is None else visible.evidence,
        threshold=None if visible is None else case.threshold,
        condition=(
            f"{condition.excitation.kind} {condition.amplitude:.3g} m/s², "
            f"{condition.nominal_stiffness:.0f} N/m, c {case.plant['damping']:.2g}, "
            f"{condition.sample_rate:.0f} Hz, {condition.duration:.0f} s, "
            f"noise {100.0 * condition.noise_share:.2g} %, gain {condition.gain:.3f}, "
            f"delay {1e3 * condition.delay:+.2f} ms"
        ),
        message=message,
        changed_by=tuple(result.get("changed_by", ())),
    )
