"""Fit of the surrogate: runs of the real estimator at drawn operating points, in both speeds of a machine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from spool_core.numbers import Array
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, settings_for
from spool_evaluation.monitor_cases.scenario import away, draw_valve
from spool_evaluation.results.page import study_command, write_page
from spool_evaluation.studies.workers import spread
from spool_sim.simulator import Simulator
from spool_tools.outputs import suite_version

from .operating_point import Measuring, Shaking, draw_measuring, draw_shaking, features
from .surrogate import FILE, Surrogate, SurrogateRow, load_surrogate

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
    out.mkdir(parents=True, exist_ok=True)
    seeds = [seed + number for number in range(cases)]
    runs = sorted(spread(_run_of, seeds, "runs of the estimator", workers), key=lambda one: one[0])
    command = study_command("operation-fit", cases, seed)
    made = fitted([one for _, found in runs for one in found], command)
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


def _run_of(seed: int) -> tuple[int, list[FitRun]]:
    found = fit_run(np.random.default_rng([seed, 3]))
    return seed, [] if found is None else [found]


def fit_run(draw: np.random.Generator) -> FitRun | None:
    """Run the real estimator on one drawn machine; ``None`` where it never tracks."""
    valve = draw_valve(draw).at(float(draw.uniform(15.0, 65.0)))
    below = bool(draw.random() < 0.5)
    shaking, measuring = draw_shaking(draw, below=below), draw_measuring(draw)
    coulomb = float(min(0.6, draw.uniform(0.03, 0.5) * valve.moving_mass * shaking.first))
    first, second = (away(draw, valve, below=below) for _ in range(2))
    profile = ((0.0, first), (float(CHANGED), first), (float(CHANGED + RAMP), second))
    noise_seed = int(draw.integers(2**31))
    machine = shaking.machine(profile, ((float(HOLD), float(RESTARTED)),))

    def estimated(measuring: Measuring) -> list[Estimate]:
        simulator = Simulator(
            valve,
            machine,
            coulomb_force=coulomb,
            sample_rate=measuring.sample_rate,
            block_size=round(measuring.sample_rate / 10),
            seed=noise_seed,
            body_sensor=measuring.body,
            spool_sensor=measuring.spool,
        )
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
        return None
    usual = np.sqrt(np.diag(rows[0].covariance))
    usual_after = np.sqrt(np.diag(rows[-1].covariance))
    again = RESTARTED + int(np.argmax(tracks[RESTARTED:CHANGED]))
    after_start = _curve(errors[again : again + CURVE] - rows[0].bias, usual)
    change = CHANGED + RAMP
    after_change = _curve(errors[change : change + CURVE] - rows[-1].bias, usual_after)
    steady = errors[SETTLED : HOLD - 1] - rows[0].bias
    lag = float((steady[1:] * steady[:-1]).sum(axis=0) @ np.reciprocal((steady**2).sum(axis=0)) / 3.0)
    return FitRun(tuple(rows), after_start, after_change, again - RESTARTED, lag)


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
    residuals = np.array([one.residual.value for one in good])
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
        float(np.mean([one.excitation.value for one in good])) / shaking.first,
        float(np.mean([one.relative_displacement.value for one in good])) * omega**2 / shaking.first,
    )


def _tracks(estimate: Estimate) -> bool:
    return estimate.state is State.TRACKING and estimate.parameters[0].validity is Validity.VALID


def _values(estimate: Estimate) -> list[float]:
    return [one.value for one in estimate.parameters]
