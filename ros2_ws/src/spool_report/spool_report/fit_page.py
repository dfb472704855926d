"""Report of an identification: the page and its pictures.

Everywhere models come by name, in the order in which they are to be seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, islice

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from spool_core.numbers import Array
from spool_core.uncertainty import LEGEND
from spool_estimator.identification.determination import sentences
from spool_estimator.identification.fit_result import Agreement

from spool_report import fit_curves as curves
from spool_report import fit_tables as tables
from spool_report import page as html
from spool_report.evidence.collection import fit_exhibits
from spool_report.evidence.exhibit import DARK, MEASURED, STYLES, subplots
from spool_report.outputs import sources
from spool_report.ranking import WORTH, FittedSeries, Rank, Ranking, ValidatedFit
from spool_report.terminal import captions, spoken

_CAPTIONS = captions("fit")
RATIO_SHOWN = (0.0, 2.0)


def fit_page(validated: ValidatedFit) -> str:
    """Return the page of a fit that has a result."""
    found = validated.fit
    title = f"{spoken(found.model.name)} fitted to {validated.data.name}"
    doubts = [f"Warning: {doubt}" for doubt in validated.data.doubts]
    waveform, *others = pictures([validated])
    error = validated.held_out_error
    held = f"{100.0 * error:.2g} % of its rms" if math.isfinite(error) else "not known: no data were held out"
    worst = [*found.warnings, *doubts][:2]
    exhibits = html.evidence(fit_exhibits(found, validated.data.valve, validated.data.fitted))
    sections: list[str] = [
        html.verdict(summary(validated)),
        html.answers(
            [
                ("How sure", f"Error on data that the fit has not seen: {held}. {LEGEND}."),
                ("What to do", " ".join(worst) or "Look at the picture below, then use the numbers."),
            ]
        ),
        waveform,
        html.heading("Parameters"),
        html.listing(sentences(found.determinations)),
        html.table(tables.parameter_table(found)),
        html.paragraph(
            f"{LEGEND}; the true value lies within it in 95 of 100 such records, if the model is right."
        ),
        *(html.listing(lines) for lines in (tables.correlations(found), found.warnings, doubts) if lines),
        html.heading("Quality of the fit"),
        html.table(tables.quality_table(validated)),
        html.section("Amplitude, friction and spectrum", others),
        html.section("Evidence", [html.paragraph(_CAPTIONS["evidence"]), *exhibits]),
    ]
    records = (*validated.data.paths, *validated.data.held_paths)
    return html.page(title, sections, sources(records, validated.data.valve))


def pictures(validated: Sequence[ValidatedFit]) -> list[Markup]:
    """Return the pictures of models that have a result on one set of data."""
    data = validated[0].data
    fitted, valve = data.fitted, data.valve
    overlays = {one.name: curves.overlay(fitted, one.fit, valve) for one in validated}
    agreements = {one.name: one.fit.agreement for one in validated if one.fit.agreement is not None}
    run = overlays[validated[0].name].run
    friction = {one.name: curves.friction(fitted, one.fit, valve) for one in validated}
    return [
        html.drawing(waveform_figure(overlays, curves.excerpts(run)), _CAPTIONS["waveform"], seen(validated)),
        html.drawing(
            ratio_figure(agreements, curves.highest_frequency(run)), _CAPTIONS["ratio"], ratio_seen(validated)
        ),
        html.drawing(
            friction_figure(friction), _CAPTIONS["friction"], f"Laws over velocity: {', '.join(friction)}."
        ),
        html.drawing(
            spectrum_figure(agreements, curves.spectra(fitted)), _CAPTIONS["spectrum"], seen(validated)
        ),
    ]


def seen(validated: Sequence[ValidatedFit]) -> str:
    """Return what a picture of waveforms or of residuals shows, in numbers."""
    parts = [f"{spoken(one.name)} leaves {100.0 * one.training_error:.2g} %" for one in validated]
    return f"Of the measured rms {', '.join(parts)}." if parts else ""


def ratio_seen(validated: Sequence[ValidatedFit]) -> str:
    """Return what a picture of amplitude ratios shows, in numbers."""
    ratios = [(spoken(one.name), one.fit.agreement) for one in validated]
    parts = [f"{name} {found.amplitude_ratio:.3f}" for name, found in ratios if found is not None]
    return f"Mean amplitude ratio: {', '.join(parts)}." if parts else ""


def summary(validated: ValidatedFit) -> str:
    """Return in one sentence how much of the motion the model explains."""
    found = validated.fit
    error = validated.held_out_error
    where = "data that it has not seen"
    if not np.isfinite(error):
        error, where = validated.training_error, "the data it was fitted to"
    state = "" if found.converged else " The descent did not converge: distrust the numbers."
    return (
        f"With these parameters {spoken(found.model.name)} gives the spool's acceleration on "
        f"{where} to within {100.0 * error:.2g} % of its rms.{state}"
    )


def compare_page(series: Sequence[FittedSeries], ranking: Ranking) -> str:
    """Return the page of a comparison in which at least one model has a result."""
    shown = [entry for entry in ranking.ranks if math.isfinite(entry.error)]
    best = ranking.preferred
    errors = [entry.held_out_error for entry in shown if entry.model == best]
    sure = f"{100.0 * errors[0]:.2g} % of its rms" if errors and math.isfinite(errors[0]) else "not known"
    use = f"Use {spoken(best)}." if best is not None else "Do not use them yet: see the reasons below."
    first, *rest = [_series(one, ranking) for one in series]
    sections: list[str] = [
        html.verdict(" ".join(ranking.sentences)),
        html.answers([("How sure", f"Error of the best on unseen data: {sure}."), ("What to do", use)]),
        *first[:1],
        html.drawing(
            ranking_figure(shown),
            "Models, best first: error above the least, and error on held-out data.",
            f"From best to worst: {', '.join(spoken(entry.model) for entry in shown)}.",
        ),
        html.table(tables.ranking_table(ranking)),
        html.listing([one.format(worth=100.0 * WORTH) for one in captions("compare")["columns"]]),
    ]
    sections += [part for parts in (first[1:], *rest) for part in parts]
    records = [path for one in series for path in (*one.data.paths, *one.data.held_paths)]
    made_from = [*sources(records), *(row for one in series for row in sources((), one.data.valve))]
    title = f"Models of {', '.join(one.data.name for one in series)}"
    return html.page(title, sections, list(dict.fromkeys(made_from)))


def styles(names: Sequence[str]) -> dict[str, tuple[str, object, str]]:
    """Return colour, dash and marker of each name."""
    return dict(zip(names, islice(cycle(STYLES), len(names)), strict=True))


def waveform_figure(overlays: Mapping[str, curves.Overlay], excerpts: Sequence[curves.Excerpt]) -> Figure:
    """Return the spool's acceleration, measured and simulated, above the residual; a column each."""
    looks = styles(list(overlays))
    figure, axes = subplots(5.8, 2, len(excerpts), sharex="col", squeeze=False, height_ratios=(3, 2))
    for column, excerpt in enumerate(excerpts):
        upper, lower = axes[0, column], axes[1, column]
        for number, (name, shown) in enumerate(overlays.items()):
            colour, dash, _ = looks[name]
            period = shown.run.records[shown.run.windows[excerpt.window].record].sample_period
            time = 1e3 * period * np.arange(excerpt.stop - excerpt.first)
            measured, simulated = shown.measured(excerpt), shown.simulated(excerpt)
            if number == 0:
                upper.plot(time, measured, color=MEASURED, lw=3.5, alpha=0.7, label="measured")
            upper.plot(time, simulated, color=colour, ls=dash, lw=1.2, label=spoken(name))
            lower.plot(time, simulated - measured, color=colour, ls=dash, lw=1.0)
        upper.set_title(f"{excerpt.title}, from {excerpt.start:.2f} s", fontsize=10)
        _label(upper, "", "spool acceleration, m/s²" if column == 0 else "")
        _label(lower, "time, ms", "model − measured, m/s²" if column == 0 else "")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=min(4, len(names)))
    return figure


