"""Surrogate of the online estimator: what its estimates are worth at an operating point.

It is fitted to runs of the real estimator on simulated blocks and kept as a small file. Each row holds one
operating point: the mean error of k, c and F_c, the covariance of the error around it, the standard
deviations that the estimator reports, and what else an estimate says. An operating point that no run met
takes the errors of the nearest row in units of the reported standard deviations, moved at random by what
neighbouring rows differ by (smoothed bootstrap). The reported standard deviations and the residual follow
from a regression over all rows: between two speeds of one machine they change little.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_evaluation.results.page import study_command, write_page
from spool_evaluation.studies.workers import spread
from spool_report.outputs import suite_version

from spool_operation.world import (
    SCALES,
    Measuring,
    Shaking,
    away,
    draw_measuring,
    draw_shaking,
    draw_valve,
    features,
)

FILE = Path(__file__).with_name("surrogate.json")

#: Neighbours that a row's random part is drawn from.
NEIGHBOURS = 3
#: Width, in scaled features, of the mean over runs that say what a gain error makes: of 0.2 to 1 that with
#: the least error for machines that are left out.
ALIKE = 0.3


@dataclass(frozen=True, slots=True)
class SurrogateRow:
    """Estimates at one operating point.

    Attributes:
        features: of the operating point, see :func:`.world.features`.
        tracking: share of the estimates that track.
        bias: mean error of k and c (relative) and of F_c over the first order's inertia force, shape (3,).
        sensitivity: of that to the relative gain error between the accelerometers, shape (3,).
        covariance: of the error around it, shape (3, 3).
        reported: standard deviations that the estimator reports, in the same units, shape (3,).
        spread: relative standard deviation of the reported ones from one estimate to the next.
        residual, residual_spread: mean and standard deviation of the relative residual.
        inertia: rms of the spool's inertia force over that of the first order.
        excitation, displacement: rms of the body, over the first order's amplitude, and of the relative
            displacement, over that amplitude divided by the natural angular frequency squared.

    """

    features: Array
    tracking: float
    bias: Array
    sensitivity: Array
    covariance: Array
    reported: Array
    spread: float
    residual: float
    residual_spread: float
    inertia: float
    excitation: float
    displacement: float

    def to_dict(self) -> dict[str, Any]:
        """Return what the file holds: numbers to five significant digits."""
        return {one.name: _digits(getattr(self, one.name)) for one in fields(self)}

    @classmethod
    def from_dict(cls, kept: dict[str, Any]) -> SurrogateRow:
        """Return the row that the file holds."""
        row: dict[str, Any] = {k: np.array(v) if isinstance(v, list) else v for k, v in kept.items()}
        return cls(**row)


@dataclass(frozen=True, eq=False)
class Surrogate:
    """All rows, and how errors develop over time.

    Attributes:
        origin: command, version and numbers of the runs it was fitted to.
        correlation: of the errors of neighbouring estimates, 1 s apart.
        start: s after a start before parameters track again.
        after_start, after_change: error over its usual size at each second after a start and after a change
            of speed, shapes (n,).

    """

    origin: str
    correlation: float
    start: int
    after_start: Array
    after_change: Array
    rows: tuple[SurrogateRow, ...]

    def row(
        self, features: Array, gain_error: float, offsets: Array, draw: np.random.Generator
    ) -> SurrogateRow:
        """Return the estimates at ``features``.

        Args:
            features: of the operating point.
            gain_error: of the spool's accelerometer; the bias includes what it makes.
            offsets: standard normal numbers of the valve, shape (4,): by how much its residual and its
                reported standard deviations depart from the regression.
            draw: source of chance.
        """
        made = _regression(self)
        distance = ((made.places - features / SCALES) ** 2).sum(axis=1)
        near = np.argpartition(distance, NEIGHBOURS)[:NEIGHBOURS]
        near = near[np.argsort(distance[near])]
        first = self.rows[int(near[0])]
        sensitivity = self.sensitivity(features)
        around = made.biases[near]
        chance = draw.standard_normal(NEIGHBOURS) / math.sqrt(NEIGHBOURS - 1)
        moved = (around - around.mean(axis=0)).T @ chance
        told = _terms(features[np.newaxis])[0] @ made.weights
        residual, *rest = np.exp(told[:-1] + offsets * made.departs)
        reported = np.array(rest)
        scale = reported / first.reported
        return replace(
            first,
            bias=(around[0] + moved) * reported + gain_error * sensitivity,
            sensitivity=sensitivity,
            covariance=first.covariance * np.outer(scale, scale),
            reported=reported,
            residual=float(residual),
            residual_spread=first.residual_spread * float(residual) / first.residual,
            inertia=float(np.exp(told[-1])),
        )

    def sensitivity(self, features: Array) -> Array:
        """Return the errors that a gain error makes at ``features``, over it, shape (3,).

        They depend on damping, speed and dry friction.
        """
        made = _regression(self)
        alike = ((made.places[:, :3] - features[:3] / SCALES[:3]) ** 2).sum(axis=1)
        weights = np.exp(-0.5 * (alike - alike.min()) / ALIKE**2)
        return np.asarray(weights @ made.sensitivities / weights.sum())

    def write(self, path: Path) -> None:
        """Write the file."""
        kept = {
            "origin": self.origin,
            "correlation": round(self.correlation, 4),
            "start": self.start,
            "after_start": _digits(self.after_start),
            "after_change": _digits(self.after_change),
            "rows": [row.to_dict() for row in self.rows],
        }
        rows = ",\n".join(json.dumps(row) for row in kept.pop("rows"))
        head = json.dumps(kept, indent=1)[:-2]
        path.write_text(f'{head},\n "rows": [\n{rows}\n]}}\n', encoding="utf-8")


@dataclass(frozen=True, slots=True)
class _Regression:
    """Regression over all rows: scaled features, biases over reported deviations, sensitivities, weights.

    ``departs`` are the standard deviations of residual and reported deviations around it, shape (4,).
    """

    places: Array
    biases: Array
    sensitivities: Array
    weights: Array
    departs: Array


@cache
def _regression(surrogate: Surrogate) -> _Regression:
    features = np.array([row.features for row in surrogate.rows])
    told = np.log([[row.residual, *row.reported, row.inertia] for row in surrogate.rows])
    terms = _terms(features)
    weights = np.linalg.lstsq(terms, told, rcond=None)[0]
    biases = np.array([row.bias / row.reported for row in surrogate.rows])
    sensitivities = np.array([row.sensitivity for row in surrogate.rows])
    departs = (told - terms @ weights)[:, :-1].std(axis=0)
    return _Regression(features / SCALES, biases, sensitivities, weights, departs)


def _terms(features: Array) -> Array:
    """Return the terms of the regression, shape (n, 12)."""
    a, b, c, d = (features / SCALES).T
    below = (features[:, 1] < 1.0).astype(float)
    return np.column_stack([np.ones(a.size), a, b, c, d, a * b, b**2, a**2, c**2, d * b, c * a, below])


@cache
def load_surrogate(path: Path = FILE) -> Surrogate:
    """Return the surrogate that ``path`` holds.

    Raises:
        InputError: the file is missing or damaged.

    """
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        rows = tuple(SurrogateRow.from_dict(row) for row in kept["rows"])
        return Surrogate(
            kept["origin"], kept["correlation"], kept["start"], np.array(kept["after_start"]),
            np.array(kept["after_change"]), rows,
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: not a surrogate ({error}); fit one: ./spool study operation-fit --out DIR"
        ) from error


def errors(row: SurrogateRow, correlation: float, sizes: Array, draw: np.random.Generator) -> Array:
    """Return errors of successive estimates, shape (n, 3), bias included.

    Args:
        row: the operating point.
        correlation: of neighbours.
        sizes: error over its usual size at each estimate, shape (n,).
        draw: source of chance.
    """
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to load

    root = np.linalg.cholesky(row.covariance + 1e-18 * np.eye(3))
    fresh = draw.standard_normal((sizes.size, 3)) * math.sqrt(1.0 - correlation**2)
    begin = draw.standard_normal(3)
    noise, _ = lfilter([1.0], [1.0, -correlation], fresh, axis=0, zi=correlation * begin[np.newaxis])
    return np.asarray(row.bias + (noise @ root.T) * sizes[:, np.newaxis])


def _digits(values: Array | float) -> Any:
    """Return ``values`` to five significant digits, nested as they are."""
    return np.vectorize(lambda one: float(f"{one:.4e}"))(values).tolist()


#: s of a run: first speed until HOLD, at rest until RESTARTED, first speed until CHANGED, then the other one.
HOLD, RESTARTED, CHANGED, RAMP, END = 34, 44, 70, 3, 106
#: s after a start or a change from which errors are as usual, and s of the curves of both.
SETTLED, CURVE = 14, 12
#: Relative gain error whose effect is measured by a second run.
GAIN = 0.01


@dataclass(frozen=True, slots=True)
class FitRun:
    """What one run gives.

    ``rows`` are its operating points; ``after_start`` and ``after_change`` the squared normalised errors at
    each second, shape (CURVE,); ``start`` the s until parameters tracked again; ``lag`` the correlation of
    neighbouring errors.
    """

    rows: tuple[SurrogateRow, ...]
    after_start: Array
    after_change: Array
    start: int
    lag: float


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> Surrogate:
    """Fit the surrogate to ``cases`` runs from ``seed`` on; write its file, and a page to ``out``."""
    runs = dict(spread(fit_run, range(seed, seed + cases), "runs of the estimator", workers))
    command = study_command("operation-fit", cases, seed)
    made = fitted([one for _, one in sorted(runs.items()) if one is not None], command)
    made.write(FILE)
    load_surrogate.cache_clear()
    spreads = np.std([row.bias for row in made.rows], axis=0)
    deviations = np.median([np.sqrt(np.diag(row.covariance)) for row in made.rows], axis=0)
    lines = [
        f"{len(made.rows)} operating points from {cases} runs of {END} s.",
        f"Correlation of neighbouring errors {made.correlation:.2f}; tracking again {made.start} s after "
        "a start.",
        "Spread of the mean errors of k, c (relative) and F_c (over the first order's inertia force): "
        + ", ".join(f"{value:.2g}" for value in spreads)
        + "; median standard deviation around them: "
        + ", ".join(f"{value:.2g}" for value in deviations)
        + ".",
    ]
    write_page(out / "operation_fit.md", "Surrogate of the estimator", command, lines)
    return made


def fit_run(seed: int) -> tuple[int, FitRun | None]:
    """Run the real estimator on the machine of ``seed``; return that and ``None`` where it never tracks."""
    draw = np.random.default_rng([seed, 3])
    valve = draw_valve(draw).at(float(draw.uniform(15.0, 65.0)))
    below = bool(draw.random() < 0.5)
    shaking, measuring = draw_shaking(draw, below=below), draw_measuring(draw)
    coulomb = float(min(0.6, draw.uniform(0.03, 0.5) * valve.moving_mass * shaking.first))
    first, second = (away(draw, valve, below=below) for _ in range(2))
    profile = ((0.0, first), (float(CHANGED), first), (float(CHANGED + RAMP), second))
    noise_seed = int(draw.integers(2**31))
    machine = shaking.machine(profile, ((float(HOLD), float(RESTARTED)),))

    def estimated(measuring: Measuring) -> list[Estimate]:
        simulator = measuring.simulator(valve, machine, coulomb_force=coulomb, seed=noise_seed)
        estimator = Estimator(settings_for(valve))
        return [one for block in simulator.records(float(END)) for one in estimator.update(block)]

    estimates = estimated(replace(measuring, gain_error=0.0))
    moved = np.array([_values(one) for one in estimated(replace(measuring, gain_error=GAIN))])
    truth = np.array([valve.spring_stiffness, valve.viscous_coefficient, coulomb])
    units = np.array([truth[0], truth[1], valve.moving_mass * shaking.first])
    errors = np.array([_values(one) for one in estimates]) - truth
    errors /= units
    sensitivity = (moved - truth) / units / GAIN - errors / GAIN
    tracks = np.array([_tracks(one) for one in estimates])
    rows = []
    for shaft, begin, end in ((first, SETTLED, HOLD), (second, CHANGED + RAMP + SETTLED, END)):
        part = slice(begin, end - 1)
        row = _row(
            features(valve, truth[1], coulomb, shaft, shaking, measuring.noise),
            estimates[part], errors[part], tracks[part], units, shaking, valve.natural_frequency,
            np.median(sensitivity[part], axis=0),
        )  # fmt: skip
        if row is not None:
            rows.append(row)
    if not rows or not tracks[SETTLED:HOLD].any():
        return seed, None
    usual = np.sqrt(np.diag(rows[0].covariance))
    usual_after = np.sqrt(np.diag(rows[-1].covariance))
    again = RESTARTED + int(np.argmax(tracks[RESTARTED:CHANGED]))
    after_start = _curve(errors[again : again + CURVE] - rows[0].bias, usual)
    change = CHANGED + RAMP
    after_change = _curve(errors[change : change + CURVE] - rows[-1].bias, usual_after)
    steady = errors[SETTLED : HOLD - 1] - rows[0].bias
    lag = float((steady[1:] * steady[:-1]).sum(axis=0) @ np.reciprocal((steady**2).sum(axis=0)) / 3.0)
    return seed, FitRun(tuple(rows), after_start, after_change, again - RESTARTED, lag)


def fitted(runs: list[FitRun], command: str) -> Surrogate:
    """Return the surrogate of ``runs``, made by ``command``."""
    rows = tuple(row for one in runs for row in one.rows)
    # Medians: one run in which the spool begins to stick must not set the curve of all.
    after_start = np.sqrt(np.nanmedian([one.after_start for one in runs], axis=0))
    after_change = np.sqrt(np.nanmedian([one.after_change for one in runs], axis=0))
    origin = f"`{command}`, version {suite_version()}: {len(runs)} runs of {END} s of the real estimator"
    return Surrogate(
        origin,
        # Of a few dozen correlated values each: the mean removed makes them look less correlated.
        min(0.95, float(np.median([one.lag for one in runs])) + 0.1),
        int(np.ceil(np.median([one.start for one in runs]))),
        np.maximum(1.0, after_start),
        np.maximum(1.0, after_change),
        rows,
    )


def _curve(errors: Array, usual: Array) -> Array:
    """Return squared errors over their usual size, mean of the three parameters, shape (CURVE,)."""
    found = np.full(CURVE, np.nan)
    found[: len(errors)] = ((errors / usual) ** 2).mean(axis=1)
    return found


def _row(
    place: Array,
    estimates: list[Estimate],
    errors: Array,
    tracks: Array,
    units: Array,
    shaking: Shaking,
    natural_frequency: float,
    sensitivity: Array,
) -> SurrogateRow | None:
    if tracks.sum() < 8 or not np.isfinite(sensitivity).all():
        return None
    good = [one for one, tracked in zip(estimates, tracks, strict=True) if tracked]
    kept = errors[tracks]
    reported = np.array([[one.standard_deviation for one in each.parameters] for each in good]) / units
    residuals, left = np.array([(one.residual.value, one.residual_force.value) for one in good]).T
    omega = 2.0 * np.pi * natural_frequency
    return SurrogateRow(
        place,
        float(tracks.mean()),
        kept.mean(axis=0),
        sensitivity,
        np.cov(kept.T),
        np.median(reported, axis=0),
        float(np.std(np.log(reported[:, 1]))),
        float(residuals.mean()),
        float(residuals.std()),
        float(np.median(left / residuals)) / float(units[2]),
        float(np.mean([one.excitation.value for one in good])) / shaking.first,
        float(np.mean([one.relative_displacement.value for one in good])) * omega**2 / shaking.first,
    )


def _tracks(estimate: Estimate) -> bool:
    return estimate.state is State.TRACKING and estimate.parameters[0].validity is Validity.VALID


def _values(estimate: Estimate) -> list[float]:
    return [one.value for one in estimate.parameters]
