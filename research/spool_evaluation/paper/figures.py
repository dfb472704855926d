"""Figures 6 to 17 of the paper, from made data and fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .data import MODELS, SERIES, PaperSeries
from .fit import PaperFit, waveform_step
from .simulation import SteppedResponse

#: Okabe and Ito's colours with a marker each: distinct for the colour-blind and in print.
BODY, SPOOL, MEASURED = "#0072B2", "#D55E00", "#999999"
MODEL_STYLES = {
    "microwedge": ("#E69F00", "o"),
    "mixed": ("#0072B2", "s"),
    "coulomb_hydrodynamic": ("#009E73", "^"),
    "fluid": ("#CC79A7", "D"),
}
SERIES_STYLES = {1: ("#E69F00", "o"), 2: ("#0072B2", "s"), 3: ("#009E73", "^"), 4: ("#CC79A7", "D")}
MODEL_NAMES = {model.name: f"model {model.number} {model.equation}" for model in MODELS}

Fits = Mapping[tuple[int, str], PaperFit]


def amplitude_figure(data: Mapping[int, SteppedResponse]) -> Figure:
    """Return figures 6 to 9: amplitudes of body and spool over frequency, one panel a series."""
    figure, panels = _panels("frequency, Hz", "acceleration amplitude, m/s²")
    for axis, series in zip(panels, SERIES, strict=True):
        response = data[series.number]
        frequencies = response.plan.frequencies
        axis.plot(frequencies, response.body_amplitudes, color=BODY, marker="s", ms=4, label="body")
        axis.plot(frequencies, response.spool_amplitudes, color=SPOOL, marker="o", ms=4, label="spool")
        axis.axvline(series.valve.natural_frequency, color="#666666", lw=1, ls=":", label="natural frequency")
        axis.set_ylim(0.0, None)
        axis.set_title(f"as Fig. {series.figure}: {series.label}", fontsize=10)
    panels[0].legend(fontsize=8)
    return figure


def comparison_figure(data: Mapping[int, SteppedResponse]) -> Figure:
    """Return figures 10 and 11: body and spool of all series."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots(1, 2)
    for series in SERIES:
        response, (colour, marker) = data[series.number], SERIES_STYLES[series.number]
        style = {"color": colour, "marker": marker, "ms": 4, "label": f"{series.number}: {series.label}"}
        axes[0].plot(response.plan.frequencies, response.body_amplitudes, **style)
        axes[1].plot(response.plan.frequencies, response.spool_amplitudes, **style)
    axes[0].set_ylim(0.0, 1.3 * max(float(data[series.number].body_amplitudes.max()) for series in SERIES))
    axes[1].set_ylim(0.0, None)
    axes[0].set_title("as Fig. 10: body", fontsize=10)
    axes[1].set_title("as Fig. 11: spool", fontsize=10)
    axes[1].legend(fontsize=8)
    for axis in axes:
        _label(axis, "frequency, Hz", "acceleration amplitude, m/s²")
    return figure


def objective_figure(fits: Fits) -> Figure:
    """Return figure 12: the objective by model and series, ours and the print; scales are their own."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots(1, 2)
    for place, model in enumerate(MODELS):
        colour, _ = MODEL_STYLES[model.name]
        at = np.arange(len(SERIES)) + 0.2 * (place - 1.5)
        name = MODEL_NAMES[model.name]
        ours = [fits[series.number, model.name].objective for series in SERIES]
        axes[0].bar(at, ours, 0.18, color=colour, label=name)
        axes[1].bar(at, [model.objective[series.number] for series in SERIES], 0.18, color=colour, label=name)
    for axis, title in zip(axes, ("as Fig. 12: made data", "Fig. 12 as printed: tables 3 to 6"), strict=True):
        axis.set_yscale("log")
        axis.set_xticks(range(len(SERIES)), [f"{s.spring_stiffness:g} N/m\n{s.oil}" for s in SERIES])
        axis.tick_params(axis="x", labelsize=8)
        axis.set_title(title, fontsize=10)
        axis.set_ylabel("objective (33), no unit")
        axis.grid(axis="y", alpha=0.3)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=len(MODELS))
    return figure


def waveform_figure(response: SteppedResponse, series: PaperSeries, fits: Fits) -> Figure:
    """Return figure 13: the spool's acceleration at 60 Hz, data in grey, the four models in colour."""
    step = waveform_step(response)
    frequency = response.plan.frequencies[step]
    shown = min(response.plan.samples, round(3.0 / frequency * response.plan.sample_rate))
    time = 1e3 * np.arange(shown) / response.plan.sample_rate
    figure, panels = _panels("time, ms", "spool acceleration, m/s²")
    for axis, model, letter in zip(panels, MODELS, "abcd", strict=True):
        fit = fits[series.number, model.name]
        axis.plot(time, response.spool[step, :shown], color=MEASURED, lw=3, label="data")
        axis.plot(time, fit.waveform[:shown], color=BODY, lw=1.2, label="model")
        axis.set_title(f"({letter}) {MODEL_NAMES[model.name]}, {frequency:g} Hz", fontsize=10)
    panels[0].legend(fontsize=8)
    return figure


