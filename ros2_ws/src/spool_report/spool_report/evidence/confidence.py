"""How far a result can be trusted: confidence ellipse, whiteness of the residual, drift over time.

Box, G. E. P., Jenkins, G. M.: Time Series Analysis (1976), section 2.1.6: the autocorrelation of n samples of
white noise has a standard deviation of 1/sqrt(n).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from scipy import fft
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95, Quantity, number, with_interval
from spool_estimator.identification.spectra import density_of
from spool_monitor.drift_trace import DriftPoint
from spool_report.evidence.exhibit import (
    AFTER,
    BEFORE,
    DARK,
    FLOOR,
    MEASURED,
    MODEL_LOOKS,
    WIDTH,
    Exhibit,
    Line,
    Mark,
    Panel,
    drawn,
    plain,
    thinned,
)

#: 95 % quantile of the chi-squared distribution of two degrees of freedom: -2 log 0.05.
CHI_SQUARED_95 = -2.0 * math.log(0.05)

ELLIPSE_TITLE = "How well drag and dry friction can be separated"
ELLIPSE_CAPTION = (
    "Pairs of viscous coefficient and Coulomb force that the record does not contradict at 95 %, from the "
    "covariance of the fit; cross: the intervals of each number by itself. Good: a small, upright ellipse "
    "that stays clear of zero. Bad: a long one that leans to the right end down: the record determines only "
    "their sum, since the spool moved with one amplitude throughout; excite it with several."
)
VISCOUS, COULOMB = "viscous_coefficient", "coulomb_force"
#: Correlation from which one makes up for the other.
ALIKE = 0.95

#: s of lag that are looked at: some periods of the slowest spool.
LONGEST_LAG = 0.25
#: Samples from which an autocorrelation is worth drawing.
LEAST = 200

WHITENESS_TITLE = "Is the residual noise?"
WHITENESS_CAPTION = (
    "Above: autocorrelation of measured less model; grey: the band that white noise keeps to at 95 of 100 "
    "lags. Below: amplitude density of the same, and of white noise of the same size. Good: within the band, "
    "and a flat spectrum. Bad: a decaying wave (a resonance or a force is missing; its period is that of the "
    "missing motion), a slow fall (drift), a sharp line in the spectrum (hum, another machine). Noise of a "
    "real channel is never quite white: what matters is how much less is left than before."
)
#: Share of lags outside of the band up to which chance may do it.
CHANCE = 0.08

DRIFT_CAPTION = (
    "Above: estimates with their 95 % band; grey: baseline of the healthy valve with its own; dashed: the "
    "change that matters; dotted: twice that, from which a reported change is an alarm. Below: the "
    "cumulative sums of the sequential test (Page 1954), for a rise and for a fall, and the threshold that "
    "noise alone crosses once in the time the monitor is set to; vertical lines: events. Good: estimates "
    "stay around the baseline and both sums at zero. Bad: a sum that climbs: the change began where it left "
    "zero, not at the event. Gaps: the valve was not excited, or its estimates were not trusted."
)
#: Events marked at most.
MARKED = 24


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Set of pairs that a fit does not contradict at 95 %.

    Attributes:
        names, units: of the two numbers.
        centre: as fitted, shape (2,).
        covariance: shape (2, 2), positive definite.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    centre: Array
    covariance: Array

    @property
    def correlation(self) -> float:
        """Of the two numbers."""
        return float(self.covariance[0, 1] / math.sqrt(self.covariance[0, 0] * self.covariance[1, 1]))

    @property
    def deviations(self) -> Array:
        """Standard deviation of each, shape (2,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def holds(self, pair: Array) -> bool:
        """Return whether ``pair`` (2,) lies within."""
        apart = np.asarray(pair) - self.centre
        return bool(apart @ np.linalg.solve(self.covariance, apart) <= CHI_SQUARED_95)

    def outline(self) -> Array:
        """Return points around it, shape (2, 181)."""
        angle = np.linspace(0.0, 2.0 * math.pi, 181)
        circle = np.array([np.cos(angle), np.sin(angle)])
        root = np.linalg.cholesky(self.covariance)
        return np.asarray(self.centre[:, np.newaxis] + math.sqrt(CHI_SQUARED_95) * root @ circle)


def ellipse_of(parameters: tuple[Quantity, ...], names: tuple[str, ...], correlation: Array) -> Ellipse:
    """Return the ellipse of both frictions from the numbers of a fit.

    Args:
        parameters: with their standard deviations.
        names: of the rows of ``correlation``.
        correlation: shape (p, p).

    Raises:
        InputError: the fit does not tell both.
    """
    known = {quantity.name: quantity for quantity in parameters if np.isfinite(quantity.value)}
    for name in (VISCOUS, COULOMB):
        if name not in known or name not in names:
            raise InputError(
                f"the fit has no separate {name.replace('_', ' ').replace('coulomb', 'Coulomb')}"
            )
    places = [names.index(name) for name in (VISCOUS, COULOMB)]
    deviations = np.array([known[name].standard_deviation for name in (VISCOUS, COULOMB)])
    part = correlation[np.ix_(places, places)]
    if not (np.isfinite(part).all() and np.isfinite(deviations).all() and (deviations > 0.0).all()):
        raise InputError("the covariance of both frictions is not known")
    if abs(float(part[0, 1])) >= 1.0:
        raise InputError("both frictions are known only as one number")
    return Ellipse(
        (VISCOUS, COULOMB),
        (known[VISCOUS].unit, known[COULOMB].unit),
        np.array([known[VISCOUS].value, known[COULOMB].value]),
        part * np.outer(deviations, deviations),
    )


def confidence_ellipse(ellipse: Ellipse) -> Exhibit:
    """Return the picture of ``ellipse``."""
    figure, axis = plt.subplots(figsize=(0.62 * WIDTH, 4.2), layout="constrained")
    across, up = ellipse.outline()
    axis.fill(across, up, color=AFTER, alpha=0.2, lw=0)
    axis.plot(across, up, color=AFTER, lw=1.6, label="95 % of both together")
    c, force = ellipse.centre.tolist()
    dc, df = (Z_95 * ellipse.deviations).tolist()
    axis.errorbar(
        [c], [force], xerr=[dc], yerr=[df], color=DARK, marker="o", ms=4, lw=1.0, label="95 % of each"
    )
    if force - 3.0 * df < 0.0:
        axis.axhline(0.0, color=MEASURED, lw=0.8)
    axis.ticklabel_format(useOffset=False)
    plain(axis, f"viscous coefficient, {ellipse.units[0]}", f"Coulomb force, {ellipse.units[1]}")
    axis.legend(fontsize=8, frameon=False)
    values = [
        with_interval(value, deviation, unit)
        for value, deviation, unit in zip(
            ellipse.centre.tolist(), ellipse.deviations.tolist(), ellipse.units, strict=True
        )
    ]
    correlation = ellipse.correlation
    told = (
        "each compensates for the other, so an error in one causes an error in the other"
        if abs(correlation) > ALIKE
        else "the record separates them"
    )
    without = ellipse.holds(np.array([ellipse.centre[0], 0.0]))
    zero = "; zero dry friction lies within the ellipse" if without else ""
    return Exhibit(
        ELLIPSE_TITLE,
        figure,
        ELLIPSE_CAPTION,
        f"Viscous coefficient {values[0]}, Coulomb force {values[1]} (± 95 %), correlation "
        f"{correlation:+.2f}: {told}{zero}.",
    )


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Autocorrelation and spectrum of a residual.

    Attributes:
        lag: s, shape (l,), from one sample on.
        correlation: at each lag, shape (l,).
        band: half width that white noise keeps to at 95 of 100 lags.
        frequency: Hz, shape (f,).
        density: power density, unit^2/Hz, shape (f,).
        rms: of the residual, in its unit.
        samples: how many.
    """

    lag: Array
    correlation: Array
    band: float
    frequency: Array
    density: Array
    rms: float
    samples: int

    @property
    def outside(self) -> float:
        """Share of the lags outside of the band; 0.05 for white noise."""
        return float(np.mean(np.abs(self.correlation) > self.band))


def whiteness(rows: Sequence[Array], period: float) -> Whiteness:
    """Return the whiteness of residual ``rows``, each without a gap, samples ``period`` s apart.

    Raises:
        InputError: too few samples, or nothing is left over at all.
    """
    samples = sum(row.size for row in rows)
    shortest = min((row.size for row in rows), default=0)
    lags = min(round(LONGEST_LAG / period), shortest // 4)
    if samples < LEAST or lags < 8:
        raise InputError(f"{samples} samples of the residual are too few for an autocorrelation")
    mean = float(np.concatenate(rows).mean())
    centred = [np.asarray(row - mean) for row in rows]
    products = np.asarray(np.sum([_products(row, lags) for row in centred], axis=0), dtype=np.float64)
    if not products[0] > 0.0:
        raise InputError("the residual is zero, as in a record simulated with this model")
    frequency, density = density_of(centred, period)
    return Whiteness(
        np.asarray(period * np.arange(1, lags + 1), dtype=np.float64),
        np.asarray(products[1:] / products[0]),
        Z_95 / math.sqrt(samples),
        frequency,
        density,
        float(np.sqrt(products[0] / samples)),
        samples,
    )


def residual_whiteness(found: Mapping[str, Whiteness], unit: str = "m/s²") -> Exhibit:
    """Return the picture of the residuals ``found``, by the name of their model; ``unit`` of the signal."""
    looks = MODEL_LOOKS[-len(found) :]
    first, last = next(iter(found.values())), list(found.values())[-1]
    lag, *rows = thinned(1e3 * last.lag, *(one.correlation for one in found.values()))
    inside = first.frequency > 0.0
    shown = list(zip(found, looks, rows, strict=True))
    correlations = [Line(name, row, *look, width=1.1) for name, look, row in shown]
    densities = [
        Line(name, np.sqrt(np.maximum(found[name].density[inside], 1e-30)), *look, width=1.1)
        for name, look, _ in shown
    ]
    band = np.full(lag.size, last.band)
    white = np.full(densities[0].values.size, last.rms / np.sqrt(max(float(last.frequency[-1]), 1e-9)))
    panels = (
        Panel(
            "lag, ms", "autocorrelation, 1", lag,
            (Line("95 % band of white noise", 0.0 * band, MEASURED, (), -band, band, 0.6), *correlations),
        ),
        Panel(
            "frequency, Hz", f"amplitude density, {unit}/√Hz", first.frequency[inside],
            (*densities, Line("white noise of the same size", white, FLOOR, (2, 2), width=1.0)),
            log_x=True, log_y=True,
        ),
    )  # fmt: skip
    parts = []
    for name, one in found.items():
        verdict = "as white noise would" if one.outside <= CHANCE else "where white noise leaves it at 5 %"
        peak = float(one.frequency[inside][int(np.argmax(one.density[inside]))])
        parts.append(
            f"{name}: {number(one.rms, 2)} {unit} rms left, most of it per Hz at {number(peak, 3)} Hz, and "
            f"its autocorrelation leaves the band at {100.0 * one.outside:.0f} % of the lags, {verdict}"
        )
    text = "; ".join(parts)
    figure = drawn(panels, (1, 1), 6.0)
    return Exhibit(WHITENESS_TITLE, figure, WHITENESS_CAPTION, f"{text[0].upper()}{text[1:]}.", panels)


def title_of(name: str) -> str:
    """Return the title of the picture of the parameter ``name``."""
    return f"Drift of the {name.replace('_', ' ').replace('coulomb', 'Coulomb')}"


def drift(name: str, unit: str, points: Sequence[DriftPoint], first: int, marks: Sequence[Mark]) -> Exhibit:
    """Return the picture of one parameter.

    Args:
        name: of the parameter.
        unit: of it.
        points: as the monitor saw them.
        first: stamp of the record's start, ns.
        marks: events of the valve.

    Raises:
        InputError: there is no estimate of it.
    """
    # A clock that was set back makes no line run back.
    stamps = np.array([point.stamp for point in points], dtype=np.int64)
    before = np.concatenate([[-1], np.maximum.accumulate(stamps)[:-1]]) if stamps.size else stamps
    rising = np.flatnonzero(stamps > before).tolist()
    table = np.array(
        [
            (one.value, one.deviation, one.baseline, one.spread, one.matters, one.up, one.down, one.threshold)
            for one in (points[place] for place in rising)
        ],
        dtype=np.float64,
    ).reshape(-1, 8)
    if not np.isfinite(table[:, 0]).any():
        raise InputError("the estimator gave no value of it in this record")
    time = np.asarray((stamps[rising] - first) * 1e-9, dtype=np.float64)
    x, *rows = thinned(time, *table.T)
    value, deviation, baseline, spread, matters, up, down, threshold = rows
    half, wide = Z_95 * deviation, Z_95 * spread
    limits = [
        Line(label, baseline + factor * matters, DARK, dash, width=0.9)
        for label, dash, size in (("change that matters", (6, 3), 1.0), ("alarm", (2, 2), 2.0))
        for factor in (-size, size)
    ]
    span = top = None
    if np.isfinite(baseline).any():  # show what was judged: first estimates may be anything
        known = np.concatenate([value, baseline - 2.2 * matters, baseline + 2.2 * matters])
        low, high = np.quantile(known[np.isfinite(known)], (0.01, 0.99)).tolist()
        room = 0.08 * (high - low) + float(np.nanmedian(half))
        span = (low - room, high + room)
    if np.isfinite(threshold).any():
        top = max(3.0 * float(np.nanmin(threshold)), 1.1 * float(max(up.max(), down.max())))
    panels = (
        Panel(
            "time since the start of the record, s", f"{_words(name)}, {unit}", x,
            (
                Line("baseline", baseline, MEASURED, (), baseline - wide, baseline + wide, 1.6),
                *limits,
                Line("estimate", value, AFTER, (), value - half, value + half, 1.2),
            ),
            marks=tuple(marks[:MARKED]), span=span,
        ),
        Panel(
            "time since the start of the record, s", "cumulative sum, s", x,
            (
                Line("sum of a rise", up, BEFORE, (6, 3), width=1.3),
                Line("sum of a fall", down, AFTER, width=1.3),
                Line("threshold", threshold, FLOOR, (2, 2), width=1.2),
            ),
            marks=tuple(marks[:MARKED]), span=None if top is None else (0.0, top),
        ),
    )  # fmt: skip
    seen = _drift_seen(name, unit, time, table)
    return Exhibit(title_of(name), drawn(panels, (3, 2), 5.2), DRIFT_CAPTION, seen, panels)


def _products(row: Array, lags: int) -> Array:
    """Return the sums of the products of ``row`` with itself 0 to ``lags`` samples later."""
    length = fft.next_fast_len(row.size + lags, real=True)
    lines = fft.rfft(row, length)
    return np.asarray(fft.irfft(lines * np.conj(lines), length)[: lags + 1])


def _drift_seen(name: str, unit: str, time: Array, table: Array) -> str:
    value, deviation, baseline, spread, matters, up, down, threshold = table.T
    known = np.flatnonzero(np.isfinite(value))
    last = int(known[-1])
    text = f"Last estimate of the {_words(name)} {with_interval(value[last], deviation[last], unit)} (± 95 %)"
    if not np.isfinite(baseline[-1]):
        return f"{text}; no baseline was learned, so nothing was judged."
    apart = value[last] - baseline[-1]
    text += (
        f", baseline {with_interval(baseline[-1], spread[-1], unit)}: {number(abs(apart / matters[-1]), 2)} "
        f"times the change that matters, {'up' if apart > 0.0 else 'down'}"
    )
    sums = np.maximum(up, down)
    crossed = np.flatnonzero(sums >= threshold)
    if crossed.size:
        return (
            f"{text}; a cumulative sum first crosses its threshold at {number(float(time[crossed[0]]), 3)} s."
        )
    if not np.isfinite(threshold).any():
        return f"{text}; the test judged nothing."
    most = number(float(np.nanmax(sums / threshold)), 2)
    return f"{text}; the cumulative sums reach {most} of their threshold at most."


def _words(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")