def ratio_figure(agreements: Mapping[str, Agreement], highest: float) -> Figure:
    """Return the amplitude ratio a_est/a_pom over frequency, up to ``highest`` Hz."""
    looks = styles(list(agreements))
    figure, axis = subplots(3.8)
    axis.axhline(1.0, color=DARK, lw=0.8)
    axis.axhspan(0.95, 1.05, color="#dddddd", lw=0, zorder=0, label="5 % of the paper's chain")
    for name, found in agreements.items():
        colour, dash, marker = looks[name]
        known = np.isfinite(found.amplitude_ratios) & (found.frequencies <= highest)
        mean = "" if np.isnan(found.amplitude_ratio) else f", mean {found.amplitude_ratio:.3f}"
        axis.plot(
            found.frequencies[known], found.amplitude_ratios[known], color=colour, ls=dash, marker=marker,
            ms=4, lw=1.2, label=spoken(name) + mean,
        )  # fmt: skip
    low, high = axis.get_ylim()
    axis.set_ylim(max(RATIO_SHOWN[0], min(low, 0.9)), min(RATIO_SHOWN[1], max(high, 1.1)))
    axis.set_xlim(0.0, highest)
    _label(axis, "frequency, Hz", "amplitude ratio $a_{est}/a_{pom}$")
    axis.legend(fontsize=8, loc="best", ncols=2)
    return figure