def ratio_figure(data: Mapping[int, SteppedResponse], fits: Fits) -> Figure:
    """Return figures 14 to 17: fitted over measured amplitude, one panel a series."""
    figure, panels = _panels("frequency, Hz", "amplitude ratio a_est / a_pom")
    for axis, series in zip(panels, sorted(SERIES, key=lambda entry: entry.ratio_figure), strict=True):
        response = data[series.number]
        for model in MODELS:
            colour, marker = MODEL_STYLES[model.name]
            ratio = np.array(fits[series.number, model.name].amplitudes) / response.spool_amplitudes
            name = MODEL_NAMES[model.name]
            axis.plot(response.plan.frequencies, ratio, color=colour, marker=marker, ms=4, lw=1, label=name)
        axis.axhline(1.0, color="#444444", lw=1)
        axis.set_title(f"as Fig. {series.ratio_figure}: {series.label}", fontsize=10)
    panels[0].legend(fontsize=8)
    return figure


def lock_figure(
    series: PaperSeries,
    measured: SteppedResponse,
    printed: SteppedResponse,
    friction: tuple[Sequence[float], Sequence[float]],
) -> Figure:
    """Return the picture of table 4's values at work: amplitudes of body and spool, and the friction law.

    ``friction`` is the relative velocity (m/s) and the force (N) of the mixed friction as printed.
    """
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots(1, 2)
    frequencies = printed.plan.frequencies
    axes[0].plot(
        measured.plan.frequencies,
        measured.spool_amplitudes,
        color=MEASURED,
        marker="o",
        ms=4,
        label="spool, made data",
    )
    axes[0].plot(frequencies, printed.body_amplitudes, color=BODY, lw=4, alpha=0.5, label="body")
    axes[0].plot(
        frequencies, printed.spool_amplitudes, color=SPOOL, ls="--", marker="s", ms=4, label="spool, table 4"
    )
    axes[0].set_ylim(0.0, None)
    axes[0].legend(fontsize=8)
    axes[0].set_title(f"model 2 with table 4: {series.label}", fontsize=10)
    _label(axes[0], "frequency, Hz", "acceleration amplitude, m/s²")
    axes[1].semilogy(friction[0], friction[1], color=SPOOL, label="friction with table 4")
    largest = series.valve.moving_mass * printed.plan.amplitude
    axes[1].axhline(largest, color=BODY, ls="--", label=f"largest inertia force, {largest:.2g} N")
    axes[1].legend(fontsize=8)
    axes[1].set_title("what would have to be overcome", fontsize=10)
    _label(axes[1], "relative velocity, m/s", "force, N")
    return figure


def _panels(across: str, up: str) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    panels = list(figure.subplots(2, 2, sharex=True).ravel())
    for number, axis in enumerate(panels):
        _label(axis, across if number > 1 else "", up if number % 2 == 0 else "")
    return figure, panels


def _label(axis: Axes, across: str, up: str) -> None:
    axis.set_xlabel(across)
    axis.set_ylabel(up)
    axis.grid(alpha=0.3)
