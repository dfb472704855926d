"""Task: the analyses of one bag, as every executor runs it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spool_core.errors import InputError
from spool_core.text import printable

from spool_fleet.analyses.base import Rows, Subject, analyses

if TYPE_CHECKING:  # slow to load
    from spool_tools.operations.record_replay import ReplaySettings

DONE, FAILED = "ok", "failed"
#: Characters of a reason.
LONGEST = 300


@dataclass(frozen=True, slots=True)
class Task:
    """Task: which analyses of which valves of the bag at ``path``; ``valve_file`` as in ``Subject``.

    ``settings`` holds those of each valve, by namespace.
    """

    path: str
    work: tuple[tuple[str, tuple[str, ...]], ...]
    valve_file: str | None = None
    settings: Mapping[str, ReplaySettings | None] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one analysis of one valve: its rows, or why there are none."""

    namespace: str
    analysis: str
    status: str
    reason: str
    rows: Rows


def run_task(task: Task) -> list[Outcome]:
    """Return the outcomes of ``task``; an analysis that fails is one of them."""
    return [_run(task, namespace, name) for namespace, names in task.work for name in names]


def failed(task: Task, reason: str) -> list[Outcome]:
    """Return the outcomes of a task that could not be run."""
    return [
        Outcome(namespace, name, FAILED, printable(reason, LONGEST), {})
        for namespace, names in task.work
        for name in names
    ]


def _run(task: Task, namespace: str, name: str) -> Outcome:
    subject = Subject(Path(task.path), namespace, task.valve_file, task.settings.get(namespace))
    try:
        rows = analyses()[name].run(subject)
    except InputError as error:
        return Outcome(namespace, name, FAILED, printable(error, LONGEST), {})
    except Exception as error:  # one bag must not end a run over thousands; the reason is kept
        text = f"{type(error).__name__}: {error}"
        return Outcome(namespace, name, FAILED, printable(text, LONGEST), {})
    return Outcome(namespace, name, DONE, "", _finite(rows))


def _finite(rows: Mapping[str, list[list[Any]]]) -> Rows:
    """Return ``rows`` with nothing in place of numbers that are none."""
    return {
        table: [
            [None if isinstance(value, float) and not math.isfinite(value) else value for value in row]
            for row in content
        ]
        for table, content in rows.items()
    }
