"""Studies over many records: how often the suite is right."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from spool_core.errors import InputError

#: Each is a module of ``studies`` with ``run(cases, seed, out, workers)``.
STUDIES = {
    "gap": "gap",
    "field": "field.study",
    "gap-limit": "gap_limit",
    "estimation": "estimation",
    "records": "records",
    "steps": "steps",
    "monitor": "monitor",
    "monitor-hours": "monitor_hours",
    "fleet": "fleet.study",
    "fleet-cost": "fleet.cost",
}


def run_study(
    what: str,
    cases: int,
    seed: int,
    out: Path,
    workers: int | None,
    *,
    diagnosing: bool = False,
) -> None:
    """Run the study ``what`` over ``cases`` cases from ``seed`` on; write what was found into ``out``.

    Args:
        what: one of ``STUDIES``.
        cases, seed, out, workers: as the study takes them.
        diagnosing: the field study also states why each wrong verdict is wrong.

    Raises:
        InputError: there is no such study, or it has no diagnosis.
    """
    if what not in STUDIES:
        raise InputError(f"study {what}: there is no such study; there are {', '.join(STUDIES)}")
    if diagnosing and what != "field":
        raise InputError(f"study {what}: only the study field has a diagnosis; remove --diagnose")
    options = {"diagnosing": True} if diagnosing else {}
    import_module(f"{__package__}.studies.{STUDIES[what]}").run(cases, seed, out, workers, **options)
