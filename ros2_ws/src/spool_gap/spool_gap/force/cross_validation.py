"""Cross-validation of a driven record's terms: by free runs of position over parts that no fit has seen.

The balance of forces is blind to small forces that add up over seconds of motion; a free run is not. A term
that helps on what it was fitted to and not on the other parts of the training records is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from spool_sim.model import Model

from .force_balance import ForceBalance
from .force_record import ForceRecord
from .force_result import Chosen, free_run_error
from .position_fit import fitted_by_position

#: s of a part at least: friction and drag act on the position within one, slow forces within a few.
PART = 6.0
#: Parts at most, each of which is left out once: with fewer than three nothing is left to fit.
MOST, FEWEST = 4, 3


def parts_of(records: Sequence[ForceRecord]) -> list[ForceRecord]:
    """Return ``records`` cut into parts that are left out by turns; few where they are short."""
    found = []
    for record in records:
        count = int(np.clip(record.duration / PART, 1, MOST))
        edges = (record.force.size * np.arange(count + 1)) // count
        for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            start = record.start + low * record.period
            place, force = record.displacement[low:high], record.force[low:high]
            found.append(ForceRecord(record.name, start, record.period, place, force))
    return found


def cross_validated(
    records: Sequence[ForceRecord],
    columns: Sequence[str],
    chosen: Chosen,
    base: Model,
    mass: float | None,
    *,
    by_position: bool = True,
) -> float:
    """Return the error of free runs of position over each part by a fit of the others, m; infinite for none.

    Args:
        records: of the training.
        columns: of the base's balance.
        chosen: effects with their shapes.
        base: model that they are added to.
        mass: kg, ``None`` where it is fitted.
        by_position: the fits follow the position, else the balance of forces alone.
    """
    parts = parts_of(records)
    if len(parts) < FEWEST:
        return math.inf
    squares = []
    for number, part in enumerate(parts):
        others = [other for place, other in enumerate(parts) if place != number]
        balance = ForceBalance(others, [part], columns, driven=True, mass=mass)
        fit = balance.fit(chosen)
        if by_position:
            fit = fitted_by_position(base, balance, chosen, fit) or fit
        squares.append(free_run_error(base, balance, chosen, fit) ** 2)
    error = math.sqrt(float(np.mean(squares)))
    return error if math.isfinite(error) else math.inf
