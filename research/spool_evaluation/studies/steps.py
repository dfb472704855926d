"""Convergence study: the error of the simulated motion over the time step, by model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from spool_evaluation.pictures.convergence_picture import SAMPLE_RATE, SHOWN, STEPS, errors, write_picture
from spool_evaluation.results.page import markdown_table, write_page

from .workers import spread

PAGE = "time_steps.md"
TITLE = "Convergence of the time integration"
ABOUT = (
    "Relative rms error of the displacement in 2 s of a sweep from 8 to 110 Hz at 10 m/s², against the same "
    "with a step of 3.9 us; order is the power with which the error falls. What is integrated, and how: "
    "[physics](../methods/physics.md)."
)
#: Of ``STEPS``, how many the table shows.
SHOWN_STEPS = 4


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> dict[str, list[float]]:  # noqa: ARG001 - not drawn
    """Compute the errors of the first ``cases`` models; ``out`` gets the table and the picture."""
    out.mkdir(parents=True, exist_ok=True)
    names = list(SHOWN)[:cases]
    unordered = dict(spread(judge, names, "models", workers))
    found = {name: unordered[name] for name in names}
    parts = [ABOUT, table(found), f"![error over time step]({write_picture(found, out).name})"]
    write_page(out / PAGE, TITLE, f"./spool study steps --cases {len(names)} --out DIR", parts)
    print(table(found))
    return found


def judge(name: str) -> tuple[str, list[float]]:
    """Return ``name`` and its relative rms errors for each of ``STEPS``."""
    return name, errors(name, SHOWN[name][0])


def order(found: Sequence[float]) -> float:
    """Return the power of the step that the error falls with, over four halvings."""
    return math.log2(found[0] / found[4]) / 4.0


def table(found: dict[str, list[float]]) -> str:
    """Return the errors as Markdown."""
    body = []
    for name, these in found.items():
        cells = [f"{error:.1e}".replace("e-0", "e-") for error in these[:SHOWN_STEPS]]
        body.append((f"`{name}`", *cells, f"{order(these):.1f}"))
    steps = [f"at {1e6 / SAMPLE_RATE / count:g} us" for count in STEPS[:SHOWN_STEPS]]
    return markdown_table(("model", *steps, "order"), body)
