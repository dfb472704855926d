"""The error of the simulated motion over the time step, by model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from spool_evaluation.pictures.convergence_picture import SAMPLE_RATE, SHOWN, STEPS, errors, write_picture

from .workers import spread

TABLE = "time_steps.md"
#: Of ``STEPS``, how many the table shows.
SHOWN_STEPS = 4


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> dict[str, list[float]]:  # noqa: ARG001 - not drawn
    """Compute the errors of the first ``cases`` models; ``out`` gets the table and the picture."""
    out.mkdir(parents=True, exist_ok=True)
    names = list(SHOWN)[:cases]
    unordered = dict(spread(judge, names, "models", workers))
    found = {name: unordered[name] for name in names}
    (out / TABLE).write_text(table(found), encoding="utf-8")
    write_picture(found, out)
    print(table(found), end="")
    return found


def judge(name: str) -> tuple[str, list[float]]:
    """Return ``name`` and its relative rms errors for each of ``STEPS``."""
    return name, errors(name, SHOWN[name][0])


def order(found: Sequence[float]) -> float:
    """Return the power of the step that the error falls with, over four halvings."""
    return math.log2(found[0] / found[4]) / 4.0


def table(found: dict[str, list[float]]) -> str:
    """Return the errors as Markdown."""
    steps = [f"at {1e6 / SAMPLE_RATE / count:g} us" for count in STEPS[:SHOWN_STEPS]]
    lines = [f"| model | {' | '.join(steps)} | order |", "|---" * (len(steps) + 2) + "|"]
    for name, these in found.items():
        cells = [f"{error:.1e}".replace("e-0", "e-") for error in these[:SHOWN_STEPS]]
        lines.append(f"| `{name}` | {' | '.join(cells)} | {order(these):.1f} |")
    return "\n".join(lines) + "\n"