def friction_figure(laws: Mapping[str, curves.FrictionCurve]) -> Figure:
    """Return measured and fitted friction over velocity, one panel a model, all of one scale."""
    looks = styles(list(laws))
    columns = 2 if len(laws) in (2, 4) else min(3, len(laws))
    rows = -(-len(laws) // columns)
    height = 3.0 * rows + 0.4 if columns > 1 else 4.6
    figure, axes = subplots(height, rows, columns, sharex=True, sharey=True, squeeze=False)
    panels = list(axes.ravel())
    for number, (name, found) in enumerate(laws.items()):
        axis = panels[number]
        axis.plot(
            found.velocity, found.force, ls="", marker=".", ms=2, mew=0, color="#bbbbbb", rasterized=True,
            zorder=1, label="measured, every sample",
        )  # fmt: skip
        axis.errorbar(
            found.centres, found.measured, yerr=(found.measured - found.low, found.high - found.measured),
            color=DARK, ls="", marker=".", ms=5, lw=0.8, zorder=3, label="measured, median and quartiles",
        )  # fmt: skip
        axis.plot(found.centres, found.law, color=looks[name][0], lw=1.8, zorder=2, label="model")
        axis.axhline(0.0, color=MEASURED, lw=0.6)
        axis.axvline(0.0, color=MEASURED, lw=0.6)
        axis.set_title(spoken(name), fontsize=10)
        last_row = number + columns >= len(laws)
        _label(
            axis, "relative velocity, m/s" if last_row else "", "force, N" if number % columns == 0 else ""
        )
        axis.tick_params(labelbottom=last_row)
    for axis in panels[len(laws) :]:
        axis.set_visible(False)
    extents = [np.abs([*one.low, *one.high]).max(initial=0.0) for one in laws.values()]
    reach = 1.3 * float(max(extents))
    across = 1.05 * max(float(np.abs(one.centres).max(initial=0.0)) for one in laws.values())
    if reach > 0.0 and across > 0.0:
        panels[0].set_ylim(-reach, reach)
        panels[0].set_xlim(-across, across)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=3, markerscale=1.5)
    return figure


