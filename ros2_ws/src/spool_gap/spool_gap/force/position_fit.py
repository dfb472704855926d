"""Output-error fit of a driven mass: its numbers by free runs of position over stretches of the records.

The balance of forces needs accelerations, whose smoothing and noise bias its numbers; a free run sees forces
that are a thousandth of the measured one, since they add up. Each stretch starts from the measured motion
(multiple shooting), so that errors do not add up over a whole record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from spool_core.errors import InputError
from spool_sim.model import Model

from .force_balance import ForceBalance, ForceFit, correlation_of, independent_samples
from .force_record import ForceRecord
from .force_result import Chosen, model_with
from .position_run import position_run, speed_at

Array = NDArray[np.float64]

#: s of a stretch: friction and drag act on the position within one, and a constant force too.
STRETCH = 8.0
#: Samples of the position that are compared in each stretch: it changes no faster.
COMPARED = 400
#: Relative step of the differences: that of the regression's rounding over a free run of some 10,000 steps.
STEP = 1e-4
#: Runs of the descent at most: it takes some 30 where it converges.
MOST = 200


def fitted_by_position(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> ForceFit | None:
    """Return ``fit`` with the coefficients that follow the position best; ``None`` where no run succeeds.

    Args:
        base: model that ``chosen`` effects, with their shapes, are added to.
        balance: gives the training records.
        chosen: effects.
        fit: by the balance of forces, where the descent starts.
    """
    parts, speeds = stretches_of(balance.train)
    size = np.maximum(np.abs(fit.coefficients), fit.deviations)
    # What no sample of the balance shows, as with a part that sticks, has neither; the free run may show it.
    size[size == 0.0] = 1.0
    scale = max(1e-12, float(np.std(np.concatenate([part.displacement for part in parts]))))

    def errors(numbers: Array) -> Array:
        moved = replace(fit, coefficients=numbers * size)
        rows = []
        for part, speed in zip(parts, speeds, strict=True):
            every = max(1, part.force.size // COMPARED)
            try:
                model, zero = model_with(base, balance, chosen, moved)
                start = float(part.displacement[0]) - balance.centre, speed
                run = position_run(part, start, model, zero, balance.sign)
            except InputError:
                run = np.full(part.force.size, np.inf)
            error = (run - part.displacement)[::every] / scale
            rows.append(np.clip(np.nan_to_num(error, nan=1e3, posinf=1e3), -1e3, 1e3))
        return np.concatenate(rows)

    start = fit.coefficients / size
    found = least_squares(errors, start, diff_step=STEP, max_nfev=MOST)
    if not np.isfinite(found.cost) or found.cost >= 0.5 * float(np.sum(errors(start) ** 2)):
        return None
    slopes = found.jac / _deviation(found.fun, len(parts))
    covariance = np.asarray(np.linalg.pinv(slopes.T @ slopes))
    moved = replace(
        fit,
        coefficients=found.x * size,
        deviations=np.sqrt(np.maximum(np.diag(covariance), 0.0)) * size,
        correlation=correlation_of(covariance),
    )
    return balance.measured(moved, chosen)


def stretches_of(records: Sequence[ForceRecord]) -> tuple[list[ForceRecord], list[float]]:
    """Return ``records`` cut into stretches of ``STRETCH`` s or a little more, and where each begins, m/s."""
    found, speeds = [], []
    for record in records:
        count = max(1, int(record.duration / STRETCH))
        edges = (record.force.size * np.arange(count + 1)) // count
        for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            place, force = record.displacement[low:high], record.force[low:high]
            start = record.start + low * record.period
            found.append(ForceRecord(record.name, start, record.period, place, force))
            speeds.append(speed_at(record, low))
    return found, speeds


def _deviation(errors: Array, parts: int) -> float:
    """Return the deviation that each of ``errors`` has were they independent: drifts hold few numbers."""
    independent = max(1.0, sum(independent_samples(row) for row in np.array_split(errors, parts)))
    return max(1e-12, float(np.sqrt(np.mean(errors**2) * errors.size / independent)))
