"""Studies over many records: how often the suite is right."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from spool_core.errors import InputError

#: Each is a module of ``studies``, or one named in full, with ``run(cases, seed, out, workers)``.
STUDIES = {
    "gap": "gap",
    "field": "field.study",
    "gap-limit": "gap_limit",
    "estimation": "estimation",
    "records": "records",
    "steps": "steps",
    "monitor": "monitor",
    "monitor-hours": "monitor_hours",
    "operation": "spool_operation.study",
    "operation-fit": "spool_operation.surrogate_fit",
    "operation-agreement": "spool_operation.agreement",
    "operation-gap": "spool_operation.gap_peer",
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
    faulty: int | None = None,
    day: int | None = None,
) -> None:
    """Run the study ``what`` over ``cases`` cases from ``seed`` on; write what was found into ``out``.

    Args:
        what: one of ``STUDIES``.
        cases, seed, out, workers: as the study takes them.
        diagnosing: the field study also states why each wrong verdict is wrong.
        faulty: days with a fault of the study of operation.
        day: seed of the one day that the study of operation replays.

    Raises:
        InputError: there is no such study, or it has no diagnosis.
    """
    if what not in STUDIES:
        raise InputError(f"study {what}: there is no such study; there are {', '.join(STUDIES)}")
    if diagnosing and what != "field":
        raise InputError(f"study {what}: only the study field has a diagnosis; remove --diagnose")
    if what != "operation" and (faulty is not None or day is not None):
        raise InputError(f"study {what}: only the study operation has valve-days; remove --faulty and --day")
    given = {"diagnosing": diagnosing or None, "faulty": faulty, "day": day}
    options = {name: value for name, value in given.items() if value is not None}
    module = STUDIES[what] if STUDIES[what].startswith("spool_") else f"{__package__}.studies.{STUDIES[what]}"
    import_module(module).run(cases, seed, out, workers, **options)
