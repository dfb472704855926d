"""The gap workflow over blind cases: how often the missing effect is named right."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table
from spool_blind.case import BlindCase, make
from spool_blind.writing import truth_of, valve_text
from spool_identification.record import Record
from spool_sim.model import MODELS
from spool_sim.valve.description import Valve, valve_from_mapping
from spool_stream.errors import InputError
from spool_tools.commands.bag_commands import write_json

from .gap_page import write_page
from .gap_summary import Row, targets
from .workers import spread

BASE = "fluid"
REFUSED, FAILED = "refused", "failed"
#: Names of the channels' truth in the catalogue, where they differ.
CATALOGUE_NAMES = {"gain_error": "spool_gain_error", "delay": "spool_delay", "full_scale": "saturation_limit"}


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[Row]:
    """Analyse ``cases`` blind cases from ``seed`` on; write rows, confusion matrix and page into ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    with (out / "cases.jsonl").open("w") as file:
        for row in spread(judge_seed, range(seed, seed + cases), f"{cases} blind cases", workers):
            rows.append(row)
            file.write(json.dumps(row.to_dict()) + "\n")
            file.flush()
    rows.sort(key=lambda row: row.seed)
    write_json(out / "confusion.json", summary(rows))
    page = write_page(rows, out, f"./spool study gap --cases {cases} --seed {seed}")
    show(rows)
    print(f"{page}: every number, what went wrong and how to make it again")
    return rows


def summary(rows: Sequence[Row]) -> dict[str, Any]:
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


def show(rows: Sequence[Row]) -> None:
    """Print the study's questions with their answers."""
    table = Table("question", "target", "found (95 % interval)", "met", box=None, pad_edge=False)
    for target in targets(rows):
        table.add_row(target.name, target.wanted, str(target.share), target.answer)
    Console(width=140).print(table)


def judge_seed(seed: int, hidden: str | None = None, factor: float | None = None) -> Row:
    """Make the case of ``seed`` and return what the workflow says to it."""
    return judge(make(seed, hidden, factor=factor))


def judge(case: BlindCase) -> Row:
    """Return what the workflow says to ``case``; a crash is a row too, and counts as wrong."""
    from spool_gap.analyse import analyse  # noqa: PLC0415 - counting needs none of its kernels

    record, valve = given(case)
    clock = Clock()
    try:
        result = analyse([record], valve, MODELS[BASE]).to_dict()
    except InputError as error:
        return row_of(case, {"verdict": REFUSED}, clock.read(), str(error))
    except Exception:  # one crash must not end the study; its last lines are kept
        text = traceback.format_exc().strip().splitlines()
        return row_of(case, {"verdict": FAILED}, clock.read(), " ".join(text[-3:]))
    return row_of(case, result, clock.read())


class Clock:
    """Time since it was made."""

    def __init__(self) -> None:
        self._begin = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        """Return (s, s of this process's computing)."""
        return time.perf_counter() - self._begin[0], time.process_time() - self._begin[1]


def given(case: BlindCase) -> tuple[Record, Valve]:
    """Return what the workflow gets to see: the record and the valve's description."""
    valve = valve_from_mapping(yaml.safe_load(valve_text(case)), f"case {case.seed}")
    period = 1.0 / case.condition.sample_rate
    return Record(f"case {case.seed}", 0, period, case.body, case.spool), valve


def row_of(case: BlindCase, result: dict[str, Any], seconds: tuple[float, float], message: str = "") -> Row:
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
    return Row(
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
    )