def spectrum_figure(agreements: Mapping[str, Agreement], measured: tuple[Array, Array, float]) -> Figure:
    """Return the spectrum of what each model leaves over, beside the measured one and the noise floor.

    ``measured``: frequency (Hz), power density ((m/s^2)^2/Hz) of the spool, and the noise floor.
    """
    looks = styles(list(agreements))
    figure, axis = subplots(4.2)
    frequency, density, floor = measured
    axis.semilogy(
        frequency[1:], np.sqrt(density[1:]), color=MEASURED, lw=3, alpha=0.6, label="measured spool"
    )
    for name, found in agreements.items():
        colour, dash, _ = looks[name]
        axis.semilogy(
            found.residual_frequencies[1:], np.sqrt(found.residual_spectrum[1:]), color=colour, ls=dash,
            lw=1.1, label=f"{spoken(name)}: model − measured",
        )  # fmt: skip
    axis.axhline(
        np.sqrt(floor), color=DARK, lw=1.0, ls=":", label="noise floor of the spool's sensor, at most"
    )
    # Where nothing but noise is left there is nothing to see.
    busy = np.flatnonzero(density > 30.0 * floor)
    axis.set_xlim(0.0, min(float(frequency[-1]), 1.3 * float(frequency[busy[-1]]) if busy.size else np.inf))
    _label(axis, "frequency, Hz", "spectral density, (m/s²)/√Hz")
    axis.legend(fontsize=8, ncols=2)
    return figure


def ranking_figure(ranks: Sequence[Rank]) -> Figure:
    """Return ``ranks``, best first, as a picture, the best on top."""
    looks = styles([entry.model for entry in ranks])
    figure, axes = subplots(1.2 + 0.5 * len(ranks), 1, 2, sharey=True)
    axes[0].set_xscale("symlog", linthresh=100.0 * WORTH, linscale=0.7)
    axes[0].axvspan(0.0, 100.0 * WORTH, color="#e4e4e4", lw=0, zorder=0, label="equally well")
    for place, entry in enumerate(ranks):
        colour, _, marker = looks[entry.model]
        for axis, value, text in (
            (axes[0], 100.0 * entry.excess, f"{100.0 * entry.excess:+.1f} %"),
            (axes[1], entry.held_out_error, f"{entry.held_out_error:.4f}"),
        ):
            if np.isfinite(value):
                axis.hlines(place, 0.0, value, color=colour, lw=2)
                axis.plot(value, place, color=colour, marker=marker, ms=7, clip_on=False)
                axis.annotate(
                    text, (value, place), xytext=(9, 0), textcoords="offset points", va="center", fontsize=8
                )
    axes[0].set_yticks(
        range(len(ranks)),
        [f"{spoken(entry.model)}\n{entry.parameters} parameters" for entry in ranks],
        fontsize=9,
    )
    axes[0].set_xlim(0.0, max(1000.0 * WORTH, 12.0 * max(100.0 * entry.excess for entry in ranks)))
    axes[0].xaxis.set_major_formatter("{x:g}")
    axes[0].set_ylim(len(ranks) - 0.5, -0.5)
    axes[0].legend(fontsize=8, loc="upper right")
    _label(axes[0], "error above the least, % of it", "")
    finite = [entry.held_out_error for entry in ranks if np.isfinite(entry.held_out_error)]
    axes[1].set_xlim(0.0, 1.3 * max(finite) if finite else 1.0)
    _label(axes[1], "error on held-out data, share of the spool's rms", "")
    return figure


def _series(one: FittedSeries, ranking: Ranking) -> list[Markup]:
    """Return the measured and simulated waveforms of a series first, then its table and pictures."""
    order = [entry.model for entry in ranking.ranks]
    validated = sorted(
        (entry for entry in one.validated if entry.fit.reason is None),
        key=lambda entry: order.index(entry.name),
    )
    table = tables.series_table(one)
    rows = [
        (*row, "; ".join(tables.parameter_lines(validated)))
        for row, validated in zip(table.rows, one.validated, strict=True)
    ]
    waveform, *others = pictures(validated) if validated else [html.paragraph("No model has a result.")]
    title = f"{one.data.name} ({one.data.valve.id})"
    return [
        waveform,
        html.heading(title),
        html.table(replace(table, columns=(*table.columns, "parameters"), rows=rows)),
        html.paragraph(f"{LEGEND}. 'Not told': only combinations of them act."),
        html.listing(tables.determined_lines(one)),
        *([html.section(f"Amplitude, friction and spectrum of {title}", others)] if others else []),
    ]


def _label(axis: Axes, across: str, up: str) -> None:
    axis.set_xlabel(across)
    axis.set_ylabel(up)
    axis.grid(alpha=0.25)
