"""Autocorrelation of the residual with the band of white noise, and its spectrum."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from spool_core.uncertainty import number

from spool_tools.report.drawing.palette import AFTER, BEFORE, DASHED, FLOOR, MEASURED, WIDTH, plain
from spool_tools.report.estimates.whiteness import Whiteness

from .exhibit import Exhibit, Line, Panel, thinned

TITLE = "Is what is left over noise?"
CAPTION = (
    "Above: autocorrelation of measured less model; grey: the band that white noise keeps to at 95 of 100 "
    "lags. Below: amplitude density of the same, and of white noise of the same size. Good: within the band, "
    "and a flat spectrum. Bad: a decaying wave (a resonance or a force is missing; its period is that of the "
    "missing motion), a slow fall (drift), a sharp line in the spectrum (hum, another machine). Noise of a "
    "real channel is never quite white: what matters is how much less is left than before."
)
LOOKS = ((BEFORE, DASHED, (6, 3)), (AFTER, "-", ()))
#: Share of lags outside of the band up to which chance may do it.
CHANCE = 0.08


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
    return Exhibit(TITLE, figure, CAPTION, _seen(found, unit), panels)


def _seen(found: Mapping[str, Whiteness], unit: str) -> str:
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
