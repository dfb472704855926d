"""Transmissibility body to spool, measured and of the model: magnitude, phase, coherence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.uncertainty import Z_95, number

from spool_tools.report.drawing.palette import AFTER, BEFORE, DARK, DASHED, MEASURED, WIDTH, plain
from spool_tools.report.estimates.cross_spectra import CrossSpectra, cross_spectra
from spool_tools.report.estimates.runs import Runs

from .exhibit import Exhibit, Line, Panel

Array = NDArray[np.float64]

TITLE = "Transmissibility body to spool"
CAPTION = (
    "Grey: spool over body acceleration as measured (H1 estimator, averaged cross spectrum over the body's "
    "power) with its 95 % band, which follows from the coherence; lines: the same estimate of the models' "
    "free runs at the same excitation. Good: the model's line lies within the band wherever the coherence is "
    "near 1. Bad: it leaves the band at the peak (drag), shifts it sideways (spring or mass), or the phase "
    "parts with rising frequency (delay between the channels). Where the coherence is low the spool moves by "
    "something else than the body, or its law is not linear: dry friction lowers it around the peak."
)
#: Lower edge of a band over the magnitude at least, so that a logarithmic axis is not stretched by it.
LEAST_BAND = 0.1
#: Coherence from which a deviation is held against the model.
TOLD = 0.8
COLOURS = ((BEFORE, DASHED, (6, 3)), (AFTER, "-", ()))


def transmissibility(runs: Runs) -> Exhibit:
    """Return magnitude, phase and coherence of ``runs``.

    Raises:
        InputError: the runs are too short.
    """
    measured = cross_spectra(runs.body, runs.measured, runs.period)
    models = {name: cross_spectra(runs.body, rows, runs.period) for name, rows in runs.simulated.items()}
    excited = measured.excited
    known = np.flatnonzero(excited)
    if not known.size:
        raise InputError("the body is hardly shaken at any frequency")
    # From the first line that the body shakes to the last one; lines between that it does not stay empty.
    shown = slice(int(known[0]), int(known[-1]) + 1)
    empty = np.where(excited, 1.0, np.nan)[shown]
    frequency = measured.frequency[shown]
    size, error = np.abs(measured.response), measured.relative_error
    low, high = (size * np.maximum(1.0 + sign * Z_95 * error, LEAST_BAND) for sign in (-1.0, 1.0))
    phase, spread = empty * _degrees(measured, shown), np.degrees(Z_95 * np.minimum(error, np.pi))
    figure, axes = plt.subplots(
        3, 1, figsize=(WIDTH, 7.0), layout="constrained", sharex=True, height_ratios=(3, 2, 1.3)
    )
    axes[0].fill_between(
        frequency, (empty * low[shown]), (empty * high[shown]), color=MEASURED, alpha=0.35, lw=0
    )
    axes[0].plot(frequency, (empty * size[shown]), color=MEASURED, lw=2.6, label="measured, with 95 % band")
    axes[1].fill_between(
        frequency, phase - spread[shown], phase + spread[shown], color=MEASURED, alpha=0.35, lw=0
    )
    axes[1].plot(frequency, phase, color=MEASURED, lw=2.6)
    axes[2].plot(frequency, (empty * measured.coherence[shown]), color=MEASURED, lw=2.6)
    looks = dict(zip(models, COLOURS[-len(models) :], strict=True))
    for name, found in models.items():
        colour, dash, _ = looks[name]
        axes[0].plot(
            frequency, empty * np.abs(found.response)[shown], color=colour, ls=dash, lw=1.2, label=name
        )
        axes[1].plot(frequency, empty * _degrees(found, shown), color=colour, ls=dash, lw=1.2)
        axes[2].plot(frequency, empty * found.coherence[shown], color=colour, ls=dash, lw=1.0)
    axes[0].set_xscale("log")
    axes[0].set_yscale("log")
    axes[0].axhline(1.0, color=DARK, lw=0.6)
    axes[2].set_ylim(0.0, 1.05)
    plain(axes[0], "", "magnitude, spool over body, 1")
    plain(axes[1], "", "phase, degrees")
    plain(axes[2], "frequency, Hz", "coherence, 1")
    axes[0].legend(fontsize=8, frameon=False)
    size_line = Line(
        "measured", (empty * size[shown]), MEASURED, (), (empty * low[shown]), (empty * high[shown]), 2.5
    )
    phase_line = Line("measured", phase, MEASURED, (), phase - spread[shown], phase + spread[shown], 2.5)
    coherence = Line("measured", (empty * measured.coherence[shown]), MEASURED, width=2.5)
    panels = tuple(
        Panel("frequency, Hz", label, frequency, (own, *lines), log_x=True, log_y=log)
        for label, own, lines, log in (
            (
                "magnitude, 1",
                size_line,
                _lines(models, looks, lambda s: empty * np.abs(s.response)[shown]),
                True,
            ),
            (
                "phase, degrees",
                phase_line,
                _lines(models, looks, lambda s: empty * _degrees(s, shown)),
                False,
            ),
            ("coherence, 1", coherence, _lines(models, looks, lambda s: empty * s.coherence[shown]), False),
        )
    )
    return Exhibit(TITLE, figure, CAPTION, _seen(measured, models, excited), panels)


def _lines(
    models: Mapping[str, CrossSpectra],
    looks: Mapping[str, tuple[str, object, tuple[int, ...]]],
    take: Callable[[CrossSpectra], Array],
) -> tuple[Line, ...]:
    return tuple(Line(name, take(found), looks[name][0], looks[name][2]) for name, found in models.items())


def _degrees(spectra: CrossSpectra, shown: slice) -> Array:
    """Return the phase, degrees, from -270 to 90: a spool lags behind its body."""
    angle = np.degrees(np.angle(spectra.response[shown]))
    return np.asarray(np.where(angle > 90.0, angle - 360.0, angle))


def _seen(measured: CrossSpectra, models: dict[str, CrossSpectra], shown: NDArray[np.bool_]) -> str:
    """Return peak, coherence there, and how much of the band each model keeps to."""
    places = np.flatnonzero(shown)
    told = places[measured.coherence[places] > TOLD]
    # Where the coherence is low a peak may be noise over little drive.
    places = told if told.size else places
    peak = places[int(np.argmax(np.abs(measured.response)[places]))]
    parts = [
        f"measured peak {number(float(np.abs(measured.response[peak])), 3)} at "
        f"{number(float(measured.frequency[peak]), 3)} Hz, coherence {measured.coherence[peak]:.2f} there"
    ]
    for name, found in models.items():
        inside = within(measured, found, told)
        own = places[int(np.argmax(np.abs(found.response)[places]))]
        parts.append(
            f"{name}: peak {number(float(np.abs(found.response[own])), 3)} at "
            f"{number(float(found.frequency[own]), 3)} Hz"
            + (
                f", within the band at {100.0 * inside:.0f} % of the lines with a coherence above {TOLD:g}"
                if told.size
                else ""
            )
        )
    if not told.size:
        parts.append(f"the coherence nowhere exceeds {TOLD:g}, so no line is held against a model")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def within(measured: CrossSpectra, model: CrossSpectra, places: Sequence[int] | NDArray[np.intp]) -> float:
    """Return the share of ``places`` at which ``model`` keeps to the measured 95 % band; NaN of none."""
    chosen = np.asarray(places, dtype=np.intp)
    if not chosen.size:
        return float("nan")
    apart = np.abs(np.abs(model.response[chosen]) - np.abs(measured.response[chosen]))
    width = Z_95 * measured.relative_error[chosen] * np.abs(measured.response[chosen])
    return float(np.mean(apart <= width))
