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
from spool_monitor.replay import DriftPoint
from spool_tools.report.evidence.exhibit import (
    AFTER,
    BEFORE,
    DARK,
    DASHED,
    FLOOR,
    MEASURED,
    WIDTH,
    Exhibit,
    Line,
    Panel,
    plain,
    thinned,
)

#: 95 % quantile of the chi-squared distribution of two degrees of freedom: -2 log 0.05.
CHI_SQUARED_95 = -2.0 * math.log(0.05)

ELLIPSE_TITLE = "How well drag and dry friction can be separated"
ELLIPSE_CAPTION = (
    "Pairs of viscous coefficient and Coulomb force that the record does not contradict at 95 %, from the "
    "covariance of the fit; cross: the intervals of each number by itself. Good: a small, upright ellipse "
    "that stays clear of zero. Bad: a long one that leans to the right end down: the record only tells their "
    "sum, since the spool moved with one amplitude throughout; drive it with several."
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
LOOKS = ((BEFORE, DASHED, (6, 3)), (AFTER, "-", ()))
#: Share of lags outside of the band up to which chance may do it.
CHANCE = 0.08

DRIFT_CAPTION = (
    "Above: estimates with their 95 % band; grey: baseline of the healthy valve with its own; dashed: the "
    "change that matters; dotted: twice that, from which a reported change is an alarm. Below: the "
    "cumulative sums of the sequential test (Page 1954), for a rise and for a fall, and the threshold that "
    "noise alone crosses once in the time the monitor is set to; vertical lines: events. Good: estimates "
    "stay around the baseline and both sums at zero. Bad: a sum that climbs: the change began where it left "
    "zero, not where the event came. Where there are no estimates the valve was not shaken, or not believed."
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

    def outline(self, points: int = 181) -> Array:
        """Return points around it, shape (2, points)."""
        angle = np.linspace(0.0, 2.0 * math.pi, points)
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
                f"the fit holds no {name.replace('_', ' ').replace('coulomb', 'Coulomb')} of its own"
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
    return Exhibit(ELLIPSE_TITLE, figure, ELLIPSE_CAPTION, _ellipse_seen(ellipse))


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
        raise InputError("nothing at all is left over, as in a record that its own model made")
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
    looks = dict(zip(found, LOOKS[-len(found) :], strict=True))
    first = next(iter(found.values()))
    last = list(found.values())[-1]
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(WIDTH, 6.0), layout="constrained")
    upper.axhspan(-last.band, last.band, color="#dddddd", lw=0, zorder=0, label="95 % band of white noise")
    upper.axhline(0.0, color=MEASURED, lw=0.6)
    for name, one in found.items():
        colour, dash, _ = looks[name]
        upper.plot(1e3 * one.lag, one.correlation, color=colour, ls=dash, lw=1.1, label=name)
        inside = one.frequency > 0.0
        lower.loglog(
            one.frequency[inside], np.sqrt(np.maximum(one.density[inside], 1e-30)), color=colour, ls=dash,
            lw=1.1, label=name,
        )  # fmt: skip
    white = last.rms / np.sqrt(max(float(last.frequency[-1]), 1e-9))
    lower.axhline(white, color=FLOOR, lw=1.0, ls=(0, (1.5, 1.2)), label="white noise of the same size")
    plain(upper, "lag, ms", "autocorrelation, 1")
    plain(lower, "frequency, Hz", f"amplitude density, {unit}/√Hz")
    for axis in (upper, lower):
        axis.margins(x=0.0)
        axis.legend(fontsize=8, frameon=False, ncols=3)
    (lag,) = thinned(1e3 * last.lag)
    inside = first.frequency > 0.0
    correlations = tuple(
        Line(name, thinned(one.correlation)[0], looks[name][0], looks[name][2]) for name, one in found.items()
    )
    band = np.full(lag.size, last.band)
    zero = Line("95 % band of white noise", np.zeros(lag.size), MEASURED, (), -band, band, 0.6)
    densities = tuple(
        Line(name, np.sqrt(np.maximum(one.density[inside], 1e-30)), looks[name][0], looks[name][2])
        for name, one in found.items()
    )
    panels = (
        Panel("lag, ms", "autocorrelation, 1", lag, (zero, *correlations)),
        Panel(
            "frequency, Hz", f"amplitude density, {unit}/√Hz", first.frequency[inside], densities,
            log_x=True, log_y=True,
        ),
    )  # fmt: skip
    return Exhibit(WHITENESS_TITLE, figure, WHITENESS_CAPTION, _whiteness_seen(found, unit), panels)


@dataclass(frozen=True, slots=True)
class Mark:
    """Event at ``time`` (s): its ``text``, and whether it was raised or cleared."""

    time: float
    text: str
    raised: bool


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
    value, deviation, baseline, spread, matters, up, down, threshold = table.T
    half = Z_95 * deviation
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(WIDTH, 5.2), layout="constrained", sharex=True, height_ratios=(3, 2)
    )
    upper.fill_between(
        time, baseline - Z_95 * spread, baseline + Z_95 * spread, color=MEASURED, alpha=0.3, lw=0
    )
    upper.plot(time, baseline, color=MEASURED, lw=1.6, label="baseline")
    for factor, dash, label in ((1.0, (0, (5, 2)), "matters"), (2.0, (0, (1.5, 1.2)), "alarm")):
        for place, sign in enumerate((-1.0, 1.0)):
            upper.plot(
                time, baseline + sign * factor * matters, color=DARK, ls=dash, lw=0.9,
                label=label if place == 0 else None,
            )  # fmt: skip
    upper.fill_between(time, value - half, value + half, color=AFTER, alpha=0.3, lw=0)
    upper.plot(time, value, color=AFTER, lw=1.2, label="estimate")
    for row, colour, style, label in (
        (up, BEFORE, "--", "sum of a rise"),
        (down, AFTER, "-", "sum of a fall"),
    ):
        lower.plot(time, row, color=colour, ls=style, lw=1.3, label=label)
    lower.plot(time, threshold, color=FLOOR, ls=(0, (1.5, 1.2)), lw=1.2, label="threshold")
    top = (
        max(3.0 * float(np.nanmin(threshold)), 1.1 * float(max(up.max(), down.max())))
        if np.isfinite(threshold).any()
        else None
    )
    lower.set_ylim(0.0, top)
    for mark in marks[:MARKED]:
        for axis in (upper, lower):
            axis.axvline(mark.time, color=DARK, lw=0.7, ls="-" if mark.raised else ":")
    _bounded(upper, value, half, baseline, matters)
    _labelled(upper, marks[:MARKED])
    plain(upper, "", f"{_words(name)}, {unit}")
    plain(lower, "time since the start of the record, s", "cumulative sum, s")
    for axis in (upper, lower):
        axis.legend(fontsize=7.5, frameon=False, ncols=4, loc="lower left")
        axis.margins(x=0.0)
    return Exhibit(
        title_of(name),
        figure,
        DRIFT_CAPTION,
        _drift_seen(name, unit, time, table),
        _panels(name, unit, time, table, marks),
    )


