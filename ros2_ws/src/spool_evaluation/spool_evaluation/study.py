"""Studies over many records: how often the suite is right."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from spool_stream.errors import InputError

#: Each is a module of ``studies`` with ``run(cases, seed, out, workers)``.
STUDIES = {
    "gap": "gap",
    "field": "field.study",
    "gap-limit": "gap_limit",
    "ablation": "ablation",
    "estimation": "estimation",
    "records": "records",
    "steps": "steps",
    "monitor": "monitor",
    "monitor-hours": "monitor_hours",
    "fleet": "fleet.study",
    "fleet-cost": "fleet.cost",
}


def run_study(what: str, cases: int, seed: int, out: Path, workers: int | None) -> None:
    """Run the study ``what`` over ``cases`` cases from ``seed`` on; write what was found into ``out``.

    Raises:
        InputError: there is no such study.
    """
    if what not in STUDIES:
        raise InputError(f"study {what}: there is no such study; there are {', '.join(STUDIES)}")
    import_module(f"{__package__}.studies.{STUDIES[what]}").run(cases, seed, out, workers)