def _ellipse_seen(ellipse: Ellipse) -> str:
    values = [
        with_interval(value, deviation, unit)
        for value, deviation, unit in zip(
            ellipse.centre.tolist(), ellipse.deviations.tolist(), ellipse.units, strict=True
        )
    ]
    correlation = ellipse.correlation
    told = (
        "what one gains the other loses, so neither is right by itself if the other is wrong"
        if abs(correlation) > ALIKE
        else "the record tells them apart"
    )
    without = ellipse.holds(np.array([ellipse.centre[0], 0.0]))
    zero = "; no dry friction at all lies within" if without else ""
    return (
        f"Viscous coefficient {values[0]}, Coulomb force {values[1]} (± 95 %), correlation "
        f"{correlation:+.2f}: {told}{zero}."
    )


def _products(row: Array, lags: int) -> Array:
    """Return the sums of the products of ``row`` with itself 0 to ``lags`` samples later."""
    length = fft.next_fast_len(row.size + lags, real=True)
    lines = fft.rfft(row, length)
    return np.asarray(fft.irfft(lines * np.conj(lines), length)[: lags + 1])


def _whiteness_seen(found: Mapping[str, Whiteness], unit: str) -> str:
    parts = []
    for name, one in found.items():
        verdict = "as white noise would" if one.outside <= CHANCE else "where white noise leaves it at 5 %"
        inside = one.frequency > 0.0
        peak = float(one.frequency[inside][int(np.argmax(one.density[inside]))])
        parts.append(
            f"{name}: {number(one.rms, 2)} {unit} rms left, most of it per Hz at {number(peak, 3)} Hz, and "
            f"its autocorrelation leaves the band at {100.0 * one.outside:.0f} % of the lags, {verdict}"
        )
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _bounded(axis: plt.Axes, value: Array, half: Array, baseline: Array, matters: Array) -> None:
    """Show what was judged: first estimates may be anything."""
    known = np.concatenate([value, baseline - 2.2 * matters, baseline + 2.2 * matters])
    known = known[np.isfinite(known)]
    if np.isfinite(baseline).any():
        low, high = np.quantile(known, (0.01, 0.99)).tolist()
        room = 0.08 * (high - low) + float(np.nanmedian(half))
        axis.set_ylim(low - room, high + room)


def _labelled(axis: plt.Axes, marks: Sequence[Mark]) -> None:
    for mark in marks:
        if mark.raised:
            axis.annotate(
                mark.text, (mark.time, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
                textcoords="offset points", rotation=90, va="top", fontsize=6.5, color=DARK,
            )  # fmt: skip


def _panels(name: str, unit: str, time: Array, table: Array, marks: Sequence[Mark]) -> tuple[Panel, ...]:
    x, *rows = thinned(time, *table.T)
    value, deviation, baseline, spread, matters, up, down, threshold = rows
    half, wide = Z_95 * deviation, Z_95 * spread
    limits = tuple(
        Line(
            f"{label} {'above' if sign > 0.0 else 'below'}",
            baseline + sign * factor * matters,
            DARK,
            dash,
            width=1.0,
        )
        for factor, dash, label in ((1.0, (6, 3), "matters"), (2.0, (2, 2), "alarm"))
        for sign in (-1.0, 1.0)
    )
    shown = tuple((mark.time, mark.text if mark.raised else f"{mark.text} over") for mark in marks[:MARKED])
    return (
        Panel(
            "time, s", f"{_words(name)}, {unit}", x,
            (
                Line("baseline", baseline, MEASURED, (), baseline - wide, baseline + wide),
                *limits,
                Line("estimate", value, AFTER, (), value - half, value + half),
            ),
            marks=shown,
        ),
        Panel(
            "time, s", "cumulative sum, s", x,
            (
                Line("sum of a rise", up, BEFORE, (6, 3)),
                Line("sum of a fall", down, AFTER),
                Line("threshold", threshold, FLOOR, (2, 2)),
            ),
            marks=shown,
        ),
    )  # fmt: skip


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
